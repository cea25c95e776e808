"""Frames handed over inside the process, for swarms that no other program can hear.

Every frame is made and logged as on a bus, and decoded once for all robots; each robot takes all estimates
of a tick at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.robots import BusRobot, Decoder, Estimates, FrameTaker
from mcp_asdf_tools.swarm.air import Air, Arrivals
from mcp_asdf_tools.swarm.transmission import SentFrame


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
            self._log(sent.frame)
        self._sent.append(sent)

    def carry(self, tick: int) -> None:
        """Let every robot hear what it hears in this tick."""
        sent, self._sent = self._sent, []
        self._hand_over(self._air.arrivals(tick, sent))

    def _hand_over(self, arrivals: Arrivals) -> None:
        """Let each robot receive all of its estimates at once, and count all other frames."""
        words, is_estimate = self._decode.estimates(arrivals.sent, arrivals.flips)
        estimates = Estimates(words[is_estimate])
        for robot, heard in zip(self._robots, estimates.heard(arrivals.reach[is_estimate]), strict=True):
            robot.receive(heard)
        if not is_estimate.all():
            self._count(arrivals, np.flatnonzero(~is_estimate))

    def _count(self, arrivals: Arrivals, others: NDArray[np.intp]) -> None:
        contents = np.array(
            [self._decode.once(arrivals.frame(number)) for number in others.tolist()], np.object_
        )
        reach = arrivals.reach[others]
        for robot in np.flatnonzero(reach.any(axis=0)).tolist():
            self._robots[robot].count(contents[reach[:, robot]].tolist())

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: there is no bus to leave."""
