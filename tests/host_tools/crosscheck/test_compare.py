"""Comparing two firmwares: they agree, and a difference is found at once and shown by the fewest calls."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from crosschecks import ROBOT, SEED, BrokenRobot, caught, judged, silent
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.crosscheck.compare import (
    Disagreement,
    Subject,
    compare_firmwares,
    crosscheck,
    differences,
    shrink,
)
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, parse_scenario


def test_native_and_mirror_agree_and_keep_every_limit() -> None:
    check = judged(NativeRobot, MirrorRobot)
    failing = caught(check, calls=10_000)
    assert failing is None, f"mcp-asdf crosscheck --replay {shrink(failing, check)}"


def test_an_exception_is_a_difference() -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle")
    finding = compare_firmwares(scenario, NativeRobot, BrokenRobot)
    assert finding is not None
    assert (finding.calls, finding.problems[0]) == (2, "status: OK, ZeroDivisionError: in settle")


class UnmakeableRobot(MirrorRobot):
    """Fails to be made in a way no firmware may."""

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        raise ZeroDivisionError("in init")


def test_the_same_exception_is_no_agreement() -> None:
    scenario = parse_scenario(f"{ROBOT},observe:1,settle")
    for robot, made, place in ((BrokenRobot, 2, "settle"), (UnmakeableRobot, 0, "init")):
        finding = compare_firmwares(scenario, robot, robot)
        assert finding == Disagreement(made, (f"both: ZeroDivisionError: in {place}",))


class SilentlyWrongRobot(MirrorRobot):
    """Has a wrong member that no output shows."""

    def state(self) -> dict[str, int]:
        return super().state() | {"updated": 7}


def test_a_hidden_difference_of_state_is_found_at_once() -> None:
    finding = compare_firmwares(parse_scenario(ROBOT), NativeRobot, SilentlyWrongRobot)
    assert finding == Disagreement(0, ("updated: 0, 7",))


def test_a_robot_that_only_one_firmware_makes_is_a_difference() -> None:
    class Choosy(MirrorRobot):
        def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
            super().__init__(config, robot_id + 128, b_hat)

    assert compare_firmwares(parse_scenario(ROBOT), NativeRobot, Choosy) == Disagreement(
        0, ("status: OK, ERR_ID",)
    )


def test_differences_name_words_of_the_image() -> None:
    one, other = (Subject(MirrorRobot, parse_scenario(ROBOT).setup) for _ in range(2))
    other.apply(Call("restore", (2, 5, 29, 1 << 16)))
    assert list(differences(one.last, other.last)) == [
        "t: 0, 5",
        "updated: 0, 1",
        "t(): 0, 5",
        "save(), word 2: 0x00000000, 0x00000005",
        "save(), word 29: 0x00000000, 0x00010000",
        f"save(), word 30: {int.from_bytes(one.last.image[-4:], 'little'):#010x}, "
        f"{int.from_bytes(other.last.image[-4:], 'little'):#010x}",
    ]


@settings(deadline=None, database=None, derandomize=True)
@given(st.lists(st.integers(0, 2), max_size=30), st.sets(st.integers(0, 29), min_size=1, max_size=4))
def test_shrinking_leaves_exactly_what_is_needed(zs: list[int], needed: set[int]) -> None:
    """Whatever calls a finding needs, those are left, in order."""
    setup = parse_scenario(ROBOT).setup
    calls = tuple(Call("receive", (at, 0, z)) for at, z in enumerate(zs))
    assume(max(needed) < len(calls))

    def check(scenario: Scenario) -> Disagreement | None:
        missing = set(needed)
        for made, call in enumerate(scenario.calls, start=1):
            missing.discard(call.numbers[0])
            if not missing:
                return Disagreement(made, ("all there",))
        return None

    assert shrink(Scenario(setup, calls), check).calls == tuple(calls[at] for at in sorted(needed))


def test_shrinking_what_is_sound_changes_nothing() -> None:
    scenario = random_scenario(SEED, 3)
    assert shrink(scenario, lambda candidate: None) == scenario


@pytest.mark.parametrize("at", [0, 1, 5])
def test_a_run_that_finds_something_counts_the_calls_made(at: int) -> None:
    """Not those of the scenario that were to come."""
    made: list[int] = []

    def check(scenario: Scenario) -> Disagreement | None:
        if sum(made) > 100 and len(scenario.calls) > at:
            return Disagreement(at, ("wrong",))
        made.append(len(scenario.calls))
        return None

    outcome = crosscheck(check, SEED, 5000, silent)
    assert outcome.failing is not None
    assert outcome.calls == sum(made) + at


def test_a_run_stops_after_the_calls_asked_for() -> None:
    heard: list[int] = []
    outcome = crosscheck(lambda scenario: None, SEED, 1234, heard.append)
    assert (outcome.calls, outcome.failing, outcome.interrupted) == (1234, None, False)
    assert heard == sorted(heard)
    assert heard[-1] == 1234
