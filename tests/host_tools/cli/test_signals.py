"""A signal ends every command in a process of its own, whenever it comes; nothing that is done is lost."""

from __future__ import annotations

import random
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from multicast import multicast
from support import PATIENCE, interruptible, slow

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")


@dataclass(frozen=True)
class Command:
    """A command that goes on until it is asked to end.

    Attributes:
        words: Its options.
        code: Exit code once it is at work; before, and if None, it is 128 + signal.
        keeps: File that it keeps, of which a part is there while it runs.
    """

    words: str
    code: int | None = None
    keeps: str | None = None


COMMANDS = {
    "swarm": Command("swarm --robots 4 --steps 100000000 --quiet --log run.log", keeps="run.log"),
    "processes": Command(
        "swarm --robots 2 --steps 100000000 --quiet --processes --log run.log", keeps="run.log"
    ),
    "node": Command("node --id 3", 0),
    "radio": Command("radio --id 3 --robots 4 --log run.log", 0, "run.log"),
    "verdict": Command("radio --id 3 --verify --wait 1000 --json"),
    "simulate": Command("simulate --trials 1000000"),
    "crosscheck": Command("crosscheck --steps 100000000"),
    "reproduce": Command("reproduce --output study"),
}
"""``sweep`` has a test of its own, since it keeps finished trials."""
CASES = [(name, number) for name in COMMANDS for number in (signal.SIGTERM, signal.SIGHUP)]
QUICK = [("swarm", signal.SIGTERM), ("node", signal.SIGHUP)]


@pytest.mark.parametrize(("name", "number"), [*QUICK, *slow(case for case in CASES if case not in QUICK)])
@interruptible()
def test_a_signal_ends_a_process_and_loses_nothing(
    name: str, number: signal.Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = COMMANDS[name]
    words = shlex.split(command.words) + (multicast(31).arguments() if name == "processes" else [])
    part = tmp_path / f"{command.keeps}.part"
    with subprocess.Popen(
        [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        wait_until(running, lambda: heeds(running.pid, number))
        if command.keeps is not None:
            wait_until(running, lambda: part.exists() and part.stat().st_size > 0)
        time.sleep(random.uniform(0, 0.5))
        running.send_signal(number)
        _, errors = running.communicate(timeout=PATIENCE)
    is_at_work = command.keeps is not None and command.code is not None
    assert running.returncode in ({command.code} if is_at_work else {command.code, 128 + number}), errors
    assert "Traceback" not in errors
    assert not part.exists()
    if command.keeps is not None:
        assert (tmp_path / command.keeps).stat().st_size > 0
    if (tmp_path / "run.log.events").exists():
        assert main(["replay", str(tmp_path / "run.log")]) == 0
        assert "reproduced" in capsys.readouterr().out


def wait_until(process: subprocess.Popen[str], holds: Callable[[], bool]) -> None:
    """Return when something holds. Fails if the process ends before."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert process.poll() is None, process.communicate()
        if time.monotonic() > deadline:
            process.kill()
        time.sleep(0.02)


def heeds(process: int, number: signal.Signals) -> bool:
    """True if a process handles a signal by now."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    (caught,) = (int(line.split()[1], 16) for line in lines if line.startswith("SigCgt"))
    return bool(caught >> (number - 1) & 1)
