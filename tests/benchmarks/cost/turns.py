"""How often the loops of an image run at most, from the text that they are compiled from.

The compiler notes which line each instruction comes from. A loop of the text states its bound beside it,
which tests/proofs prove for any memory contents. An AVR has more loops: of shifts, by counts that C's lemmas
keep below the width, and of copies, which count down from a constant.
"""

from __future__ import annotations

import re
from collections import defaultdict
from functools import cache
from itertools import pairwise

from elftools.elf.elffile import ELFFile

from .flow import CALL, Flow
from .images import FIRMWARE, PORTS, Image, Instruction
from .ways import Entries, Loop, parts

_STATED = re.compile(r"\b(?:for|while) \(.*/\* at most (\d+)")
_SHIFT = re.compile(r"(?:<<|>>)=? *(?:(\d+)(?! *\*)|\([\w>-]+ & (\d+)U?\))?")
_SHIFT_STATED = re.compile(r"/\* .*shift by at most (\d+)")
_LONGEST_SHIFT = 31
"""Of a shift of a word that is not by a constant: no lemma allows the width."""
_ASSIGNED = re.compile(r"\s*(?:mcp_asdf_t )?\*?\w+ = .*;|\s*\*?\w+ = \(mcp_asdf_t\)\{")
_STORES = {"sw": 4, "sh": 2, "sb": 1, "st": 1, "std": 1}
"""Bytes by instructions of the processors whose compilers copy in a loop of their own."""
_OF_LIBRARY = {"__ashldi3": 7, "__lshrdi3": 7, "__ashrdi3": 7}
"""Turns of the loops, one of bytes and one of bits, in avr-libgcc's shifts of 64 bits by at most 63."""
_COPIES = {"memcpy", "memset"}
"""Loops of c_ref/ports/memory.c, which copy or clear a robot at most."""


class Turns:
    """A bound of the image's loops, for ``LongestWay``."""

    def __init__(self, image: Image, flow: Flow) -> None:
        self._flow, self._robot = flow, int(image.symbols["robot"]["st_size"])
        texts = _texts(image)
        self._texts = {
            number: texts[line.address] for number, line in enumerate(flow.lines) if line.address in texts
        }
        self._following = {number: flow.following(number) for number in range(len(flow.lines))}
        self._before: dict[int, set[int]] = defaultdict(set)
        for number, following in self._following.items():
            for each in following:
                self._before[each].add(number)

    def __call__(self, loop: Loop, entries: Entries) -> tuple[int, int]:
        """As ``ways.Bound`` says. Raises ValueError if nothing bounds the loop."""
        function, entry = self._flow.lines[min(loop)].function, min(entries)
        if function in _OF_LIBRARY:
            return entry, _OF_LIBRARY[function] + 1
        if function in _COPIES:
            return entry, self._robot + 1
        if len(entries) > 1:
            return self._with_entries(loop)
        counted = self._counted(loop, entry)
        if counted is not None:
            return entry, counted
        tests = {each: turns for each in loop - self._within(loop, entry) if (turns := self._stated(each))}
        if not tests:
            return entry, 1 + (self._longest_shift(loop) or self._turns_of_copy(loop))
        is_test = entry in tests or self._is_left_at_once(loop, entry)
        return entry, max(tests.values()) + is_test

    def _stated(self, number: int) -> int:
        """The bound beside the loop to whose line an instruction belongs; 0 if there is none."""
        found = _STATED.search(self._texts.get(number, ""))
        return int(found[1]) if found else 0

    def _longest_shift(self, loop: Loop) -> int:
        """The most bits that a line of the loop shifts by; 0 if none does. A loop is not counted down from a
        constant here, so constant shifts of the line are others: beside them, it may be any."""
        counts = [0]
        for text in {self._texts.get(each, "") for each in loop}:
            stated = _SHIFT_STATED.search(text)
            other = int(stated[1]) if stated else _LONGEST_SHIFT
            shifts = _SHIFT.findall(text.split("/*")[0])
            counts += [int(mask or other) for constant, mask in shifts if not constant]
            if shifts and all(constant for constant, _ in shifts):
                counts.append(_LONGEST_SHIFT)
        return max(counts)

    def _turns_of_copy(self, loop: Loop) -> int:
        """Turns of an assignment of a structure, of which a robot is the largest."""
        stored = sum(_STORES.get(self._flow.lines[each].name, 0) for each in loop)
        if not any(_ASSIGNED.match(self._texts.get(each, "")) for each in loop) or stored == 0:
            raise ValueError(f"nothing bounds a loop in {self._flow.lines[min(loop)].function}")
        return -(-self._robot // stored)

    def _within(self, loop: Loop, entry: int) -> set[int]:
        """Instructions of the loops within this one."""
        graph = {each: [one for one in self._following[each] if one in loop - {entry}] for each in loop}
        inner = (part for part in parts(graph, entry) if len(part) > 1 or part <= set(graph[min(part)]))
        return set().union(*inner)

    def _is_left_at_once(self, loop: Loop, entry: int) -> bool:
        """True if the loop may end before the first jump, so that it tests before it turns."""
        number = entry
        while len(self._following[number]) == 1:
            (number,) = self._following[number]
        return not loop.issuperset(self._following[number])

    def _with_entries(self, loop: Loop) -> tuple[int, int]:
        """Of a loop that is entered in several places: an instruction without which least goes round. If all
        is of one loop of the text, any of them runs at most once in each turn and once more for the test;
        those of shifts, which may be loops themselves, are left out."""
        tests = {self._texts[each]: self._stated(each) for each in loop if self._stated(each)}
        if len(tests) != 1:
            raise ValueError(f"nothing bounds a loop in {self._flow.lines[min(loop)].function}")
        outside = [each for each in sorted(loop) if not _SHIFT.search(self._texts.get(each, "<<"))]
        cut = min(outside, key=lambda each: len(self._within(loop, each)))
        return cut, 1 + max(tests.values())

    def _counted(self, loop: Loop, entry: int) -> int | None:
        """Turns of an AVR's loop that counts a register down to 0 from a constant loaded before it."""
        *_, count, last = sorted(loop)
        lines = self._flow.lines
        if lines[last].name != "brne" or lines[count].name != "dec" or self._following[last][0] != entry:
            return None
        register = lines[count].operands.strip()
        if sum(_touches(lines[each], register) for each in loop) > 1:
            return None
        number = entry
        while self._before[number] - loop == {number - 1}:
            number -= 1
            line = lines[number]
            operands = [each.strip() for each in line.operands.split(";")[0].split(",")]
            if operands[0] == register and line.name in ("ldi", "mov"):
                if line.name == "ldi":
                    return int(operands[1], 0)
                register = operands[1]
            elif _touches(line, register):
                return None
        return None


def _touches(line: Instruction, register: str) -> bool:
    """True unless an instruction certainly leaves an AVR's register as it is."""
    number = int(register[1:])
    pairs = ("movw", "adiw", "sbiw", "ld", "ldd", "lpm", "lds")
    named = {register} if line.name not in pairs else {register, f"r{number & ~1}"}
    by_name = CALL.fullmatch(line.name) or (number < 2 and "mul" in line.name)
    return bool(by_name or named & set(re.findall(r"\br\d+", line.operands)))


def _texts(image: Image) -> dict[int, str]:
    """Lines of C that instructions are compiled from, by address; none of a compiler's own library."""
    texts: dict[int, str] = {}
    with image.path.open("rb") as stream:
        program = ELFFile(stream).get_dwarf_info()
        for unit in program.iter_CUs():
            lines = program.line_program_for_CU(unit)
            assert lines is not None
            files = [each.name.decode() for each in lines["file_entry"]]
            states = [each.state for each in lines.get_entries() if each.state is not None]
            for state, following in pairwise(states):
                text = "" if state.end_sequence else _text(files[state.file - 1], state.line)
                texts.update((address, text) for address in range(state.address, following.address) if text)
    return texts


def _text(name: str, line: int) -> str:
    """One line of the firmware's C; nothing of what is not the firmware's."""
    lines = _sources().get(name, [])
    return lines[line - 1] if 0 < line <= len(lines) else ""


@cache
def _sources() -> dict[str, list[str]]:
    files = [*FIRMWARE.glob("*.[ch]"), PORTS / "memory.c"]
    return {each.name: each.read_text(encoding="utf-8").splitlines() for each in files}
