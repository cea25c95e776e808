"""A single wrong bit in the mirror is found; what both firmwares do wrong, by the oracle."""

from __future__ import annotations

import pytest

from crosschecks import FAULTS, caught, judged, planted
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf_tools.crosscheck.compare import Check, shrink
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, parse_scenario


def assert_minimal(scenario: Scenario, check: Check) -> None:
    """Nothing can be left out: no call, and no word that a restore replaces."""
    for at, call in enumerate(scenario.calls):
        before, behind = scenario.calls[:at], scenario.calls[at + 1 :]
        assert check(scenario.with_calls(before + behind)) is None, f"{scenario} does not need {call}"
        for pair in range(0, len(call.numbers), 2) if call.name == "restore" else ():
            fewer = Call("restore", call.numbers[:pair] + call.numbers[pair + 2 :])
            calls = (*before, fewer, *behind)
            assert check(scenario.with_calls(calls)) is None, f"{scenario} does not need all of {call}"


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught(fault: str) -> None:
    failure = caught(judged(NativeRobot, planted(fault)))
    assert failure is not None
    assert judged(NativeRobot, MirrorRobot)(failure.scenario) is None, "it is not the fault that shows"


@pytest.mark.parametrize("fault", ["estimate: c t", "halving: ties to even", "restore"])
def test_a_fault_is_shown_by_a_minimal_scenario(fault: str) -> None:
    check = judged(NativeRobot, planted(fault))
    failure = caught(check)
    assert failure is not None
    least = shrink(failure, check)
    assert_minimal(least.scenario, check)
    assert check(parse_scenario(str(least.scenario))) == least


@pytest.mark.parametrize(
    "fault",
    [
        *("estimate: what says nothing", "estimate: mirror image", "alpha_word: cap", "mean", "test"),
        *("test: fewest messages", "filter period"),
    ],
)
def test_what_both_do_wrong_is_caught_by_exact_arithmetic(fault: str) -> None:
    wrong = planted(fault)
    assert caught(judged(wrong, wrong)) is not None
