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
from support import run

# --- Counting --------------------------------------------------------------------------------------------


def loop(times: int) -> None:
    for _ in range(times):
        pass


def test_each_turn_of_a_loop_takes_as_many_instructions_as_the_others() -> None:
    """The counted instructions belong to Python's interpreter. Loops with 0, 1 and 10 turns are counted."""
    without_a_turn = count_instructions(partial(loop, times=0))
    with_one_turn = count_instructions(partial(loop, times=1))
    with_ten_turns = count_instructions(partial(loop, times=10))

    instructions_of_a_turn = with_one_turn - without_a_turn
    assert without_a_turn > 0
    assert instructions_of_a_turn > 0
    assert with_ten_turns == without_a_turn + 10 * instructions_of_a_turn


def test_the_first_instructions_that_a_process_counts_are_counted_in_full() -> None:
    """Some versions of Python begin to tell of instructions only when they have been asked once before."""
    program = (
        "from mcp_asdf_tools.crosscheck.operation_count import count_instructions\n"
        "def add(): return (lambda number: number + 1)(2)\n"
        "print(count_instructions(add), count_instructions(add))"
    )
    first_count, second_count = run(sys.executable, "-c", program).split()
    assert first_count == second_count


def test_a_call_without_end_is_cut_short_after_20_000_instructions() -> None:
    """No call of a robot may take 20,000 instructions. Instruction 20,001 is counted, and ends the call."""
    endless_call = partial(loop, times=10**9)
    assert count_instructions(endless_call) == 20_000 + 1


def test_a_debugger_is_in_its_place_again_after_counting() -> None:
    """A trace function counts instructions. Python has a place for one, and debuggers use it, too."""

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


@pytest.mark.parametrize(("switch_collector", "was_on"), [(gc.disable, False), (gc.enable, True)])
@pytest.mark.usefixtures("collector_switched_back")
def test_the_garbage_collector_is_off_while_counting_and_then_as_before(
    switch_collector: Callable[[], None], was_on: bool
) -> None:
    """The garbage collector's instructions would be counted as the robot's.

    Before, it is switched on or off. The counted call records whether it is on.
    """
    is_on_while_counting: list[bool] = []

    def counted_call() -> None:
        is_on_while_counting.append(gc.isenabled())

    switch_collector()
    count_instructions(counted_call)
    assert is_on_while_counting == [False]
    assert gc.isenabled() == was_on


# --- Workloads -------------------------------------------------------------------------------------------


def workloads_at(axis: str, value: int) -> list[Workload]:
    """Return the workloads at a value of an axis."""
    return [workload for workload in workloads_along(axis) if getattr(workload, axis) == value]


both_workloads = pytest.mark.parametrize("workload_class", [Workload, RobustWorkload])


@both_workloads
def test_workloads_with_64_observations_have_all_kinds_of_accuracies_and_counts(
    workload_class: type[Workload],
) -> None:
    """A workload is a robot whose calls are counted: with the paper's filter, or with the robust one.

    Its b_hat is in units of 2**-32, and n of its t tiles are black: none, two fifths or all. The accuracies
    b_hat are the least, 1/2, 0.95 and the largest. The last workload halves its memory.
    """
    smallest_b_hat = 2**12
    one_half = 2**31
    b_hat_95 = round(0.95 * 2**32)
    largest_b_hat = 2**32 - 2**12
    expected_workloads = []
    for b_hat in (smallest_b_hat, one_half, b_hat_95, largest_b_hat):
        for n in (0, 25, 64):  # none, two fifths (rounded down) or all
            expected_workloads.append(workload_class(t=64, n=n, b_hat=b_hat))
    expected_workloads.append(workload_class(t=64, n=32, halves=True))

    workloads = [workload for workload in workloads_at("t", 64) if type(workload) is workload_class]
    assert workloads == expected_workloads


def test_workloads_have_a_power_of_two_of_observations_or_one_less() -> None:
    """Counts t go from 1 to 2**31. A loop over the bits of t would show, and a loop up to t even more."""
    expected_counts = {1}
    for exponent in range(1, 32):
        expected_counts |= {2**exponent - 1, 2**exponent}
    assert {workload.t for workload in workloads_along("t")} == expected_counts


def test_workloads_with_9_messages_have_tests_of_both_outcomes_and_the_largest_sums() -> None:
    """``agrees`` says whether the messages agree with the robot. If they do not, the filter's test rejects.

    For the robust filter, a robot that agrees has seen half of its 1000 tiles black.
    """
    largest_confidence = 0xFFFFFF1F  # the alpha of a message, as a word
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
    """A test by m messages uses the table's entry for m. The first entry is for two messages.

    The last one is for q and more, of at most 127.
    """
    expected_workloads = [Workload(q=q, m=m) for m in m_values]
    assert workloads_at("q", q) == expected_workloads


def test_a_robot_whose_calls_are_counted_has_observed_all_but_one_of_its_t_tiles() -> None:
    """The counted call observes the last. 400 of the tiles before it are black.

    Its x_hat, in units of 2**-23, and its confidence alpha are 1, whatever it has observed.
    """
    b_hat = round(3 / 4 * 2**32)  # in units of 2**-32
    robot = Workload(t=1000, n=400, b_hat=b_hat).make_robot(MirrorRobot)
    assert robot.s.t == 999
    assert robot.s.n == 400
    assert robot.s.accuracy.b_hat == b_hat
    assert robot.s.x_hat == 2**23
    assert alpha_from_word(robot.s.alpha) == 1


def test_a_workload_has_messages_in_its_open_round_and_as_many_in_the_closed_round_before() -> None:
    """Three robots have sent estimates: 1/3, which is 2**23 / 3 units, and 1000 and 2000 units more.

    A robot keeps the sums of its rounds. Those of the confidences alpha are equal in both rounds, as they
    have the same messages.
    """
    robot = Workload(m=3).make_robot(MirrorRobot)
    sums_of_open_round = robot.s.open
    sums_of_closed_round = robot.s.closed
    third = 2**23 // 3
    assert sums_of_open_round.count == 3
    assert sums_of_open_round.x == third + (third + 1000) + (third + 2000)
    assert sums_of_open_round.alpha > 0
    assert sums_of_closed_round.alpha == sums_of_open_round.alpha
    assert sums_of_closed_round.alpha_x > 0
    assert robot.id == 127  # none of the senders


def test_a_robust_workload_has_as_many_votes_as_are_counted() -> None:
    """A vote weighs one estimate; further votes after 512 are not counted. There are three messages."""
    robot = RobustWorkload(m=3).make_robot(MirrorRobot)
    assert robot.config.filter == Filter.ROBUST
    assert robot.s.robust.votes == 512


@both_workloads
@pytest.mark.parametrize("m", [10, 127])
@pytest.mark.parametrize(("agrees", "expected_status"), [(False, Status.UPDATED), (True, Status.OK)])
def test_the_filter_of_a_workload_re_estimates_b_hat_unless_the_messages_agree_with_the_robot(
    workload_class: type[Workload], m: int, agrees: bool, expected_status: Status
) -> None:
    """``settle`` ends a round, after which the filter makes its test. There are m messages.

    Half of the robot's 1000 observations are black. ``settle`` returns UPDATED after a re-estimate.
    """
    robot = workload_class(m=m, n=500, agrees=agrees).make_robot(MirrorRobot)
    assert robot.settle() == expected_status


@pytest.mark.parametrize(("halves", "expected_t"), [(False, 64), (True, 32)])
def test_the_next_observation_of_a_workload_is_its_last_or_halves_its_memory(
    halves: bool, expected_t: int
) -> None:
    """The last observation makes t 64. If the memory is for 64, it is full then, and t is halved to 32."""
    robot = Workload(t=64, n=32, halves=halves).make_robot(MirrorRobot)
    assert robot.observe(Observation.BLACK) == Status.OK
    assert robot.t == expected_t


# --- Time and storage ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def operations() -> Counts:
    return count_operations()


# design: R34
@pytest.mark.slow
def test_no_call_of_a_robot_takes_longer_with_more_observations_messages_or_neighbours(
    operations: Counts,
) -> None:
    """``find_growth`` returns a line about a call that takes more instructions in the upper half of a range.

    A range is of the observations t, of the messages m or of the table's entries q. ``operations`` has the
    counts of all calls of a robot with the paper's filter, and of one with the robust filter.
    """
    calls_with_robust_filter = {f"{name}, robust" for name in CALLS}
    assert operations.keys() == CALLS.keys() | calls_with_robust_filter
    assert find_growth(operations) == []


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
    """The limits are a little above the largest counts of instructions today, so that slowness is noticed.

    The robust filter takes more: its test goes through 32 slots, which keep estimates, about six times.
    """
    count = largest_count(operations, name)
    assert 0 < count < limit


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
    """``settle`` ends a round. The filter's test needs five estimates, and it has 32 slots for them.

    So more than 32 messages take no longer.
    """
    settle_by_messages = operations["settle, robust"]["m"]
    assert settle_by_messages[4] < settle_by_messages[5] < settle_by_messages[32]
    assert settle_by_messages[32] == settle_by_messages[127]


@pytest.mark.slow
def test_a_step_takes_longer_than_an_observation_and_the_end_of_a_round(operations: Counts) -> None:
    """``step`` is both in one call. It is compared after 127 messages."""
    step = operations["step"]["m"][127]
    settle = operations["settle"]["m"][127]
    shortest_observation = min(operations["observe"]["m"].values())
    assert step > shortest_observation + settle


@pytest.mark.slow
def test_a_new_message_takes_longer_than_a_repeated_one_and_that_longer_than_one_s_own(
    operations: Counts,
) -> None:
    """A message under the robot's own id is refused at once. The robots have received 20 messages before.

    With the robust filter, too, a repeated message takes less time than a new one.
    """

    def count_after_20_messages(name: str) -> int:
        return operations[name]["m"][20]

    assert count_after_20_messages("receive") > count_after_20_messages("receive again")
    assert count_after_20_messages("receive again") > count_after_20_messages("receive own")
    assert count_after_20_messages("receive, robust") > count_after_20_messages("receive again, robust")


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
    """Looks at each entry of the table."""

    def settle(self) -> Status:
        assert self.config.table is not None
        loop(self.config.table.q)
        return super().settle()


class RobotThatSavesAByteForEachMessage(MirrorRobot):
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

    calls_with_problems = set()
    for problem in problems:
        call, _, description = problem.partition(":")
        calls_with_problems.add(call)
        assert f"where {axis} is" in description
    assert calls_with_problems == growing_calls


@pytest.mark.parametrize(("name", "size"), [("images", 124), ("robust_images", 156)])
def test_a_saved_robot_has_the_same_size_whatever_it_has_received(name: str, size: int) -> None:
    """It has received 0 to 127 messages. It is saved in 31 words of 4 bytes, or 39 with the robust filter."""
    size_by_messages = measure_storage()[name]
    assert size_by_messages == dict.fromkeys(range(128), size)


def test_a_table_takes_4_bytes_an_entry_and_12_more() -> None:
    """The 12 bytes are three words: one with the number q of entries, one with omega, and a checksum."""
    size_by_entries = measure_storage()["tables"]
    assert size_by_entries == {q: 12 + 4 * q for q in range(2, 128)}


def test_a_saved_robot_that_grows_with_each_message_is_measured() -> None:
    """The saved robot takes 124 bytes without messages, and one byte more with every message, up to 127."""
    size_by_messages = measure_storage(RobotThatSavesAByteForEachMessage)["images"]
    assert size_by_messages == {m: 124 + m for m in range(128)}
