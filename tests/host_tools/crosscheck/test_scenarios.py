"""Scenarios, which are a robot and its calls: they reach every outcome, and are lines that read back."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable

import pytest

from crosschecks import ROBOT_WITHOUT_FILTER, check_calls
from golden import assert_equals_golden_file
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Filter
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.audit import Audit
from mcp_asdf_tools.crosscheck.compare import RobotUnderTest
from mcp_asdf_tools.crosscheck.random_scenarios import random_scenario
from mcp_asdf_tools.crosscheck.robust_scenarios import robust_scenario
from mcp_asdf_tools.crosscheck.scenario import Scenario, parse_scenario


def outcomes_of(scenarios: Iterable[Scenario]) -> set[str]:
    """Make the calls of scenarios, and return each name of a call with its result, such as "step UPDATED"."""
    outcomes = set[str]()
    for scenario in scenarios:
        robot = RobotUnderTest(MirrorRobot, scenario.setup)
        outcomes |= {f"{call.name} {robot.apply(call).outcome}" for call in scenario.calls}
    return outcomes


def test_random_scenarios_bring_about_every_result_of_every_call() -> None:
    """An outcome is the name of a call and its result. 40 scenarios have all those below, and no others."""
    outcomes = outcomes_of(random_scenario(seed=1, index=index) for index in range(40))
    assert outcomes == {
        "observe OK",
        "observe ERR_OBSERVATION",
        "step OK",
        "step UPDATED",
        "step ERR_OBSERVATION",
        "receive OK",
        "receive REPEATED",
        "receive ERR_SENDER",
        "receive ERR_X_HAT",
        "settle OK",
        "settle UPDATED",
        "restore OK",
        "restore ERR_IMAGE",
        "damage ERR_IMAGE",
    }


@pytest.fixture(scope="module")
def audit_of_robust_scenarios() -> Audit:
    """The mirror's calls of 150 scenarios with the robust filter. All calls are right."""
    audit = Audit()
    for index in range(150):
        list(check_calls(robust_scenario(seed=1, index=index), audit))
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
    times_of_events = audit_of_robust_scenarios.events
    assert times_of_events[event] > 30


@pytest.mark.slow
def test_robust_scenarios_come_so_near_the_threshold_that_rounding_may_decide(
    audit_of_robust_scenarios: Audit,
) -> None:
    """Where rounding may decide, exact arithmetic leaves the test's result open: it is undecided.

    That happens more than ten times in 150 scenarios.
    """
    times_of_events = audit_of_robust_scenarios.events
    assert times_of_events["undecided"] > 10


def test_robust_scenarios_restore_legal_and_illegal_images_and_update_b_hat() -> None:
    """An image is a saved robot, and b_hat the accuracy that a robot assumes of its sensor.

    ERR_IMAGE is the result of an illegal image, and UPDATED that of a call that updates b_hat.
    """
    outcomes = outcomes_of(robust_scenario(seed=1, index=index) for index in range(20))
    assert {"restore OK", "restore ERR_IMAGE", "settle UPDATED", "step UPDATED"} <= outcomes


PAPER_SCENARIOS = [random_scenario(seed, index) for seed in (0, 1) for index in range(100)]
ROBUST_SCENARIOS = [robust_scenario(1, index) for index in range(100)]


@pytest.mark.parametrize("scenarios", [PAPER_SCENARIOS, ROBUST_SCENARIOS], ids=["paper", "robust"])
def test_scenarios_of_other_seeds_and_indices_differ(scenarios: list[Scenario]) -> None:
    """There are a hundred indices for each seed: two seeds with the paper's filters, one with the robust one.

    Two scenarios would be equal if their lines were.
    """
    different_lines = {str(scenario) for scenario in scenarios}
    assert len(different_lines) == len(scenarios)


@pytest.mark.parametrize("scenarios", [PAPER_SCENARIOS, ROBUST_SCENARIOS], ids=["paper", "robust"])
def test_the_line_of_a_scenario_is_parsed_as_the_same_scenario(scenarios: list[Scenario]) -> None:
    """Every fourth of the 200 scenarios of the paper's filters is written as a line, as a report prints it.

    So is every fourth of the 100 scenarios of the robust filter.
    """
    for scenario in scenarios[::4]:
        line = str(scenario)
        assert parse_scenario(line) == scenario


def test_the_line_of_a_scenario_needs_no_quotes_in_a_shell() -> None:
    """A report prints it for a user to run again. 300 scenarios of both kinds of filters are written so."""
    for scenario in [*PAPER_SCENARIOS, *ROBUST_SCENARIOS]:
        line = str(scenario)
        assert shlex.quote(line) == line


def test_robust_scenarios_are_of_robots_with_the_robust_filter() -> None:
    """A hundred scenarios are drawn. The first part of each is the setup of its robot."""
    for scenario in ROBUST_SCENARIOS:
        assert scenario.setup.filter == Filter.ROBUST


def test_the_scenarios_of_a_seed_stay_the_same() -> None:
    """So the seed in a report repeats it later. The golden file has scenarios of an earlier version.

    If they change on purpose, write the golden vectors anew, too.
    """
    some_scenarios = [*PAPER_SCENARIOS[::50], *ROBUST_SCENARIOS[::50]]
    lines = [str(scenario) for scenario in some_scenarios]
    assert_equals_golden_file("scenarios.txt", lines)


@pytest.mark.parametrize(
    ("line", "expected_message"),
    [
        ("", "starts with"),
        ("table:0.05,robot:0:1:64:0:1", "table:0.05 needs omega and q"),
        ("table:1.5:30,robot:0:1:64:0:1", "omega is 1.5"),
        ("table:0.05:2:5,robot:0:1:64:0:1", "table:0.05:2:5 needs omega and q"),
        ("robot:0:1:64:256:1", "256 is too large"),
        (f"{ROBOT_WITHOUT_FILTER},leave:1", "'leave:1' is no call"),
        (f"{ROBOT_WITHOUT_FILTER},observe:1:1", "takes 1"),
        (f"{ROBOT_WITHOUT_FILTER},observe:-1", "'-1' is no whole number"),
        (f"{ROBOT_WITHOUT_FILTER},observe:²", "'²' is no whole number"),
        (f"{ROBOT_WITHOUT_FILTER},observe:{'1' * 5000}", "is no whole number"),
        (f"{ROBOT_WITHOUT_FILTER},receive:1:4294967296:0", "4294967296 is too large"),
        (f"{ROBOT_WITHOUT_FILTER},restore:2:5", "the image has no '2'; it has b_hat, t, n,"),
        (f"{ROBOT_WITHOUT_FILTER},restore:version=1", "the image has no 'version'"),
        (f"{ROBOT_WITHOUT_FILTER},restore:checksum=1", "the image has no 'checksum'"),
        (f"{ROBOT_WITHOUT_FILTER},restore:robust_turn=1", "the image has no 'robust_turn'"),
        (f"{ROBOT_WITHOUT_FILTER},restore:t", "'' is no whole number"),
        (f"{ROBOT_WITHOUT_FILTER},restore:t=4294967296", "4294967296 is too large; the limit there is"),
        (f"{ROBOT_WITHOUT_FILTER},restore:updated=256", "256 is too large; the limit there is 255"),
        (f"{ROBOT_WITHOUT_FILTER},damage:124:1", "124 is too large"),
    ],
)
def test_a_wrong_line_of_a_scenario_is_refused_with_the_reason(line: str, expected_message: str) -> None:
    """A line has a table, if there is one, a robot, and its calls, such as "robot:2:1:64:0:1,observe:1"."""
    with pytest.raises(UsageError, match=re.escape(expected_message)):
        parse_scenario(line)
