"""The longest path through code with loops, each of which has a bound in a comment of the source.

A loop's bound stands beside its statement: ``for (...) { /* at most 32 turns */``. In a nested loop, the
product of both bounds may be too high. A second number then bounds all turns of the inner loop together:
``/* at most 31 turns, 496 in all */``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path

_STATEMENT = re.compile(r"\b(?:for|while) \(.*/\* (?:at most )?(\d+) turns(?:, (\d+) in all)?")

Graph = Mapping[int, Iterable[int]]
"""Which instructions may follow each instruction of a function, by their numbers."""


@dataclass(frozen=True)
class Bound:
    """How often a loop turns: at most ``turns`` times whenever it is entered, and at most ``in_all`` times in
    a call of the function, if that is known to be fewer."""

    turns: int
    in_all: int | None


def bounds_in(sources: Iterable[Path]) -> dict[str, Bound]:
    """Return the bounds of the loops in C sources, by place: a file's name, a colon and the line's number."""
    bounds = {}
    for source in sources:
        for number, line in enumerate(source.read_text(encoding="utf-8").splitlines(), 1):
            if match := _STATEMENT.search(line):
                turns, in_all = match.groups()
                bounds[f"{source.name}:{number}"] = Bound(int(turns), int(in_all) if in_all else None)
    return bounds


@dataclass
class _Region:
    """The code from an entry of a loop or a function to its exits.

    Attributes:
        costs: Largest cost of a path from the entry to an instruction, itself included, by its number.
        cost_of_loops_in_all: Cost of inner loops whose bound is for all turns. It is added once.
        places: Places of the loop statements in the region.
    """

    costs: dict[int, int]
    cost_of_loops_in_all: int
    places: set[str]


class LongestPath:
    """The largest possible cost of one call of a function, for any data."""

    def __init__(
        self, graph: Graph, weights: Mapping[int, int], places: Mapping[int, str], bounds: Mapping[str, Bound]
    ) -> None:
        """Prepare for the instructions of a function.

        Args:
            graph: Their order.
            weights: What each costs, with what it calls.
            places: The source line that each belongs to, by number.
            bounds: Bounds of loops by their places.
        """
        self._graph = graph
        self._weights = weights
        self._places = places
        self._bounds = bounds

    def cost(self, start: int) -> int:
        """Return the cost of the dearest path from an instruction on.

        Raises ValueError for a loop without a bound in the source.
        """
        region = self._region(set(self._graph), {start})
        return max(region.costs.values()) + region.cost_of_loops_in_all

    def _region(self, numbers: set[int], region_entries: set[int]) -> _Region:
        """Return the costs within these instructions, up to where the path comes to an entry again."""
        inside = numbers - region_entries
        graph = {number: [after for after in self._graph[number] if after in inside] for number in numbers}
        components = _strong_components(graph)
        component_of = {number: index for index, component in enumerate(components) for number in component}
        # By component: the components from which it is reached, the instructions at which it is entered, and
        # the largest cost of a path that leads there.
        earlier_components: dict[int, set[int]] = {index: set() for index in range(len(components))}
        entries: dict[int, set[int]] = {index: set() for index in range(len(components))}
        costs_before: dict[int, int] = dict.fromkeys(range(len(components)), 0)
        for entry in region_entries:
            entries[component_of[entry]].add(entry)
        for number, following in graph.items():
            for after in following:
                index_after = component_of[after]
                if index_after != component_of[number]:
                    earlier_components[index_after].add(component_of[number])
                    entries[index_after].add(after)

        region = _Region({}, 0, set())
        for index in TopologicalSorter(earlier_components).static_order():
            component = components[index]
            # A component of one instruction is a loop only if that instruction jumps to itself.
            is_loop = len(component) > 1 or any(number in graph[number] for number in component)
            inner = self._loop(component, entries[index]) if is_loop else None
            for member in component:
                own_cost = self._weights[member] if inner is None else inner.costs[member]
                region.costs[member] = costs_before[index] + own_cost
                for after in graph[member]:
                    index_after = component_of[after]
                    if index_after != index:
                        costs_before[index_after] = max(costs_before[index_after], region.costs[member])
            if inner is not None:
                region.cost_of_loops_in_all += inner.cost_of_loops_in_all
                region.places |= inner.places
        return region

    def _loop(self, numbers: set[int], entries: set[int]) -> _Region:
        """Return the costs within a loop from its entry on, after as many turns as it may take."""
        turn = self._region(numbers, entries)
        lines = self._lines_of(numbers)
        places = (lines & self._bounds.keys()) - turn.places
        if not places:
            raise ValueError(f"there is a loop without a bound in the source: {sorted(lines)}")
        # Instructions of other lines may have been moved into the loop: the largest of their bounds is safe.
        bound = max((self._bounds[place] for place in places), key=lambda bound: bound.turns)
        ends_of_turn = {number for number in numbers if not entries.isdisjoint(self._graph[number])}
        exits = {number for number in numbers if any(after not in numbers for after in self._graph[number])}
        # A compiler may copy a loop's body, and jump between the copies: then there are several entries, and
        # one turn may pass each entry once. The rest of the last turn may pass them again.
        cost_of_turn = len(entries) * max(turn.costs[number] for number in ends_of_turn)
        repeated_turns = bound.turns if len(entries) == 1 else bound.turns + 1
        # A loop that can be left only at the end of a turn never begins a turn in vain.
        if exits <= ends_of_turn:
            repeated_turns -= 1
        cost_in_all = turn.cost_of_loops_in_all
        if bound.in_all is not None:
            cost_in_all += bound.in_all * cost_of_turn
            repeated_turns = 0
        costs = {number: cost + repeated_turns * cost_of_turn for number, cost in turn.costs.items()}
        return _Region(costs, cost_in_all, turn.places | places)

    def _lines_of(self, numbers: Iterable[int]) -> set[str]:
        return {self._places[number] for number in numbers if number in self._places}


def _strong_components(graph: Graph) -> list[set[int]]:
    """Return the sets of nodes in which every node can be reached from every other node (Kosaraju)."""
    order: list[int] = []
    visited: set[int] = set()
    for node in graph:
        _visit(graph, node, visited, order)
    backwards: dict[int, list[int]] = {node: [] for node in graph}
    for node, following in graph.items():
        for after in following:
            backwards[after].append(node)
    components = []
    assigned: set[int] = set()
    for node in reversed(order):
        component: list[int] = []
        _visit(backwards, node, assigned, component)
        if component:
            components.append(set(component))
    return components


def _visit(graph: Graph, start: int, visited: set[int], finished: list[int]) -> None:
    """Visit what can be reached from a node and is not visited yet; append each after what follows it."""
    if start in visited:
        return
    visited.add(start)
    open_nodes = [(start, iter(graph[start]))]
    while open_nodes:
        node, following = open_nodes[-1]
        unvisited = next((after for after in following if after not in visited), None)
        if unvisited is None:
            open_nodes.pop()
            finished.append(node)
        else:
            visited.add(unvisited)
            open_nodes.append((unvisited, iter(graph[unvisited])))
