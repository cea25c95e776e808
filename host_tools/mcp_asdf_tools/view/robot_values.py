"""The latest values that robots have sent in frames, on a bus or in a log."""

from __future__ import annotations

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frame_layout import Q23_ONE
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Telemetry, decode_frame
from mcp_asdf_tools.view.history import QUANTITIES, State
from mcp_asdf_tools.view.roster import Q24_ONE, Roster

_X = QUANTITIES.index("x")
_X_HAT = QUANTITIES.index("x_hat")
_B_HAT = QUANTITIES.index("b_hat")


class LatestRobotValues:
    """The robots that have sent estimates or telemetry, with the latest values that they sent.

    Attributes:
        roster: What an observer knows of all nodes, also of those that sent no values.
        has_telemetry: Whether a robot has sent telemetry: x and b_hat are in no other frame.
    """

    def __init__(self, frame_format: FrameFormat, true_accuracy: float | None) -> None:
        """Start without robots, to decode estimates by ``frame_format``.

        ``true_accuracy`` is that of every robot's sensor, which no frame shows; None if it is unknown.
        """
        self.roster = Roster()
        self.has_telemetry = False
        self._frame_format = frame_format
        known_accuracy = np.nan if true_accuracy is None else true_accuracy
        self._unknown_values = [np.nan, np.nan, np.nan, known_accuracy]
        self._values_by_robot: dict[int, list[float]] = {}

    @property
    def ids(self) -> list[int]:
        """Ids of the robots that have sent values, in the order of the first ones."""
        return list(self._values_by_robot)

    def receive(self, frame: can.Message, now: float) -> int | None:
        """Take the values of a frame of any node, received at ``now`` seconds. O(1).

        Return the sender's id if these are its first values, else None. Heartbeats and rejected frames have
        no values; they only go to the roster.
        """
        content = decode_frame(frame, self._frame_format)
        self.roster.receive(frame, content, now)
        if not isinstance(content, Estimate | Telemetry):
            return None
        is_new = content.sender not in self._values_by_robot
        if is_new:
            self._values_by_robot[content.sender] = self._unknown_values.copy()
        values = self._values_by_robot[content.sender]
        if isinstance(content, Estimate):
            values[_X_HAT] = content.x_hat / Q23_ONE
        else:
            self.has_telemetry = True
            values[_X] = content.x / Q23_ONE
            values[_B_HAT] = content.b_hat / Q24_ONE
        return content.sender if is_new else None

    def state(self, tick: int, now: float, robots: list[int], neighbours: NDArray[np.bool_]) -> State:
        """Return the state at ``now`` seconds, with a column for each id in ``robots``, and no positions.

        Robots without a frame in the last SILENT_SECONDS lose their values, here and in states to come, until
        they send again. No frame shows which robot receives from which, so callers give ``neighbours`` that
        are all false.
        """
        for robot_id, values in self._values_by_robot.items():
            if self.roster.robots[robot_id].is_silent(now):
                values[:] = self._unknown_values
        columns = [self._values_by_robot.get(robot_id, self._unknown_values) for robot_id in robots]
        return State(tick, np.array(columns).T, neighbours, positions=None)
