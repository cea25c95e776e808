"""The longest path through code with loops, each of which has a bound in a comment of the source.

A loop's bound stands beside its statement: ``for (...) { /* at most 32 turns */``. In a nested loop, the
product of both bounds may be too high. A second number then bounds all turns of the inner loop together:
``/* at most 31 turns, 496 in all */``.

The path is found by implicit path enumeration. How often each edge of the graph is taken is a variable of a
linear program: an instruction is left at most as often as it is reached, and a bound says how often a loop's
entries are reached from inside the loop. The optimum is at least the cost of any real path.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog  # type: ignore[import-untyped]
from scipy.sparse import csr_array  # type: ignore[import-untyped]
from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]

_STATEMENT = re.compile(r"\b(?:for|while) \(.*/\* (?:at most )?(\d+) turns(?:, (\d+) in all)?")
_CALLER = -1
"""The number of a node before the first instruction. A call enters the graph from this node, once."""

Graph = Mapping[int, Iterable[int]]
"""For the number of each instruction of a function, the numbers of the instructions that may follow it."""
Edge = tuple[int, int]
"""The numbers of an instruction and of one that may follow it."""


@dataclass(frozen=True)
class Bound:
    """The bound that the source states for a loop.

    Attributes:
        turns: How often the loop turns at most, each time that it is entered.
        in_all: How often it turns at most in a whole call of the function, or None if nothing is stated.
    """

    turns: int
    in_all: int | None


@dataclass(frozen=True)
class Loop:
    """A loop of a graph.

    Attributes:
        members: The numbers of its instructions. From each of them every other one can be reached.
        entries: The members that may follow an instruction outside of the loop.
    """

    members: set[int]
    entries: set[int]


def bounds_in(sources: Iterable[Path]) -> dict[str, Bound]:
    """Return the bounds of the loops in C sources by their lines.

    A line is a file's name, a colon and the line's number, such as "a.c:7".
    """
    bounds = {}
    for source in sources:
        for number, line in enumerate(source.read_text(encoding="utf-8").splitlines(), 1):
            if match := _STATEMENT.search(line):
                turns, in_all = match.groups()
                bounds[f"{source.name}:{number}"] = Bound(int(turns), int(in_all) if in_all else None)
    return bounds


def longest_path(
    graph: Graph,
    weights: Mapping[int, int],
    source_lines: Mapping[int, str],
    bounds: Mapping[str, Bound],
    start: int,
) -> int:
    """Return the largest possible cost of one call of a function, for any data.

    Args:
        graph: The instructions that may follow each instruction of the function.
        weights: The cost of each instruction, which includes that of the function that it calls.
        source_lines: The line of the source that an instruction comes from, such as "a.c:7", if it is known.
        bounds: The bounds of loops by their lines.
        start: The number of the first instruction.

    Raises ValueError for a loop without a bound in the source.
    """
    edges = [(_CALLER, start)] + [(number, end) for number in graph for end in graph[number]]
    origins, ends = np.array(edges).T
    # Each row of the matrix, times the numbers of takes of all edges, is at most its limit. The first rows
    # say that an instruction is left no more often than it is reached.
    rows = [1.0 * (origins == number) - (ends == number) for number in graph]
    limits = [0] * len(rows)
    unused_bounds = dict(bounds)
    for loop in _find_loops(set(edges), edges):
        bound = _take_bound(loop, source_lines, unused_bounds)
        for row, limit in _limits_of_returns(loop, bound, edges):
            rows.append(row)
            limits.append(limit)
    costs = [-weights[end] for end in ends]
    takes = [(1, 1)] + [(0, None)] * (len(edges) - 1)
    result = linprog(costs, A_ub=csr_array(np.array(rows)), b_ub=limits, bounds=takes)
    if not result.success:
        raise ValueError(f"no longest path: {result.message}")
    return int(-result.fun + 1e-6)


def _take_bound(loop: Loop, source_lines: Mapping[int, str], unused_bounds: dict[str, Bound]) -> Bound:
    """Return the bound of a loop; all bounds at the loop's lines are removed from ``unused_bounds``.

    Raises ValueError if there is none.
    """
    lines = {source_lines[number] for number in loop.members if number in source_lines}
    bounds_of_loop = [unused_bounds.pop(line) for line in lines if line in unused_bounds]
    if not bounds_of_loop:
        raise ValueError(f"there is a loop without a bound in the source: {sorted(lines)}")
    # Instructions of other lines may have been moved into the loop: the largest of their bounds is safe.
    return max(bounds_of_loop, key=lambda bound: bound.turns)


def _limits_of_returns(loop: Loop, bound: Bound, edges: list[Edge]) -> Iterator[tuple[Any, int]]:
    """Yield rows of the matrix with limits, which bound how often a loop's entries are reached from inside.

    For each entry one row bounds this in relation to how often the loop is entered. Another row bounds it for
    a whole call, if the source does.
    """
    origins, ends = np.array(edges).T
    from_inside = np.isin(origins, list(loop.members))
    entrances = np.isin(ends, list(loop.entries)) & ~from_inside
    most_returns = _most_returns_to_an_entry(loop, edges, bound)
    for entry in loop.entries:
        returns = 1.0 * ((ends == entry) & from_inside)
        yield returns - most_returns * entrances, 0
        if bound.in_all is not None:
            yield returns, bound.in_all


def _most_returns_to_an_entry(loop: Loop, edges: Iterable[Edge], bound: Bound) -> int:
    """Return how often an entry of a loop is reached from inside at most, each time the loop is entered."""
    if len(loop.entries) > 1:
        # A compiler may copy a loop's body, and jump between the copies. After the last turn, what is not
        # the entry that was entered may be reached once more.
        return bound.turns + 1
    ends_of_turn = {origin for origin, end in edges if origin in loop.members and end in loop.entries}
    exits = {origin for origin, end in edges if origin in loop.members and end not in loop.members}
    # A loop that can be left only at the end of a turn never begins a turn in vain.
    return bound.turns - 1 if exits <= ends_of_turn else bound.turns


def _find_loops(edges: set[Edge], all_edges: Iterable[Edge]) -> list[Loop]:
    """Return the loops that ``edges`` form. An outer loop stands behind the loops inside it.

    ``all_edges`` are the edges of the whole graph. Those of them that lead into a loop show its entries.
    """
    numbers = sorted({number for edge in edges for number in edge})
    index_of = {number: index for index, number in enumerate(numbers)}
    matrix = np.zeros((len(numbers), len(numbers)), bool)
    for origin, end in edges:
        matrix[index_of[origin], index_of[end]] = True
    _count, labels = connected_components(csr_array(matrix), connection="strong")
    loops = []
    for label in np.unique(labels):
        members = {number for number in numbers if labels[index_of[number]] == label}
        inner_edges = {(origin, end) for origin, end in edges if origin in members and end in members}
        if inner_edges:  # else it is a single instruction that does not follow itself
            entries = {end for origin, end in all_edges if end in members and origin not in members}
            loops += _find_loops({edge for edge in inner_edges if edge[1] not in entries}, all_edges)
            loops.append(Loop(members, entries))
    return loops
