"""Graphs: which robots receive from which where they do not move, given as edges, and reading them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any

from mcp_asdf.robot import MAX_ID, MAX_ROUND_SIZE
from mcp_asdf_tools.common.errors import UsageError

_EDGES_IN_ONE_LINE = re.compile(r"[0-9>;\s]*")
"""Only what edges are made of: a path with nothing else would be taken for edges."""
_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
# Behind an edge other tools write a weight, or its attributes in braces as networkx does. Ids have at most
# five digits: int() raises an error of its own for a hostile number with thousands of them.
_EDGE = re.compile(
    r"(?P<first_id>[0-9]{1,5})(?:\s*(?P<arrow>>)\s*|\s+)(?P<second_id>[0-9]{1,5})"
    rf"(?:\s+(?:{_NUMBER}|\{{.*\}}))?",
    re.ASCII,
)

MAX_ROBOTS = 2**16
"""Largest number of robots without a bus: ids have 16 bits."""
MAX_ON_BUS = MAX_ID + 1
"""Largest number of robots on a bus, and of those that can all receive from each other."""


@dataclass(frozen=True)
class Graph:
    """Directed links between robots.

    Attributes:
        links: (sender, receiver) for each pair in which the receiver hears the sender.
        source: The file that they come from, if any; graphs with the same links are equal.
    """

    links: frozenset[tuple[int, int]]
    source: str = field(default="graph", compare=False)

    def __str__(self) -> str:
        """Return the edges in one line, which ``parse_graph`` takes back, such as ``3 5; 5 > 7``.

        In ``3 5`` both robots receive from each other; in ``5 > 7`` only 7 receives from 5.
        """
        edges = []
        for sender, receiver in sorted(self.links):
            if (receiver, sender) not in self.links:
                edges.append(f"{sender} > {receiver}")
            elif sender < receiver:  # an edge of both directions is written once
                edges.append(f"{sender} {receiver}")
        return "; ".join(edges)

    def check(self, robots: int) -> None:
        """Check that the graph is one of ``robots`` robots. O(links).

        Raises UsageError unless all ids are among 0 .. robots - 1, and no robot receives from more than 127
        others.
        """
        senders = {sender for sender, _ in self.links}
        receivers = {receiver for _, receiver in self.links}
        unknown_ids = [robot for robot in senders | receivers if robot >= robots]
        if unknown_ids:
            raise UsageError(
                f"{self.source} names robot {min(unknown_ids)}, but the ids of {robots} robots are 0 to "
                f"{robots - 1}; take more robots or remove the edge"
            )
        # The firmware limits from how many others a robot receives, but not how many receive from it.
        neighbour_counts = Counter(receiver for _, receiver in self.links)
        for receiver, count in sorted(neighbour_counts.items()):
            if count > MAX_ROUND_SIZE:
                raise UsageError(
                    f"in {self.source} robot {receiver} hears {count} others, but a round of the firmware "
                    f"holds {MAX_ROUND_SIZE}; remove edges"
                )


def parse_graph(description: Any) -> Graph:
    """Return the graph that a file, a text or an object describes.

    A text has edges in one line, separated by semicolons; any other text is the path of a file. An object is
    a list of pairs (both hear each other), a boolean array [receiver, sender], or a graph of networkx.

    An edge is ``3 5`` if robots 3 and 5 hear each other, ``3 > 5`` if only 5 hears 3. In a file each line has
    one; empty lines and everything after a ``#`` are ignored, and so is a weight or ``{...}`` behind an edge.
    An edge without ``>`` may be listed in both directions. Raises UsageError, naming the line, for anything
    else, for ids outside 0 .. 65535, for repeated edges and for a graph without edges. O(lines).
    """
    from mcp_asdf_tools.common.files import read_at_most  # noqa: PLC0415 (only a path needs it)

    if not isinstance(description, str | Path):
        return _parse_lines(_format_edges(description), "edge", "graph")
    if isinstance(description, str) and is_text_of_edges(description):
        return _parse_lines(description.split(";"), "edge", "graph")
    # All else is the path of a file. "utf-8-sig" leaves out the mark with which programs of Windows begin a
    # text.
    try:
        lines = read_at_most(description).decode("utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise UsageError(
            f"cannot read the graph {description}: {error}; give a text file of edges"
        ) from error
    return _parse_lines(lines, "line", str(description))


def is_text_of_edges(text: str) -> bool:
    """Return whether a text holds edges in one line, or nothing, and is no path of a file."""
    return _EDGES_IN_ONE_LINE.fullmatch(text) is not None


def parse_edges(text: Any) -> Graph:
    """Return the graph of edges in one line, such as ``3 5; 5 > 7``.

    In ``3 5`` both robots receive from each other; in ``5 > 7`` only 7 receives from 5. This is for the
    graphs in recordings and results, which come from others: where ``parse_graph`` would take a text for the
    path of a file and open it, this function raises UsageError. So it does for any other text or object.
    """
    if not isinstance(text, str) or not is_text_of_edges(text):
        raise UsageError(
            f"graph is {text!r}, but a recording or a file of results has to hold the edges themselves, such "
            "as '3 5; 5 > 7': it may not name a file"
        )
    return _parse_lines(text.split(";"), "edge", "graph")


def _format_edges(graph: Any) -> list[str]:
    """Return the edges of an object as texts: ``3 5`` of both directions, ``3 > 5`` from 3 to 5 alone.

    The object is as ``parse_graph`` takes it: pairs of ids, a square boolean array [receiver, sender], or a
    graph of networkx. Raises UsageError for any other.
    """
    import numpy as np  # noqa: PLC0415 (it loads slowly, and texts and files need none of it)

    if isinstance(graph, np.ndarray) and graph.dtype == np.bool_:
        if graph.ndim != 2 or graph.shape[0] != graph.shape[1]:
            raise UsageError(f"graph has shape {graph.shape}; give a square array, [receiver, sender]")
        return [f"{sender} > {receiver}" for receiver, sender in np.argwhere(graph)]
    id_pairs = graph
    separator = " "
    is_of_networkx = hasattr(graph, "is_directed") and hasattr(graph, "edges")
    if is_of_networkx:
        id_pairs = list(graph.edges())
        separator = " > " if graph.is_directed() else " "
    # ``index`` is that of the module operator: it takes integers of any kind, and refuses all that is none.
    try:
        return [f"{index(first)}{separator}{index(second)}" for first, second in id_pairs]
    except (TypeError, ValueError):
        fix = "give a file, edges such as '3 5; 5 > 7', pairs of ids, a boolean array, or a networkx graph"
        raise UsageError(f"graph is {graph!r}; {fix}") from None


@dataclass(frozen=True)
class _Edge:
    """An edge between two robots, as a line of a text has it.

    Attributes:
        first_id: Id that stands first; with an arrow, that of the sender.
        second_id: Id that stands second.
        is_one_way: Whether only the second robot receives from the first, as in ``3 > 5``.
    """

    first_id: int
    second_id: int
    is_one_way: bool

    @property
    def forward_link(self) -> tuple[int, int]:
        """The link on which the first robot sends and the second one receives."""
        return self.first_id, self.second_id

    @property
    def backward_link(self) -> tuple[int, int]:
        """The link on which the second robot sends and the first one receives."""
        return self.second_id, self.first_id


def _parse_lines(lines: Iterable[str], unit: str, source: str) -> Graph:
    """Return the graph of the edges in ``lines``.

    Comments behind a ``#`` and empty lines are left out. For messages, ``unit`` is "edge" or "line", as which
    the lines are counted from 1, and ``source`` is the file's name or "graph". Raises UsageError for a line
    that is no edge, if there is none at all, and for an edge that is there already. One of both directions
    may come again from its other end, as in an adjacency list.
    """
    line_of_link: dict[tuple[int, int], int] = {}  # links are pairs of sender and receiver
    two_way_edges = set()
    for line_number, line in enumerate(lines, start=1):
        line_without_comment, _, _comment = line.partition("#")
        edge_text = line_without_comment.strip()
        if not edge_text:
            continue
        position = f"{source}, {unit} {line_number}"
        edge = _parse_edge(edge_text, position)
        if edge.backward_link in two_way_edges and not edge.is_one_way:
            continue  # the edge is there already, written from its other end
        new_links = [edge.forward_link]
        if not edge.is_one_way:
            new_links.append(edge.backward_link)
            two_way_edges.add(edge.forward_link)
        for sender, receiver in new_links:
            if (sender, receiver) in line_of_link:
                raise UsageError(
                    f"{position}: that robot {receiver} hears {sender} is in {unit} "
                    f"{line_of_link[sender, receiver]} already; remove one of them"
                )
            line_of_link[sender, receiver] = line_number
    if not line_of_link:
        raise UsageError(f"{source} has no edge, so no robot would hear another; write edges such as '3 5'")
    return Graph(frozenset(line_of_link), source)


def _parse_edge(edge_text: str, position: str) -> _Edge:
    """Return the edge that a text such as ``3 5`` or ``3 > 5`` describes; the text has no comment.

    ``position`` says where the line stands, such as "a.txt, line 7", and begins messages. Raises UsageError
    for a text that is no edge, an id that is too large, and an edge from a robot to itself.
    """
    match = _EDGE.fullmatch(edge_text)
    if match is None or max(int(match["first_id"]), int(match["second_id"])) >= MAX_ROBOTS:
        fix = f"write two ids, 0 to {MAX_ROBOTS - 1}, such as '3 5' or '3 > 5'"
        raise UsageError(f"{position}: {edge_text!r} is not an edge; {fix}")
    # Without an arrow the group has not taken part in the match, and is None.
    edge = _Edge(int(match["first_id"]), int(match["second_id"]), is_one_way=match["arrow"] is not None)
    if edge.first_id == edge.second_id:
        raise UsageError(f"{position}: robot {edge.first_id} cannot be its own neighbour; remove the edge")
    return edge
