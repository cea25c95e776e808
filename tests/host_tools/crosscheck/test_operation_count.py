"""The count of instructions: time and storage are bounded whatever t, m and q, and growth is caught."""

from __future__ import annotations

import gc
import hashlib
import sys
from collections.abc import Callable
from functools import partial

import pytest

from mcp_asdf.mirror import MirrorRobot, State
from mcp_asdf.robot import Observation, Status
from mcp_asdf_tools.crosscheck.operation_count import (
    CALLS,
    _situations,
    count_operations,
    growing,
    instructions,
    measure_storage,
)
from support import slow


def loop(times: int) -> None:
    for _ in range(times):
        pass


def test_instructions_are_counted_inside_every_call_and_nothing_is_left_behind() -> None:
    """Other watchers, such as a debugger, are back afterwards; what has no end is cut short."""

    def other(frame: object, event: str, argument: object) -> None:
        return None

    before = sys.gettrace()
    sys.settrace(other)
    try:
        none, one, ten, endless = (instructions(partial(loop, times)) for times in (0, 1, 10, 10**9))
        assert sys.gettrace() is other and gc.isenabled()
    finally:
        sys.settrace(before)
    assert none > 0 and ten - one == 9 * (one - none) > 0
    assert endless == 4001
    collects: list[bool] = []
    for usual in (gc.disable, gc.enable):
        usual()
        instructions(lambda: collects.append(gc.isenabled()))
        collects.append(gc.isenabled())
    assert collects == [False, False, False, True]


def test_situations_are_what_they_say() -> None:
    """A round ends with a test that rejects and one that does not, and with the robust filter likewise."""
    every = [*_situations()]
    digest = hashlib.sha256(repr(every).encode())
    for each in (each for _, value, each in every if value in (1, 2, 9, 64, 1 << 20)):
        robot = each.robot(MirrorRobot)
        digest.update(robot.save())
        assert robot.config.table is None or robot.config.table.q == each.q
        if each.t == 1000 and (each.m > 9 or not each.robust):
            assert (robot.settle() == Status.UPDATED) == (each.m > 1 and not each.agrees)
        assert robot.observe(Observation.BLACK) == Status.OK
        assert robot.t == (each.t // 2 if each.halves else each.t)
    assert digest.hexdigest()[:8] == "037100e3", "instructions are counted in other situations"


# design: R34
def test_calls_do_not_grow_over_the_whole_range() -> None:
    operations = count_operations()
    assert growing(operations) == []
    assert operations.keys() == CALLS.keys() | {f"{name}, robust" for name in CALLS}
    for name, axes in operations.items():
        assert {1, 2, 2**31 - 1, 2**31} <= axes["t"].keys()
        assert axes["m"].keys() == set(range(128))
        assert axes["q"].keys() == (set() if "robust" in name else set(range(2, 128)))
        assert all(0 < count < 2000 for most in axes.values() for count in most.values())
    # Both outcomes of the test, a new accuracy and all kinds of messages are counted.
    of = {call: axes["m"] for call, axes in operations.items()}
    assert of["settle"][0] < of["settle"][2] == of["settle"][127]
    assert of["step"][127] > of["settle"][127] + min(of["observe"].values())
    assert of["receive"][20] > of["receive again"][20] > of["receive own"][20]
    # So are the robust filter's: no test with too few voices, a test, a new accuracy.
    settles = of["settle, robust"]
    assert settles[2] < settles[3] < settles[64] == settles[127]
    assert of["receive, robust"][20] > of["receive again, robust"][20]


def looping(times: Callable[[State], int]) -> type[MirrorRobot]:
    """Loops so many times at the end of a round."""

    class Looping(MirrorRobot):
        def settle(self) -> Status:
            loop(times(self.s))
            return super().settle()

    return Looping


class Endless(MirrorRobot):
    """Loops once for each observation."""

    @property
    def x_raw(self) -> int:
        loop(self.s.t)
        return super().x_raw


class Searching(MirrorRobot):
    """Looks at each entry of the table, and saves all that it has heard."""

    def settle(self) -> Status:
        assert self.config.table is not None
        loop(self.config.table.q)
        return super().settle()

    def save(self) -> bytes:
        return super().save() + bytes(self.s.open.count)


@pytest.mark.parametrize(
    ("robot", "axis", "calls"),
    [
        (looping(lambda state: state.open.count), "m", ["settle", "step"]),
        (looping(lambda state: state.crowd.votes), "m", ["settle, robust", "step, robust"]),
        (Searching, "q", ["settle", "step"]),
        *slow([(Endless, "t", ["x", "x, robust"])]),
    ],
)
def test_time_that_grows_is_caught(robot: type[MirrorRobot], axis: str, calls: list[str]) -> None:
    problems = growing(count_operations(robot, [axis]))
    assert sorted(problem.split(":")[0] for problem in problems) == calls
    assert all(f"where {axis} is" in problem for problem in problems)


def test_storage() -> None:
    storage = measure_storage()
    assert storage["images"] == dict.fromkeys(range(128), 124)
    assert storage["tables"] == {q: 12 + 4 * q for q in range(2, 128)}
    assert len({*measure_storage(Searching)["images"].values()}) == 128
