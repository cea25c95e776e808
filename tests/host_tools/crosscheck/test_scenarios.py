"""Scenarios: they reach every outcome and the edge of the test, and are lines that read back."""

from __future__ import annotations

import hashlib
import random
import re
import shlex
from collections import Counter

import pytest

from crosschecks import ROBOT, SEED
from mcp_asdf.fixed_point import ONE
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter
from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.compare import RobotUnderTest
from mcp_asdf_tools.crosscheck.oracle import Audit
from mcp_asdf_tools.crosscheck.random_scenarios import (
    TABLES,
    random_scenario,
    robust_scenario,
    round_at_threshold,
)
from mcp_asdf_tools.crosscheck.scenario import TableChoice, parse_scenario


def test_scenarios_bring_about_every_status() -> None:
    """What they reach beyond that, the planted faults show."""
    found = set()
    for number in range(100):
        scenario = random_scenario(SEED, number)
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        found |= {f"{call.name} {robot.apply(call).outcome}" for call in scenario.calls}
    assert found == {
        *("observe OK", "observe ERR_OBSERVATION", "step OK", "step UPDATED", "step ERR_OBSERVATION"),
        *("receive OK", "receive REPEATED", "receive ERR_SENDER", "receive ERR_X_HAT"),
        *("settle OK", "settle UPDATED", "restore OK", "restore ERR_IMAGE", "damage ERR_IMAGE"),
    }


# design: R24
@pytest.mark.parametrize("choice", [TableChoice(*table) for table in TABLES], ids=str)
def test_rounds_come_near_the_threshold_on_both_sides(choice: TableChoice) -> None:
    source, table, sides = random.Random(5), choice.build(), Counter[bool]()
    for _ in range(400):
        m = source.randint(2, 127)
        x_hats, own = round_at_threshold(source, table, m)
        assert len(x_hats) == m
        assert all(0 <= x <= ONE for x in (*x_hats, own))
        left = (sum(x_hats) - m * own) ** 2 << FRACTION_BITS
        right = table.entry(m) * (m * sum(x * x for x in x_hats) - sum(x_hats) ** 2)
        if right and abs(left - right) * 2**24 < right:
            sides[left > right] += 1
    assert min(sides[False], sides[True]) > 20


# design: R38
def test_robust_scenarios_go_every_way_and_come_near_the_threshold_on_both_sides() -> None:
    """Within what rounding may decide, and so on both sides of the threshold by the same offsets."""
    audit, statuses = Audit(), set[str]()
    for number in range(150):
        scenario = robust_scenario(SEED, number)
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        for call in scenario.calls:
            before = robot.last_result
            assert audit.check_call(scenario.setup, call, before, robot.apply(call)) == []
            statuses.add(f"{call.name} {robot.last_result.outcome}")
    assert min(audit.robust[way] for way in WAYS) > 50 and audit.robust["undecided"] > 10
    assert {"restore OK", "restore ERR_IMAGE", "settle UPDATED", "step UPDATED"} <= statuses


WAYS = ("voted", "moving", "too few", "rejected", "returned", "kept")


def test_scenarios_differ_and_are_lines_that_read_back() -> None:
    scenarios = [random_scenario(seed, number) for seed in (0, 1) for number in range(100)]
    lines = [str(each) for each in scenarios]
    assert len(set(lines)) == len(lines)
    assert [parse_scenario(line) for line in lines] == scenarios
    assert all(shlex.quote(line) == line for line in lines), "a line needs no quotes"
    robust = [robust_scenario(1, number) for number in range(100)]
    digests = [hashlib.sha256("\n".join(map(str, each)).encode()).hexdigest()[:8] for each in (lines, robust)]
    assert digests == ["76bd364a", "5ac9a318"], "the pools have changed: golden vectors are made of them, too"
    assert [parse_scenario(str(each)) for each in robust] == robust
    assert len(set(map(str, robust))) == 100 and {each.setup.filter for each in robust} == {Filter.ROBUST}


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "starts with"),
        ("table:0.05,robot:0:1:64:0:1", "table:0.05 needs omega and q"),
        ("table:1.5:30,robot:0:1:64:0:1", "omega is 1.5"),
        ("table:0.05:2:5,robot:0:1:64:0:1", "table:0.05:2:5 needs omega and q"),
        ("robot:0:1:64:256:1", "256 is too large"),
        (f"{ROBOT},leave:1", "'leave:1' is no call"),
        (f"{ROBOT},observe:1:1", "takes 1"),
        (f"{ROBOT},observe:-1", "'-1' is no whole number"),
        (f"{ROBOT},observe:²", "'²' is no whole number"),
        (f"{ROBOT},observe:{'1' * 5000}", "is no whole number"),
        (f"{ROBOT},receive:1:4294967296:0", "4294967296 is too large"),
        (f"{ROBOT},restore:1", "pairs"),
        (f"{ROBOT},restore:0:1", "1 to 29"),
        (f"{ROBOT},restore:30:1", "1 to 29"),
        (f"{ROBOT},restore:1:4294967296", "32-bit"),
        (f"{ROBOT},damage:124:1", "124 is too large"),
    ],
)
def test_a_line_that_will_not_do_is_explained(line: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=re.escape(complaint)):
        parse_scenario(line)
