"""Comparing two firmwares: they agree, and a difference is found at once and shown by the fewest calls."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from crosschecks import ROBOT, SEED, BrokenRobot, caught, judged
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config, Filter
from mcp_asdf_tools.crosscheck.compare import (
    Failure,
    Firmware,
    Subject,
    compare_firmwares,
    crosscheck,
    differences,
    shrink,
)
from mcp_asdf_tools.crosscheck.random_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, parse_scenario


# design: R12, R21, R24, R33
def test_native_and_mirror_agree_and_keep_every_limit() -> None:
    assert caught(judged(NativeRobot, MirrorRobot), calls=10_000) is None


def test_native_and_mirror_agree_next_to_the_threshold_of_the_robust_filter() -> None:
    """Nothing else notices four mistakes in how the mirror folds b_hat at 1/2."""
    for number in range(40):
        scenario = robust_scenario(23, number)
        assert compare_firmwares(scenario, MirrorRobot, NativeRobot) is None, str(scenario)


class Unmakeable(MirrorRobot):
    """Fails to be made in a way no firmware may."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        raise ZeroDivisionError("in init")


class Choosy(MirrorRobot):
    """Refuses every id."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(config, robot_id + 128, b_hat)


class SilentlyWrong(MirrorRobot):
    """Has a wrong member that no output shows."""

    def state(self) -> dict[str, int]:
        return super().state() | {"updated": 7}


@pytest.mark.parametrize(
    ("left", "right", "made", "problem"),
    [
        (NativeRobot, BrokenRobot, 2, "status: OK, ZeroDivisionError: in settle"),
        (BrokenRobot, BrokenRobot, 2, "both: ZeroDivisionError: in settle"),
        (Unmakeable, Unmakeable, 0, "both: ZeroDivisionError: in init"),
        (NativeRobot, SilentlyWrong, 0, "updated: 0, 7"),
        (NativeRobot, Choosy, 0, "status: OK, ERR_ID"),
    ],
)
def test_a_difference_or_an_exception_ends_the_scenario(
    left: Firmware, right: Firmware, made: int, problem: str
) -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle,settle")
    expected = Failure(scenario.with_calls(scenario.calls[:made]), (problem,))
    assert compare_firmwares(scenario, left, right) == expected


def test_differences_name_words_of_the_image() -> None:
    one, other = (Subject(MirrorRobot, parse_scenario(ROBOT).setup) for _ in range(2))
    other.apply(Call("restore", (2, 5, 29, 1 << 16)))
    *found, checksum = differences(one.last, other.last)
    assert found == [
        "t: 0, 5",
        "updated: 0, 1",
        "t(): 0, 5",
        "save(), word 2: 0x00000000, 0x00000005",
        "save(), word 29: 0x00000000, 0x00010000",
    ]
    assert checksum.startswith("save(), word 30: ")


@settings(deadline=None, database=None, derandomize=True)
@given(st.lists(st.integers(0, 2), max_size=30), st.sets(st.integers(0, 29), min_size=1, max_size=4))
def test_shrinking_leaves_exactly_what_is_needed(zs: list[int], needed: set[int]) -> None:
    """Whatever calls a finding needs, those are left, in order; of a restore, the words that it needs."""
    setup = parse_scenario(ROBOT).setup
    calls = tuple(Call("restore", (1, at, 2, z, 3, z)) for at, z in enumerate(zs))
    assume(max(needed) < len(calls))

    def check(scenario: Scenario) -> Failure | None:
        missing = set(needed)
        for made, call in enumerate(scenario.calls, start=1):
            missing.discard(dict(call.pairs).get(1, -1))
            if not missing:
                return Failure(scenario.with_calls(scenario.calls[:made]), ("all there",))
        return None

    least = shrink(Failure(Scenario(setup, calls), ()), check)
    assert least.scenario.calls == tuple(Call("restore", (1, at)) for at in sorted(needed))


@pytest.mark.parametrize("at", [0, 1, 5])
def test_a_run_that_finds_something_counts_the_calls_made(at: int) -> None:
    """Not those of the scenario that were to come."""
    made: list[int] = []

    def check(scenario: Scenario) -> Failure | None:
        if sum(made) > 100 and len(scenario.calls) > at:
            return Failure(scenario.with_calls(scenario.calls[:at]), ("wrong",))
        made.append(len(scenario.calls))
        return None

    outcome = crosscheck(check, SEED, 5000, lambda done: None)
    assert outcome.failure is not None
    assert (outcome.calls, outcome.scenarios) == (sum(made) + at, len(made) + 1)


def test_a_run_stops_after_the_calls_asked_for_and_every_fourth_robot_is_robust() -> None:
    heard: list[int] = []
    robust: list[bool] = []

    def check(scenario: Scenario) -> None:
        robust.append(scenario.setup.filter == Filter.ROBUST)

    outcome = crosscheck(check, SEED, 1234, heard.append)
    assert (outcome.calls, outcome.failure, outcome.interrupted) == (1234, None, False)
    assert sum(heard) == 1234
    assert robust[:8] == [False, False, False, True] * 2
