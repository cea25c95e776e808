"""Topology and faults: the frames that reach each robot, and when."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Protocol

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.swarm.faults import Faults, SentFrame, Ways
from mcp_asdf_tools.swarm.ways import Mask


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
class Batch:
    """Frames sent in one tick that arrive in one tick on one kind of ways."""

    sent: Sequence[SentFrame]
    ways: Ways

    def one_by_one(self) -> list[tuple[float, int, can.Message]]:
        """Place, receiver and frame of each arrival, those of a receiver in the order of sending."""
        reach, places, damaged = self.ways.reach, self.ways.places, self.ways.damaged
        numbers, receivers = (each.tolist() for each in reach.nonzero())
        come_at = [0.0] * len(numbers) if places is None else places[reach].tolist()
        return [
            (place, receiver, damaged.get((number, receiver), self.sent[number].frame))
            for place, number, receiver in zip(come_at, numbers, receivers, strict=True)
        ]


@dataclass(frozen=True)
class Arrivals:
    """Frames that robots hear in one tick.

    Attributes:
        in_turn: Those that come in their turn: late ones first, then frames as sent, copies, damaged ones.
        behind: Those that fall behind these, by rising place.
    """

    in_turn: Sequence[Batch]
    behind: Sequence[Batch]

    def of(self, robot: int) -> list[can.Message]:
        """The frames that ``robot`` hears, in order."""
        behind = [pair for each in self.behind for pair in each.ways.to(robot, each.sent)]
        return [
            *(frame for each in self.in_turn for _, frame in each.ways.to(robot, each.sent)),
            *(frame for _, frame in sorted(behind, key=itemgetter(0))),
        ]

    def for_all(self) -> Iterator[tuple[Sequence[can.Message], Mask]]:
        """The frames that robots hear, in an order that is right for each, and which robots hear which."""
        for each in self.in_turn:
            if each.ways.damaged:
                yield _with_one_receiver(each.one_by_one(), each.ways.reach.shape[1])
            else:
                yield [sent.frame for sent in each.sent], each.ways.reach
        behind = sorted((one for each in self.behind for one in each.one_by_one()), key=itemgetter(0))
        if behind:
            yield _with_one_receiver(behind, self.behind[0].ways.reach.shape[1])


def _with_one_receiver(
    arrivals: Sequence[tuple[float, int, can.Message]], receivers: int
) -> tuple[Sequence[can.Message], Mask]:
    reach = np.zeros((len(arrivals), receivers), np.bool_)
    reach[np.arange(len(arrivals)), [receiver for _, receiver, _ in arrivals]] = True
    return [frame for *_, frame in arrivals], reach


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
        return Arrivals(
            [each for each in due if each.ways.places is None],
            [each for each in due if each.ways.places is not None],
        )
