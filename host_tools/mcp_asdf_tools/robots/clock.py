"""Clocks of a swarm, which decide when a tick ends.

In lockstep it ends when all frames have arrived, in real time when its period is over.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Literal

ClockKind = Literal["lockstep", "real-time"]
"""Name of a clock, as an option and in reports."""

_RECEIVING_SHARE = 0.5
"""Share of a tick's period in which robots wait for frames; the rest is for settling, the end of the tick."""


class RealTimeClock:
    """Clock by which tick k begins k periods after the first, or as soon after that as tick k - 1 is over.

    Robots receive frames for the first half of the period; the rest is for settling. Frames that come later
    are received in the next tick.
    """

    def __init__(
        self,
        steps_per_second: float,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Create a clock, which starts with the first call of ``wait_for_tick``.

        ``now`` returns the time in seconds, and ``sleep`` waits for a number of seconds.
        """
        self._period = 1 / steps_per_second
        self._now = now
        self._sleep = sleep
        self._start = 0.0
        """Time at which tick 0 begins, or would have begun."""
        self._lateness: list[float] = []
        """Seconds by which each tick so far has begun too late."""

    def wait_for_tick(self, tick: int) -> None:
        """Sleep until the time of this tick has come, and record how late it begins.

        The first tick begins at once, whatever its number. Call this once for each tick.
        """
        is_first_call = not self._lateness
        if is_first_call:
            # By this start the present tick begins now.
            self._start = self._now() - tick * self._period
        begin_time = self._start + tick * self._period
        seconds_left = begin_time - self._now()
        # A sleep may end early, by the resolution of its timer.
        while seconds_left > 0:
            self._sleep(seconds_left)
            seconds_left = begin_time - self._now()
        self._lateness.append(-seconds_left)

    def seconds_left_to_receive(self, tick: int) -> float:
        """Return how many seconds are left of the first half of this tick's period; 0 if it is over."""
        deadline = self._start + (tick + _RECEIVING_SHARE) * self._period
        return max(0.0, deadline - self._now())

    def figures(self) -> dict[str, Any] | None:
        """Return how late ticks have begun, for JSON; None before the first tick.

        Keys: ``mean_lateness`` and ``max_lateness`` in seconds; ``late_ticks``, the number of ticks late by
        more than half a period, in which no time was left for frames; ``drift``, the lateness of the last
        tick.
        """
        if not self._lateness:
            return None
        late_ticks = [lateness for lateness in self._lateness if lateness > self._period / 2]
        return {
            "mean_lateness": math.fsum(self._lateness) / len(self._lateness),
            "max_lateness": max(self._lateness),
            "late_ticks": len(late_ticks),
            "drift": self._lateness[-1],
        }
