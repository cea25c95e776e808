"""Scenarios: they reach every outcome and the edge of the test, and are lines that read back."""

from __future__ import annotations

import re
import shlex

import pytest

from crosschecks import ROBOT, SEED
from golden import assert_equals_golden_file
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.compare import RobotUnderTest
from mcp_asdf_tools.crosscheck.oracle import Audit
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import Scenario, parse_scenario


def test_random_scenarios_bring_about_every_result_of_every_call() -> None:
    """What they reach beyond that, the planted faults show."""
    outcomes = set[str]()
    for index in range(100):
        scenario = random_scenario(SEED, index)
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        outcomes |= {f"{call.name} {robot.apply(call).outcome}" for call in scenario.calls}

    assert outcomes == {
        *("observe OK", "observe ERR_OBSERVATION", "step OK", "step UPDATED", "step ERR_OBSERVATION"),
        *("receive OK", "receive REPEATED", "receive ERR_SENDER", "receive ERR_X_HAT"),
        *("settle OK", "settle UPDATED", "restore OK", "restore ERR_IMAGE", "damage ERR_IMAGE"),
    }


@pytest.fixture(scope="module")
def audit_of_robust_scenarios() -> Audit:
    """The mirror's calls of 150 scenarios with the robust filter, all of which are right."""
    audit = Audit()
    for index in range(150):
        scenario = robust_scenario(SEED, index)
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        for call in scenario.calls:
            before = robot.last_result
            assert audit.check_call(scenario.setup, call, before, robot.apply(call)) == []
    return audit


# design: R38
@pytest.mark.slow
@pytest.mark.parametrize(
    "event", ["vote", "own vote", "too few", "accepted", "rejected", "returned", "supported"]
)
def test_robust_scenarios_bring_about_all_that_the_filter_does(
    audit_of_robust_scenarios: Audit, event: str
) -> None:
    """In 150 scenarios each event, from a vote to a rejection of b_hat, happens more than thirty times."""
    assert audit_of_robust_scenarios.robust[event] > 30


@pytest.mark.slow
def test_robust_scenarios_come_so_near_the_threshold_that_rounding_may_decide(
    audit_of_robust_scenarios: Audit,
) -> None:
    """So they come near it on both sides, by the same distances."""
    assert audit_of_robust_scenarios.robust["undecided"] > 10


def test_robust_scenarios_restore_legal_and_illegal_images_and_update_b_hat() -> None:
    outcomes = set[str]()
    for index in range(150):
        scenario = robust_scenario(SEED, index)
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        outcomes |= {f"{call.name} {robot.apply(call).outcome}" for call in scenario.calls}

    assert {"restore OK", "restore ERR_IMAGE", "settle UPDATED", "step UPDATED"} <= outcomes


SCENARIOS = [random_scenario(seed, index) for seed in (0, 1) for index in range(100)]
ROBUST_SCENARIOS = [robust_scenario(1, index) for index in range(100)]


@pytest.mark.parametrize("scenarios", [SCENARIOS, ROBUST_SCENARIOS], ids=["paper", "robust"])
def test_scenarios_of_other_seeds_and_indices_differ(scenarios: list[Scenario]) -> None:
    assert len(set(map(str, scenarios))) == len(scenarios)


@pytest.mark.parametrize("scenarios", [SCENARIOS, ROBUST_SCENARIOS], ids=["paper", "robust"])
def test_a_scenario_reads_back_from_its_line(scenarios: list[Scenario]) -> None:
    assert [parse_scenario(str(scenario)) for scenario in scenarios] == scenarios


def test_a_line_needs_no_quotes_in_a_shell() -> None:
    """The line of a scenario, which a report prints for a user to run again."""
    assert [shlex.quote(str(scenario)) for scenario in SCENARIOS] == list(map(str, SCENARIOS))


def test_robust_scenarios_are_of_robots_with_the_robust_filter() -> None:
    assert {scenario.setup.filter for scenario in ROBUST_SCENARIOS} == {Filter.ROBUST}


def test_the_scenarios_of_a_seed_stay_the_same() -> None:
    """The seed in a report repeats it later.

    If they change on purpose, write the golden vectors anew, too.
    """
    some_scenarios = [*SCENARIOS[::50], *ROBUST_SCENARIOS[::50]]
    assert_equals_golden_file("scenarios.txt", list(map(str, some_scenarios)))


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
def test_a_wrong_line_is_refused_with_the_reason(line: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=re.escape(complaint)):
        parse_scenario(line)
