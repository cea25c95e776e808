"""The history of the robots on a bus, recorded from their frames."""

from __future__ import annotations

import time
from collections.abc import Callable

import can

from mcp_asdf_tools.bus.frames import FrameFormat, decode_frame
from mcp_asdf_tools.view.history import History, RunDescription
from mcp_asdf_tools.view.roster import Roster

STATES_PER_SECOND = 10
"""States that a history has for each second on a bus; they are its ticks."""
TICKS_PER_REPORT = 5
"""Ticks from one report on the robots of a bus to the next."""


class BusRecorder:
    """Records the history of the robots on a bus from their frames.

    A bus shows neither positions nor which robot receives from which, so the history has none of these.

    Attributes:
        history: What was recorded so far; robots are in the order of their first estimate or telemetry.
        roster: What an observer knows of all nodes, also of those that sent neither.
    """

    def __init__(
        self,
        bus: can.BusABC,
        frame_format: FrameFormat,
        title: str,
        fill_ratio: float | None = None,
        true_accuracy: float | None = None,
    ) -> None:
        """Prepare to record from ``bus`` the estimates of ``frame_format``, heartbeats and telemetry.

        ``fill_ratio`` and ``true_accuracy``, which frames do not show, are for the page; None if unknown.
        """
        description = RunDescription(
            title, robots=[], fill_ratio=fill_ratio, steps_per_second=STATES_PER_SECOND
        )
        self.history = History(description)
        self._bus = bus
        self.roster = Roster(true_accuracy)
        self._frame_format = frame_format
        self._next_report_tick = 0
        self._start_time = 0.0

    def record(self, should_stop: Callable[[], bool]) -> None:
        """Receive frames and add states to the history until ``should_stop``, which is asked after each.

        States come STATES_PER_SECOND times a second, and time starts anew with each call. Raises can.CanError
        if the bus fails.
        """
        self._start_time = time.monotonic()
        tick = 0
        while not should_stop():
            seconds_to_tick = tick / STATES_PER_SECOND - self._seconds_since_start()
            # Wait for a frame at most until the next state is due. With a timeout of 0 a frame that has
            # arrived is still received, so that the state comes after it.
            frame = self._bus.recv(timeout=max(seconds_to_tick, 0.0))
            if frame is not None:
                self._receive(frame)
            if seconds_to_tick <= 0:
                self._add_state(tick)
                # The next tick that is still to come. A busy computer leaves out ticks that have passed, so
                # that the states do not fall further and further behind.
                present_tick = int(self._seconds_since_start() * STATES_PER_SECOND)
                tick = present_tick + 1

    def _receive(self, frame: can.Message) -> None:
        """Take a frame of any node, and add its robot to the history with its first values.

        O(robots), or O(states) for a new robot.
        """
        self.roster.receive(frame, decode_frame(frame, self._frame_format), self._seconds_since_start())
        robots_in_history = len(self.history.description.robots)
        for new_robot_id in self.roster.ids_with_values[robots_in_history:]:
            self.history.add_robot(new_robot_id)

    def _seconds_since_start(self) -> float:
        """Return the seconds since recording began."""
        return time.monotonic() - self._start_time

    def _add_state(self, tick: int) -> None:
        """Add a state if there are robots, and every TICKS_PER_REPORT ticks replace the history's report."""
        now = self._seconds_since_start()
        robot_ids = self.roster.ids_with_values
        if robot_ids:
            self.history.add(self.roster.make_state(tick, now, robot_ids))
        if tick >= self._next_report_tick:
            self.history.report = self.roster.report(now)
            self._next_report_tick = tick + TICKS_PER_REPORT
