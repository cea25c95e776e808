"""Values that are known once the launch file runs."""

from __future__ import annotations

from dataclasses import dataclass

from launch import LaunchContext


@dataclass
class LaunchConfiguration:
    """The value of an argument."""

    name: str

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]
