"""Bus connection that tracks the frames it expects."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

import can

from mcp_asdf_tools.robots import FrameTaker
from mcp_asdf_tools.swarm.faults import SentFrame
from mcp_asdf_tools.swarm.transmission import Key

TIMEOUT = 2.0
"""Seconds after which a frame that has not come counts as lost."""

_MOST_RETURNED = 256
"""Sent frames remembered, since the bus may return them."""

_MOST_LATE = 4096
"""Frames read once the time is over: the queue counts, but a flood must not keep a robot listening."""


class SwarmError(RuntimeError):
    """The swarm cannot go on: the bus lost a frame."""


class Connection:
    """Bus connection that tracks the frames it expects.

    Attributes:
        bus: The connection.
        missed: Expected frames that were late or lost so far.
    """

    def __init__(
        self,
        bus: can.BusABC,
        who: str,
        what: str,
        stranger: FrameTaker | None = None,
        every: FrameTaker | None = None,
    ) -> None:
        """``stranger`` takes each unexpected frame, ``every`` all frames.

        Errors name the listener ``who``, and missing frames by ``what``, a format for a ``SentFrame``.
        """
        self.bus = bus
        self.missed = 0
        self._who = who
        self._what = what
        self._stranger = stranger
        self._every = every
        self._late: list[SentFrame] = []
        self._own: deque[Key] = deque(maxlen=_MOST_RETURNED)

    def send(self, frame: can.Message) -> None:
        """Put ``frame`` on the bus. Raises can.CanError if that does not take it."""
        self.bus.send(frame, timeout=TIMEOUT)
        self._own.append((frame.arbitration_id, bytes(frame.data), frame.is_error_frame))

    def take(self, expected: Sequence[SentFrame], patience: float | None) -> Sequence[SentFrame]:
        """Read until all ``expected`` have come, or for ``patience`` seconds; returns those that have.

        They are in the order given, after late ones of earlier calls. Raises SwarmError if one is missing
        after TIMEOUT seconds and ``patience`` is None. O(frames on the bus).
        """
        wanted = [*self._late, *expected] if self._late else expected
        left: dict[Key, int] = {}
        for each in wanted:
            left[each.key] = left.get(each.key, 0) + 1
        self._read(left, TIMEOUT if patience is None else patience)
        self._late = []
        if not left:
            return wanted
        if patience is None:
            raise self._error([each for each in wanted if each.key in left])
        come: list[SentFrame] = []
        for each in reversed(wanted):  # of frames that are the same those sent last are missing
            (self._late if _took(left, each.key) else come).insert(0, each)
        self.missed += sum(each in expected for each in self._late)
        return come

    def _read(self, left: dict[Key, int], seconds: float) -> None:
        """Take frames off ``left`` until it is empty or the time is over."""
        monotonic, recv = time.monotonic, self.bus.recv
        deadline, late = monotonic() + seconds, 0
        while left and late < _MOST_LATE:
            seconds = max(0.0, deadline - monotonic())
            late += seconds == 0.0
            frame = recv(seconds)
            if frame is None:
                return
            self._sort(frame, left)

    def drain(self, frames: int) -> None:
        """Read up to ``frames`` frames while none is expected, since a bus may return sent ones."""
        for _ in range(frames):
            frame = self.bus.recv(0)
            if frame is not None:
                self._sort(frame, {})

    def _sort(self, frame: can.Message, left: dict[Key, int]) -> None:
        """Take a frame off ``left``, or hand over a stranger."""
        if self._every is not None:
            self._every(frame)
        key = frame.arbitration_id, bytes(frame.data), frame.is_error_frame
        if _took(left, key) or self._stranger is None:
            return
        # A bus may return sent frames. SocketCAN does not mark frames from this computer as received.
        if frame.is_rx or key not in self._own:
            self._stranger(frame)

    def _error(self, missing: Sequence[SentFrame]) -> SwarmError:
        names = ", ".join(dict.fromkeys(self._what.format(each) for each in missing[:8]))
        return SwarmError(
            f"{self._who} did not hear {names}{', ...' * (len(missing) > 8)} within {TIMEOUT:g} s on "
            f"{self.bus.channel_info}: the bus loses frames; use a faster bus or fewer robots"
        )


def _took(left: dict[Key, int], key: Key) -> bool:
    """Take one of ``key`` off; False if none is left."""
    number = left.get(key, 0)
    if number == 1:
        del left[key]
    elif number:
        left[key] = number - 1
    return number > 0
