"""Comparing two firmwares: they agree, and the first difference is shown by as few calls as possible."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crosschecks import ROBOT_WITHOUT_FILTER, BrokenRobot, find_failure
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools.crosscheck.compare import (
    Failure,
    Firmware,
    RobotUnderTest,
    compare_firmwares,
    differences,
    run_crosscheck,
    shrink,
)
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, parse_scenario


# design: R12, R21, R24, R33
def test_the_c_and_the_python_robot_agree_in_every_bit_and_with_exact_arithmetic() -> None:
    """NativeRobot calls the C; MirrorRobot computes the same in Python.

    Both make thousands of random calls, drawn with a fixed seed, and are compared after each, with each other
    and with exact arithmetic.
    """
    failure = find_failure(NativeRobot, MirrorRobot, max_calls=6_000)
    assert failure is None


def test_the_c_and_the_python_robot_agree_next_to_the_threshold_of_the_robust_filter() -> None:
    """The calls of 20 random scenarios lead to tests that just reject, or just do not.

    ``compare_firmwares`` returns the first difference, and here None.
    """
    for index in range(20):
        scenario = robust_scenario(seed=23, index=index)
        failure = compare_firmwares(scenario, MirrorRobot, NativeRobot)
        assert failure is None, str(scenario)


class RobotThatCannotBeMade(MirrorRobot):
    """Raises an exception that no firmware may raise."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        raise ZeroDivisionError("in init")


class RobotThatRefusesEveryId(MirrorRobot):
    """Adds 128 to its id, which makes it too large."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id + 128, b_hat)


class RobotWithUpdatedAsSeven(MirrorRobot):
    """Has a wrong value, 7, in the field "updated" of its state, which no result shows."""

    def state(self) -> dict[str, int]:
        return super().state() | {"updated": 7}


@pytest.mark.parametrize(
    ("first", "second", "call_count", "expected_problem"),
    [
        # BrokenRobot raises an error in settle, the second call.
        (NativeRobot, BrokenRobot, 2, "status: OK, ZeroDivisionError: in settle"),
        (BrokenRobot, BrokenRobot, 2, "both: ZeroDivisionError: in settle"),
        # The others differ before the first call.
        (RobotThatCannotBeMade, RobotThatCannotBeMade, 0, "both: ZeroDivisionError: in init"),
        (NativeRobot, RobotWithUpdatedAsSeven, 0, "updated: 0, 7"),
        (NativeRobot, RobotThatRefusesEveryId, 0, "status: OK, ERR_ID"),
    ],
)
def test_a_difference_or_an_exception_is_reported_with_the_calls_up_to_it(
    first: Firmware, second: Firmware, call_count: int, expected_problem: str
) -> None:
    """The failure has the first ``call_count`` of three calls; with 0 the robots differ as they are made."""
    scenario = parse_scenario(f"{ROBOT_WITHOUT_FILTER},observe:1,settle,settle")
    failure = compare_firmwares(scenario, first, second)

    assert failure is not None
    assert failure.scenario.calls == scenario.calls[:call_count]
    assert failure.problems == (expected_problem,)


def test_differences_of_two_robots_are_listed_by_field_result_and_word_of_the_saved_robot() -> None:
    """The second robot is restored from its saved words, in which two numbers are changed.

    Its count t of observations becomes 5, and ``updated`` says that b_hat was updated after x_hat. Each line
    has the first robot's value and the second's. Names of results, such as t(), have brackets.
    """
    scenario = parse_scenario(f"{ROBOT_WITHOUT_FILTER},restore:t=5:updated=1")
    (restore,) = scenario.calls
    first = RobotUnderTest(MirrorRobot, scenario.setup)
    second = RobotUnderTest(MirrorRobot, scenario.setup)
    second.apply(restore)
    *lines, checksum_line = differences(first.last_result, second.last_result)

    assert lines == [
        "t: 0, 5",
        "updated: 0, 1",
        "t(): 0, 5",
        "save(), word 2: 0x00000000, 0x00000005",
        "save(), word 29: 0x00000000, 0x00010000",
    ]
    assert checksum_line.startswith("save(), word 30: ")


def scenario_of_restores(numbers_of_calls: Iterable[dict[str, int]]) -> Scenario:
    """Return a scenario that restores a robot again and again, each time with these numbers, by name."""
    calls = [Call("restore", new_numbers=tuple(numbers.items())) for numbers in numbers_of_calls]
    return Scenario(parse_scenario(ROBOT_WITHOUT_FILTER).setup, tuple(calls))


@settings(max_examples=25, deadline=None, database=None, derandomize=True)
@given(needed_calls=st.sets(st.integers(0, 29), min_size=1, max_size=4), call_count=st.integers(30, 40))
def test_shrinking_leaves_exactly_the_calls_and_numbers_that_the_failure_needs(
    needed_calls: set[int], call_count: int
) -> None:
    """A scenario has 30 to 40 calls, counted from 0. The failure needs one to four of them.

    Each call replaces t by its count, by which the check knows it, and n and x_hat needlessly. The shortest
    scenario has only the needed calls, and in them only t.
    """

    def fail_if_all_needed_calls_were_made(scenario: Scenario) -> Failure | None:
        calls_made = {dict(call.new_numbers).get("t") for call in scenario.calls}
        if needed_calls <= calls_made:
            return Failure(scenario, ("all needed calls",))
        return None

    scenario = scenario_of_restores({"t": count, "n": 7, "x_hat": count % 3} for count in range(call_count))
    shortest_failure = shrink(Failure(scenario, ()), fail_if_all_needed_calls_were_made)

    expected_scenario = scenario_of_restores({"t": count} for count in sorted(needed_calls))
    assert shortest_failure.scenario == expected_scenario


def ignore_progress(calls_made: int) -> None:
    """Take the number of calls of a scenario, which the cross-check reports, and do nothing."""


@pytest.mark.parametrize("calls_up_to_failure", [0, 1, 5])
def test_a_crosscheck_that_fails_has_counted_the_calls_up_to_the_failing_one(
    calls_up_to_failure: int,
) -> None:
    """Three scenarios, that is robots and their calls, pass. The fourth fails after 0, 1 or 5 calls.

    5000 calls are asked for, which are more than four scenarios have.
    """
    passed_call_counts: list[int] = []

    def fail_in_fourth_scenario(scenario: Scenario) -> Failure | None:
        if len(passed_call_counts) == 3:
            calls = scenario.calls[:calls_up_to_failure]
            return Failure(scenario.replace_calls(calls), ("wrong",))
        passed_call_counts.append(len(scenario.calls))
        return None

    result = run_crosscheck(fail_in_fourth_scenario, seed=1, calls=5000, on_calls=ignore_progress)
    assert result.failure is not None
    assert result.calls == sum(passed_call_counts) + calls_up_to_failure
    assert result.scenarios == 3 + 1


def test_a_crosscheck_without_a_failure_ends_after_exactly_the_calls_asked_for() -> None:
    """1234 calls are asked for, and the last scenario is cut short there.

    The function ``on_calls`` is told how many calls each scenario has made.
    """

    def find_nothing_wrong(scenario: Scenario) -> None:
        return None

    reported_calls: list[int] = []
    result = run_crosscheck(find_nothing_wrong, seed=1, calls=1234, on_calls=reported_calls.append)
    assert result.failure is None
    assert not result.interrupted
    assert result.calls == 1234
    assert sum(reported_calls) == 1234


def test_every_fourth_scenario_of_a_crosscheck_has_a_robot_with_the_robust_filter() -> None:
    """The others have a robot with one of the paper's filters. 1234 calls are more than 8 scenarios have."""
    is_robust: list[bool] = []

    def record_filter(scenario: Scenario) -> None:
        is_robust.append(scenario.setup.filter == Filter.ROBUST)

    run_crosscheck(record_filter, seed=1, calls=1234, on_calls=ignore_progress)

    first_four, next_four = is_robust[:4], is_robust[4:8]
    assert first_four == [False, False, False, True]
    assert next_four == [False, False, False, True]
