"""Actions of a launch file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from launch import LaunchContext


@dataclass
class DeclareLaunchArgument:
    """An argument of the launch file."""

    name: str
    default_value: str
    description: str


@dataclass
class OpaqueFunction:
    """A function that returns further actions."""

    function: Callable[[LaunchContext], list[Any]]
