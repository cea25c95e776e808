"""Who hears whom: every robot every other, or the edges of a graph. Moving robots are in ``world.arena``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import MAX_ID
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_at_most

_EDGES = re.compile(r"[0-9>;\s]*")
_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
# Behind an edge other tools write a weight, or its attributes in braces as networkx does.
_EDGE = re.compile(rf"([0-9]{{1,5}})(?:\s*(>)\s*|\s+)([0-9]{{1,5}})(?:\s+(?:{_NUMBER}|\{{.*\}}))?", re.ASCII)

MAX_ROBOTS = 2**16
"""Largest number of robots without a bus: ids have 16 bits."""
MAX_ON_BUS = MAX_ID + 1
"""Largest number of robots on a bus, and of those that can all hear each other."""


class Topology(Protocol):
    """Who hears whom, step by step. Extensions make one: entry point group ``mcp_asdf.topologies``."""

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """The next steps, shape (steps, N, N): ``[k, i, j]`` is True if i hears j in step k."""


class Static:
    """A topology that never changes."""

    def __init__(self, hears: NDArray[np.bool_]) -> None:
        """Take who hears whom, shape (N, N)."""
        self._hears = hears

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """The next steps. O(1)."""
        return np.broadcast_to(self._hears, (steps, *self._hears.shape))


class Checked:
    """The topology of an extension, whose answers are checked."""

    def __init__(self, topology: Topology, name: str, robots: int) -> None:
        self._topology, self._name, self._robots = topology, name, robots

    def advance(self, steps: int) -> NDArray[np.bool_]:
        """The next steps. Raises UsageError unless they are what ``Topology`` says. O(steps N^2)."""
        hears, shape = np.asarray(self._topology.advance(steps)), (steps, self._robots, self._robots)
        if hears.shape != shape or hears.dtype != np.bool_:
            raise UsageError(
                f"topology {self._name} gives {hears.dtype} of shape {hears.shape}; return bool of {shape}"
            )
        if hears.diagonal(axis1=1, axis2=2).any():
            raise UsageError(f"in topology {self._name} a robot hears itself; clear the diagonal")
        return hears


@dataclass(frozen=True)
class Graph:
    """Directed links between robots.

    Attributes:
        links: (sender, receiver) of every way that a message can go.
        source: The file that they come from, if any; graphs with the same links are equal.
    """

    links: frozenset[tuple[int, int]]
    source: str = field(default="graph", compare=False)

    def topology(self, robots: int) -> Static:
        """Who hears whom among ``robots`` robots. Raises UsageError for a link to any other."""
        self.check(robots)
        hears = np.zeros((robots, robots), np.bool_)
        for sender, receiver in self.links:
            hears[receiver, sender] = True
        return Static(hears)

    def __str__(self) -> str:
        """The edges in one line, which ``graph_of`` takes back: ``3 5; 5 > 7``."""
        both = {link for link in self.links if link[::-1] in self.links}
        return "; ".join(
            f"{a} {b}" if (a, b) in both else f"{a} > {b}"
            for a, b in sorted(self.links)
            if (a, b) not in both or a < b
        )

    def check(self, robots: int) -> None:
        """Raises UsageError unless all ids are among ``0 .. robots - 1``, and no robot hears more others than
        a round of the firmware holds. O(links)."""
        unknown = sorted({robot for link in self.links for robot in link if robot >= robots})
        if unknown:
            raise UsageError(
                f"{self.source} names robot {unknown[0]}, but the ids of {robots} robots are 0 to "
                f"{robots - 1}; take more robots or remove the edge"
            )
        heard = Counter(receiver for _, receiver in self.links)
        for receiver, count in heard.most_common(1):
            if count > MAX_ID:
                raise UsageError(
                    f"in {self.source} robot {receiver} hears {count} others, but a round of the firmware "
                    f"holds {MAX_ID}; remove edges"
                )


def graph_of(given: Any) -> Graph:
    """Return the graph that a file, a text or an object describes.

    A text has edges in one line, separated by semicolons; any other text is the path of a file. An object is
    a list of pairs (both hear each other), a boolean array [receiver, sender], or a graph of networkx.

    An edge is ``3 5`` if robots 3 and 5 hear each other, ``3 > 5`` if only 5 hears 3. In a file each line has
    one; empty lines and everything after a ``#`` are ignored, and so is a weight or ``{...}`` behind an edge.
    An edge without ``>`` may be listed in both directions. Raises UsageError, naming the line, for anything
    else, for ids outside 0 .. 65535, for repeated edges and for a graph without edges. O(lines).
    """
    if not isinstance(given, str | Path):
        return _parse_graph(_edges_of(given), "edge", "graph")
    if isinstance(given, str) and is_text_of_edges(given):
        return _parse_graph(given.split(";"), "edge", "graph")
    try:
        lines = read_at_most(given).decode("utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot read the graph {given}: {error}; give a text file of edges") from error
    return _parse_graph(lines, "line", str(given))


def is_text_of_edges(text: str) -> bool:
    """Return whether a text holds edges in one line, or nothing, and is no path of a file."""
    return _EDGES.fullmatch(text) is not None


def graph_of_edges(text: Any) -> Graph:
    """Return the graph of edges in one line, such as ``3 5; 5 > 7``, and never open a file.

    For the graphs in recordings and results, which come from others. Raises UsageError for anything else.
    """
    if not isinstance(text, str) or not is_text_of_edges(text):
        raise UsageError(
            f"graph is {text!r}, but a recording or a file of results has to hold the edges themselves, such "
            "as '3 5; 5 > 7': it may not name a file"
        )
    return graph_of(text)


def _edges_of(given: Any) -> list[str]:
    """An object's edges as lines. Raises UsageError if it has none that can be read."""
    sign = ""
    if isinstance(given, np.ndarray) and given.dtype == np.bool_:
        if given.ndim != 2 or given.shape[0] != given.shape[1]:
            raise UsageError(f"graph has shape {given.shape}; give a square array, [receiver, sender]")
        pairs, sign = [(sender, receiver) for receiver, sender in np.argwhere(given)], "> "
    elif hasattr(given, "is_directed") and hasattr(given, "edges"):
        pairs, sign = list(given.edges()), "> " if given.is_directed() else ""
    else:
        pairs = given
    try:
        return [f"{index(first)} {sign}{index(second)}" for first, second in pairs]
    except (TypeError, ValueError):
        fix = "give a file, edges such as '3 5; 5 > 7', pairs of ids, a boolean array, or a networkx graph"
        raise UsageError(f"graph is {given!r}; {fix}") from None


@dataclass(frozen=True)
class _Edge:
    """An edge as it is written, with the number of its line."""

    sender: int
    receiver: int
    is_one_way: bool
    line_number: int

    @property
    def links(self) -> list[tuple[int, int]]:
        """The (sender, receiver) pairs that the edge stands for: one, or both directions."""
        link = (self.sender, self.receiver)
        return [link] if self.is_one_way else [link, link[::-1]]

    def is_reverse_of(self, other: _Edge) -> bool:
        """Whether both say the same of two robots that hear each other, in either direction."""
        is_reversed = (self.sender, self.receiver) == (other.receiver, other.sender)
        return is_reversed and not self.is_one_way and not other.is_one_way


def _parse_graph(lines: Iterable[str], unit: str, source: str) -> Graph:
    """Return the graph of the edges in ``lines``. Errors name ``source`` and the number of the ``unit``."""
    edge_of_link: dict[tuple[int, int], _Edge] = {}
    for line_number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        edge = _parse_edge(text, f"{source}, {unit} {line_number}", line_number)
        for link in edge.links:
            earlier_edge = edge_of_link.setdefault(link, edge)
            if earlier_edge is not edge and not edge.is_reverse_of(earlier_edge):
                sender, receiver = link
                raise UsageError(
                    f"{source}, {unit} {line_number}: that robot {receiver} hears {sender} is in {unit} "
                    f"{earlier_edge.line_number} already; remove one of them"
                )
    if not edge_of_link:
        raise UsageError(f"{source} has no edge, so no robot would hear another; write edges such as '3 5'")
    return Graph(frozenset(edge_of_link), source)


def _parse_edge(text: str, position: str, line_number: int) -> _Edge:
    """Return the edge of a line without its comment. Raises UsageError, naming the ``position``, if none."""
    match = _EDGE.fullmatch(text)
    if match is None or max(int(match[1]), int(match[3])) >= MAX_ROBOTS:
        fix = f"write two ids, 0 to {MAX_ROBOTS - 1}, such as '3 5' or '3 > 5'"
        raise UsageError(f"{position}: {text!r} is not an edge; {fix}")
    edge = _Edge(int(match[1]), int(match[3]), match[2] is not None, line_number)
    if edge.sender == edge.receiver:
        raise UsageError(f"{position}: robot {edge.sender} cannot be its own neighbour; remove the edge")
    return edge
