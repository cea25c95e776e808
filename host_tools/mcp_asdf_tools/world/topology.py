"""Who can hear whom: everybody, the edges of a graph, or whoever is near in a moving world.

``mcp_asdf_tools.world.arena.Arena`` is the topology of robots that move.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from mcp_asdf_tools.bus.frames import MAX_NODE
from mcp_asdf_tools.common.errors import UsageError


class Topology(Protocol):
    """Who can hear whom at present."""

    def neighbours(self, robot: int) -> Collection[int]:
        """Ids of the robots that ``robot`` hears; never itself."""


@dataclass(frozen=True)
class FullyConnected:
    """Every robot of ``0 .. robots - 1`` hears every other."""

    robots: int

    def neighbours(self, robot: int) -> Collection[int]:
        """Ids of the robots that ``robot`` hears. O(robots)."""
        return frozenset(range(self.robots)) - {robot}


@dataclass(frozen=True)
class Graph:
    """Robots that hear whom a file of edges says.

    Attributes:
        source: The file.
        links: (sender, receiver) of every way that a message can go.
    """

    source: str
    links: frozenset[tuple[int, int]]

    def neighbours(self, robot: int) -> Collection[int]:
        """Ids of the robots that ``robot`` hears. O(1)."""
        return self._heard.get(robot, frozenset())

    @cached_property
    def _heard(self) -> dict[int, frozenset[int]]:
        """Whom each robot hears, if anybody."""
        heard: dict[int, set[int]] = {}
        for sender, receiver in self.links:
            heard.setdefault(receiver, set()).add(sender)
        return {robot: frozenset(senders) for robot, senders in heard.items()}

    def check(self, robots: int) -> None:
        """Raises UsageError unless all ids are among ``0 .. robots - 1``. O(links)."""
        unknown = sorted({robot for link in self.links for robot in link if robot >= robots})
        if unknown:
            raise UsageError(
                f"{self.source} names robot {unknown[0]}, but the ids of {robots} robots are 0 to "
                f"{robots - 1}; take more robots or cut the edge"
            )


def read_graph(path: Path | str) -> Graph:
    """Read a list of edges.

    One a line: ``3 5`` if robots 3 and 5 hear each other, ``3 > 5`` if only 5 hears 3. Empty lines, and
    whatever follows a ``#``, say nothing. Raises UsageError, naming the line, for anything else, for ids
    outside 0 .. 127, and for a link that stands there already. O(lines).
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read the graph {path}: {error}; give a text file of edges") from error
    first_line: dict[tuple[int, int], int] = {}
    for number, line in enumerate(lines, start=1):
        for link in _links_of(line.partition("#")[0], f"{path}, line {number}"):
            if link in first_line:
                raise UsageError(
                    f"{path}, line {number}: that robot {link[1]} hears {link[0]} stands in line "
                    f"{first_line[link]} already; cut one of them"
                )
            first_line[link] = number
    return Graph(str(path), frozenset(first_line))


def _links_of(text: str, place: str) -> list[tuple[int, int]]:
    """The links of a line. Raises UsageError, naming the ``place``, if it is no edge."""
    words = text.replace(">", " > ").split()
    if not words:
        return []
    is_one_way = words[1:2] == [">"]
    ends = words[::2] if is_one_way else words
    if len(words) != (3 if is_one_way else 2):
        raise UsageError(f"{place}: {text.strip()!r} is no edge; write two ids, such as '3 5' or '3 > 5'")
    first, second = (_id_of(word, place) for word in ends)
    if first == second:
        raise UsageError(f"{place}: robot {first} cannot be its own neighbour; cut the edge")
    return [(first, second)] if is_one_way else [(first, second), (second, first)]


def _id_of(word: str, place: str) -> int:
    if not (word.isascii() and word.isdigit() and int(word) <= MAX_NODE):
        raise UsageError(f"{place}: {word!r} is no robot; ids are 0 to {MAX_NODE}")
    return int(word)
