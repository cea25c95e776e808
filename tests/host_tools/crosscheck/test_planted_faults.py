"""A single wrong bit in the mirror or its table is found; what both firmwares do wrong, by the oracle."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import pytest

from crosschecks import FAULTS, caught, judged, planted
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.crosscheck.compare import Check, Firmware, shrink
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


class TamperedRobot(MirrorRobot):
    """A mirror whose table of q = 30 has the last bit wrong in its first entry."""

    @classmethod
    def tampered(cls, config: Config) -> Config:
        if config.table is None or config.table.q != 30:
            return config
        first, *others = config.table.entries
        return replace(config, table=replace(config.table, entries=(first ^ 1, *others)))

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(self.tampered(config), robot_id, b_hat)

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        return super().restore(cls.tampered(config), image)


def test_one_bit_of_a_table_entry_is_caught() -> None:
    failure = caught(judged(NativeRobot, cast(Firmware, TamperedRobot)))
    assert failure is not None
    table = failure.scenario.setup.table
    assert table is not None and table.q == 30
