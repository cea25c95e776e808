"""Topology and faults: the frames that reach each robot, and when."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.swarm.faults import Faults, SentFrame, Ways
from mcp_asdf_tools.swarm.ways import Mask, flipped


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
    """Frames that robots hear in one tick, in an order that is right for each of them.

    Attributes:
        sent: The frames as they were sent; one that arrives differently is here once for each receiver.
        flips: Bits of the data that arrive flipped, as in ``Ways``, shape (frames,).
        reach: True for the robots that hear a frame, shape (frames, robots).
    """

    sent: Sequence[can.Message]
    flips: NDArray[np.uint64]
    reach: Mask

    def frame(self, number: int) -> can.Message:
        """A frame as it arrives."""
        flips = int(self.flips[number])
        return flipped(self.sent[number], flips) if flips else self.sent[number]

    def of(self, robot: int) -> list[can.Message]:
        """The frames that ``robot`` hears, in order."""
        return [self.frame(number) for number in self.reach[:, robot].nonzero()[0].tolist()]


@dataclass(frozen=True)
class Batch:
    """Frames sent in one tick that arrive in one tick on one kind of ways."""

    sent: Sequence[SentFrame]
    ways: Ways

    def arrivals(self) -> Arrivals:
        """The frames in the order of sending."""
        frames, reach, flips = [each.frame for each in self.sent], self.ways.reach, self.ways.flips
        if flips is None and self.ways.places is None:
            return Arrivals(frames, np.zeros(len(frames), np.uint64), reach)
        numbers, receivers = reach.nonzero()
        own = np.zeros((len(numbers), reach.shape[1]), np.bool_)
        own[np.arange(len(numbers)), receivers] = True
        came = np.zeros(len(numbers), np.uint64) if flips is None else flips[reach]
        return Arrivals([frames[number] for number in numbers.tolist()], came, own)


def _joined(batches: Sequence[Batch], robots: int) -> Arrivals:
    """Those in their turn as they come, then those that fall behind, by rising place."""
    parts = [each.arrivals() for each in batches]
    sent = [frame for each in parts for frame in each.sent]
    flips = np.concatenate([np.zeros(0, np.uint64), *(each.flips for each in parts)])
    reach = np.concatenate([np.zeros((0, robots), np.bool_), *(each.reach for each in parts)])
    if all(each.ways.places is None for each in batches):
        return Arrivals(sent, flips, reach)
    places = [_places(each.ways, len(part.sent)) for each, part in zip(batches, parts, strict=True)]
    order = np.concatenate(places).argsort(kind="stable")
    return Arrivals([sent[number] for number in order.tolist()], flips[order], reach[order])


def _places(ways: Ways, arrivals: int) -> NDArray[np.float64]:
    """Place in its tick of each arrival, 0 for its turn."""
    return np.zeros(arrivals) if ways.places is None else ways.places[ways.reach]


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
        self._due: defaultdict[int, list[Batch]] = defaultdict(list)

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
        for ways in self._faults.ways(tick, sent, in_range):
            self._due[tick + ways.delay].append(Batch(sent, ways))
        due = self._due.pop(tick, [])
        self.in_range += int(np.count_nonzero(in_range))
        self.arrived += sum(int(np.count_nonzero(each.ways.reach)) for each in due)
        return _joined(due, in_range.shape[1])
