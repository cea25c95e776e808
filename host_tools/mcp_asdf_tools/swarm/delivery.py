"""Which robots receive which frames, and when: by topology, latency and faults of the links."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import sender_of

ReceiverMask: TypeAlias = NDArray[np.bool_]
"""Whether a robot receives a frame, shape (frames, robots); a robot's column is its id."""


FrameKey: TypeAlias = tuple[int, bytes]
"""Identifier and data of a frame: a bus preserves both, and they tell frames apart."""


def key_of(frame: can.Message) -> FrameKey:
    """Return the identifier and the data of a frame."""
    return frame.arbitration_id, bytes(frame.data)


@dataclass(frozen=True)
class SentFrame:
    """A frame that a node has put on the bus.

    Attributes:
        frame: The frame as it is on the bus.
        sender: The node that sent it. A faulty node may send under another node's id.
        tick: The tick in which it was sent.
        repetition: Number of frames with the same identifier that the node sent earlier in this tick.
        is_falsified: Whether a fault has put another estimate in place of the robot's own.
    """

    frame: can.Message
    sender: int
    tick: int
    repetition: int = 0
    is_falsified: bool = False

    @cached_property
    def key(self) -> FrameKey:
        """Identifier and data of the frame, computed once, since late frames are compared in many ticks."""
        return key_of(self.frame)

    @property
    def is_under_own_id(self) -> bool:
        """True if the node sent the frame under its own id."""
        return sender_of(self.frame) == self.sender

    def with_false_estimate(self, frame: can.Message) -> SentFrame:
        """Return a copy of this that carries ``frame``, which has another estimate, in place of its own.

        It is marked as falsified if the data of the two frames differ, or if it has been falsified before.
        """
        is_different = frame.data != self.frame.data
        return replace(self, frame=frame, is_falsified=self.is_falsified or is_different)


@dataclass(frozen=True)
class Deliveries:
    """Frames on their way to robots, in the order in which robots receive them.

    Attributes:
        sent_frames: The frames. A frame that a fault has corrupted is here once for each of its receivers,
            since the fault flips other bits for each of them.
        receivers: The robots that receive each frame.
        delay: Ticks by which faults delay all of these frames.
        copy_number: Distinguishes copies of one frame for the same receiver.
    """

    sent_frames: Sequence[SentFrame]
    receivers: ReceiverMask
    delay: int = 0
    copy_number: int = 0

    def frames_for(self, robot: int) -> list[SentFrame]:
        """Return the frames that a robot receives, in order."""
        indices = np.flatnonzero(self.receivers[:, robot])
        return [self.sent_frames[index] for index in indices.tolist()]


LinkFaults: TypeAlias = Callable[[Sequence[SentFrame], ReceiverMask], list[Deliveries]]
"""Applies the faults of links to frames and the robots in range of their senders: ``Faults.on_delivery``."""


class DeliveryQueue:
    """Frames between senders and receivers: they wait here for latency and delays to pass.

    Attributes:
        in_range_count: Frames sent so far, counted once for each robot in range of the sender.
        delivered_count: Frames delivered so far, counted once for each receiver.
    """

    def __init__(
        self, current_neighbours: Callable[[], NDArray[np.bool_]], apply_link_faults: LinkFaults, latency: int
    ) -> None:
        """Create an empty queue.

        Args:
            current_neighbours: Returns a matrix whose entry (i, j) is whether robot i receives from robot j
                at present; the diagonal is false.
            apply_link_faults: Turns frames and the robots in range into deliveries.
            latency: Ticks from sending to delivery, 0 or 1. Who is in range is decided at delivery.
        """
        self.in_range_count = 0
        self.delivered_count = 0
        self._current_neighbours = current_neighbours
        self._apply_link_faults = apply_link_faults
        self._frames_by_tick: deque[Sequence[SentFrame]] = deque([()] * latency)
        """Frames that wait for the latency to pass; an entry has those of a tick, the earliest tick first."""
        self._pending: defaultdict[int, list[Deliveries]] = defaultdict(list)
        """Deliveries by the tick in which they arrive."""

    def deliver(self, tick: int, sent_frames: Sequence[SentFrame]) -> Deliveries:
        """Take the frames sent in ``tick``, and return what robots receive in it.

        Without latency these frames go to the robots in range. With latency the frames of the last tick do,
        while these wait. Faults may take some away, delay or duplicate them. ``in_range_count`` and
        ``delivered_count`` grow by one for each frame and robot. Call this once per tick, in order.
        O(faults frames robots).
        """
        self._frames_by_tick.append(sent_frames)
        # Without latency these are the frames of this tick.
        arriving_frames = self._frames_by_tick.popleft()
        in_range = self._robots_in_range(arriving_frames)
        self.in_range_count += int(np.count_nonzero(in_range))
        # Faults may delay frames: everything goes through the queue, also what arrives in this tick.
        for deliveries in self._apply_link_faults(arriving_frames, in_range):
            self._pending[tick + deliveries.delay].append(deliveries)

        _, robot_count = in_range.shape
        arriving_now = _concatenate(self._pending.pop(tick, []), robot_count)
        self.delivered_count += int(np.count_nonzero(arriving_now.receivers))
        return arriving_now

    def _robots_in_range(self, sent_frames: Sequence[SentFrame]) -> ReceiverMask:
        """Return a mask that says which robots are at present in range of the sender of each frame."""
        senders = np.array([sent_frame.sender for sent_frame in sent_frames], np.intp)
        receivers_by_sender = self._current_neighbours().T  # row j: whether each robot receives from j
        return receivers_by_sender[senders]


def _concatenate(all_deliveries: Sequence[Deliveries], robot_count: int) -> Deliveries:
    """Return several deliveries as one, in order, without their delays and copy numbers."""
    sent_frames: list[SentFrame] = []
    # With an empty array at the front the result has its shape and type even if nothing is delivered.
    no_receivers = np.zeros((0, robot_count), np.bool_)
    receivers = [no_receivers]
    for deliveries in all_deliveries:
        sent_frames += deliveries.sent_frames
        receivers.append(deliveries.receivers)
    return Deliveries(sent_frames, np.concatenate(receivers))
