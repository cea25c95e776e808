"""The clock of a swarm in real time. Time is kept by a watch of the tests' own, so nothing here waits."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from mcp_asdf_tools.robots.clock import RealTimeClock

STEPS_PER_SECOND = 8
PERIOD = 0.125
"""Seconds from one tick to the next: 1 / STEPS_PER_SECOND."""
START = 1000.0
"""Time at which a watch starts, in seconds."""


@dataclass
class Watch:
    """Time that passes only when somebody sleeps, or a test sets it.

    Attributes:
        now: The time in seconds, from START on.
        missing_sleep: Seconds by which a sleep ends too early, unless it is short itself.
    """

    now: float = START
    missing_sleep: float = 0.0

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += max(seconds - self.missing_sleep, self.missing_sleep)

    def clock(self) -> RealTimeClock:
        return RealTimeClock(STEPS_PER_SECOND, lambda: self.now, self.sleep)


def begin_ticks(watch: Watch, clock: RealTimeClock, *, periods_of_work: list[float]) -> list[float]:
    """Begin ticks whose work takes so many periods each, and return when each has begun, in periods."""
    beginnings = []
    for tick, periods in enumerate(periods_of_work, start=5):
        clock.begin(tick)
        beginnings.append((watch.now - START) / PERIOD)
        watch.now += periods * PERIOD
    return beginnings


def test_ticks_that_are_done_in_time_begin_at_multiples_of_the_period() -> None:
    """The work of each tick takes at most a period, so each begins one period after the last."""
    watch = Watch()
    beginnings = begin_ticks(watch, watch.clock(), periods_of_work=[0.5, 0, 1, 0.25, 0])
    assert beginnings == [0, 1, 2, 3, 4]


def test_ticks_after_a_long_one_begin_at_once_until_they_have_caught_up() -> None:
    """The first takes two periods. The next ones begin when the one before is done, until one is in time."""
    watch = Watch()
    beginnings = begin_ticks(watch, watch.clock(), periods_of_work=[2, 0.5, 0.5, 0.5, 0])
    assert beginnings == [0, 2, 2.5, 3, 4]


def test_ticks_that_take_longer_than_the_period_begin_when_the_last_is_over() -> None:
    """The work of each tick takes 1.5 periods."""
    watch = Watch()
    beginnings = begin_ticks(watch, watch.clock(), periods_of_work=[1.5, 1.5, 1.5, 1.5])
    assert beginnings == [0, 1.5, 3, 4.5]


def test_a_clock_has_no_figures_of_lateness_before_the_first_tick() -> None:
    """``figures`` returns None in place of how late ticks have begun."""
    assert Watch().clock().figures() is None


def test_figures_say_in_seconds_how_late_ticks_have_begun() -> None:
    """Five ticks begin 0, 1, 0.5, 0 and 0 periods late, so only one is late by more than half of a period."""
    watch = Watch()
    clock = watch.clock()

    begin_ticks(watch, clock, periods_of_work=[2, 0.5, 0.5, 0.5, 0])

    assert clock.figures() == {
        "mean_lateness": (1 + 0.5) / 5 * PERIOD,
        "max_lateness": PERIOD,
        "late_ticks": 1,
        "drift": 0,
    }


def test_the_drift_is_the_lateness_of_the_last_tick() -> None:
    """The last of four ticks is due after 3 periods, and begins after 4.5."""
    watch = Watch()
    clock = watch.clock()
    begin_ticks(watch, clock, periods_of_work=[1.5, 1.5, 1.5, 1.5])
    figures = clock.figures()

    assert figures is not None
    assert figures["drift"] == 1.5 * PERIOD


def test_a_tick_does_not_begin_early_when_a_sleep_ends_early() -> None:
    """Every sleep ends a quarter of a period too early."""
    watch = Watch(missing_sleep=PERIOD / 4)
    clock = watch.clock()
    clock.begin(tick=0)
    clock.begin(tick=1)

    assert watch.now >= START + PERIOD


@pytest.mark.parametrize(
    ("periods_since_tick_0", "periods_left"), [(1, 0.5), (1.25, 0.25), (1.5, 0), (1.75, 0), (72, 0)]
)
def test_a_tick_s_frames_are_waited_for_in_the_first_half_of_its_period(
    periods_since_tick_0: float, periods_left: float
) -> None:
    """Tick 1 begins one period after tick 0. The time left falls to 0 in half a period, and then stays 0."""
    watch = Watch()
    clock = watch.clock()
    clock.begin(tick=0)
    watch.now += periods_since_tick_0 * PERIOD

    assert clock.seconds_left_to_receive(tick=1) == periods_left * PERIOD
