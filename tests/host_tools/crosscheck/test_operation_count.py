"""The count of instructions: time and storage are bounded whatever t, m and q, and growth is found.

A robot has t observations, receives m messages in a round, and has q thresholds in the table of its test. A
workload describes a robot whose calls are counted.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from mcp_asdf.fixed_point import alpha_from_word
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter, Observation, Status
from mcp_asdf_tools.crosscheck.operation_count import (
    CALLS,
    Counts,
    count_instructions,
    count_operations,
    find_growth,
    measure_storage,
    workloads_along,
)
from mcp_asdf_tools.crosscheck.workloads import RobustWorkload, Workload

# --- Counting --------------------------------------------------------------------------------------------


def loop(times: int) -> None:
    for _ in range(times):
        pass


def test_each_turn_of_a_loop_takes_as_many_instructions_as_the_others() -> None:
    """The counted instructions belong to Python's interpreter."""
    without_a_turn = count_instructions(partial(loop, times=0))
    with_one_turn = count_instructions(partial(loop, times=1))
    with_ten_turns = count_instructions(partial(loop, times=10))
    assert 0 < without_a_turn < with_one_turn
    assert with_ten_turns == without_a_turn + 10 * (with_one_turn - without_a_turn)


def test_a_call_without_end_is_cut_short_after_20_000_instructions() -> None:
    """No call of a robot may take 20,000 instructions. Instruction 20,001 is counted, and ends the call."""
    assert count_instructions(partial(loop, times=10**9)) == 20_000 + 1


def test_a_debugger_is_in_its_place_again_after_counting() -> None:
    """A trace function counts instructions. Python has only one, and debuggers use it, too."""

    def debugger(frame: object, event: str, argument: object) -> None:
        return None

    previous_trace = sys.gettrace()
    sys.settrace(debugger)
    try:
        count_instructions(partial(loop, times=1))
        assert sys.gettrace() is debugger
    finally:
        sys.settrace(previous_trace)


@pytest.fixture
def collector_switched_back() -> Iterator[None]:
    yield
    gc.enable()


@pytest.mark.parametrize(("switch_collector", "is_on"), [(gc.disable, False), (gc.enable, True)])
@pytest.mark.usefixtures("collector_switched_back")
def test_the_garbage_collector_is_off_while_counting_and_then_as_before(
    switch_collector: Callable[[], None], is_on: bool
) -> None:
    """The garbage collector's instructions would be counted as the robot's."""
    is_on_while_counting: list[bool] = []
    switch_collector()
    count_instructions(lambda: is_on_while_counting.append(gc.isenabled()))
    assert is_on_while_counting == [False]
    assert gc.isenabled() == is_on


# --- Workloads -------------------------------------------------------------------------------------------


def workloads_at(axis: str, value: int) -> list[Workload]:
    """Return the workloads at a value of an axis."""
    return [workload for workload in workloads_along(axis) if getattr(workload, axis) == value]


both_workloads = pytest.mark.parametrize("workload_class", [Workload, RobustWorkload])


@both_workloads
def test_workloads_with_64_observations_have_all_kinds_of_accuracies_and_counts(
    workload_class: type[Workload],
) -> None:
    """A workload is a robot whose calls are counted. Its b_hat is in units of 2**-32, and n tiles are black.

    The accuracies b_hat are the least, 1/2, 0.95 and the largest. The last workload halves its memory.
    """
    expected = []
    for b_hat in (2**12, 2**31, round(0.95 * 2**32), 2**32 - 2**12):
        # No tiles, two fifths of them, and all are black.
        expected += [workload_class(t=64, n=n, b_hat=b_hat) for n in (0, 25, 64)]
    expected.append(workload_class(t=64, n=32, halves=True))

    assert [workload for workload in workloads_at("t", 64) if type(workload) is workload_class] == expected


@pytest.mark.parametrize("t", [32, 63, 127])
def test_no_workload_halves_counts_that_fill_no_memory(t: int) -> None:
    """A full memory halves the counts, and a memory is for 64 observations or a larger multiple of four."""
    assert not any(workload.halves for workload in workloads_at("t", t))


def test_workloads_have_a_power_of_two_of_observations_or_one_less() -> None:
    """Counts t go from 1 to 2**31. A loop over the bits of t would show, and a loop up to t even more."""
    expected = {1}
    for exponent in range(1, 32):
        expected |= {2**exponent - 1, 2**exponent}
    assert {workload.t for workload in workloads_along("t")} == expected


def test_workloads_with_9_messages_have_tests_of_both_outcomes_and_the_largest_sums() -> None:
    """``agrees`` says whether the messages agree with the robot. If they do not, the filter's test rejects.

    For the robust filter, a robot that agrees has seen half of its 1000 tiles black.
    """
    largest_confidence = 0xFFFFFF1F  # as a message has it
    assert workloads_at("m", 9) == [
        Workload(m=9),
        Workload(m=9, agrees=True),
        Workload(m=9, alpha=largest_confidence),
        RobustWorkload(m=9, n=500),
        RobustWorkload(m=9, n=500, agrees=True),
    ]


@pytest.mark.parametrize(("q", "m_values"), [(2, [2, 2, 3]), (30, [2, 30, 31]), (127, [2, 127, 127])])
def test_workloads_with_a_table_of_q_entries_use_its_first_and_its_last_ones(
    q: int, m_values: list[int]
) -> None:
    """The entry for m messages is used. The first is for two, the last for q and more, of at most 127."""
    assert workloads_at("q", q) == [Workload(q=q, m=m) for m in m_values]


def test_a_robot_whose_calls_are_counted_runs_its_filter_at_the_end_of_the_present_round() -> None:
    """So the most expensive call is counted, and no user's robot takes longer.

    A round is the time between two broadcasts. The filter runs every ``filter_period`` rounds, and
    ``filter_left`` of them are left.
    """
    robot = Workload().make_robot(MirrorRobot)
    assert robot.config.filter_period == 1
    assert robot.s.filter_left == 1


def test_a_robot_whose_calls_are_counted_has_a_table_of_the_size_q_of_its_workload() -> None:
    """The table has the thresholds of the filter's test, and a search in it would take longer with more."""
    robot = Workload(q=30).make_robot(MirrorRobot)
    assert robot.config.table is not None
    assert robot.config.table.q == 30


def test_a_robot_whose_calls_are_counted_has_observed_all_but_one_of_its_t_tiles() -> None:
    """The counted call observes the last. Its x_hat, in units of 2**-23, and its confidence alpha are 1."""
    b_hat = 3 * 2**30  # 3/4 in units of 2**-32
    robot = Workload(t=1000, n=400, b_hat=b_hat).make_robot(MirrorRobot)
    assert robot.s.t == 999
    assert robot.s.n == 400
    assert robot.s.accuracy.b_hat == b_hat
    assert robot.s.x_hat == 2**23
    assert alpha_from_word(robot.s.alpha) == 1


def test_a_workload_has_messages_in_its_open_round_and_as_many_in_the_closed_round_before() -> None:
    """Robots 0, 1 and 2 estimate 1/3, which is 2**23 / 3 units, and 0, 1000 and 2000 units more.

    Of the closed round the robot keeps the sum of the confidences alpha, which is the same, and that of
    alpha x_hat.
    """
    robot = Workload(m=3).make_robot(MirrorRobot)
    third = 2**23 // 3
    assert robot.id == 127
    assert robot.s.open.count == 3
    assert robot.s.open.x == third + (third + 1000) + (third + 2000)
    assert robot.s.closed.alpha == robot.s.open.alpha > 0
    assert robot.s.closed.alpha_x > 0


def test_a_workload_without_messages_has_an_x_hat_of_1() -> None:
    """A robot that ``agrees`` has the mean of its messages as x_hat. Without messages it has 1 (2**23)."""
    robot = Workload(m=0, agrees=True).make_robot(MirrorRobot)
    assert robot.s.x_hat == 2**23


def test_a_robust_workload_has_an_estimate_of_each_message_in_a_slot() -> None:
    """Robots 0, 1 and 2 send 0, 1000 and 2000 units of 2**-23.

    A slot keeps the estimate of one robot in units of 2**-16, which are 2**7 times as large.
    """
    robot = RobustWorkload(m=3).make_robot(MirrorRobot)
    assert robot.s.robust.filled_slots == 0b111
    assert robot.s.estimates[:4] == [0, round(1000 / 2**7), round(2000 / 2**7), 0]


def test_a_robust_workload_has_as_many_votes_as_are_counted() -> None:
    """A vote weighs one estimate; further votes after 512 are not counted."""
    robot = RobustWorkload(m=3).make_robot(MirrorRobot)
    assert robot.config.filter == Filter.ROBUST
    assert robot.s.robust.votes == 512


@both_workloads
@pytest.mark.parametrize("m", [10, 127])
@pytest.mark.parametrize(("agrees", "status"), [(False, Status.UPDATED), (True, Status.OK)])
def test_the_filter_of_a_workload_re_estimates_b_hat_unless_the_messages_agree_with_the_robot(
    workload_class: type[Workload], m: int, agrees: bool, status: Status
) -> None:
    """``settle`` ends a round, after which the filter makes its test. Half of 1000 observations are black."""
    robot = workload_class(m=m, n=500, agrees=agrees).make_robot(MirrorRobot)
    assert robot.settle() == status


@pytest.mark.parametrize(("halves", "t"), [(False, 64), (True, 32)])
def test_the_next_observation_of_a_workload_is_its_last_or_halves_its_memory(halves: bool, t: int) -> None:
    """The last observation makes t 64. If the memory is for 64, it is full then, and t is halved to 32."""
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
    """``find_growth`` returns a line for each call that takes more instructions in the later half of a range.

    A range is of the observations t, of the messages m or of the table's entries q.
    """
    assert find_growth(operations) == []
    assert operations.keys() == CALLS.keys() | {f"{name}, robust" for name in CALLS}


@pytest.mark.slow
def test_instructions_of_each_call_are_counted_up_to_the_largest_t_m_and_q_that_a_robot_can_have(
    operations: Counts,
) -> None:
    """So the test finds a call that takes longer with more of them, from any t, m or q on.

    A robot can have 1 to 2**31 observations t (only some are counted), 0 to 127 messages m in a round, and a
    table of 2 to 127 entries q. With the robust filter it has no table.
    """
    largest_t = 2**31
    for name, count_by_axis in operations.items():
        has_table = "robust" not in name  # the names are "settle", "settle, robust" and so on
        q_values = set(range(2, 128)) if has_table else set()
        assert {1, 2, largest_t - 1, largest_t} <= count_by_axis["t"].keys()
        assert count_by_axis["m"].keys() == set(range(128))
        assert count_by_axis["q"].keys() == q_values


def largest_count(operations: Counts, name: str) -> int:
    """Return the largest number of instructions of a call, over all axes."""
    return max(max(count_by_value.values(), default=0) for count_by_value in operations[name].values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "limit"), [("step", 1050), ("step, robust", 10_000), ("receive, robust", 240)]
)
def test_calls_take_few_instructions(operations: Counts, name: str, limit: int) -> None:
    """The limits are a little above the largest counts of today, so that a slower call is noticed.

    The robust filter takes more: its test goes through 32 slots, which keep estimates, about six times.
    """
    assert 0 < largest_count(operations, name) < limit


@pytest.mark.slow
def test_the_end_of_a_round_takes_longer_with_enough_messages_for_a_test_but_no_longer_with_more(
    operations: Counts,
) -> None:
    """``settle`` ends a round and makes the filter's test, which needs two messages, and 127 are the most."""
    settle_by_messages = operations["settle"]["m"]
    assert settle_by_messages[0] < settle_by_messages[2]
    assert settle_by_messages[2] == settle_by_messages[127]


@pytest.mark.slow
def test_the_end_of_a_round_takes_longer_with_each_slot_that_the_robust_filter_fills(
    operations: Counts,
) -> None:
    """Its test needs five estimates, and it has 32 slots for them."""
    settle_by_messages = operations["settle, robust"]["m"]
    assert settle_by_messages[4] < settle_by_messages[5] < settle_by_messages[32]
    assert settle_by_messages[32] == settle_by_messages[127]


@pytest.mark.slow
def test_a_step_takes_longer_than_an_observation_and_the_end_of_a_round(operations: Counts) -> None:
    """``step`` is both in one call."""
    shortest_observation = min(operations["observe"]["m"].values())
    assert operations["step"]["m"][127] > operations["settle"]["m"][127] + shortest_observation


@pytest.mark.slow
def test_a_new_message_takes_longer_than_a_repeated_one_and_that_longer_than_one_s_own(
    operations: Counts,
) -> None:
    """The counted robots have received 20 messages in the round."""
    count = {name: count_by_axis["m"][20] for name, count_by_axis in operations.items()}
    assert count["receive"] > count["receive again"] > count["receive own"]
    assert count["receive, robust"] > count["receive again, robust"]


class RobotThatLoopsOverMessages(MirrorRobot):
    def settle(self) -> Status:
        loop(self.s.open.count)
        return super().settle()


class RobustRobotThatLoopsOverMessages(MirrorRobot):
    def settle(self) -> Status:
        if self.s.robust.votes:
            loop(self.s.accepted)
        return super().settle()


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
        (RobotThatLoopsOverMessages, "m", {"settle", "step"}),
        (RobotThatSearchesItsTable, "q", {"settle", "step"}),
        (RobustRobotThatLoopsOverMessages, "m", {"settle, robust", "step, robust"}),
        (RobotThatLoopsOverObservations, "t", {"x", "x, robust"}),
    ],
)
def test_calls_whose_time_grows_with_messages_observations_or_the_table_are_found(
    firmware: type[MirrorRobot], axis: str, growing_calls: set[str]
) -> None:
    """The firmware loops over its messages m, its observations t or the q entries of its table.

    A problem is a line such as "settle: 600 instructions where m is 64 to 127, but 500 below".
    """
    problems = find_growth(count_operations(firmware, [axis]))
    assert {problem.partition(":")[0] for problem in problems} == growing_calls
    assert all(f"where {axis} is" in problem for problem in problems)


@pytest.mark.parametrize(("name", "size"), [("images", 124), ("robust_images", 156)])
def test_a_saved_robot_has_the_same_size_whatever_it_has_received(name: str, size: int) -> None:
    """It has received 0 to 127 messages. It is saved in 31 words of 4 bytes, or 39 with the robust filter."""
    assert measure_storage()[name] == dict.fromkeys(range(128), size)


def test_a_table_takes_4_bytes_an_entry_and_12_more() -> None:
    """The 12 bytes are three words: one with the number q of entries, one with omega, and a checksum."""
    assert measure_storage()["tables"] == {q: 12 + 4 * q for q in range(2, 128)}


def test_a_saved_robot_that_grows_with_each_message_is_measured() -> None:
    """This one saves a byte more for each of 0 to 127 messages."""
    sizes = measure_storage(RobotThatSearchesItsTable)["images"]
    assert sizes == {m: 124 + m for m in range(128)}
