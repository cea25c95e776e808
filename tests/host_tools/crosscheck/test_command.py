"""``mcp-asdf crosscheck``: its reports of agreement, failures and interrupts."""

from __future__ import annotations

import json
import re
import shlex
import signal
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any, NamedTuple, cast

import pytest

from crosschecks import FAULTS, ROBOT_WITHOUT_FILTER, BrokenRobot, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Observation, Status
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.crosscheck.compare import Firmware
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts
from mcp_asdf_tools.crosscheck.scenario import Scenario, parse_scenario

COUNTS_THAT_DO_NOT_GROW: Counts = {
    "x": {axis: {1: 58, 2: 58} for axis in AXES},
    "x, robust": {"t": {1: 9, 2: 9}, "m": {1: 9, 2: 9}, "q": {}},
}
"""Instructions by call, by axis (observations t, messages m, entries q of the table) and by value there."""
BYTES_THAT_DO_NOT_GROW = {
    "tables": {30: 132},
    "images": {0: 124, 127: 124},
    "robust_images": {0: 156, 127: 156},
}
"""Bytes of a table by its number of entries, and of a saved robot (an image) by its number of messages."""
COUNTING_MODULE = "mcp_asdf_tools.crosscheck.operation_count"
"""Module that counts instructions and bytes for the command, which takes seconds."""


@pytest.fixture(scope="module", autouse=True)
def skip_counting() -> Iterator[None]:
    """Counting takes seconds. Replace it by a possible result."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(f"{COUNTING_MODULE}.count_operations", lambda: COUNTS_THAT_DO_NOT_GROW)
        monkeypatch.setattr(f"{COUNTING_MODULE}.measure_storage", lambda: BYTES_THAT_DO_NOT_GROW)
        yield


def use_mirror(monkeypatch: pytest.MonkeyPatch, mirror: Firmware) -> None:
    """Let the command compare the C with this firmware in place of the Python one, the mirror."""
    firmwares = {"native": NativeRobot, "mirror": mirror}
    monkeypatch.setattr("mcp_asdf_tools.robots.firmwares.load_firmware", firmwares.__getitem__)


class CommandResult(NamedTuple):
    """How a command has ended, and what it has printed."""

    exit_code: int
    output: str
    errors: str


def run_crosscheck_command(*arguments: str) -> CommandResult:
    """Run ``mcp-asdf crosscheck``, which compares the robots in C and in Python call by call."""
    with redirect_stdout(StringIO()) as output, redirect_stderr(StringIO()) as errors:
        exit_code = cli.main(["crosscheck", *arguments])
    return CommandResult(exit_code, output.getvalue(), errors.getvalue())


def json_report(*arguments: str) -> dict[str, Any]:
    """Run the command with --json, and return its report."""
    report: dict[str, Any] = json.loads(run_crosscheck_command(*arguments, "--json").output)
    return report


# --- The whole check -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def report_of_6000_calls() -> dict[str, Any]:
    """The report in JSON of a check of 6000 calls, which finds no difference."""
    return json_report("--steps", "6000")


@pytest.mark.slow
def test_the_json_report_of_a_check_without_a_difference_says_ok_and_has_no_problems(
    report_of_6000_calls: dict[str, Any],
) -> None:
    """6000 random calls of the robots in C and in Python, drawn with the default seed, 1, gave the same."""
    report = report_of_6000_calls
    assert report["ok"] is True
    assert report["problems"] == []
    assert report["failure"] is None
    assert report["interrupted"] is False
    assert report["seed"] == 1
    assert report["steps"] == 6000


def as_read_from_json(values: dict[str, Any]) -> Any:
    """Return the values after a way through JSON, where keys that are numbers become texts."""
    return json.loads(json.dumps(values))


@pytest.mark.slow
def test_the_json_report_has_the_measured_instructions_and_bytes(
    report_of_6000_calls: dict[str, Any],
) -> None:
    """Two constants of the tests stand in for what is measured, which takes seconds."""
    assert report_of_6000_calls["operations"] == as_read_from_json(COUNTS_THAT_DO_NOT_GROW)
    assert report_of_6000_calls["storage"] == as_read_from_json(BYTES_THAT_DO_NOT_GROW)


@pytest.mark.slow
def test_the_json_report_counts_scenarios_tests_and_events_of_the_robust_filter(
    report_of_6000_calls: dict[str, Any],
) -> None:
    """A scenario is a robot and its calls; a vote, for one, is an estimate that the filter has weighed.

    With the default seed, 6000 calls are of 59 scenarios, and a filter makes 126 tests in them. The limits
    are far below, so that other scenarios do not break this test.
    """
    events = {"vote", "own vote", "too few", "accepted", "rejected", "returned"}
    assert report_of_6000_calls["scenarios"] > 10
    assert report_of_6000_calls["tests"] > 20
    assert report_of_6000_calls["robust"].keys() >= events


@pytest.mark.slow
def test_the_json_report_has_errors_below_a_thousandth_for_every_quantity(
    report_of_6000_calls: dict[str, Any],
) -> None:
    """The errors are against exact arithmetic and 64-bit floats. Rounding leads to less than 2**-17."""
    rows_of_errors = report_of_6000_calls["errors"]
    assert {row["quantity"] for row in rows_of_errors} == {"x_hat", "alpha", "b_hat"}
    for row in rows_of_errors:
        assert row["exact"] < 1 / 1000
        assert row["float64"] < 1 / 1000


@pytest.fixture(scope="module")
def check_of_500_calls() -> CommandResult:
    """The result of a check of 500 calls with seed 3, which finds no difference."""
    return run_crosscheck_command("--steps", "500", "--seed", "3")


def test_a_check_without_a_difference_ends_with_the_verdict_and_how_to_repeat_it(
    check_of_500_calls: CommandResult,
) -> None:
    """The check is ``mcp-asdf crosscheck --steps 500 --seed 3``; native is the robot in C."""
    assert check_of_500_calls.exit_code == 0
    assert check_of_500_calls.errors == ""
    *_, calls_line, verdict, repeat = check_of_500_calls.output.splitlines()
    assert re.fullmatch(r"calls made and compared: 500 in \d+ scenarios, seed 3", calls_line)
    assert verdict == "native and mirror agree in every bit"
    assert repeat == "again: mcp-asdf crosscheck --steps 500 --seed 3"


def test_a_check_prints_the_bytes_that_tables_and_saved_robots_take(
    check_of_500_calls: CommandResult,
) -> None:
    """The tests replace the measured bytes. A table of q = 30 entries takes 132: 12, and 4 for each entry."""
    expected = "memory: 12 + 4 q bytes for a table, 124 for a saved robot, 156 with the robust filter"
    assert expected in check_of_500_calls.output.splitlines()


def test_a_check_prints_how_often_each_event_of_the_robust_filter_happened(
    check_of_500_calls: CommandResult,
) -> None:
    """The line is such as "the robust filter: 17 vote, 4 own vote"."""
    number_and_event = r"\d+ [a-z ]+"
    line = rf"^the robust filter: ({number_and_event}, )*{number_and_event}$"
    assert re.search(line, check_of_500_calls.output, re.MULTILINE)


def test_a_check_prints_a_table_of_errors_by_the_size_of_the_value(check_of_500_calls: CommandResult) -> None:
    """A region is a range of values: here one of x_hat, the estimate of a robot."""
    number_of_samples, error = r"\d+", r"[\d.e-]+"
    assert "              region  samples    exact  float64\n" in check_of_500_calls.output
    row = rf"x_hat +0.999 to 1 +{number_of_samples} +{error} +{error}\n"
    assert re.search(row, check_of_500_calls.output)


def test_a_check_prints_a_table_of_the_most_instructions_of_each_call(
    check_of_500_calls: CommandResult,
) -> None:
    """The tests replace the counts: reading x takes 58, or 9 with the robust filter, which has no table."""
    table = (
        "\n"
        "instructions of Python's interpreter per call, at most\n"
        "           over t  over m  over q\n"
        "x              58      58      58\n"
        "x, robust       9       9       -\n"
    )
    assert table in check_of_500_calls.output


@pytest.mark.parametrize(
    ("counts", "bytes_by_size", "expected_problem"),
    [
        (
            {"x": {"m": {1: 9, 2: 10, 3: 11, 126: 10, 127: 10}}},
            BYTES_THAT_DO_NOT_GROW,
            "x: 11 instructions where m is 3 to 127, but 10 below",
        ),
        (
            {"x": {"t": {1: 20_001, 2: 20_001}}},
            BYTES_THAT_DO_NOT_GROW,
            "x: 20001 instructions where t is 2 to 2, but 20001 below",
        ),
        (
            COUNTS_THAT_DO_NOT_GROW,
            BYTES_THAT_DO_NOT_GROW | {"tables": {2: 21}},
            "a table with q = 2 takes 21 bytes",
        ),
        (
            COUNTS_THAT_DO_NOT_GROW,
            BYTES_THAT_DO_NOT_GROW | {"images": {0: 124, 1: 125}},
            "robots take [124, 125] bytes",
        ),
        (
            COUNTS_THAT_DO_NOT_GROW,
            BYTES_THAT_DO_NOT_GROW | {"robust_images": {0: 156, 1: 157}},
            "robots take [156, 157] bytes",
        ),
    ],
)
def test_a_claim_about_time_or_memory_that_does_not_hold_fails_the_check(
    counts: Counts,
    bytes_by_size: dict[str, dict[int, int]],
    expected_problem: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither time nor memory of a robot may grow with its observations t, messages m or the table's size q.

    The counts of instructions and bytes, which the command would measure, are replaced by some that grow. The
    command prints the problem and ends with exit code 1; one call of a robot (--steps 1) is enough for that.
    """
    monkeypatch.setattr(f"{COUNTING_MODULE}.count_operations", lambda: counts)
    monkeypatch.setattr(f"{COUNTING_MODULE}.measure_storage", lambda: bytes_by_size)
    result = run_crosscheck_command("--steps", "1", "--json")
    assert result.exit_code == 1
    assert json.loads(result.output)["problems"] == [expected_problem]


class InterruptedRobot(MirrorRobot):
    """Is interrupted by Ctrl-C at the 51st observation of all such robots together."""

    observations = 0

    def observe(self, z: Observation) -> Status:
        InterruptedRobot.observations += 1
        if InterruptedRobot.observations > 50:
            raise KeyboardInterrupt
        return super().observe(z)


def test_a_check_that_ctrl_c_interrupts_reports_the_calls_that_it_has_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ctrl-C comes at the 51st observation. The line with the number of calls ends with "interrupted"."""
    use_mirror(monkeypatch, InterruptedRobot)
    result = run_crosscheck_command("--steps", "100000")
    assert result.exit_code == 128 + signal.SIGINT
    fewer_than_1000 = r"\d{1,3}"  # of the 100,000 calls that were asked for
    assert re.search(rf"compared: {fewer_than_1000} in \d+ scenarios, seed 1, interrupted\n", result.output)


# --- A failure and its replay ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def failed_check() -> Iterator[CommandResult]:
    """A check of up to 30,000 calls of a mirror that rounds wrongly when it halves its counts.

    That mirror is still in place afterwards, so that a test can replay the failure.
    """
    with pytest.MonkeyPatch.context() as monkeypatch:
        use_mirror(monkeypatch, mirror_with(FAULTS["halving: ties to even"]))
        yield run_crosscheck_command("--steps", "30000")


def parse_failing_scenario(output: str) -> Scenario:
    """Return the scenario in the last line of an output, "replay: mcp-asdf crosscheck --replay robot:..."."""
    *command, scenario = shlex.split(output.splitlines()[-1])
    assert command == ["replay:", "mcp-asdf", "crosscheck", "--replay"]
    return parse_scenario(scenario)


def test_a_failure_is_shown_by_the_fewest_calls_that_lead_to_it(failed_check: CommandResult) -> None:
    """A robot that rounds wrongly as it halves its counts needs two of the thousands of calls made.

    They are in the last line of the output, which has the command that makes them again.
    """
    scenario = parse_failing_scenario(failed_check.output)
    assert failed_check.exit_code == 1
    assert [call.name for call in scenario.calls] == ["restore", "step"]


def test_the_command_in_the_last_line_of_a_failed_check_prints_the_failure_again(
    failed_check: CommandResult,
) -> None:
    """The last line is "replay: mcp-asdf crosscheck --replay robot:...", and the failure stands above it."""
    last_line = failed_check.output.splitlines()[-1]
    options = last_line.removeprefix("replay: mcp-asdf crosscheck ")
    replayed = run_crosscheck_command(*shlex.split(options))
    assert replayed.exit_code == 1
    assert failed_check.output.endswith(replayed.output)


def test_a_replay_in_json_has_the_calls_and_the_problem_of_the_failure(failed_check: CommandResult) -> None:
    """The first problem is in n, the number of black tiles, which the robot halves and rounds wrongly."""
    scenario = parse_failing_scenario(failed_check.output)
    failure = json_report("--replay", str(scenario))["failure"]
    assert failure["replay"] == str(scenario)
    assert failure["calls"] == [str(call) for call in scenario.calls]
    first_problem, *_others = failure["problems"]
    assert first_problem.startswith("n: ")


def test_a_replay_without_a_difference_says_that_both_robots_agree() -> None:
    """Both refuse the last of three calls, and return the same status. It observes the colour 9.

    Only 1, black, and 0, white, are colours.
    """
    result = run_crosscheck_command("--replay", f"{ROBOT_WITHOUT_FILTER},observe:1,settle,observe:9")
    expected = "native and mirror agree in every bit over 3 calls\n"
    assert result == CommandResult(exit_code=0, output=expected, errors="")


def test_a_replay_without_a_difference_has_no_failure_in_its_json() -> None:
    """Both robots refuse the last of three calls, an observation of 9, and return the same status.

    The reported status, OK, is that of making the robots.
    """
    report = json_report("--replay", f"{ROBOT_WITHOUT_FILTER},observe:1,settle,observe:9")
    assert report == {"ok": True, "status": "OK", "calls": 3, "failure": None}


ROBOT_WITH_UNKNOWN_FILTER = "robot:9:1:64:0:3221225472"
"""Filters have the numbers 0 to 3, so no robot has filter 9."""


def test_a_replay_of_a_robot_that_both_firmwares_refuse_makes_no_call() -> None:
    """There is no robot with filter 9. Firmwares that both refuse it agree, so the exit code is 0."""
    result = run_crosscheck_command("--replay", f"{ROBOT_WITH_UNKNOWN_FILTER},observe:1,observe:1")
    expected = "native and mirror both refuse to make this robot (ERR_CONFIG); no call was made\n"
    assert result == CommandResult(exit_code=0, output=expected, errors="")


def test_a_replay_of_a_robot_that_both_firmwares_refuse_has_their_status_in_its_json() -> None:
    """There is no robot with filter 9. Firmwares that both refuse it agree, so the report says ok.

    ``status`` is their common refusal.
    """
    report = json_report("--replay", f"{ROBOT_WITH_UNKNOWN_FILTER},observe:1,observe:1")
    assert report == {"ok": True, "status": "ERR_CONFIG", "calls": 0, "failure": None}


def test_a_replay_with_a_difference_counts_the_calls_up_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """BrokenRobot raises an exception in ``settle``, the second of three calls."""
    use_mirror(monkeypatch, cast(Firmware, BrokenRobot))
    report = json_report("--replay", f"{ROBOT_WITHOUT_FILTER},observe:1,settle,observe:1")
    assert not report["ok"]
    assert report["status"] == "OK", "the status of making the robot, before any call"
    assert report["calls"] == 2


# --- Bad usage -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "expected_message"),
    [
        (["--steps", "0"], "--steps is 0"),
        (["--seed", "-1"], "--seed is -1"),
        (["--replay", "nonsense"], "starts with"),
        (["--replay", ROBOT_WITHOUT_FILTER, "--steps", "5"], "--replay runs one scenario"),
        (["--replay", ROBOT_WITHOUT_FILTER, "--seed", "5"], "--replay runs one scenario"),
    ],
)
def test_a_wrong_option_is_refused_with_exit_code_2_and_the_reason(
    arguments: list[str], expected_message: str
) -> None:
    """The error names the option, and nothing else is printed: no check was made."""
    result = run_crosscheck_command(*arguments)
    assert result.exit_code == 2
    assert result.output == ""
    assert expected_message in result.errors
