"""Launch a swarm of robots on this computer: ``ros2 launch mcp_asdf_ros swarm.launch.py robots:=5``.

Robot 3 publishes its state on ``/robot_3/state`` and waits for tiles on ``/robot_3/black``. Where each robot
has a computer, run ``robot_node`` there, with an id of its own.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

MAX_ROBOTS = 128


def launch_robots(context: LaunchContext) -> list[Node]:
    """Return the nodes of all robots. Raises ValueError for a number of robots that is not 1 to 128."""
    robots_text = LaunchConfiguration("robots").perform(context)
    if not robots_text.isdecimal() or not 1 <= int(robots_text) <= MAX_ROBOTS:
        raise ValueError(f"robots is {robots_text!r}; choose 1 to {MAX_ROBOTS}")
    filter_name = LaunchConfiguration("filter").perform(context)
    return [
        Node(
            package="mcp_asdf_ros",
            executable="robot_node",
            namespace=f"robot_{robot_id}",
            parameters=[{"id": robot_id, "filter": filter_name}],
        )
        for robot_id in range(int(robots_text))
    ]


def generate_launch_description() -> LaunchDescription:
    """Return what ``ros2 launch`` runs."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("robots", default_value="5", description="number of robots"),
            DeclareLaunchArgument("filter", default_value="robust", description="filter of every robot"),
            OpaqueFunction(function=launch_robots),
        ]
    )
