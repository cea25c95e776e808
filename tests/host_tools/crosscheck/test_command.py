"""``mcp-asdf crosscheck``: its reports of agreement, failures and interrupts."""

from __future__ import annotations

import json
import re
import shlex
import signal
from typing import Any, cast

import pytest

from crosschecks import FAULTS, ROBOT, SEED, BrokenRobot, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Observation, Status
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.crosscheck import oracle
from mcp_asdf_tools.crosscheck.compare import Firmware
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts
from mcp_asdf_tools.crosscheck.scenario import Scenario, parse_scenario

COUNTS: Counts = {
    "x": {axis: {1: 58, 2: 58} for axis in AXES},
    "x, robust": {"t": {1: 9, 2: 9}, "m": {1: 9, 2: 9}, "q": {}},
}
STORAGE = {"tables": {30: 132}, "images": {0: 124, 127: 124}, "robust_images": {0: 156, 127: 156}}


@pytest.fixture(autouse=True)
def skip_counting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace counting, which takes seconds, by what it may return."""
    monkeypatch.setattr("mcp_asdf_tools.crosscheck.operation_count.count_operations", lambda: COUNTS)
    monkeypatch.setattr("mcp_asdf_tools.crosscheck.operation_count.measure_storage", lambda: STORAGE)


def use_mirror(monkeypatch: pytest.MonkeyPatch, mirror: Firmware) -> None:
    """Let the command load another mirror."""
    firmwares = {"native": NativeRobot, "mirror": mirror}
    monkeypatch.setattr("mcp_asdf_tools.robots.firmwares.load_firmware", firmwares.__getitem__)


def main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run the command, and return its exit code, output and errors."""
    code = cli.main(["crosscheck", *arguments])
    output = capsys.readouterr()
    return code, output.out, output.err


def json_report(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """Run the command with --json, and return its report."""
    _, output, _ = main(capsys, *arguments, "--json")
    report: dict[str, Any] = json.loads(output)
    return report


# --- The whole check -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_report_has_all_results(capsys: pytest.CaptureFixture[str]) -> None:
    report = json_report(capsys, "--steps", "6000")
    errors, tests, robust = report.pop("errors"), report.pop("tests"), report.pop("robust")

    assert report.pop("scenarios") > 10
    assert report == {
        "ok": True,
        "seed": SEED,
        "steps": 6000,
        "interrupted": False,
        "failure": None,
        "problems": [],
        "operations": json.loads(json.dumps(COUNTS)),
        "storage": json.loads(json.dumps(STORAGE)),
    }
    assert tests > 20
    assert robust.keys() >= {"vote", "own vote", "too few", "accepted", "rejected", "returned"}
    assert {row["quantity"] for row in errors} == set(oracle.QUANTITIES)
    assert all(row["exact"] < 1e-3 and row["float64"] < 1e-3 for row in errors)


def test_the_verdict_says_what_was_compared_and_how_to_repeat_it(capsys: pytest.CaptureFixture[str]) -> None:
    code, output, errors = main(capsys, "--steps", "2000", "--seed", "4")
    assert (code, errors) == (0, "")
    memory, robust, calls, verdict, repeat = output.splitlines()[-5:]
    expected_memory = "memory: 12 + 4 q bytes for a table, 124 for a saved robot, 156 with the robust filter"

    assert memory == expected_memory
    assert re.fullmatch(r"the robust filter: (\d+ [a-z ]+(, |$))+", robust)
    assert re.fullmatch(r"calls made and compared: 2000 in \d+ scenarios, seed 4", calls)
    assert verdict == "native and mirror agree in every bit"
    assert repeat == "again: mcp-asdf crosscheck --steps 2000 --seed 4"


def test_errors_and_instructions_are_shown_in_tables(capsys: pytest.CaptureFixture[str]) -> None:
    _, output, _ = main(capsys, "--steps", "2000", "--seed", "4")
    lines = output.splitlines()[:-5]

    assert (lines[0], lines[2]) == ("", "              region  samples    exact  float64")
    assert re.search(r"x_hat +0.999 to 1 +\d+ +[\d.e-]+ +[\d.e-]+\n", output)
    assert lines[-5:] == [
        "",
        "instructions of Python's interpreter per call, at most",
        "           over t  over m  over q",
        "x              58      58      58",
        "x, robust       9       9       -",
    ]


@pytest.mark.parametrize(
    ("operations", "storage", "problem"),
    [
        (
            {"x": {"m": {1: 9, 2: 10, 3: 11, 126: 10, 127: 10}}},
            STORAGE,
            "x: 11 instructions where m is 3 to 127, but 10 below",
        ),
        (
            {"x": {"t": {1: 20_001, 2: 20_001}}},
            STORAGE,
            "x: 20001 instructions where t is 2 to 2, but 20001 below",
        ),
        (COUNTS, STORAGE | {"tables": {2: 21}}, "a table with q = 2 takes 21 bytes"),
        (COUNTS, STORAGE | {"images": {0: 124, 1: 125}}, "robots take [124, 125] bytes"),
        (COUNTS, STORAGE | {"robust_images": {0: 156, 1: 157}}, "robots take [156, 157] bytes"),
    ],
)
def test_a_claim_about_time_or_memory_that_does_not_hold_fails_the_check(
    operations: Counts,
    storage: dict[str, dict[int, int]],
    problem: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In place of what is measured there are counts that grow with observations t, messages m or table q."""
    monkeypatch.setattr("mcp_asdf_tools.crosscheck.operation_count.count_operations", lambda: operations)
    monkeypatch.setattr("mcp_asdf_tools.crosscheck.operation_count.measure_storage", lambda: storage)
    code, output, _ = main(capsys, "--steps", "1", "--seed", "0", "--json")
    assert (code, json.loads(output)["problems"]) == (1, [problem])


class InterruptedRobot(MirrorRobot):
    """Is interrupted by Ctrl-C at its 51st observation."""

    observations = 0

    def observe(self, z: Observation) -> Status:
        InterruptedRobot.observations += 1
        if InterruptedRobot.observations > 50:
            raise KeyboardInterrupt
        return super().observe(z)


def test_an_interrupted_check_reports_what_was_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, InterruptedRobot)
    code, output, _ = main(capsys, "--steps", "100000")
    assert code == 128 + signal.SIGINT
    assert re.search(r"compared: \d{1,3} in \d+ scenarios, seed 1, interrupted\n", output)


# --- A failure and its replay ----------------------------------------------------------------------------


def failing_scenario(output: str) -> Scenario:
    """Return the scenario that the last line of the command's output replays."""
    *command, scenario = shlex.split(output.splitlines()[-1])
    assert command == ["replay:", "mcp-asdf", "crosscheck", "--replay"]
    return parse_scenario(scenario)


def test_a_failure_is_shown_by_the_fewest_calls_and_a_line_that_replays_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that rounds wrongly is to be shown by three calls, of some of the 30,000 made."""
    use_mirror(monkeypatch, mirror_with(FAULTS["halving: ties to even"]))

    code, output, _ = main(capsys, "--steps", "30000")

    assert code == 1
    assert [call.name for call in failing_scenario(output).calls] == ["restore", "observe", "observe"]


def test_the_line_that_replays_a_failure_shows_the_failure_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, mirror_with(FAULTS["halving: ties to even"]))
    _, output, _ = main(capsys, "--steps", "30000")
    scenario = failing_scenario(output)

    code, replay_output, _ = main(capsys, "--replay", str(scenario))

    assert code == 1
    assert output.endswith(replay_output)
    failure = json_report(capsys, "--replay", str(scenario))["failure"]
    assert failure["replay"] == str(scenario)
    assert failure["calls"] == [str(call) for call in scenario.calls]
    assert failure["problems"][0].startswith("n: ")  # the number of black tiles


def test_a_replay_without_a_difference_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    expected = "native and mirror agree in every bit over 3 calls\n"
    replay = f"{ROBOT},observe:1,settle,observe:9"
    assert main(capsys, "--replay", replay) == (0, expected, "")
    report = json_report(capsys, "--replay", replay)

    assert report == {"ok": True, "status": "OK", "calls": 3, "failure": None}


def test_a_replay_of_a_robot_that_both_refuse_makes_no_call(capsys: pytest.CaptureFixture[str]) -> None:
    replay = "robot:9:1:64:0:3221225472,observe:1,observe:1"
    expected = "native and mirror both refuse to make this robot (ERR_CONFIG); no call was made\n"
    assert main(capsys, "--replay", replay) == (0, expected, "")
    report = json_report(capsys, "--replay", replay)

    assert report == {"ok": True, "status": "ERR_CONFIG", "calls": 0, "failure": None}


def test_a_replay_with_a_difference_counts_the_calls_up_to_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, cast(Firmware, BrokenRobot))
    report = json_report(capsys, "--replay", f"{ROBOT},observe:1,settle,observe:9")
    assert not report["ok"]
    assert report["status"] == "OK"
    assert report["calls"] == 2  # the robot fails in the second, settle


# --- Bad usage -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--steps", "0"], "--steps is 0"),
        (["--seed", "-1"], "--seed is -1"),
        (["--replay", "nonsense"], "starts with"),
        (["--replay", ROBOT, "--steps", "5"], "--replay runs one scenario"),
        (["--replay", ROBOT, "--seed", "5"], "--replay runs one scenario"),
    ],
)
def test_a_wrong_option_is_refused(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, output, errors = main(capsys, *arguments)
    assert (code, output) == (2, "")
    assert complaint in errors
