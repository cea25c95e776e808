"""What went over the bus of a swarm, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import can

from mcp_asdf_tools.bus import Heartbeat, Rejection, Telemetry, decode_heartbeat, decode_telemetry


@dataclass
class Reception:
    """What one robot heard, in frames.

    Attributes:
        delivered: Messages of the swarm that reached the firmware.
        refused: Those among them that the firmware did not accept (repeated or invalid).
        heartbeats: Heartbeats.
        telemetry: Telemetry, that of other processes' robots included.
        errors: Error frames.
        strays: Legal messages that nobody of the swarm has sent; another program uses the subject.
        collisions: Messages under the robot's own id: another node has it, too.
        rejected: Other frames, by the reason why they are no message.
        last_telemetry: The last telemetry of each sender, by id.
    """

    delivered: int = 0
    refused: int = 0
    heartbeats: int = 0
    telemetry: int = 0
    errors: int = 0
    strays: int = 0
    collisions: int = 0
    rejected: Counter[Rejection] = field(default_factory=Counter)
    last_telemetry: dict[int, Telemetry] = field(default_factory=dict)

    def take_other(self, frame: can.Message, reason: Rejection) -> None:
        """Count a frame that is no estimate, for this ``reason``."""
        if reason is Rejection.ERROR_FRAME:
            self.errors += 1
            return
        if reason is Rejection.SUBJECT:
            if isinstance(decode_heartbeat(frame), Heartbeat):
                self.heartbeats += 1
                return
            telemetry = decode_telemetry(frame)
            if isinstance(telemetry, Telemetry):
                self.telemetry += 1
                self.last_telemetry[telemetry.sender] = telemetry
                return
        self.rejected[reason] += 1


@dataclass
class Traffic:
    """What went over the bus, in frames.

    Attributes:
        receptions: What each robot heard, by id.
        sent: Messages that robots sent.
        heartbeats_sent: Heartbeats.
        telemetry_sent: Telemetry.
        on_the_bus: All frames that got onto the bus, after the faults of their senders.
        in_range: Those, counted once for each robot in range of their senders.
        arrived: Frames that robots heard of those, late ones and copies included.
        missed: Frames that the bus lost or brought after the time of their tick; none in lockstep.
        bits: Length of all frames on a bus shared by all (``mcp_asdf_tools.bus.load.wire_bits``).
        most_bits: The same of the tick that has most.
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
    most_bits: int = 0

    def total(self, name: str) -> int:
        """The sum over robots of one of the numbers in ``Reception``."""
        return sum(getattr(each, name) for each in self.receptions)

    @property
    def collisions(self) -> dict[int, int]:
        """How many messages under its own id each robot heard, by id; robots that heard none left out."""
        return {robot: each.collisions for robot, each in enumerate(self.receptions) if each.collisions}

    @property
    def rejected(self) -> Counter[Rejection]:
        """The frames that were no message, by reason."""
        return sum((each.rejected for each in self.receptions), Counter[Rejection]())

    @property
    def telemetry(self) -> dict[int, Telemetry]:
        """The last telemetry of each sender, by id."""
        return {sender: last for each in self.receptions for sender, last in each.last_telemetry.items()}

    def figures(self) -> dict[str, Any]:
        """The counts as plain values, for JSON."""
        own = {name: value for name, value in vars(self).items() if name != "receptions"}
        return own | {
            "delivered": self.total("delivered"),
            "heartbeats_heard": self.total("heartbeats"),
            "telemetry_heard": self.total("telemetry"),
            "errors_heard": self.total("errors"),
            "refused": self.total("refused"),
            "strays": self.total("strays"),
            "collisions": {str(robot): count for robot, count in self.collisions.items()},
            "rejected": {reason.name: count for reason, count in self.rejected.items()},
        }
