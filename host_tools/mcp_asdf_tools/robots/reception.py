"""Frames that a robot hears: decoded, and counted by kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import pairwise

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus import (
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_estimates,
    decode_heartbeat,
    decode_telemetry,
)
from mcp_asdf_tools.robots.events import message_text
from mcp_asdf_tools.robots.firmwares import Words

Mask = NDArray[np.bool_]
Texts = NDArray[np.object_]

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
        content = self.once(frame)
        # With the frame itself, since the id of an object that has gone may be another's.
        self._known[id(frame)] = frame, content
        return content

    def estimates(
        self, frames: Sequence[can.Message], flips: NDArray[np.uint64]
    ) -> tuple[Words, NDArray[np.bool_]]:
        """As ``bus.decode_estimates``."""
        return decode_estimates(frames, self.frames, flips)

    def once(self, frame: can.Message) -> Content:
        """Decode a frame that will not be decoded again."""
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

    def count(self, contents: Sequence[Content]) -> None:
        """Count frames that are no estimates."""
        for each in contents:
            if isinstance(each, Heartbeat):
                self.heartbeats += 1
            elif isinstance(each, Telemetry):
                self.telemetry += 1
                self.last_telemetry[each.sender] = each
            elif each is Rejection.ERROR_FRAME:
                self.errors += 1
            elif isinstance(each, Rejection):
                self.rejected[each] += 1


class Estimates:
    """Estimates as a firmware and a recorder take them.

    Attributes:
        words: Shape (estimates, 3): sender, x_hat and alpha, as ``bus.frames.Message``.
    """

    def __init__(self, words: Words, texts: Callable[[], Texts] | None = None) -> None:
        """Take estimates whose ``texts`` are made when they are asked for."""
        self.words = words
        self._make_texts = texts

    @classmethod
    def of(cls, rows: Sequence[Sequence[int]]) -> Estimates:
        """Estimates of these senders, x_hat and alpha."""
        return cls(np.array(rows, np.uint32).reshape(-1, 3))

    def __len__(self) -> int:
        return len(self.words)

    def heard(self, reach: Mask) -> Iterator[Estimates]:
        """For each receiver those that reach it, by ``reach`` of shape (estimates, receivers)."""
        _, which = reach.T.nonzero()
        words, texts = self.words[which], cache(lambda: self.texts[which])
        ends = np.count_nonzero(reach, axis=0).cumsum().tolist()
        for start, end in pairwise([0, *ends]):
            yield Estimates(words[start:end], partial(_part, texts, start, end))

    @property
    def texts(self) -> Texts:
        """The same as events, shape (estimates,); made once for all receivers."""
        if self._make_texts is not None:
            return self._make_texts()
        return np.array([message_text(*row) for row in self.words.tolist()], np.object_)


def _part(texts: Callable[[], Texts], start: int, end: int) -> Texts:
    return texts()[start:end]


def rows_of(contents: Sequence[Content]) -> list[tuple[int, int, int]]:
    """Senders, x_hat and alpha of the estimates among ``contents``."""
    return [(each.sender, each.x_hat, each.alpha) for each in contents if isinstance(each, Message)]
