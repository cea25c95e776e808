"""Frames that a robot hears: decoded, and counted by kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import can
import numpy as np

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
from mcp_asdf_tools.robots.firmwares import Words

Content = Message | Heartbeat | Telemetry | Rejection
"""Content of a frame, or the reason why it has none."""

_MAX_KNOWN = 4096
"""Frames in a decoder's cache: some ticks of 127 robots, since frames may come late."""


class Decoder:
    """Decoder with a cache, for many robots that hear the same frame object one after the other.

    Attributes:
        frames: Format of estimates.
    """

    def __init__(self, frames: FrameFormat) -> None:
        self.frames = frames
        self._known: dict[int, tuple[can.Message, Content]] = {}

    def __call__(self, frame: can.Message) -> Content:
        """Decode a frame, which must not change any more."""
        known = self._known.get(id(frame))
        if known is not None:
            return known[1]
        if len(self._known) == _MAX_KNOWN:
            self._known.clear()
        content = self._content(frame)
        # With the frame itself, since the id of an object that has gone may be another's.
        self._known[id(frame)] = frame, content
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


def words_of(messages: Sequence[Message]) -> Words:
    """Estimates for a firmware, shape (messages, 3)."""
    return np.array([(each.sender, each.x_hat, each.alpha) for each in messages], np.uint32).reshape(-1, 3)
