"""The count of instructions: time and storage are bounded whatever t, m and q, and growth is caught."""

from __future__ import annotations

import gc
import sys

import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, Status
from mcp_asdf_tools.crosscheck.operation_count import (
    CALLS,
    Counts,
    Storage,
    count_operations,
    growing,
    instructions,
    measure_storage,
)


def test_instructions_are_counted_inside_every_call() -> None:
    def loop(times: int) -> None:
        for _ in range(times):
            pass

    none, one, ten = (instructions(lambda times=times: loop(times)) for times in (0, 1, 10))  # type: ignore[misc]
    assert none > 0 and ten - one == 9 * (one - none) > 0


def test_calls_do_not_grow_over_the_whole_range(operations: Counts) -> None:
    assert growing(operations) == []
    assert operations.keys() == set(CALLS)
    for axes in operations.values():
        assert {1, 2, 2**31 - 1, 2**31} <= axes["t"].keys()
        assert axes["m"].keys() == set(range(128))
        assert axes["q"].keys() == set(range(2, 128))
        assert all(0 < count < 2000 for most in axes.values() for count in most.values())


def test_both_outcomes_of_the_test_and_a_new_accuracy_are_counted(operations: Counts) -> None:
    settle = operations["settle"]["m"]
    assert settle[0] < settle[2] == settle[127]
    assert operations["step"]["m"][127] > operations["settle"]["m"][127] + min(
        operations["observe"]["m"].values()
    )


class LoopingRobot(MirrorRobot):
    """Loops once for each message of a round."""

    def settle(self) -> Status:
        for _ in range(self.s.open.count):
            pass
        return super().settle()


class EndlessRobot(MirrorRobot):
    """Loops once for each observation."""

    @property
    def x_raw(self) -> int:
        t = self.s.t
        while t:
            t -= 1
        return super().x_raw


class SearchingRobot(MirrorRobot):
    """Looks at each entry of the table."""

    def settle(self) -> Status:
        assert self.config.table is not None
        [None for _ in self.config.table.entries]
        return super().settle()


class LargeRobot(MirrorRobot):
    """Saves all that it has heard."""

    def save(self) -> bytes:
        return super().save() + bytes(self.s.open.count)


@pytest.mark.parametrize(
    ("robot", "axis", "calls"),
    [
        (LoopingRobot, "m", ["settle", "step"]),
        (EndlessRobot, "t", ["x"]),
        (SearchingRobot, "q", ["settle", "step"]),
    ],
)
def test_time_that_grows_is_caught(robot: type[MirrorRobot], axis: str, calls: list[str]) -> None:
    problems = growing(count_operations(robot, [axis]))
    assert sorted(problem.split(":")[0] for problem in problems) == calls
    assert all(f"where {axis} is" in problem for problem in problems)


def test_what_watches_leaves_no_trace() -> None:
    """Other watchers, such as a debugger, are back afterwards; what has no end is cut short."""

    def other(frame: object, event: str, argument: object) -> None:
        return None

    before = sys.gettrace()
    sys.settrace(other)
    try:
        robot = EndlessRobot(Config(filter=Filter.OFF), 0, 0.7)
        robot.s.t = 10**9
        assert 20_000 < instructions(lambda: robot.x_raw) < 20_010
        assert sys.gettrace() is other and gc.isenabled()
    finally:
        sys.settrace(before)


def test_storage() -> None:
    storage = measure_storage()
    assert storage.problems() == []
    assert storage.images == [124]
    assert storage.tables == {q: 12 + 4 * q for q in range(2, 128)}
    assert len(measure_storage(LargeRobot).problems()) == 1
    assert len(Storage({2: 21}, [124]).problems()) == 1
