"""Values of robots as their frames give them, on a bus or in a log."""

from __future__ import annotations

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frame_layout import Q23_ONE
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Telemetry, decode_frame
from mcp_asdf_tools.view.film import QUANTITIES, State
from mcp_asdf_tools.view.roster import Roster

_X, _X_HAT, _B_HAT, _ = range(len(QUANTITIES))


class LatestRobotValues:
    """The robots that have sent estimates or telemetry, with the latest values that they sent.

    Attributes:
        roster: What an observer knows of all nodes, also of those without values.
        has_telemetry: Whether a robot has sent telemetry: x and b_hat are in no other frame.
    """

    def __init__(self, frame_format: FrameFormat, true_accuracy: float | None) -> None:
        """Begin without robots. All have the same ``true_accuracy``, None if it is unknown."""
        self.roster = Roster()
        self.has_telemetry = False
        self._frame_format = frame_format
        self._unknown = [np.nan, np.nan, np.nan, np.nan if true_accuracy is None else true_accuracy]
        self._values: dict[int, list[float]] = {}

    @property
    def ids(self) -> list[int]:
        """Ids of the robots with values, in the order in which they were first heard."""
        return [*self._values]

    def receive(self, frame: can.Message, now: float) -> int | None:
        """Take a frame of any node at ``now`` seconds; return the id of a robot that is new. O(1)."""
        content = decode_frame(frame, self._frame_format)
        self.roster.hear(frame, content, now)
        if not isinstance(content, Estimate | Telemetry):
            return None
        is_new = content.sender not in self._values
        values = self._values.setdefault(content.sender, self._unknown.copy())
        if isinstance(content, Estimate):
            values[_X_HAT] = content.x_hat / Q23_ONE
        else:
            self.has_telemetry = True
            values[_X], values[_B_HAT] = content.x / Q23_ONE, content.b_hat / 2**24
        return content.sender if is_new else None

    def state(self, tick: int, now: float, robots: list[int], hears: NDArray[np.bool_]) -> State:
        """Return the state of ``robots`` at ``now`` seconds; nothing is known of those that are silent.

        A bus does not show who hears whom, so ``hears`` is all false.
        """
        for robot, values in self._values.items():
            if self.roster.robots[robot].is_silent(now):
                values[:] = self._unknown
        columns = [self._values.get(robot, self._unknown) for robot in robots]
        return State(tick, np.array(columns).T, hears, None)
