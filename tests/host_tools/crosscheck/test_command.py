"""``mcp-asdf crosscheck``: what it prints of agreement, failures and interrupts."""

from __future__ import annotations

import json
import re
import shlex
from typing import cast

import pytest

from crosschecks import FAULTS, ROBOT, SEED, BrokenRobot, mirror_with
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Observation, Status
from mcp_asdf_tools.cli import crosscheck as command
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.crosscheck import oracle
from mcp_asdf_tools.crosscheck.compare import Firmware
from mcp_asdf_tools.crosscheck.operation_count import AXES, Counts
from mcp_asdf_tools.crosscheck.scenario import parse_scenario

COUNTS: Counts = {
    "x": {axis: {1: 58, 2: 58} for axis in AXES},
    "x, robust": {axis: {1: 9, 2: 9} for axis in ("t", "m")} | {"q": {}},
}
STORAGE = {"tables": {30: 132}, "images": {0: 124, 127: 124}}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take what counting gives for granted."""
    monkeypatch.setattr(command, "count_operations", lambda: COUNTS)
    monkeypatch.setattr(command, "measure_storage", lambda: STORAGE)


def use_mirror(monkeypatch: pytest.MonkeyPatch, mirror: Firmware) -> None:
    """Let the command load another mirror."""
    monkeypatch.setattr(command, "load_firmware", {"native": NativeRobot, "mirror": mirror}.__getitem__)


def main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["crosscheck", *arguments])
    return code, *capsys.readouterr()


def test_the_command_reports_everything(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = main(capsys, "--steps", "6000", "--json")
    report = json.loads(out)
    errors, tests, robust = (report.pop(name) for name in ("errors", "tests", "robust"))
    assert code == 0
    assert (report.pop("scenarios") > 10, tests > 20) == (True, True)
    assert robust.keys() >= {"voted", "moving", "too few", "rejected", "returned", "kept"}
    assert report == {
        **{"ok": True, "seed": SEED, "steps": 6000, "interrupted": False, "failure": None, "problems": []},
        **json.loads(json.dumps({"operations": COUNTS, "storage": STORAGE})),
    }
    assert {row["quantity"] for row in errors} == set(oracle.QUANTITIES)
    assert all(0 <= row["exact"] < 1e-3 > row["float64"] for row in errors)


def test_the_command_speaks_to_people(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = main(capsys, "--steps", "2000", "--seed", "4")
    assert (code, err) == (0, "")
    *lines, memory, robust, calls, verdict, again = out.splitlines()
    assert re.search(r"x_hat +0.999 to 1 +\d+ +[\d.e-]+ +[\d.e-]+\n", out)
    assert (lines[0], lines[2]) == ("", "              region  samples    exact  float64")
    assert lines[-5:] == [
        *("", "instructions of Python's interpreter per call, at most", "           over t  over m  over q"),
        *("x              58      58      58", "x, robust       9       9       -"),
    ]
    assert re.fullmatch(r"the robust filter: (\d+ [a-z ]+(, |$))+", robust)
    assert memory == "memory: 12 + 4 q bytes for a table, 124 for a saved robot"
    assert re.fullmatch(r"calls made and compared: 2000 in \d+ scenarios, seed 4", calls)
    assert verdict == "native and mirror agree in every bit"
    assert again == "again: mcp-asdf crosscheck --steps 2000 --seed 4"


def test_a_failure_is_printed_with_a_line_that_replays_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, mirror_with(FAULTS["halving: ties to even"]))
    code, out, _ = main(capsys, "--steps", "30000")
    *_, last = out.splitlines()
    assert code == 1
    assert last.startswith("replay: mcp-asdf crosscheck --replay ")
    replay = shlex.split(last)[3:]
    scenario = parse_scenario(replay[1])
    assert len(scenario.calls) == 2, "no fewer show it"
    code, again, _ = main(capsys, *replay)
    assert code == 1
    assert out.endswith(again), "the replay shows something else"
    code, report, _ = main(capsys, *replay, "--json")
    failure = json.loads(report)["failure"]
    assert code == 1
    assert (failure["replay"], failure["calls"]) == (replay[1], [str(call) for call in scenario.calls])
    assert failure["problems"][0].startswith("n: ")
    monkeypatch.undo()
    told = f"native and mirror agree in every bit over {len(scenario.calls)} calls\n"
    assert main(capsys, *replay) == (0, told, "")


def test_a_replay_tells_the_calls_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["--replay", f"{ROBOT},observe:1,settle,observe:9", "--json"]
    assert json.loads(main(capsys, *replay)[1]) == {"ok": True, "status": "OK", "calls": 3, "failure": None}
    refused = ["--replay", "robot:9:1:64:0:3221225472,observe:1,observe:1"]
    told = "native and mirror both refuse to make this robot (ERR_CONFIG); no call was made\n"
    assert main(capsys, *refused) == (0, told, "")
    report = json.loads(main(capsys, *refused, "--json")[1])
    assert report == {"ok": True, "status": "ERR_CONFIG", "calls": 0, "failure": None}
    use_mirror(monkeypatch, cast(Firmware, BrokenRobot))
    report = json.loads(main(capsys, *replay)[1])
    assert (report["ok"], report["status"], report["calls"]) == (False, "OK", 2)


@pytest.mark.parametrize(
    ("operations", "storage", "told"),
    [
        (
            {"x": {"m": {1: 9, 2: 10, 3: 11, 126: 10, 127: 10}}},
            STORAGE,
            "x: 11 instructions where m is 3 to 127, but 10 below",
        ),
        (
            {"x": {"t": {1: 4001, 2: 4001}}},
            STORAGE,
            "x: 4001 instructions where t is 2 to 2, but 4001 below",
        ),
        (COUNTS, STORAGE | {"tables": {2: 21}}, "a table with q = 2 takes 21 bytes"),
        (COUNTS, STORAGE | {"images": {0: 124, 1: 125}}, "robots take [124, 125] bytes"),
    ],
)
def test_a_claim_that_does_not_hold_fails_the_command(
    operations: Counts,
    storage: dict[str, dict[int, int]],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command, "count_operations", lambda: operations)
    monkeypatch.setattr(command, "measure_storage", lambda: storage)
    code, out, _ = main(capsys, "--steps", "1", "--seed", "0", "--json")
    assert (code, json.loads(out)["problems"]) == (1, [told])


class InterruptedRobot(MirrorRobot):
    """Ctrl-C comes while it works."""

    calls = 0

    def observe(self, z: Observation) -> Status:
        InterruptedRobot.calls += 1
        if InterruptedRobot.calls > 50:
            raise KeyboardInterrupt
        return super().observe(z)


def test_an_interrupt_reports_what_was_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, InterruptedRobot)
    code, out, _ = main(capsys, "--steps", "100000")
    assert code == 130
    assert re.search(r"compared: \d{1,3} in \d+ scenarios, seed 1, interrupted\n", out)


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
def test_bad_usage(arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = main(capsys, *arguments)
    assert (code, out) == (2, "")
    assert complaint in err
