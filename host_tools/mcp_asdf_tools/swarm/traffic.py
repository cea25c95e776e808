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
    """Counts of the frames that robots have sent and received.

    Attributes:
        receptions: Frames that each robot received, by id.
        sent: Estimates that robots sent.
        heartbeats_sent: Heartbeats that robots sent.
        telemetry_sent: Telemetry frames that robots sent.
        on_the_bus: All frames that got onto the bus, after the faults of their senders.
        in_range: The same frames, counted once for each robot in range of the sender.
        arrived: The same frames, counted once for each robot that received them; copies count, too.
        missed: Frames that the bus lost, or carried after their tick; none in lockstep.
        bits: Length of all frames in bits on one bus, with as many stuff bits as possible.
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
        """Count the frames that got onto the bus in one tick, and their bits.

        Bits are counted with as many stuff bits as possible. Those of the busiest tick are ``peak_bits``.
        """
        bits = sum(worst_case_bits(frame) for frame in frames)
        self.on_the_bus += len(frames)
        self.bits += bits
        self.peak_bits = max(self.peak_bits, bits)

    def total(self, count_name: str) -> int:
        """Return the sum over all robots of one of the counts in ``Reception``, given its name."""
        return sum(getattr(reception, count_name) for reception in self.receptions)

    def figures(self) -> dict[str, Any]:
        """Return the counts as plain values, for JSON.

        Keys are the counts of this class, and counts of what all robots together received, by kind of frame.
        ``id_conflicts`` has the count of each robot whose id another node used, by id; ``rejected`` a count
        for each reason.
        """
        # All attributes but the receptions are plain numbers.
        counts = {name: value for name, value in vars(self).items() if name != "receptions"}
        rejected = Counter[Rejection]()
        id_conflicts = {}
        for robot, reception in enumerate(self.receptions):
            rejected += reception.rejected
            if reception.id_conflicts:
                # Names in JSON are texts, and without conflicts there is no entry.
                id_conflicts[str(robot)] = reception.id_conflicts
        return counts | {
            "delivered": self.total("delivered"),
            "heartbeats_heard": self.total("heartbeats"),
            "telemetry_heard": self.total("telemetry"),
            "errors_heard": self.total("errors"),
            "refused": self.total("refused"),
            "unknown": self.total("unknown"),
            "strays": self.total("strays"),
            "id_conflicts": id_conflicts,
            "rejected": {reason.name: count for reason, count in rejected.items()},
        }
