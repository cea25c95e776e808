"""Topology and faults: the frames that reach each robot, and when."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Protocol

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.swarm.faults import Faults, SentFrame

_Turn = tuple[float, int, int, int]
"""Place of a frame among those that a robot hears in a tick: place, tick and number sent, version."""


class Hearer(Protocol):
    """Robot as seen by a medium."""

    def hear(self, *frames: can.Message) -> None:
        """Take frames of neighbours, possibly changed on their way."""

    def hear_stranger(self, frame: can.Message) -> None:
        """Take a frame from outside the swarm."""


class InRange(Protocol):
    """World as seen by the air."""

    @property
    def hears(self) -> NDArray[np.bool_]:
        """True if robot i hears j at present, by id; never itself."""


@dataclass(frozen=True)
class Arrivals:
    """Frames that robots hear in one tick.

    Attributes:
        tick: The tick.
        sent: Frames that arrive in time and unchanged at some of them.
        plain: Whether they do at a robot, shape (frames, robots).
        others: The other frames, by the robot that hears them.
    """

    tick: int
    sent: Sequence[SentFrame]
    plain: NDArray[np.bool_]
    others: Mapping[int, Sequence[tuple[_Turn, can.Message]]]

    def of(self, robot: int) -> list[can.Message]:
        """The frames that ``robot`` hears, in order: by place, and at equal places as sent."""
        plain = np.flatnonzero(self.plain[:, robot])
        frames = [self.sent[number].frame for number in plain.tolist()]
        for before, (place, frame) in enumerate(self.between(robot, plain)):
            frames.insert(place + before, frame)
        return frames

    def between(self, robot: int, plain: NDArray[np.intp]) -> list[tuple[int, can.Message]]:
        """The other frames that ``robot`` hears, in order, each with the number of ``plain`` ones before."""
        numbers = plain.tolist()
        return [
            (len(numbers) if place > 0 else bisect_left(numbers, number) if tick == self.tick else 0, frame)
            for (place, tick, number, _), frame in sorted(self.others.get(robot, ()), key=itemgetter(0))
        ]


class Air:
    """The frames that each robot hears of those sent: by topology, latency and faults.

    Attributes:
        in_range: Frames sent so far, counted once for each neighbour in range.
        arrived: Frames heard so far.
    """

    def __init__(self, world: InRange, faults: Faults, latency: int) -> None:
        """Carry frames in ``latency`` steps, 0 or 1, to robots that are in range when these have passed."""
        self.in_range = self.arrived = 0
        self._world = world
        self._faults = faults
        self._is_late = latency > 0
        self._held: tuple[Sequence[SentFrame], NDArray[np.bool_] | None] = (), None
        self._due: dict[int, dict[int, list[tuple[_Turn, can.Message]]]] = {}

    def arrivals(
        self, tick: int, sent: Sequence[SentFrame], came: NDArray[np.bool_] | None = None
    ) -> Arrivals:
        """The frames that robots hear in this tick, of those ``sent`` in it and late ones.

        ``came``, of shape (frames, robots), is false where a bus has not brought a frame to a robot. Call
        once per tick, and pass no frame twice. O(faults frames robots).
        """
        if self._is_late:
            (sent, came), self._held = self._held, (sent, came)
        in_range = self._world.hears[:, np.array([each.sender for each in sent], np.intp)].T
        if came is not None:
            in_range = in_range & came
        ways = self._faults.ways(tick, sent, in_range)
        for (number, robot), deliveries in ways.changed.items():
            for version, way in enumerate(deliveries):
                turn = way.place, tick, number, version
                due = self._due.setdefault(tick + way.delay, defaultdict(list))
                due[robot].append((turn, way.frame))
        others = self._due.pop(tick, {})
        self.in_range += int(np.count_nonzero(in_range))
        self.arrived += int(np.count_nonzero(ways.plain)) + sum(map(len, others.values()))
        return Arrivals(tick, sent, ways.plain, others)
