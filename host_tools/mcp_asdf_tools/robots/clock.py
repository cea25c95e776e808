"""Clocks of a swarm: a tick ends when all frames have arrived, or when its time slot ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Literal

ClockKind = Literal["lockstep", "real-time"]
"""Kinds of clocks."""


class RealTimeClock:
    """Tick k begins k periods after the first, or as soon after that as tick k - 1 is over.

    Robots listen for the first half of the period; the rest is for settling. Frames that come later are
    heard in the next tick.
    """

    def __init__(
        self,
        steps_per_second: float,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period = 1 / steps_per_second
        self._now = now
        self._sleep = sleep
        self._start = 0.0
        self._late: list[float] = []

    def begin(self, tick: int) -> None:
        """Sleep until the tick's time has come."""
        if not self._late:
            self._start = self._now() - tick * self._period
        due = self._start + tick * self._period
        # A sleep may end early, by the resolution of its timer.
        while (left := due - self._now()) > 0:
            self._sleep(left)
        self._late.append(-left)

    def patience(self, tick: int) -> float:
        """Seconds left to wait for frames of this tick: until the middle of the period."""
        return max(0.0, self._start + (tick + 0.5) * self._period - self._now())

    def figures(self) -> dict[str, Any] | None:
        """Lateness of the beginnings of ticks, in seconds; ``drift`` is that of the last one.

        A tick counts as late if it begins after more than half a period.
        """
        if not self._late:
            return None
        return {
            "mean_lateness": math.fsum(self._late) / len(self._late),
            "max_lateness": max(self._late),
            "late_ticks": sum(late > self._period / 2 for late in self._late),
            "drift": self._late[-1],
        }
