"""A single wrong bit in the mirror, its constants or its table is found, also if the C has it, too."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import pytest

from crosschecks import FAULTS, caught, judged, planted
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config
from mcp_asdf_tools.crosscheck import exact
from mcp_asdf_tools.crosscheck import oracle as audit_module
from mcp_asdf_tools.crosscheck.compare import Check, Firmware, compare_firmwares, shrink
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, TableChoice, build_table, parse_scenario
from support import slow


def assert_minimal(scenario: Scenario, check: Check) -> None:
    """Nothing can be left out: no call, and no word that a restore replaces."""
    finding = check(scenario)
    assert finding is not None
    assert finding.calls == len(scenario.calls), "the finding is not at the end"
    for at, call in enumerate(scenario.calls):
        before, behind = scenario.calls[:at], scenario.calls[at + 1 :]
        assert check(scenario.with_calls(before + behind)) is None, f"{scenario} does not need {call}"
        for pair in range(0, len(call.numbers), 2) if call.name == "restore" else ():
            fewer = Call("restore", call.numbers[:pair] + call.numbers[pair + 2 :])
            calls = (*before, fewer, *behind)
            assert check(scenario.with_calls(calls)) is None, f"{scenario} does not need all of {call}"


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught_and_shown_by_a_minimal_scenario(fault: str) -> None:
    check = judged(NativeRobot, planted(fault))
    failing = caught(check)
    assert failing is not None
    least = shrink(failing, check)
    assert_minimal(least, check)
    assert check(parse_scenario(str(least))) == check(least)
    assert judged(NativeRobot, MirrorRobot)(least) is None, "it is not the fault that shows"


@pytest.mark.parametrize(
    "fault",
    [
        *("estimate: what says nothing", "estimate: mirror image", "alpha_word: cap", "sums", "mean"),
        *("received alpha: shift", "received alpha: nothing", "senders", "counters"),
        *("test: fewest messages", "halving: ties to even", "filter period"),
    ],
)
def test_what_both_do_wrong_is_caught_by_exact_arithmetic(fault: str) -> None:
    wrong = planted(fault)
    assert caught(lambda scenario: compare_firmwares(scenario, wrong, wrong), calls=2000) is None
    assert caught(judged(wrong, wrong)) is not None


class TamperedRobot(MirrorRobot):
    """A mirror whose table has one bit wrong in one entry, where it has the given q."""

    q, entry, bit = 30, 0, 0

    @classmethod
    def tampered(cls, config: Config) -> Config:
        if config.table is None or config.table.q != cls.q:
            return config
        entries = list(config.table.entries)
        entries[cls.entry] ^= 1 << cls.bit
        return replace(config, table=replace(config.table, entries=tuple(entries)))

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        super().__init__(self.tampered(config), robot_id, b_hat)

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        return super().restore(cls.tampered(config), image)


@pytest.mark.parametrize(
    ("q", "entry", "bit"), [(30, 0, 0), (127, 125, 2), *slow([(30, 28, 1), (30, 29, 0), (2, 0, 3)])]
)
def test_one_bit_of_a_table_entry_is_caught(q: int, entry: int, bit: int) -> None:
    robot = type("Robot", (TamperedRobot,), {"q": q, "entry": entry, "bit": bit})
    check = judged(NativeRobot, cast(Firmware, robot))
    failing = caught(check)
    assert failing is not None
    least = shrink(failing, check)
    assert_minimal(least, check)
    assert build_table(cast(TableChoice, least.setup.table)).q == q


def test_a_table_that_is_wrong_for_both_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(choice: TableChoice, m: int) -> int:
        return round(exact.true_threshold(choice, m) * (1 + 2.0**-20))

    assert caught(judged(MirrorRobot, MirrorRobot), calls=5000) is None
    monkeypatch.setattr(audit_module, "true_threshold", wrong)
    failing = caught(judged(MirrorRobot, MirrorRobot), calls=5000)
    assert failing is not None
    finding = judged(MirrorRobot, MirrorRobot)(failing)
    assert finding is not None
    assert "the true threshold" in finding.problems[0]
