"""Comparing two firmwares: they agree, and the first difference is shown by as few calls as possible."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from crosschecks import ROBOT, SEED, BrokenRobot, find_failure
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

    Scenarios are drawn with a fixed seed.
    """
    assert find_failure(NativeRobot, MirrorRobot, max_calls=10_000) is None


def test_the_c_and_the_python_robot_agree_next_to_the_threshold_of_the_robust_filter() -> None:
    for index in range(40):
        scenario = robust_scenario(23, index)
        assert compare_firmwares(scenario, MirrorRobot, NativeRobot) is None, str(scenario)


class RobotThatCannotBeMade(MirrorRobot):
    """Raises an exception that no firmware may raise."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        raise ZeroDivisionError("in init")


class RobotThatRefusesEveryId(MirrorRobot):
    """Adds 128 to its id."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id + 128, b_hat)


class RobotWithAWrongField(MirrorRobot):
    """Has a wrong field in its state, which no result shows."""

    def state(self) -> dict[str, int]:
        return super().state() | {"updated": 7}


@pytest.mark.parametrize(
    ("first", "second", "call_count", "problem"),
    [
        (NativeRobot, BrokenRobot, 2, "status: OK, ZeroDivisionError: in settle"),
        (BrokenRobot, BrokenRobot, 2, "both: ZeroDivisionError: in settle"),
        (RobotThatCannotBeMade, RobotThatCannotBeMade, 0, "both: ZeroDivisionError: in init"),
        (NativeRobot, RobotWithAWrongField, 0, "updated: 0, 7"),
        (NativeRobot, RobotThatRefusesEveryId, 0, "status: OK, ERR_ID"),
    ],
)
def test_a_difference_or_an_exception_is_reported_with_the_calls_up_to_it(
    first: Firmware, second: Firmware, call_count: int, problem: str
) -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle,settle")
    expected = Failure(scenario.with_calls(scenario.calls[:call_count]), (problem,))
    assert compare_firmwares(scenario, first, second) == expected


def test_differences_name_fields_results_and_words_of_the_saved_robot() -> None:
    setup = parse_scenario(ROBOT).setup
    first, second = RobotUnderTest(MirrorRobot, setup), RobotUnderTest(MirrorRobot, setup)
    # Restore the second robot with word 2 of its saved state, the count t, as 5, and bit 16 of word 29 set.
    second.apply(Call("restore", (2, 5, 29, 1 << 16)))
    *lines, checksum_line = differences(first.last_result, second.last_result)

    assert lines == [
        "t: 0, 5",
        "updated: 0, 1",
        "t(): 0, 5",
        "save(), word 2: 0x00000000, 0x00000005",
        "save(), word 29: 0x00000000, 0x00010000",
    ]
    assert checksum_line.startswith("save(), word 30: ")


@settings(deadline=None, database=None, derandomize=True)
@given(st.lists(st.integers(0, 2), max_size=30), st.sets(st.integers(0, 29), min_size=1, max_size=4))
def test_shrinking_leaves_exactly_the_calls_and_words_that_the_failure_needs(
    extra_words: list[int], needed: set[int]
) -> None:
    """So a report is short. The check fails once the calls of the ``needed`` numbers were made.

    Each call writes its number into word 1, and other values into words 2 and 3, which are not needed.
    """
    assume(max(needed) < len(extra_words))
    calls = tuple(Call("restore", (1, number, 2, word, 3, word)) for number, word in enumerate(extra_words))

    def check_scenario(scenario: Scenario) -> Failure | None:
        missing = set(needed)
        for call_count, call in enumerate(scenario.calls, start=1):
            missing.discard(dict(call.pairs).get(1, -1))
            if not missing:
                return Failure(scenario.with_calls(scenario.calls[:call_count]), ("all needed calls",))
        return None

    shortest = shrink(Failure(Scenario(parse_scenario(ROBOT).setup, calls), ()), check_scenario)
    assert shortest.scenario.calls == tuple(Call("restore", (1, number)) for number in sorted(needed))


@pytest.mark.parametrize("failing_call", [0, 1, 5])
def test_a_run_counts_the_calls_up_to_the_failure(failing_call: int) -> None:
    calls_made: list[int] = []

    def check_scenario(scenario: Scenario) -> Failure | None:
        if sum(calls_made) > 100 and len(scenario.calls) > failing_call:
            return Failure(scenario.with_calls(scenario.calls[:failing_call]), ("wrong",))
        calls_made.append(len(scenario.calls))
        return None

    result = run_crosscheck(check_scenario, SEED, 5000, lambda calls: None)
    assert result.failure is not None
    assert result.calls == sum(calls_made) + failing_call
    assert result.scenarios == len(calls_made) + 1


def test_a_run_ends_after_exactly_the_calls_asked_for() -> None:
    reported_calls: list[int] = []
    result = run_crosscheck(lambda scenario: None, SEED, 1234, reported_calls.append)
    assert result.calls == 1234
    assert result.failure is None
    assert not result.interrupted
    assert sum(reported_calls) == 1234


def test_every_fourth_scenario_is_of_a_robot_with_the_robust_filter() -> None:
    is_robust: list[bool] = []

    def check_scenario(scenario: Scenario) -> None:
        is_robust.append(scenario.setup.filter == Filter.ROBUST)

    run_crosscheck(check_scenario, SEED, 1234, lambda calls: None)
    assert is_robust[:8] == [False, False, False, True] * 2
