"""A signal ends every command in a process of its own, whenever it comes; nothing that is done is lost."""

from __future__ import annotations

import random
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mcp_asdf_tools.cli.main import main
from multicast import multicast
from support import PATIENCE, interruptible, slow

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")

KILLED, HUNG_UP = signal.SIGTERM, signal.SIGHUP
LOG = "--log run.log"
CASES = [
    (f"swarm --robots 4 --steps 100000000 --quiet {LOG}", KILLED, None),
    ("node --id 3", HUNG_UP, 0),
    *slow(
        [
            (f"swarm --robots 2 --steps 100000000 --quiet --processes {LOG}", HUNG_UP, None),
            (f"radio --id 3 --robots 4 {LOG}", KILLED, 0),
            ("radio --id 3 --verify --wait 1000 --json", HUNG_UP, None),
            ("simulate --trials 1000000", KILLED, None),
            ("crosscheck --steps 100000000", HUNG_UP, None),
            ("reproduce --output study", KILLED, None),
        ]
    ),
]
"""A command that goes on until it is asked to end, and its exit code once it is at work; before, and if None,
it is 128 + signal. ``sweep`` has a test of its own, since it keeps finished trials."""


@pytest.mark.parametrize(("line", "number", "code"), CASES)
@interruptible()
def test_a_signal_ends_a_process_and_loses_nothing(
    line: str, number: signal.Signals, code: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = shlex.split(line) + (multicast(31).arguments() if "--processes" in line else [])
    log, part = tmp_path / "run.log", tmp_path / "run.log.part"
    with subprocess.Popen(
        [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        wait_until(running, lambda: heeds(running.pid, number))
        if LOG in line:
            wait_until(running, lambda: part.exists() and part.stat().st_size > 0)
        time.sleep(random.uniform(0, 0.5))
        running.send_signal(number)
        _, errors = running.communicate(timeout=PATIENCE)
    is_at_work = LOG in line and code is not None
    assert running.returncode in ({code} if is_at_work else {code, 128 + number}), errors
    assert "Traceback" not in errors
    if LOG in line:
        assert log.stat().st_size > 0 and not part.exists()
    if Path(f"{log}.events").exists():
        assert main(["replay", str(log)]) == 0
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
