"""Frames handed over inside the process, for swarms that no other program can hear.

Every frame is made and logged as on a bus, and decoded once for all robots; each robot takes all estimates
of a tick at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus import Message
from mcp_asdf_tools.robots import BusRobot, Decoder, Estimates, FrameTaker, rows_of
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
            self._log(copy(sent.frame))
        self._sent.append(sent)

    def carry(self, tick: int) -> None:
        """Let every robot hear what it hears in this tick."""
        sent, self._sent = self._sent, []
        arrivals = self._air.arrivals(tick, sent)
        contents = np.array([self._decode(each.frame) for each in arrivals.sent], np.object_)
        is_estimate = np.array([isinstance(each, Message) for each in contents], np.bool_)
        self._hand_over_estimates(
            arrivals, is_estimate.nonzero()[0], Estimates.of(rows_of(contents.tolist()))
        )
        others = contents[~is_estimate]
        if len(others):
            for robot, heard in zip(self._robots, arrivals.plain[~is_estimate].T, strict=True):
                robot.count(others[heard].tolist())

    def _hand_over_estimates(
        self, arrivals: Arrivals, numbers: NDArray[np.intp], estimates: Estimates
    ) -> None:
        """Let each robot receive all of its estimates at once, late and changed ones in their turn."""
        for robot, heard in zip(self._robots, arrivals.plain[numbers].T, strict=True):
            if robot.id in arrivals.others:
                robot.receive(self._with_others(arrivals, robot, numbers[heard], estimates[heard]))
            else:
                robot.receive(estimates[heard])

    def _with_others(
        self, arrivals: Arrivals, robot: BusRobot, numbers: NDArray[np.intp], estimates: Estimates
    ) -> Estimates:
        """The plain estimates of these ``numbers`` and the other ones in order; counts what is none."""
        others = [(place, self._decode(frame)) for place, frame in arrivals.between(robot.id, numbers)]
        robot.count([content for _, content in others if not isinstance(content, Message)])
        order = list(range(len(numbers)))
        for before, place in enumerate(place for place, content in others if isinstance(content, Message)):
            order.insert(place + before, len(order))
        return (estimates + Estimates.of(rows_of([content for _, content in others])))[order]

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: there is no bus to leave."""
