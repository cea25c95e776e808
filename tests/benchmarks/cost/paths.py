"""Bounds from the machine code: the longest path through a function, and its deepest stack."""

from __future__ import annotations

import re
from collections import defaultdict

from .images import CLONE, FIRMWARE, Image, Instruction
from .loops import bounds_in, longest_path

_CALL = re.compile(r"bl|jal|call|rcall")
_TARGET = re.compile(r"(?:0x)?([0-9a-f]+) <")
_BRANCH = re.compile(r"(?!bic|bf[ci]|bkpt)b\w+(\.[nw])?|b(\.[nw])?|cbn?z|j|jal|r?jmp|r?call")
_INDIRECT_CALL = re.compile(r"blx|jalr|e?icall")
_COMPUTED = re.compile(r"tb[bh]|ijmp|mov\s+pc|jr\s+(?!ra)|bx\s+(?!lr)|ldr(\.w)?\s+pc, \[(?!sp)")
_END = re.compile(r"(ret|reti|jr|bx|udf)\b|(pop|ldm\w*).*\bpc\b|(ldr|mov)(\.w)?\s+pc")
_JUMP = re.compile(r"b(\.[nw])?|j|r?jmp")
_DOWN = (
    re.compile(r"(?:push|stmdb(?:\.w)? sp!,)(?:\.w)? \{(?P<list>.*)\}"),
    re.compile(r"sub(?:w|\.w)? sp, (?:sp, )?#(?P<bytes>\d+)"),
    re.compile(r"strd?(?:\.w)? .*\[sp, #-(?P<bytes>\d+)\]!"),
    re.compile(r"addi sp,sp,-(?P<bytes>\d+)"),
    re.compile(r"push (?P<list>r\d+)$"),
)
"""Instructions that move the stack pointer down by a constant."""


class Paths:
    """The instructions of an image, and bounds of its functions for any data."""

    def __init__(self, image: Image) -> None:
        self._image, self._lines = image, image.code
        self._numbers = {line.address: number for number, line in enumerate(image.code)}
        self._functions: dict[str, list[int]] = defaultdict(list)
        for number, line in enumerate(image.code):
            self._functions[line.function].append(number)
        self._source_lines = {number: line.source_line for number, line in enumerate(image.code)}
        self._loop_bounds = bounds_in(sorted(FIRMWARE.glob("*.[ch]")))

    def longest(self, name: str, without: str = "") -> int:
        """Return the most instructions on any path through a function and the functions that it calls.

        Paths that call or jump to the function named ``without`` are left out.
        Raises ValueError if there is no bound: a loop that the source does not bound, recursion, a computed
        jump.
        """
        most_instructions: dict[int, int] = {}
        """Results by the first instruction of a function, which several others may call."""

        def count(start: int, callers: tuple[int, ...]) -> int:
            function = self._lines[start].function
            if start in callers:
                raise ValueError(f"{function} calls itself")
            if start in most_instructions:
                return most_instructions[start]
            graph = self._graph(start, without)
            weights = {}
            for number in graph:
                called = self._called(number)
                weights[number] = 1
                if called is not None:
                    weights[number] += count(called, (*callers, start))
            most = longest_path(graph, weights, self._source_lines, self._loop_bounds, start)
            most_instructions[start] = most
            return most

        return count(self._start(name), ())

    def deepest(self, name: str) -> int:
        """Return the bytes of stack below the pointer before a call, with the return address if it is pushed.

        A compiled function takes its frame, as the compiler reports it (-fstack-usage), and the most of what
        it calls; where it ends with a jump to another function its frame is gone by then. A function of the
        compiler's library takes all that its instructions ever move the pointer down. Raises ValueError if
        there is no bound.
        """
        return self._deepest(self._start(name), ())

    # --- The graph ---

    def _start(self, name: str) -> int:
        return self._numbers[self._image.address(name)]

    def _target(self, line: Instruction) -> int | None:
        if _INDIRECT_CALL.fullmatch(line.name):
            raise ValueError(f"{line.function} calls what a pointer leads to: {line.name} {line.operands}")
        match = _TARGET.search(line.operands) if _BRANCH.fullmatch(line.name) else None
        return self._numbers.get(int(match[1], 16)) if match else None

    def _called(self, number: int) -> int | None:
        """Return the first instruction of what this one calls; on an AVR a call may only take stack."""
        line = self._lines[number]
        target = self._target(line) if _CALL.fullmatch(line.name) else None
        return None if target == number + 1 else target

    def _following(self, number: int) -> list[int]:
        """Return the numbers of the instructions that may run next in the same call; calls return."""
        line = self._lines[number]
        text = f"{line.name} {line.operands}"
        if _COMPUTED.match(text):
            raise ValueError(f"{line.function} jumps to what a table holds: {text}")
        if _END.match(text):
            return []
        target = self._target(line)
        is_call = _CALL.fullmatch(line.name) is not None
        following = [] if target is None or is_call else [target]
        if not _JUMP.fullmatch(line.name):  # a branch may not be taken, and a call returns
            following.append(number + 1)
        return following

    def _graph(self, start: int, without: str) -> dict[int, list[int]]:
        """Return which instructions may follow each one from the first on, without those of a function."""
        graph: dict[int, list[int]] = {}
        waiting = [start]
        while waiting:
            number = waiting.pop()
            if number not in graph:
                graph[number] = [
                    following for following in self._following(number) if not self._enters(following, without)
                ]
                waiting += graph[number]
        return graph

    def _enters(self, number: int, name: str) -> bool:
        """Return whether an instruction is one of the function of this name, or calls it."""
        called = self._called(number)
        instructions = [number] if called is None else [number, called]
        functions = {CLONE.sub("", self._lines[instruction].function) for instruction in instructions}
        return name != "" and name in functions

    # --- Stack ---

    def _deepest(self, start: int, callers: tuple[int, ...]) -> int:
        """Return the most bytes of stack that a function and the functions that it calls need together.

        ``start`` is the number of its first instruction, and ``callers`` are those of the functions that have
        called it. Raises ValueError if the function calls itself.
        """
        name = self._lines[start].function
        if start in callers:
            raise ValueError(f"{name} calls itself")
        frame = self._image.frames.get(CLONE.sub("", name))
        own_bytes = self._moved_down(name) if frame is None else frame
        deepest = own_bytes
        for number in self._functions[name]:
            line = self._lines[number]
            falls_through = self._following(number) if frame is None and number + 1 < len(self._lines) else []
            for target in (self._target(line), *falls_through):
                if target is not None and self._lines[target].function != name:
                    below = self._deepest(target, (*callers, start))
                    is_call = _CALL.fullmatch(line.name) is not None
                    deepest = max(deepest, below + own_bytes if is_call or frame is None else below)
        return deepest

    def _moved_down(self, name: str) -> int:
        """Return the bytes by which a function's instructions move the stack pointer down, if all run."""
        is_avr = self._image.target.tools.startswith("avr")
        bytes_of_register = 1 if is_avr else 4
        moved_bytes = 2 if is_avr else 0  # an AVR's call pushes the return address
        for line in map(self._lines.__getitem__, self._functions[name]):
            for pattern in _DOWN:
                if match := pattern.match(f"{line.name} {line.operands}"):
                    parts = match.groupdict()
                    if "list" in parts:
                        moved_bytes += bytes_of_register * len(parts["list"].split(","))
                    else:
                        moved_bytes += int(parts["bytes"])
        return moved_bytes
