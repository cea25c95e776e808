"""The longest way through a function, whatever the data: instructions, cycles, divisions, turns of loops."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from .flow import CALL, Flow
from .images import Instruction
from .timing import Timing, is_conditional

_TABLE = re.compile(r"tb[bh]|ijmp|mov\s+pc|jr\s+(?!ra)|bx\s+(?!lr)|ldr(\.w)?\s+pc, \[(?!sp)")
_DIVISION = re.compile(r"[us]div|(div|rem)u?")
_SKIPS = re.compile(r"cpse|sb[ri][cs]")

Loop = set[int]
"""Numbers of instructions from each of which there is a way to each."""
Entries = set[int]
"""Those of them that are reached from elsewhere."""
Bound = Callable[[Loop, Entries], tuple[int, int]]
"""One of a loop's instructions that lies on every way around it, but for ways around loops within it, and how
often it runs at most, once the loop is entered. Raises ValueError if there is no bound."""


@dataclass(frozen=True)
class Weight:
    """Something counted along a way: ``of`` an instruction, ``after`` one if another than the next follows,
    and of a ``turn`` of a loop."""

    of: Callable[[Instruction], int] = lambda _: 0
    after: Callable[[Instruction, Instruction], int] = lambda _, __: 0
    turn: int = 0


INSTRUCTIONS = Weight(lambda _: 1)
DIVISIONS = Weight(lambda line: int(bool(_DIVISION.fullmatch(line.name))))
TURNS = Weight(turn=1)


def cycles(timing: Timing) -> Weight:
    """Those of a processor, each instruction at its slowest."""

    def jumped(line: Instruction, following: Instruction) -> int:
        if _SKIPS.fullmatch(line.name):
            return (following.address - line.address) // 2 - 1  # a cycle for each word that is skipped
        return timing.taken if is_conditional(line.name) else 0

    return Weight(lambda line: timing.cycles(line.name, line.operands), jumped)


class LongestWay:
    """The most of a weight that any way through a function can have."""

    def __init__(self, flow: Flow, bound: Bound | None = None, weight: Weight = INSTRUCTIONS) -> None:
        """Without ``bound``, a loop has none."""
        self._flow, self._bound, self._weight = flow, bound or self._no_bound, weight
        self._known: dict[int, int] = {}
        self._active: set[int] = set()
        self._next: dict[int, list[int]] = {}

    def of(self, name: str) -> int:
        """The most. Raises ValueError if there is none: a loop without bound, recursion, a computed jump."""
        self._active.clear()
        return self._called(self._flow.start(name))

    def _called(self, start: int) -> int:
        if start not in self._known:
            if start in self._active:
                raise ValueError(f"{self._flow.lines[start].function} calls itself")
            self._active.add(start)
            self._known[start] = max(self._most(None, start, None).values())
            self._active.remove(start)
        return self._known[start]

    def _most(self, within: Loop | None, start: int, cut: int | None) -> dict[int, int]:
        """The most of any way from ``start`` up to each instruction and including it; within a loop, if one
        is given, and without jumps to ``cut``."""
        arriving, found = defaultdict(int, {start: 0}), dict[int, int]()
        graph = self._graph(within, start, cut)
        for part in parts(graph, start):
            (one, *others) = part
            if others or one in graph[one]:
                found |= self._around(part, {each: arriving[each] for each in part if each in arriving})
            else:
                found[one] = arriving[one] + self._of(one)
            for number in part:
                for following in set(graph[number]) - part:
                    most = found[number] + self._after(number, following)
                    arriving[following] = max(arriving[following], most)
        return found

    def _around(self, loop: Loop, arriving: dict[int, int]) -> dict[int, int]:
        """The same within a loop that is entered with so much. From the first time that the cut runs to its
        last there are whole laps; before and after there is less than one."""
        cut, times = self._bound(loop, set(arriving))
        lap = self._most(loop, cut, cut)
        whole = self._back(lap, cut) + self._weight.turn
        found: dict[int, int] = defaultdict(int)
        begun = []
        for entry, most in arriving.items():
            if entry == cut:
                begun.append(most)
                continue
            way = self._most(loop, entry, cut)
            begun.append(most + self._back(way, cut))
            for number, length in way.items():
                found[number] = max(found[number], most + length)
        for number, length in lap.items():
            found[number] = max(found[number], max(begun) + (times - 1) * whole + length)
        return found

    def _back(self, way: dict[int, int], cut: int) -> int:
        """The most of a way that ends with a jump to the cut."""
        return max(way[each] + self._after(each, cut) for each in way if cut in self._following(each))

    def _graph(self, within: Loop | None, start: int, cut: int | None) -> dict[int, list[int]]:
        graph, left = dict[int, list[int]](), [start]
        while left:
            number = left.pop()
            if number not in graph:
                graph[number] = [
                    each
                    for each in self._following(number)
                    if each != cut and (within is None or each in within)
                ]
                left += graph[number]
        return graph

    def _following(self, number: int) -> list[int]:
        if number not in self._next:
            self._next[number] = self._flow.following(number)
        return self._next[number]

    def _of(self, number: int) -> int:
        line = self._flow.lines[number]
        if _TABLE.match(f"{line.name} {line.operands}"):
            raise ValueError(f"{line.function} jumps to what a table holds: {line.name} {line.operands}")
        target = self._flow.target(line)
        is_call = target is not None and CALL.fullmatch(line.name) and target != number + 1
        # A call of what follows is an AVR's way to take two bytes of stack.
        return self._weight.of(line) + (self._called(target) if is_call and target is not None else 0)

    def _after(self, number: int, following: int) -> int:
        if following == number + 1:
            return 0
        return self._weight.after(self._flow.lines[number], self._flow.lines[following])

    def _no_bound(self, loop: Loop, _: Entries) -> tuple[int, int]:
        raise ValueError(f"there is a loop in {self._flow.lines[min(loop)].function}")


def parts(graph: dict[int, list[int]], start: int) -> Iterator[set[int]]:
    """The strongly connected parts that are reached from ``start``, each before those that follow it."""
    order: list[int] = []
    _walk(graph, start, set(), order)
    back: dict[int, list[int]] = defaultdict(list)
    for number, following in graph.items():
        for each in following:
            back[each].append(number)
    seen: set[int] = set()
    for number in reversed(order):
        if number not in seen:
            part: list[int] = []
            _walk(back, number, seen, part)
            yield set(part)


def _walk(graph: dict[int, list[int]], start: int, seen: set[int], left: list[int]) -> None:
    """Depth first from ``start``, adding what is left to ``left`` when all behind it is."""
    seen.add(start)
    way = [(start, iter(graph[start]))]
    while way:
        number, following = way[-1]
        new = next((each for each in following if each not in seen), None)
        if new is None:
            left.append(number)
            way.pop()
        else:
            seen.add(new)
            way.append((new, iter(graph[new])))
