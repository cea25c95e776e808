"""Time is kept by a clock of the test's own, so nothing here waits."""

from __future__ import annotations

from mcp_asdf_tools.robots.clock import RealTimeClock


class Watch:
    """Time that passes only when somebody sleeps or works."""

    def __init__(self, oversleeps: float = 0.0) -> None:
        self.now = 1000.0
        self.slept: list[float] = []
        self._oversleeps = oversleeps

    def read(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.slept.append(seconds)
        self.now += seconds + self._oversleeps


def run(watch: Watch, work: list[float], rate: float = 8) -> tuple[RealTimeClock, list[float]]:
    """Beginnings of ticks after the first, where tick k takes work[k] seconds."""
    clock, began = RealTimeClock(rate, watch.read, watch.sleep), []
    for tick, seconds in enumerate(work):
        clock.begin(tick)
        began.append(watch.now - 1000.0)
        watch.now += seconds
    return clock, began


def test_ticks_begin_at_multiples_of_the_period() -> None:
    clock, began = run(Watch(), [0.0625, 0.0, 0.125, 0.03125, 0.0])
    assert began == [0.0, 0.125, 0.25, 0.375, 0.5]
    assert clock.figures() == {"mean_lateness": 0.0, "max_lateness": 0.0, "late_ticks": 0, "drift": 0.0}


def test_a_long_tick_makes_later_ones_late_until_they_have_caught_up() -> None:
    watch = Watch()
    clock, began = run(watch, [0.25, 0.0625, 0.0625, 0.0625, 0.0])
    assert began == [0.0, 0.25, 0.3125, 0.375, 0.5]
    assert clock.figures() == {
        "mean_lateness": (0.125 + 0.0625) / 5,
        "max_lateness": 0.125,
        "late_ticks": 1,
        "drift": 0.0,
    }
    assert watch.slept == [0.0625]


def test_drift_is_what_is_never_caught_up() -> None:
    clock, began = run(Watch(), [0.1875] * 9)
    assert began[-1] == 8 * 0.1875
    figures = clock.figures()
    assert figures is not None
    assert figures["drift"] == figures["max_lateness"] == 8 * 0.0625
    assert figures["late_ticks"] == 7


def test_sleeps_that_end_early_are_gone_on_with() -> None:
    watch = Watch(oversleeps=-0.03125)
    clock = RealTimeClock(8, watch.read, lambda seconds: watch.sleep(max(seconds, 0.0625)))
    clock.begin(0)
    clock.begin(1)
    assert watch.now >= 1000.125
    assert len(watch.slept) > 1


def test_patience_ends_in_the_middle_of_the_period() -> None:
    watch = Watch()
    clock = RealTimeClock(8, watch.read, watch.sleep)
    clock.begin(0)
    clock.begin(1)
    assert clock.patience(1) == 0.0625
    watch.now += 0.03125
    assert clock.patience(1) == 0.03125
    watch.now += 5
    assert clock.patience(1) == 0.0


def test_a_clock_that_never_ran_has_nothing_to_say() -> None:
    assert RealTimeClock(10).figures() is None
