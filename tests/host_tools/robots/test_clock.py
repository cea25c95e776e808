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
    """Begin one tick per entry of ``periods_of_work``. Return when each tick has begun, in periods."""
    beginnings = []
    for tick, periods in enumerate(periods_of_work, start=5):
        clock.wait_for_tick(tick)
        beginnings.append((watch.now - START) / PERIOD)
        watch.now += periods * PERIOD
    return beginnings


@pytest.mark.parametrize(
    ("periods_of_work", "expected_beginnings"),
    [
        ([0.5, 0, 1, 0.25, 0], [0, 1, 2, 3, 4]),
        ([2, 0.5, 0.5, 0.5, 0], [0, 2, 2.5, 3, 4]),  # the fourth is in time again
        ([1.5, 1.5, 1.5, 1.5], [0, 1.5, 3, 4.5]),
    ],
    ids=["in time", "the first is long", "all are long"],
)
def test_ticks_begin_at_multiples_of_the_period_or_as_soon_as_the_last_one_is_over(
    periods_of_work: list[float], expected_beginnings: list[float]
) -> None:
    """All times are in periods. ``periods_of_work`` says how long the work of each tick takes.

    The time is that of a watch, which only the clock's pauses and this work move on.
    """
    watch = Watch()
    beginnings = begin_ticks(watch, watch.clock(), periods_of_work=periods_of_work)
    assert beginnings == expected_beginnings


def test_a_clock_has_no_figures_of_lateness_before_the_first_tick() -> None:
    """``figures`` returns None in place of how late ticks have begun."""
    clock_without_a_tick = Watch().clock()
    assert clock_without_a_tick.figures() is None


@pytest.mark.parametrize(
    ("periods_of_work", "expected_lateness", "expected_late_ticks"),
    [([2, 0.5, 0.5, 0.5, 0], [0, 1, 0.5, 0, 0], 1), ([1.5, 1.5, 1.5, 1.5], [0, 0.5, 1, 1.5], 2)],
)
def test_figures_say_in_seconds_how_late_ticks_have_begun(
    periods_of_work: list[float], expected_lateness: list[float], expected_late_ticks: int
) -> None:
    """The work of each tick takes some periods, by which the next ones may begin late.

    ``expected_lateness`` is in periods, and the figures in seconds. A tick counts as late if it begins more
    than half a period late. ``drift`` is how late the last tick has begun.
    """
    watch = Watch()
    clock = watch.clock()

    begin_ticks(watch, clock, periods_of_work=periods_of_work)

    *_, lateness_of_last_tick = expected_lateness
    mean_lateness = sum(expected_lateness) / len(expected_lateness)
    assert clock.figures() == {
        "mean_lateness": mean_lateness * PERIOD,
        "max_lateness": max(expected_lateness) * PERIOD,
        "late_ticks": expected_late_ticks,
        "drift": lateness_of_last_tick * PERIOD,
    }


def test_a_tick_does_not_begin_early_when_a_sleep_ends_early() -> None:
    """Every pause of the clock ends a quarter of a period too early, so it has to pause again.

    Tick 0 begins at the start, and tick 1 not before a period is over.
    """
    watch = Watch(missing_sleep=PERIOD / 4)
    clock = watch.clock()
    clock.wait_for_tick(tick=0)
    clock.wait_for_tick(tick=1)

    assert watch.now >= START + PERIOD


@pytest.mark.parametrize(
    ("periods_since_tick_0", "expected_periods_left"), [(1, 0.5), (1.25, 0.25), (1.5, 0), (1.75, 0), (72, 0)]
)
def test_a_tick_s_frames_are_waited_for_in_the_first_half_of_its_period(
    periods_since_tick_0: float, expected_periods_left: float
) -> None:
    """Tick 1 begins one period after tick 0. The time left falls to 0 in half a period, and then stays 0."""
    watch = Watch()
    clock = watch.clock()
    clock.wait_for_tick(tick=0)
    watch.now += periods_since_tick_0 * PERIOD

    assert clock.seconds_left_to_receive(tick=1) == expected_periods_left * PERIOD
