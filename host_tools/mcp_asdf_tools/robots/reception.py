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

Content = Message | Heartbeat | Telemetry | Rejection
"""Content of a frame, or the reason why it has none."""


class Decoder:
    """Decoder with a cache, for many robots that hear the same frame object one after the other.

    Attributes:
        frames: Format of estimates.
    """

    def __init__(self, frames: FrameFormat) -> None:
        self.frames = frames
        self._last: dict[int, tuple[can.Message, Content]] = {}

    def __call__(self, frame: can.Message) -> Content:
        """Decode a frame, which must not change any more."""
        known = self._last.get(frame.arbitration_id)
        if known is not None and known[0] is frame:
            return known[1]
        content = self._content(frame)
        self._last[frame.arbitration_id] = frame, content
        return content

    def _content(self, frame: can.Message) -> Content:
        estimate = decode(frame, self.frames)
        if estimate is not Rejection.SUBJECT:
            return estimate
        heartbeat = decode_heartbeat(frame)
        if isinstance(heartbeat, Heartbeat):
            return heartbeat
        telemetry = decode_telemetry(frame)
        return telemetry if isinstance(telemetry, Telemetry) else estimate


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

    def count(self, content: Heartbeat | Telemetry | Rejection) -> None:
        """Count a frame that is no estimate."""
        if isinstance(content, Heartbeat):
            self.heartbeats += 1
        elif isinstance(content, Telemetry):
            self.telemetry += 1
            self.last_telemetry[content.sender] = content
        elif content is Rejection.ERROR_FRAME:
            self.errors += 1
        else:
            self.rejected[content] += 1
