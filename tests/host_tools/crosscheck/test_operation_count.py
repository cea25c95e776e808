"""The count of operations: it counts and computes, time and storage are bounded, and growth is caught."""

from __future__ import annotations

import gc
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from mcp_asdf import mirror
from mcp_asdf.fixed_point import ONE
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf_tools.common.figures import save_figure
from mcp_asdf_tools.crosscheck.operation_count import (
    BOUNDS,
    LINE_BOUNDS,
    WIDEST,
    CallCount,
    Storage,
    Tally,
    count_operations,
    counting_type,
    exceeded,
    measure_storage,
)
from mcp_asdf_tools.crosscheck.operation_plot import draw
from mcp_asdf_tools.crosscheck.scenario import TableChoice, build_table


def test_counting_integers_count_and_compute() -> None:
    tally = Tally()
    number = counting_type(tally)
    a, b = number(12), number(5)
    result = ((a + 1) * b - 3 // b << 2) % 7 & -a | b ^ 2
    assert result == ((12 + 1) * 5 - 3 // 5 << 2) % 7 & -12 | 5 ^ 2
    assert type(result) is number
    assert tally.counts == {"add": 3, "multiply": 1, "divide": 2, "shift": 1, "logic": 3, "compare": 1}
    tally.clear()
    assert not (max(a, 1) is not a or min(1, a) is a or not a)
    assert tally.counts == {"compare": 3}
    assert int((1 << b).bit_length()) + int(a**2) == 150
    assert (tally.counts["shift"], tally.counts["bit length"], tally.counts["multiply"]) == (1, 1, 1)
    assert tally.widest == 8


def test_every_arithmetic_method_of_int_is_counted() -> None:
    """Whatever int offers that returns a number and takes at most one other."""
    tally = Tally()
    number = counting_type(tally)
    exempt = {
        "__new__",
        "__getnewargs__",
        "__sizeof__",
        "__class__",
        "__dir__",
        "__format__",
        "__repr__",
        "__str__",
    }
    exempt |= {"__hash__", "__init__", "__reduce__", "__reduce_ex__", "__init_subclass__", "__subclasshook__"}
    # Reading a number as another type is no arithmetic, and neither are these used on the firmware's way.
    exempt |= {
        "__int__",
        "__index__",  # which range() and the like do not even ask for: hence the count of lines and builtins
        "__trunc__",
        "__floor__",
        "__ceil__",
        "__float__",
        "__round__",
        "__pos__",
    }
    exempt |= {"__truediv__", "__rtruediv__", "__rpow__", "__divmod__", "__rdivmod__", "__abs__"}
    exempt |= {"__getattribute__", "__setattr__", "__delattr__", "__doc__", "__getstate__"}
    counted = {name for name in vars(number) if name in dir(int)}
    assert {name for name in dir(int) if name.startswith("__")} - exempt - counted == set()
    source = Path(str(mirror.__file__)).read_text(encoding="utf-8")
    assert not re.search(
        r"\babs\(|\bdivmod\(|(?<!/)/(?!/)", re.sub(r'""".*?"""|#.*|f?".*?"', "", source, flags=re.S)
    )


def test_a_counting_robot_computes_the_same() -> None:
    plain, tally = MirrorRobot(Config(build_table(TableChoice("0.05", 30)), filter_period=1), 0, 0.7), Tally()
    counting, number = MirrorRobot(plain.config, 0, 0.7), counting_type(tally)
    for t in range(40):
        for robot, kind in ((plain, int), (counting, number)):
            robot.receive_raw(kind(1 + t % 3), kind(ONE // 3 + t), kind(0x80000001 + 256 * t))
            robot.receive_raw(kind(9), kind(ONE // 2), kind(0x80000002))
            robot.step(Observation(t % 2))
    assert plain.state() == counting.state()
    assert tally.counts.total() > 1000


@pytest.mark.slow
def test_operations_are_bounded_whatever_t_m_and_q(operations: dict[str, CallCount]) -> None:
    assert exceeded(operations) == []
    for name, count in operations.items():
        assert count.most > 0.7 * BOUNDS[name], f"{name}: the bound says nothing"
        assert count.lines > 0.7 * LINE_BOUNDS[name], f"{name}: the bound says nothing"
        assert count.widest > 0.5 * WIDEST


def test_operations_are_counted_over_the_whole_range(operations: dict[str, CallCount]) -> None:
    for count in operations.values():
        assert {1, 2, 2**31 - 1, 2**31} <= count.axes["t"].keys()
        assert count.axes["m"].keys() == set(range(128))
        assert count.axes["q"].keys() == set(range(2, 128))


@pytest.mark.parametrize("axis", ["t", "m", "q"])
def test_operations_do_not_grow(operations: dict[str, CallCount], axis: str) -> None:
    """The later half of an axis has nothing above the earlier half."""
    for name, count in operations.items():
        most = [most for _, (_, most) in sorted(count.axes[axis].items())]
        half = len(most) // 2
        assert max(most[half:]) <= max(most[:half]), name


class GrowingRobot(MirrorRobot):
    """Sums a round's messages when it closes, as a simple program would."""

    def settle(self) -> Status:
        total = self.s.t
        for _ in range(self.s.open.count):
            total = total + 1
        return super().settle()


class WideRobot(MirrorRobot):
    """Uses an integer of more bits than a few words hold."""

    @property
    def x_raw(self) -> int:
        return super().x_raw << 100 >> 100


class LargeRobot(MirrorRobot):
    """Saves all that it has heard."""

    def save(self) -> bytes:
        return super().save() + bytes(self.s.open.count)


class LoopingRobot(MirrorRobot):
    """Loops once for each message of a round, and touches no number that counts."""

    def settle(self) -> Status:
        self.loop(int(self.s.open.count))
        return super().settle()

    def loop(self, times: int) -> int:
        total = 0
        for turn in range(times):
            total += turn * turn
        return total


class BareRobot(LoopingRobot):
    """The same by hand."""

    def loop(self, times: int) -> int:
        while times:
            times -= 1
        return times


class OneLineRobot(LoopingRobot):
    """The same on one line, without a builtin."""

    def loop(self, times: int) -> int:
        return len([None for _ in MESSAGES[:times]])


class HiddenRobot(LoopingRobot):
    """The same inside a builtin: one line, whatever the times."""

    def loop(self, times: int) -> int:
        return sum(range(times))


class EndlessRobot(LoopingRobot):
    """Loops once for each observation."""

    def settle(self) -> Status:
        self.loop(int(self.s.t))
        return super().settle()


MESSAGES = [None] * 127


@pytest.mark.parametrize(
    ("robot", "axis", "told"),
    [
        (GrowingRobot, "m", "operations"),
        pytest.param(GrowingRobot, "m", "lines executed", marks=pytest.mark.slow),
        (LoopingRobot, "m", "lines executed"),
        pytest.param(LoopingRobot, "m", "uses range,", marks=pytest.mark.slow),
        pytest.param(BareRobot, "m", "lines executed", marks=pytest.mark.slow),
        pytest.param(OneLineRobot, "m", "lines executed", marks=pytest.mark.slow),
        pytest.param(HiddenRobot, "m", "uses range, sum,", marks=pytest.mark.slow),
        pytest.param(EndlessRobot, "t", "lines executed", marks=pytest.mark.slow),
    ],
)
def test_time_that_grows_is_caught(robot: type[MirrorRobot], axis: str, told: str) -> None:
    problems = exceeded(count_operations(robot, [axis]))
    assert [problem.split(":")[0] for problem in problems if told in problem] == ["settle", "step"]


def test_what_watches_leaves_no_trace() -> None:
    """Neither for robots nor for other watchers, such as a debugger."""

    def other(frame: object, event: str, argument: object) -> None:
        return None

    before = sys.gettrace()
    sys.settrace(other)
    try:
        tally = Tally()
        tally.watch(lambda: BareRobot(Config(filter=Filter.OFF), 0, 0.7).loop(10**9))
        assert sys.gettrace() is other
    finally:
        sys.settrace(before)
    assert 1000 <= tally.lines <= 1001, "it is cut short there"


def test_what_others_leave_behind_is_not_counted() -> None:
    """Collecting garbage runs Python of any owner, in the middle of any line."""

    def tell(phase: str, told: dict[str, int]) -> None:
        sorted(told)

    gc.callbacks.append(tell)
    try:
        tally = Tally()
        tally.watch(lambda: list(zip(range(10 * gc.get_threshold()[0]))))
        assert (tally.lines, "sorted" in tally.builtins, gc.isenabled()) == (1, False, True)
    finally:
        gc.callbacks.remove(tell)


def test_integers_that_are_too_wide_are_caught() -> None:
    assert [problem.split(":")[0] for problem in exceeded(count_operations(WideRobot, ["q"]))] == ["x"]


def test_storage() -> None:
    storage = measure_storage()
    assert storage.problems() == []
    assert storage.images == [124]
    assert storage.tables[30] == 132
    assert storage.tables.keys() == set(range(2, 128))
    assert len(measure_storage(LargeRobot).problems()) == 1
    assert len(Storage({2: 21}, [124]).problems()) == 1


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_equal_figures_give_equal_files(
    operations: dict[str, CallCount], tmp_path: Path, suffix: str
) -> None:
    first, second = (tmp_path / f"{name}.{suffix}" for name in ("first", "second"))
    for path in (first, second):
        save_figure(draw(operations), path)
    assert first.read_bytes() == second.read_bytes()


def test_the_plot_shows_every_count(operations: dict[str, CallCount]) -> None:
    panels = draw(operations).axes
    for axes, axis in zip(panels, ("t", "m", "q"), strict=True):
        assert len(axes.lines) == len(BOUNDS)
        for line, count in zip(axes.lines, operations.values(), strict=True):
            points = sorted(count.axes[axis].items())
            assert list(map(float, np.asarray(line.get_xdata()))) == [value for value, _ in points]
            assert list(map(float, np.asarray(line.get_ydata()))) == [most for _, (_, most) in points]
