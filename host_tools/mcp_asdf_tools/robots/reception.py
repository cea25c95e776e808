"""Frames that a robot hears: decoded, and counted by kind."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import can

from mcp_asdf_tools.bus import (
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
)


class Decoder:
    """``decode`` with a cache, for many robots that hear the same frame object one after the other.

    Attributes:
        frames: Where estimates are on the bus.
    """

    def __init__(self, frames: FrameFormat) -> None:
        self.frames = frames
        self._last: dict[int, tuple[can.Message, Message | Rejection]] = {}

    def __call__(self, frame: can.Message) -> Message | Rejection:
        """Decode an estimate. A frame must not change once it has been decoded."""
        known = self._last.get(frame.arbitration_id)
        if known is not None and known[0] is frame:
            return known[1]
        message = decode(frame, self.frames)
        self._last[frame.arbitration_id] = frame, message
        return message


@dataclass
class Reception:
    """Frames that one robot heard.

    Attributes:
        delivered: Estimates handed to the firmware.
        refused: Those among them that the firmware did not accept (repeated or invalid).
        id_conflicts: Estimates under the robot's own id: another node has it, too.
        strays: Legal estimates from outside the swarm: another program uses the subject.
        heartbeats: Heartbeats.
        telemetry: Telemetry, that of other processes' robots included.
        errors: Error frames.
        rejected: Other frames, by the reason why they are no estimate.
        last_telemetry: The last telemetry of each sender, by id.
    """

    delivered: int = 0
    refused: int = 0
    id_conflicts: int = 0
    strays: int = 0
    heartbeats: int = 0
    telemetry: int = 0
    errors: int = 0
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
