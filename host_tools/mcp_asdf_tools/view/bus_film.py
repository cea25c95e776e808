"""Film of robots elsewhere, from their estimates and telemetry on a bus."""

from __future__ import annotations

import time
from collections.abc import Callable

import can
import numpy as np

from mcp_asdf_tools.bus import ONE, FrameFormat, Message, Telemetry, decode_any
from mcp_asdf_tools.view.film import QUANTITIES, LiveFilm, Sample, Stage

SAMPLES_PER_SECOND = 10
_X, _X_HAT, _B_HAT, _ = range(len(QUANTITIES))


class BusFilm:
    """Film of all robots that a bus has.

    A bus says nothing of places and of who hears whom, so the film has none.

    Attributes:
        film: What was heard so far; robots are in the order in which they were first heard.
        has_telemetry: Whether a robot sends it: x and b_hat are in no other frame.
    """

    def __init__(
        self, bus: can.BusABC, frames: FrameFormat, title: str, f: float | None = None, b: float | None = None
    ) -> None:
        """Listen on ``bus`` for these estimates; the true ``f`` and ``b`` are drawn if they are known."""
        self.film = LiveFilm(Stage(title, [], fill_ratio=f, steps_per_second=SAMPLES_PER_SECOND))
        self.has_telemetry = False
        self._bus = bus
        self._frames = frames
        self._unknown = [np.nan, np.nan, np.nan, np.nan if b is None else b]
        self._states: dict[int, list[float]] = {}

    def record(self, should_stop: Callable[[], bool]) -> None:
        """Film until asked to stop. Raises can.CanError if the bus fails."""
        began, tick = time.monotonic(), 0
        while not should_stop():
            left = began + tick / SAMPLES_PER_SECOND - time.monotonic()
            frame = self._bus.recv(max(left, 0.0))
            if frame is not None:
                self.hear(frame)
            if left <= 0:
                self._take(tick)
                tick = int((time.monotonic() - began) * SAMPLES_PER_SECOND) + 1

    def hear(self, frame: can.Message) -> None:
        """Take a frame of any node. O(1)."""
        content = decode_any(frame, self._frames)
        if isinstance(content, Message):
            self._state(content.sender)[_X_HAT] = content.x_hat / ONE
        elif isinstance(content, Telemetry):
            self.has_telemetry = True
            state = self._state(content.sender)
            state[_X], state[_B_HAT] = content.x / ONE, content.b_hat / 2**24

    def _state(self, robot: int) -> list[float]:
        if robot not in self._states:
            self._states[robot] = self._unknown.copy()
            self.film.join(robot)
        return self._states[robot]

    def _take(self, tick: int) -> None:
        if self._states:
            count = len(self._states)
            values = np.array(list(self._states.values())).T
            self.film.add(Sample(tick, values, np.zeros((count, count), np.bool_), None))
