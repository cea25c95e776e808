"""A signal ends every command, whenever it comes; nothing that is done is lost."""

from __future__ import annotations

import json
import os
import random
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from host_tools.cli.test_main import fake_command
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from mcp_asdf_tools.recording.events import events_path
from multicast import multicast
from support import PATIENCE, interruptible, slow

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")

KILLED, HUNG_UP = signal.SIGTERM, signal.SIGHUP
LOG = "--log run.log"
FAULTS = "--fault liar=0.1 --fault collide=0.1,id=2,robots=1 --fault crash=0.01"
CASES = [
    (f"swarm --robots 4 --steps 100000000 --quiet {LOG}", KILLED, None),
    (f"swarm --robots 5 --steps 100000000 --quiet {FAULTS} {LOG}", signal.SIGKILL, -9),
    ("node --id 3", HUNG_UP, 0),
    *slow(
        [
            (f"swarm --robots 2 --steps 100000000 --quiet --processes {LOG}", HUNG_UP, None),
            (f"radio --id 3 --robots 4 --interface virtual {LOG}", KILLED, 0),
            ("radio --id 3 --interface virtual --verify --wait 1000 --json", HUNG_UP, None),
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
    """A log is replayed; what no process survives leaves a part of it."""
    words = shlex.split(line) + (multicast(31).arguments() if "--processes" in line else [])
    log, part = tmp_path / "run.log", tmp_path / "run.log.part"
    with (
        subprocess.Popen(
            [sys.executable, "-m", "mcp_asdf_tools.cli.main", *words],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as running,
        ExitStack() as in_the_end,
    ):
        in_the_end.callback(running.kill)  # also if it goes on where it should have ended
        wait_until(running, lambda: number == signal.SIGKILL or heeds(running.pid, number))
        if LOG in line:
            wait_until(running, lambda: part.exists() and part.stat().st_size > 0)
        time.sleep(random.uniform(0, 0.5))
        running.send_signal(number)
        _, errors = running.communicate(timeout=PATIENCE)
    is_at_work = LOG in line and code is not None
    assert running.returncode in ({code} if is_at_work else {code, 128 + number}), errors
    assert "Traceback" not in errors
    if LOG in line:
        is_lost = number == signal.SIGKILL
        found = part if is_lost else log
        assert found.stat().st_size > 0 and part.exists() == is_lost == (not log.exists())
        if events_path(found).exists():
            assert main(["replay", str(found), "--json"]) == 0
            out, err = capsys.readouterr()
            report = json.loads(out)
            assert report["incomplete"] == ("is incomplete: its run was cut off" in err) == is_lost
            assert report["verdict"]["reproduced"] > 0 and report["verdict"]["difference"] is None


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


# In this process

ENDINGS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize("number", ENDINGS)
@interruptible()
def test_every_signal_that_asks_to_end_acts_as_ctrl_c(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = []

    def work() -> int:
        try:
            os.kill(os.getpid(), number)
            signal.pause()
        finally:
            for second in (signal.SIGTERM, signal.SIGHUP):  # as terminals and service managers send them
                os.kill(os.getpid(), second)
            saved.append("all")
        return 0

    handlers = [signal.getsignal(each) for each in ENDINGS]
    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == ENDINGS[number]
    assert saved == ["all"]
    assert capsys.readouterr().err == "mcp-asdf table: interrupted\n"
    assert [signal.getsignal(each) for each in ENDINGS] == handlers


@interruptible()
def test_commands_that_end_by_themselves_tell_the_signal_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second signal changes nothing, but Ctrl-C acts at once."""

    def work() -> int:
        with stopping() as is_asked:
            assert not is_asked()
            for _ in range(2):
                os.kill(os.getpid(), signal.SIGTERM)
            assert is_asked()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        return INTERRUPTED

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == 143


def test_what_the_program_was_started_to_ignore_stays_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> int:
        os.kill(os.getpid(), signal.SIGHUP)
        with stopping() as is_asked:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not is_asked()
        return 0

    fake_command(monkeypatch, work)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as by nohup
    try:
        assert cli.main(["table"]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)


@interruptible()
def test_ctrl_c_within_an_import_waits_for_its_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = []

    def importing(name: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        done.append(name)

    handler = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(cli, "import_module", importing)
    assert cli.main(["swarm"]) == 130
    assert capsys.readouterr() == ("", "mcp-asdf swarm: interrupted\n")
    assert done == ["mcp_asdf_tools.cli.swarm"]
    assert signal.getsignal(signal.SIGINT) is handler
