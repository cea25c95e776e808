"""Time is kept by a clock of the test's own, so nothing here waits."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from mcp_asdf_tools.robots.clock import RealTimeClock

PERIOD = 0.125


@dataclass
class Watch:
    """Time that passes only when somebody sleeps or works; a sleep ends ``early`` by so much."""

    now: float = 1000.0
    early: float = 0.0

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += max(seconds, 2 * self.early) - self.early

    def clock(self) -> RealTimeClock:
        return RealTimeClock(1 / PERIOD, lambda: self.now, self.sleep)


@pytest.mark.parametrize(
    ("work", "began", "late"),
    [
        ([0.5, 0, 1, 0.25, 0], [0, 1, 2, 3, 4], [0, 0, 0, 0, 0]),
        ([2, 0.5, 0.5, 0.5, 0], [0, 2, 2.5, 3, 4], [0, 1, 0.5, 0, 0]),  # late until it has caught up
        ([1.5] * 9, [1.5 * tick for tick in range(9)], [0.5 * tick for tick in range(9)]),
    ],
)
def test_ticks_begin_at_multiples_of_the_period_or_when_the_last_is_over(
    work: list[float], began: list[float], late: list[float]
) -> None:
    """All in periods; a tick is late after more than half of one."""
    watch = Watch()
    clock, found = watch.clock(), []
    assert clock.figures() is None
    for tick, periods in enumerate(work, start=5):
        clock.begin(tick)
        found.append((watch.now - 1000) / PERIOD)
        watch.now += periods * PERIOD
    assert found == began
    assert clock.figures() == {
        "mean_lateness": sum(late) / len(late) * PERIOD,
        "max_lateness": max(late) * PERIOD,
        "late_ticks": sum(each > 0.5 for each in late),
        "drift": late[-1] * PERIOD,
    }


def test_sleeps_that_end_early_are_gone_on_with_and_patience_ends_in_the_middle_of_the_period() -> None:
    watch = Watch(early=0.03125)
    clock = watch.clock()
    clock.begin(0)
    clock.begin(1)
    assert watch.now >= 1000 + PERIOD
    for now, left in ((0.125, 0.0625), (0.15625, 0.03125), (9, 0)):
        watch.now = 1000 + now
        assert clock.seconds_left_to_receive(1) == left
