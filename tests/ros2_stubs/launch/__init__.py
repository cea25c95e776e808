"""What the launch file of c_ref/examples/ros2 uses of ROS's launch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class LaunchContext:
    """Values of the launch file's arguments."""

    launch_configurations: dict[str, str] = field(default_factory=dict)


@dataclass
class LaunchDescription:
    """The actions of a launch file, in the order in which they are executed."""

    entities: list[Any]
