"""Topology and faults: the frames that reach each robot, and when."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Sequence
from itertools import count
from typing import Protocol

import can

from mcp_asdf_tools.swarm.faults import Faults, SentFrame


class Hearer(Protocol):
    """Robot as seen by a medium."""

    def hear(self, frame: can.Message) -> None:
        """Take a frame of a neighbour, possibly changed on its way."""

    def hear_stranger(self, frame: can.Message) -> None:
        """Take a frame from outside the swarm."""


class InRange(Protocol):
    """World as seen by the air."""

    def neighbours(self, robot: int) -> Collection[int]:
        """Ids of the robots that ``robot`` hears at present; never itself."""


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
        self._is_late = latency > 0
        self._held: dict[int, Sequence[SentFrame]] = {}
        self._faults = faults
        self._late: dict[int, list[tuple[int, float, int, can.Message]]] = {}
        self._order = count()

    @property
    def is_plain(self) -> bool:
        """Whether every frame reaches the robots in range in the tick in which it is sent."""
        return not self._is_late and not self._faults.faults

    def count(self, frames: int) -> None:
        """Count frames that a robot in range hears, where this object is not asked for arrivals."""
        self.in_range += frames
        self.arrived += frames

    def hand_over(self, hearers: Sequence[Hearer], tick: int, sent: Sequence[SentFrame]) -> None:
        """Let every robot, by id, hear its arrivals of this tick, without a bus. O(robots sent)."""
        for robot, hearer in enumerate(hearers):
            for frame in self.arrivals(robot, tick, [each for each in sent if each.sender != robot]):
                hearer.hear(frame)

    def arrivals(self, receiver: int, tick: int, sent: Sequence[SentFrame]) -> list[can.Message]:
        """The frames that ``receiver`` hears in this tick, in order, of those ``sent`` in it and late ones.

        Call once per tick. O((sent + late) log late).
        """
        if self._is_late:
            sent, self._held[receiver] = self._held.get(receiver, ()), tuple(sent)
        neighbours = self._world.neighbours(receiver)
        in_range = [each for each in sent if each.sender in neighbours]
        heard = self._heard(receiver, tick, in_range) if self._faults.faults else [s.frame for s in in_range]
        self.in_range += len(in_range)
        self.arrived += len(heard)
        return heard

    def _heard(self, receiver: int, tick: int, in_range: Sequence[SentFrame]) -> list[can.Message]:
        late = self._late.setdefault(receiver, [])
        for each in in_range:
            for way in self._faults.deliver(each, receiver, tick):
                heapq.heappush(late, (tick + way.delay, way.place, next(self._order), way.frame))
        heard = []
        while late and late[0][0] <= tick:
            heard.append(heapq.heappop(late)[-1])
        return heard
