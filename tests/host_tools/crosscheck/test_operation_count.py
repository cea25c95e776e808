"""The count of instructions: time and storage are bounded whatever t, m and q, and growth is found."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from mcp_asdf.mirror import MirrorRobot, State
from mcp_asdf.robot import Config, Filter, Observation, Status
from mcp_asdf_tools.crosscheck.operation_count import (
    CALLS,
    Counts,
    Workload,
    count_instructions,
    count_operations,
    find_growth,
    measure_storage,
    workloads_along,
)
from support import slow

# --- Counting --------------------------------------------------------------------------------------------


def loop(times: int) -> None:
    for _ in range(times):
        pass


def test_instructions_of_a_loop_are_counted() -> None:
    none, one, ten = (count_instructions(partial(loop, times)) for times in (0, 1, 10))
    assert none > 0
    assert ten - one == 9 * (one - none) > 0


def test_a_call_without_end_is_cut_short() -> None:
    """After 20,000 instructions, more than any call of a robot may take."""
    assert count_instructions(partial(loop, 10**9)) == 20_001


def test_counting_gives_a_debugger_its_place_back() -> None:
    """Instructions are counted by a trace function, of which Python has one, and debuggers use it, too."""

    def debugger(frame: object, event: str, argument: object) -> None:
        return None

    previous_trace = sys.gettrace()
    sys.settrace(debugger)
    try:
        count_instructions(partial(loop, 1))
        assert sys.gettrace() is debugger
    finally:
        sys.settrace(previous_trace)


@pytest.fixture
def collector_switched_back() -> Iterator[None]:
    yield
    gc.enable()


@pytest.mark.parametrize(("switch", "is_on"), [(gc.disable, False), (gc.enable, True)])
@pytest.mark.usefixtures("collector_switched_back")
def test_the_garbage_collector_is_off_while_counting_and_then_as_before(
    switch: Callable[[], None], is_on: bool
) -> None:
    """Its instructions would be counted as the robot's."""
    was_on: list[bool] = []
    switch()
    count_instructions(lambda: was_on.append(gc.isenabled()))
    assert (was_on, gc.isenabled()) == ([False], is_on)


# --- Workloads -------------------------------------------------------------------------------------------


def workloads_at(axis: str, value: int) -> list[Workload]:
    """Return the workloads at a value of an axis."""
    return [workload for workload in workloads_along(axis) if getattr(workload, axis) == value]


def test_workloads_at_a_t_are_of_all_kinds_of_accuracies_and_counts() -> None:
    """A workload is a robot whose calls are counted, here after 64 observations, of which n are black."""
    least, half, usual, most = 2**12, 2**31, 4080218931, 2**32 - 2**12
    expected = [
        Workload(t=64, n=n, b_hat=b_hat, robust=robust)
        for robust in (False, True)
        for b_hat in (least, half, usual, most)
        for n in (0, 25, 64)
    ]
    expected.insert(12, Workload(t=64, n=32, halves=True))
    expected.append(Workload(t=64, n=32, halves=True, robust=True))

    assert workloads_at("t", 64) == expected


def test_workloads_at_a_t_that_no_memory_can_have_are_not_halved() -> None:
    assert not any(workload.halves for t in (32, 63, 127) for workload in workloads_at("t", t))


def test_workloads_cover_t_around_powers_of_two() -> None:
    t_values = {workload.t for workload in workloads_along("t")}
    powers = [2**exponent for exponent in range(32)]
    assert t_values == {*powers, *(power - 1 for power in powers[1:])}


def test_workloads_at_an_m_have_tests_of_both_outcomes_and_the_largest_sums() -> None:
    assert workloads_at("m", 9) == [
        Workload(m=9),
        Workload(m=9, agrees=True),
        Workload(m=9, alpha=0xFFFFFF1F),
        Workload(m=9, n=500, robust=True),
        Workload(m=9, n=500, agrees=True, robust=True),
    ]


@pytest.mark.parametrize(("q", "m_values"), [(2, [2, 2, 3]), (30, [2, 30, 31]), (127, [2, 127, 127])])
def test_workloads_at_a_q_use_the_first_and_the_last_entries(q: int, m_values: list[int]) -> None:
    assert workloads_at("q", q) == [Workload(q=q, m=m) for m in m_values]


def test_a_workload_is_a_robot_in_the_last_round_before_its_filter_runs() -> None:
    """So the next call is the most expensive one. A round is the time between two broadcasts."""
    robot = Workload(t=1000, n=400, m=3, q=30).make_robot(MirrorRobot)
    s = robot.s

    assert robot.id == 127
    assert robot.config.filter_period == s.filter_left == 1
    assert s.t == 1000 - 1
    assert s.n == 400
    assert s.x_hat == 2**23  # 1.0
    assert s.alpha == 0x80000001  # 1.0, as a mantissa and a shift
    assert s.accuracy.b_hat == 3 << 30  # 3/4 in units of 2**-32
    assert s.open.count == 3
    assert s.open.x == 3 * (2**23 // 3) + (0 + 1000 + 2000)
    assert s.closed.alpha == s.open.alpha > 0 and s.closed.alpha_x > 0
    assert robot.config.table is not None and robot.config.table.q == 30


def test_a_workload_without_messages_has_an_x_hat_of_1() -> None:
    assert Workload(m=0, agrees=True).make_robot(MirrorRobot).s.x_hat == 2**23


def test_a_robust_workload_has_an_estimate_of_each_message_and_votes() -> None:
    robot = Workload(m=3, robust=True).make_robot(MirrorRobot)
    assert robot.config == Config(robot.config.table, Filter.ROBUST, filter_period=1)
    assert (robot.s.robust.votes, robot.s.robust.filled_slots) == (512, 0b111)
    assert robot.s.estimates[:4] == [0, 8, 16, 0]  # 0, 1000 and 2000 units of 2**-23


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("m", [10, 127])
@pytest.mark.parametrize(("agrees", "status"), [(False, Status.UPDATED), (True, Status.OK)])
def test_the_filter_updates_unless_the_workload_agrees(
    robust: bool, m: int, agrees: bool, status: Status
) -> None:
    robot = Workload(m=m, n=500, agrees=agrees, robust=robust).make_robot(MirrorRobot)
    assert robot.settle() == status


@pytest.mark.parametrize(("halves", "t"), [(False, 64), (True, 32)])
def test_the_next_observation_makes_t_or_halves_it(halves: bool, t: int) -> None:
    robot = Workload(t=64, n=32, halves=halves).make_robot(MirrorRobot)
    assert robot.observe(Observation.BLACK) == Status.OK
    assert robot.t == t


# --- Time and storage ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def operations() -> Counts:
    return count_operations()


# design: R34
@pytest.mark.slow
def test_no_call_of_a_robot_takes_longer_with_more_observations_messages_or_neighbours(
    operations: Counts,
) -> None:
    assert find_growth(operations) == []
    assert operations.keys() == CALLS.keys() | {f"{name}, robust" for name in CALLS}


@pytest.mark.slow
def test_calls_are_counted_over_the_ranges_of_t_m_and_q(operations: Counts) -> None:
    """Observations t, messages m of a tick, and entries q of the table, which the robust filter has not."""
    for name, count_by_axis in operations.items():
        assert {1, 2, 2**31 - 1, 2**31} <= count_by_axis["t"].keys()
        assert count_by_axis["m"].keys() == set(range(128))
        assert count_by_axis["q"].keys() == (set() if "robust" in name else set(range(2, 128)))


def largest_count(operations: Counts, name: str) -> int:
    """Return the largest number of instructions of a call, over all axes."""
    return max(count for count_by_value in operations[name].values() for count in count_by_value.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "limit"), [("step", 1000), ("step, robust", 10_000), ("receive, robust", 240)]
)
def test_calls_take_few_instructions(operations: Counts, name: str, limit: int) -> None:
    """The test of the robust filter goes through 32 slots about six times."""
    assert 0 < largest_count(operations, name) < limit


@pytest.mark.slow
def test_both_outcomes_of_the_test_and_an_update_are_counted(operations: Counts) -> None:
    """Once there are messages enough for a test, ``settle``, which makes it, takes longer, but no more."""
    count_by_m = {name: count_by_axis["m"] for name, count_by_axis in operations.items()}
    settle = count_by_m["settle"]
    assert settle[0] < settle[2] == settle[127]
    assert count_by_m["step"][127] > settle[127] + min(count_by_m["observe"].values())
    robust_settle = count_by_m["settle, robust"]

    assert robust_settle[4] < robust_settle[5] < robust_settle[32] == robust_settle[127]


@pytest.mark.slow
def test_all_kinds_of_messages_are_counted(operations: Counts) -> None:
    count = {name: count_by_axis["m"][20] for name, count_by_axis in operations.items()}
    assert count["receive"] > count["receive again"] > count["receive own"]
    assert count["receive, robust"] > count["receive again, robust"]


def robot_that_loops(times: Callable[[State], int]) -> type[MirrorRobot]:
    """Return a firmware that loops so many times at the end of a round."""

    class LoopingRobot(MirrorRobot):
        def settle(self) -> Status:
            loop(times(self.s))
            return super().settle()

    return LoopingRobot


class RobotThatLoopsOverObservations(MirrorRobot):
    @property
    def x_raw(self) -> int:
        loop(self.s.t)
        return super().x_raw


class RobotThatSearchesItsTable(MirrorRobot):
    """Looks at each entry of the table, and saves a byte for each message."""

    def settle(self) -> Status:
        assert self.config.table is not None
        loop(self.config.table.q)
        return super().settle()

    def save(self) -> bytes:
        return super().save() + bytes(self.s.open.count)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("firmware", "axis", "growing_calls"),
    [
        (robot_that_loops(lambda state: state.open.count), "m", ["settle", "step"]),
        (RobotThatSearchesItsTable, "q", ["settle", "step"]),
        *slow(
            [
                (
                    robot_that_loops(lambda state: state.accepted if state.robust.votes else 0),
                    "m",
                    ["settle, robust", "step, robust"],
                ),
                (RobotThatLoopsOverObservations, "t", ["x", "x, robust"]),
            ]
        ),
    ],
)
def test_time_that_grows_is_found(firmware: type[MirrorRobot], axis: str, growing_calls: list[str]) -> None:
    problems = find_growth(count_operations(firmware, [axis]))
    assert sorted(problem.split(":")[0] for problem in problems) == growing_calls
    assert all(f"where {axis} is" in problem for problem in problems)


@pytest.mark.parametrize(("name", "size"), [("images", 124), ("robust_images", 156)])
def test_a_saved_robot_has_the_same_size_whatever_it_has_received(name: str, size: int) -> None:
    assert measure_storage()[name] == dict.fromkeys(range(128), size)


def test_a_table_takes_4_bytes_an_entry() -> None:
    assert measure_storage()["tables"] == {q: 12 + 4 * q for q in range(2, 128)}


def test_storage_that_grows_is_measured() -> None:
    assert len(set(measure_storage(RobotThatSearchesItsTable)["images"].values())) == 128
