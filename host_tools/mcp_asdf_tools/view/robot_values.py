"""The latest values that robots have sent in frames, on a bus or in a log."""

from __future__ import annotations

import can
import numpy as np

from mcp_asdf_tools.bus.frame_layout import B_HAT_UNITS, Q23_ONE
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Telemetry, decode_frame
from mcp_asdf_tools.view.history import QUANTITIES, State
from mcp_asdf_tools.view.roster import Roster

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
        # In the order of QUANTITIES, whose last one is the true accuracy.
        self._unknown_values = [np.nan, np.nan, np.nan, known_accuracy]
        self._values_by_robot: dict[int, list[float]] = {}
        self._no_links = np.zeros((0, 0), np.bool_)

    @property
    def robot_ids(self) -> list[int]:
        """The ids of the robots that have sent values, in the order in which they began."""
        return list(self._values_by_robot)

    def receive(self, frame: can.Message, now: float) -> int | None:
        """Take the values of a frame of any node, received at ``now`` seconds. O(1).

        Return the sender's id if these are its first values, else None. The roster receives every frame, but
        heartbeats and rejected frames have no values.
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
            values[_B_HAT] = content.b_hat / B_HAT_UNITS
        return content.sender if is_new else None

    def make_state(self, tick: int, now: float, robot_ids: list[int]) -> State:
        """Return the state at ``now`` seconds, with a column for each id in ``robot_ids``.

        It has neither links nor positions, as no frame shows them. Robots without a frame in the last
        SILENT_SECONDS lose their values, here and in states to come, until they send again.
        """
        for robot_id, values in self._values_by_robot.items():
            if self.roster.robots[robot_id].is_silent(now):
                values[:] = self._unknown_values
        # A robot that has sent nothing so far has unknown values.
        columns = [self._values_by_robot.get(robot_id, self._unknown_values) for robot_id in robot_ids]
        # States share this matrix, which would otherwise take most of a long history's memory.
        if len(self._no_links) != len(robot_ids):
            self._no_links = np.zeros((len(robot_ids), len(robot_ids)), np.bool_)
        return State(tick, np.array(columns).T, self._no_links, positions=None)
