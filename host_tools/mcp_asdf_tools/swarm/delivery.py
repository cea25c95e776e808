"""Delivery: the frames that each robot hears, and when, by topology, latency and faults."""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import can
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
"""One value for each frame of a tick and each receiver, by id, shape (frames, receivers)."""


@dataclass(frozen=True)
class SentFrame:
    """A frame that has got onto the bus.

    Attributes:
        frame: As it is there.
        sender: The node that has sent it, which may differ from the id in the frame.
        tick: When.
        number: Frames with its identifier that the node has sent before in this tick.
    """

    frame: can.Message
    sender: int
    tick: int
    number: int = 0


def content_of(frame: can.Message) -> tuple[int, bytes]:
    """What tells a frame on a bus from others: identifier and data."""
    return frame.arbitration_id, bytes(frame.data)


@dataclass(frozen=True)
class Paths:
    """Frames of one tick on paths of one kind to robots, in an order that is right for each of them.

    Attributes:
        sent: The frames; one that arrives damaged is here once for each receiver.
        reach: True for the robots that hear a frame, shape (frames, robots).
        flips: Bits of the data that arrive flipped, the lowest that of the first byte, shape (frames,).
        delay: Ticks that they take.
        version: Number that tells copies for one receiver apart.
    """

    sent: Sequence[SentFrame]
    reach: Mask
    flips: NDArray[np.uint64]
    delay: int = 0
    version: int = 0

    def frame(self, number: int) -> can.Message:
        """A frame as it arrives."""
        frame, flips = self.sent[number].frame, int(self.flips[number])
        if not flips:
            return frame
        damaged, data = copy.copy(frame), int.from_bytes(frame.data, "little") ^ flips
        damaged.data = bytearray(data.to_bytes(len(frame.data), "little"))
        return damaged

    def of(self, robot: int) -> list[can.Message]:
        """The frames that ``robot`` hears, in order."""
        return [self.frame(number) for number in self.reach[:, robot].nonzero()[0].tolist()]


Links: TypeAlias = Callable[[int, Sequence[SentFrame], Mask], list[Paths]]
"""``Faults.paths``: those of frames that arrive in a tick, if undisturbed, at the receivers in range."""


class Delivery:
    """The frames that each robot hears of those sent.

    Attributes:
        in_range: Frames sent so far, counted once for each neighbour in range.
        arrived: Frames heard so far.
    """

    def __init__(self, hears: Callable[[], NDArray[np.bool_]], paths: Links, latency: int) -> None:
        """Bring frames in ``latency`` steps, 0 or 1, to robots that are in range when these have passed.

        ``hears`` returns whether robot i hears j at present, by id; never itself.
        """
        self.in_range = self.arrived = 0
        self._hears, self._paths = hears, paths
        self._is_late = latency > 0
        self._held: Sequence[SentFrame] = ()
        self._due: defaultdict[int, list[Paths]] = defaultdict(list)

    def arrivals(self, tick: int, sent: Sequence[SentFrame]) -> Paths:
        """The frames that robots hear in this tick, of those ``sent`` in it and late ones.

        Call once per tick, and pass no frame twice. O(faults frames robots).
        """
        if self._is_late:
            sent, self._held = self._held, sent
        in_range = self._hears()[:, np.array([each.sender for each in sent], np.intp)].T
        for paths in self._paths(tick, sent, in_range):
            self._due[tick + paths.delay].append(paths)
        due = _joined(self._due.pop(tick, []), in_range.shape[1])
        self.in_range += int(np.count_nonzero(in_range))
        self.arrived += int(np.count_nonzero(due.reach))
        return due


def _joined(due: Sequence[Paths], robots: int) -> Paths:
    """All of these, in this order."""
    return Paths(
        [each for paths in due for each in paths.sent],
        np.concatenate([np.zeros((0, robots), np.bool_), *(paths.reach for paths in due)]),
        np.concatenate([np.zeros(0, np.uint64), *(paths.flips for paths in due)]),
    )
