"""``mcp-asdf crosscheck``: what it prints of agreement, failures and interrupts."""

from __future__ import annotations

import json
import re
import shlex
from functools import cache
from typing import cast

import pytest

from crosschecks import ROBOT, SEED, BrokenRobot, planted
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Observation, Status
from mcp_asdf_tools.cli import crosscheck as command
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.crosscheck import oracle as audit_module
from mcp_asdf_tools.crosscheck.compare import Check, Firmware
from mcp_asdf_tools.crosscheck.operation_count import Counts, measure_storage
from mcp_asdf_tools.crosscheck.scenario import Scenario, parse_scenario


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, operations: Counts) -> None:
    """Count operations and bytes once for all tests."""
    monkeypatch.setattr(command, "count_operations", lambda: operations)
    monkeypatch.setattr(command, "measure_storage", cache(measure_storage))


def use_mirror(monkeypatch: pytest.MonkeyPatch, mirror: Firmware) -> None:
    """Let the command load another mirror."""
    monkeypatch.setattr(command, "load_firmware", {"native": NativeRobot, "mirror": mirror}.__getitem__)


def main(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["crosscheck", *arguments])
    return code, *capsys.readouterr()


def test_the_command_reports_everything(quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = main(capsys, "--steps", "3000", "--json")
    report = json.loads(out)
    assert code == 0
    assert (report["ok"], report["steps"], report["seed"], report["failure"]) == (True, 3000, SEED, None)
    assert {row["quantity"] for row in report["errors"]} == set(audit_module.QUANTITIES)
    assert all(row["exact"]["p99.9"] <= row["exact"]["max"] for row in report["errors"])
    assert report["decisions"]["m <= q"]["tests"] > 20
    assert report["operations"]["x"]["t"]["1"] > 10
    assert report["storage"]["images"] == [124]


def test_the_command_speaks_to_people(quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = main(capsys, "--steps", "2000", "--seed", "4")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    *_, calls, verdict, again = lines
    assert re.fullmatch(r"calls made and compared: 2000 in \d+ scenarios, seed 4", calls)
    assert verdict == "native and mirror agree in every bit"
    assert again == "again: mcp-asdf crosscheck --steps 2000 --seed 4"
    assert max(map(len, lines)) <= 100
    assert "…" not in out


def test_a_failure_is_printed_with_a_line_that_replays_it(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, planted("halving: ties to even"))
    code, out, _ = main(capsys, "--steps", "30000")
    *_, last = out.splitlines()
    assert code == 1
    assert last.startswith("replay: mcp-asdf crosscheck --replay ")
    replay = shlex.split(last)[3:]
    code, again, _ = main(capsys, *replay)
    assert code == 1
    assert out.endswith(again), "the replay shows something else"
    code, report, _ = main(capsys, *replay, "--json")
    assert code == 1
    assert json.loads(report)["failure"]["replay"] == replay[1]
    calls = parse_scenario(replay[1]).calls
    monkeypatch.undo()
    code, out, _ = main(capsys, *replay)
    assert (code, out) == (0, f"native and mirror agree in every bit over {len(calls)} calls\n")


@pytest.mark.parametrize(
    ("item", "status"),
    [
        ("robot:9:1:64:0:3221225472", "ERR_CONFIG"),
        ("robot:2:1:66:0:3221225472", "ERR_CONFIG"),
        ("robot:2:1:64:128:3221225472", "ERR_ID"),
        ("robot:2:1:64:0:0", "ERR_B_HAT"),
        ("robot:0:1:64:0:3221225472", "ERR_TABLE"),
        ("table:0.05:30:1:0,robot:0:1:64:0:3221225472", "ERR_TABLE"),
    ],
)
def test_a_replay_does_not_claim_calls_of_a_robot_that_is_refused(
    item: str, status: str, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["--replay", f"{item},observe:1,observe:1,observe:1"]
    told = f"native and mirror both refuse to make this robot ({status}); no call was made\n"
    assert main(capsys, *replay) == (0, told, "")
    report = json.loads(main(capsys, *replay, "--json")[1])
    assert report == {"ok": True, "status": status, "calls": 0, "failure": None}


def test_a_replay_tells_the_calls_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["--replay", f"{ROBOT},observe:1,settle,observe:9", "--json"]
    assert json.loads(main(capsys, *replay)[1]) == {"ok": True, "status": "OK", "calls": 3, "failure": None}
    use_mirror(monkeypatch, cast(Firmware, BrokenRobot))
    report = json.loads(main(capsys, *replay)[1])
    assert (report["ok"], report["status"], report["calls"]) == (False, "OK", 2)


def test_a_failure_as_json(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, planted("counters"))
    code, out, _ = main(capsys, "--steps", "30000", "--json")
    report = json.loads(out)
    assert (code, report["ok"]) == (1, False)
    assert report["failure"]["problems"]
    assert parse_scenario(report["failure"]["replay"])


def test_a_claim_that_does_not_hold_fails_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], operations: Counts
) -> None:
    slow = operations | {"x": {**operations["x"], "m": {1: 10, 127: 1000}}}
    monkeypatch.setattr(command, "count_operations", lambda: slow)
    code, out, _ = main(capsys, "--steps", "10")
    assert code == 1
    assert "FAILED: x: 1000 instructions" in out


class InterruptedRobot(MirrorRobot):
    """Ctrl-C comes while it works."""

    calls = 0

    def observe(self, z: Observation) -> Status:
        InterruptedRobot.calls += 1
        if InterruptedRobot.calls > 50:
            raise KeyboardInterrupt
        return super().observe(z)


def test_an_interrupt_reports_what_was_done(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use_mirror(monkeypatch, InterruptedRobot)
    InterruptedRobot.calls = 0
    code, out, _ = main(capsys, "--steps", "100000", "--json")
    report = json.loads(out)
    assert code == 130
    assert report["interrupted"]
    assert 0 < report["steps"] < 1000
    InterruptedRobot.calls = 0
    code, out, _ = main(capsys, "--steps", "100000")
    assert code == 130
    assert ", interrupted\n" in out


def test_an_interrupt_while_shrinking_still_prints_a_replay(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(scenario: Scenario, check: Check) -> Scenario:
        raise KeyboardInterrupt

    use_mirror(monkeypatch, planted("counters"))
    monkeypatch.setattr(command, "shrink", interrupted)
    code, out, err = main(capsys, "--steps", "30000")
    assert code == 1
    assert "interrupted" in err
    code, again, _ = main(capsys, *shlex.split(out.splitlines()[-1])[3:])
    assert code == 1
    assert out.endswith(again)


@pytest.mark.slow
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
