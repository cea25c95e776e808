#!/usr/bin/env python3
"""A ROS 2 node of one robot, which observes the floor and exchanges estimates with the robots around it.

Topics:

- ``black`` (std_msgs/Bool), read: the tile under the sensor. Publish one whenever the robot has moved on.
- ``state`` (mcp_asdf_ros/State), written: what the robot knows, after every round.
- ``/estimates`` (mcp_asdf_ros/Estimate), read and written: the broadcasts of all robots.

Parameters:

- ``id``: of the robot, 0 to 127. Every robot has its own.
- ``initial_b_hat``: probability that the sensor names a colour correctly, as the robot assumes at first.
- ``filter``: ``robust``, ``adaptive`` (the paper's), ``always`` or ``none``.
- ``filter_period``: rounds from one run of the filter to the next.
- ``broadcast_period``: length of a round, in seconds.
- ``omega`` and ``neighbours``: error probability of the paper's filter, and number of neighbours up to which
  its thresholds are exact.
"""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from mcp_asdf_ros.msg import Estimate, State
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Bool

from mcp_asdf import Config, Filter, NativeRobot, Observation
from mcp_asdf_tools.tables.thresholds import check_q, generate, parse_omega

FILTERS = {
    "robust": Filter.ROBUST,
    "adaptive": Filter.ADAPTIVE,
    "always": Filter.ALWAYS,
    "none": Filter.OFF,  # "off" would arrive as false: ROS reads values of parameters as YAML
}
QUEUE_DEPTH = 128
"""Messages that a topic keeps until the node handles them: one of each robot."""


class RobotNode(Node):
    """The node. Its callbacks run one after the other, as the robot needs it: do not give it to an executor
    with several threads.

    Attributes:
        robot: The firmware of the robot.
    """

    def __init__(self) -> None:
        """Make the robot by the node's parameters.

        Raises ValueError for a parameter that is out of range, ParameterException for one of another type.
        """
        super().__init__("robot")
        robot_id = self._declare("id", 0)
        initial_b_hat = self._declare("initial_b_hat", 0.95)
        self.robot = NativeRobot(self._declare_config(), robot_id, initial_b_hat)
        broadcast_period = self._declare("broadcast_period", 1.0)
        if not broadcast_period > 0:
            raise ValueError(f"broadcast_period is {broadcast_period} seconds; choose more than 0")

        self._estimates = self.create_publisher(Estimate, "/estimates", QUEUE_DEPTH)
        self._states = self.create_publisher(State, "state", QUEUE_DEPTH)
        self.create_subscription(Estimate, "/estimates", self._receive_estimate, QUEUE_DEPTH)
        self.create_subscription(Bool, "black", self._observe_tile, QUEUE_DEPTH)
        self.create_timer(broadcast_period, self._close_round)

    def _declare(self, name: str, default: Any) -> Any:
        """Declare a parameter, and return its value, which has the type of the default."""
        return self.declare_parameter(name, default).value

    def _declare_config(self) -> Config:
        """Declare the parameters of the filter, and return them as settings of the firmware."""
        filter_name = self._declare("filter", "robust")
        filter_period = self._declare("filter_period", 1000)
        omega = self._declare("omega", 0.05)
        neighbours = self._declare("neighbours", 30)
        if filter_name not in FILTERS:
            raise ValueError(f"filter is {filter_name!r}; choose {', '.join(FILTERS)}")
        robot_filter = FILTERS[filter_name]
        # Only the paper's filter has a hypothesis test, which needs a table of thresholds.
        needs_table = robot_filter is Filter.ADAPTIVE
        table = generate(parse_omega(str(omega)), check_q(neighbours)) if needs_table else None
        return Config(table, robot_filter, filter_period)

    def _observe_tile(self, message: Bool) -> None:
        self.robot.observe(Observation.BLACK if message.data else Observation.WHITE)

    def _receive_estimate(self, message: Estimate) -> None:
        """Add a robot's estimate to the round. The robot counts those that it rejects."""
        # A node also receives what it has published itself.
        if message.sender != self.robot.id:
            self.robot.receive_raw(message.sender, message.x_hat, message.alpha)

    def _close_round(self) -> None:
        """Broadcast the robot's estimate, close the round of what it has received, and publish its state."""
        robot = self.robot
        estimate = Estimate(sender=robot.id, x_hat=robot.x_hat_raw, alpha=robot.alpha_raw)
        self._estimates.publish(estimate)
        robot.settle()
        self._states.publish(self._read_state())

    def _read_state(self) -> State:
        """Return the message of what the robot knows now."""
        robot = self.robot
        counters = robot.counters
        return State(
            x=robot.x,
            x_hat=robot.x_hat,
            b_hat=robot.b_hat,
            observations=robot.t,
            accepted=counters.accepted,
            rejected=counters.rejected,
            updates=counters.updates,
        )


def main() -> int:
    """Run the node until it is stopped. Returns 1, with the reason on standard error, if it cannot start."""
    rclpy.init()
    try:
        node = RobotNode()
    except (ValueError, ParameterException) as error:
        print(f"robot_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # somebody has stopped it
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
