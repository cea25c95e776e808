"""Counts of the frames on a swarm's bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import can

from mcp_asdf_tools.bus.frame_layout import Rejection
from mcp_asdf_tools.bus.load import worst_case_bits
from mcp_asdf_tools.robots.bus_robot import Reception


@dataclass
class Traffic:
    """Frames on the bus, counted.

    Attributes:
        receptions: Frames that each robot heard, by id.
        sent: Messages that robots sent.
        heartbeats_sent: Heartbeats.
        telemetry_sent: Telemetry.
        on_the_bus: All frames that got onto the bus, after the faults of their senders.
        in_range: Those, counted once for each robot in range of their senders.
        arrived: Frames that robots heard of those, late ones and copies included.
        missed: Frames that the bus lost or delivered after their tick; none in lockstep.
        bits: Length of all frames on a bus shared by all, at worst.
        peak_bits: The same in the busiest tick.
    """

    receptions: Sequence[Reception]
    sent: int = 0
    heartbeats_sent: int = 0
    telemetry_sent: int = 0
    on_the_bus: int = 0
    in_range: int = 0
    arrived: int = 0
    missed: int = 0
    bits: int = 0
    peak_bits: int = 0

    def add(self, frames: Sequence[can.Message]) -> None:
        """Count the frames that got onto the bus in one tick."""
        bits = sum(map(worst_case_bits, frames))
        self.on_the_bus += len(frames)
        self.bits += bits
        self.peak_bits = max(self.peak_bits, bits)

    def total(self, name: str) -> int:
        """The sum over robots of one of the numbers in ``Reception``."""
        return sum(getattr(each, name) for each in self.receptions)

    def figures(self) -> dict[str, Any]:
        """The counts as plain values, for JSON."""
        own = {name: value for name, value in vars(self).items() if name != "receptions"}
        rejected = sum((each.rejected for each in self.receptions), Counter[Rejection]())
        conflicts = {str(robot): each.id_conflicts for robot, each in enumerate(self.receptions)}
        return own | {
            "delivered": self.total("delivered"),
            "heartbeats_heard": self.total("heartbeats"),
            "telemetry_heard": self.total("telemetry"),
            "errors_heard": self.total("errors"),
            "refused": self.total("refused"),
            "unknown": self.total("unknown"),
            "strays": self.total("strays"),
            "id_conflicts": {robot: count for robot, count in conflicts.items() if count},
            "rejected": {reason.name: count for reason, count in rejected.items()},
        }
