"""Frames handed over inside the process, for swarms that no other program can hear.

Every frame is made and logged as on a bus, and decoded once for all robots; each robot takes all estimates
of a tick at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import can
import numpy as np

from mcp_asdf_tools.bus import Message
from mcp_asdf_tools.robots import BusRobot, Decoder, Estimates, FrameTaker, rows_of
from mcp_asdf_tools.swarm.air import Air
from mcp_asdf_tools.swarm.transmission import SentFrame
from mcp_asdf_tools.swarm.ways import Mask


class InProcess:
    """A medium without a bus. O(robots) a frame, with a small constant."""

    missed = 0

    def __init__(
        self, robots: Sequence[BusRobot], air: Air, decoder: Decoder, log: FrameTaker | None
    ) -> None:
        """Carry frames between all robots of a swarm; ``log`` takes a copy of each."""
        self._robots = robots
        self._air = air
        self._decode = decoder
        self._log = log
        self._sent: list[SentFrame] = []

    def send(self, sent: SentFrame) -> None:
        """Take a frame, and log it as a bus would hand it over."""
        if self._log is not None:
            self._log(copy(sent.frame))
        self._sent.append(sent)

    def carry(self, tick: int) -> None:
        """Let every robot hear what it hears in this tick."""
        sent, self._sent = self._sent, []
        for frames, reach in self._air.arrivals(tick, sent).for_all():
            self._hand_over(frames, reach)

    def _hand_over(self, frames: Sequence[can.Message], reach: Mask) -> None:
        """Let each robot receive all of its estimates at once, and count all other frames."""
        contents = np.array([self._decode(frame) for frame in frames], np.object_)
        is_estimate = np.array([isinstance(each, Message) for each in contents], np.bool_)
        estimates, others = Estimates.of(rows_of(contents.tolist())), contents[~is_estimate]
        for robot, heard in zip(self._robots, estimates.heard(reach[is_estimate]), strict=True):
            robot.receive(heard)
        if len(others):
            for robot, heard in zip(self._robots, reach[~is_estimate].T, strict=True):
                robot.count(others[heard].tolist())

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: there is no bus to leave."""
