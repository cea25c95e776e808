"""A signal ends every command, whenever it comes; nothing that is done is lost."""

from __future__ import annotations

import json
import random
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from host_tools.cli.test_main import fake_command
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from mcp_asdf_tools.recording.events import events_path
from multicast import multicast
from support import PATIENCE, interruptible, slow

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")

Capture = pytest.CaptureFixture[str]

# --- Processes -------------------------------------------------------------------------------------------


@contextmanager
def start_command(line: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a command as a process in a folder, and kill it in the end if it goes on."""
    with subprocess.Popen(
        [sys.executable, "-m", "mcp_asdf_tools.cli.main", *shlex.split(line)],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until(process: subprocess.Popen[str], condition: Callable[[], bool]) -> None:
    """Return when a condition holds. Fails if the process ends before, or is killed for its slowness."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert process.poll() is None, process.communicate()
        if time.monotonic() > deadline:
            process.kill()
        time.sleep(0.02)


def handles_signal(process: subprocess.Popen[str], number: signal.Signals) -> bool:
    """Return whether a process has a handler for a signal by now."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    match = re.search(r"^SigCgt:\s+([0-9a-f]+)$", status, re.MULTILINE)
    assert match is not None
    caught_signals = int(match[1], 16)  # bit 0 is signal 1
    signal_bit = 1 << (number - 1)
    return caught_signals & signal_bit != 0


def end_by_signal(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """Send a signal at some time in the next half second; return what the process wrote to standard error."""
    time.sleep(random.uniform(0, 0.5))
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    return errors


@pytest.mark.parametrize(
    ("line", "number", "code_at_work"),
    [
        ("node --id 3", signal.SIGHUP, 0),
        *slow(
            [
                ("radio --id 3 --interface virtual --verify --wait 1000 --json", signal.SIGHUP, None),
                ("simulate --trials 1000000", signal.SIGTERM, None),
                ("crosscheck --steps 100000000", signal.SIGHUP, None),
                ("reproduce --output study", signal.SIGTERM, None),
            ]
        ),
    ],
)
@interruptible()
def test_a_signal_ends_a_process_whenever_it_comes(
    line: str, number: signal.Signals, code_at_work: int | None, tmp_path: Path
) -> None:
    """A command that goes on until it is asked to end has an exit code of its own for that, once at work."""
    with start_command(line, tmp_path) as process:
        wait_until(process, lambda: handles_signal(process, number))
        errors = end_by_signal(process, number)

    assert process.returncode in {code_at_work, exit_code_of(number)}, errors
    assert "Traceback" not in errors


LONG_SWARM = "swarm --steps 100000000 --quiet --log run.log"
FAULTS = "--fault liar=0.1 --fault collide=0.1,id=2,robots=1 --fault crash=0.01"


def has_frames(log: Path) -> bool:
    """Return whether a log, or the part of one, holds anything yet."""
    return log.exists() and log.stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "number"),
    [("--robots 4", signal.SIGTERM), *slow([("--robots 2 --processes", signal.SIGHUP)])],
)
@interruptible()
def test_a_swarm_that_a_signal_ends_leaves_a_complete_log_that_can_be_replayed(
    options: str, number: signal.Signals, tmp_path: Path, capsys: Capture
) -> None:
    bus = shlex.join(multicast(31).arguments()) if "--processes" in options else ""
    log, part = tmp_path / "run.log", tmp_path / "run.log.part"
    with start_command(f"{LONG_SWARM} {options} {bus}", tmp_path) as process:
        wait_until(process, lambda: handles_signal(process, number) and has_frames(part))
        errors = end_by_signal(process, number)
    assert process.returncode == exit_code_of(number), errors
    assert "Traceback" not in errors
    assert not part.exists()
    assert cli.main(["replay", str(log), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    assert report["incomplete"] is False
    assert report["verdict"]["reproduced"] > 0
    assert report["verdict"]["difference"] is None


@pytest.mark.slow
@interruptible()
def test_emulated_neighbours_that_a_signal_ends_leave_a_complete_log(tmp_path: Path) -> None:
    log, part = tmp_path / "run.log", tmp_path / "run.log.part"
    line = "radio --id 3 --robots 4 --interface virtual --log run.log"
    with start_command(line, tmp_path) as process:
        wait_until(process, lambda: handles_signal(process, signal.SIGTERM) and has_frames(part))
        errors = end_by_signal(process, signal.SIGTERM)

    assert process.returncode == 0, errors
    assert has_frames(log)
    assert not part.exists()


@pytest.mark.slow
@interruptible()
def test_a_swarm_that_is_killed_leaves_a_part_of_its_log_that_can_be_replayed(
    tmp_path: Path, capsys: Capture
) -> None:
    part = tmp_path / "run.log.part"
    with start_command(f"{LONG_SWARM} --robots 5 {FAULTS}", tmp_path) as process:
        wait_until(process, lambda: has_frames(part) and has_frames(events_path(part)))
        end_by_signal(process, signal.SIGKILL)
    assert not (tmp_path / "run.log").exists()
    assert cli.main(["replay", str(part), "--json"]) == 0
    output, errors = capsys.readouterr()
    report = json.loads(output)

    assert report["incomplete"] is True
    assert "is incomplete: its run was cut off" in errors
    assert report["verdict"]["reproduced"] > 0
    assert report["verdict"]["difference"] is None


# --- In this process -------------------------------------------------------------------------------------

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def exit_code_of(number: signal.Signals) -> int:
    """Return the exit code that a shell reports of a process that a signal has ended."""
    return 128 + number


def wait_for_signal(number: signal.Signals) -> int:
    """Send this process a signal and wait for it; return exit code 0 if it raises nothing."""
    signal.raise_signal(number)
    signal.pause()
    return 0


@pytest.mark.parametrize("number", ENDING_SIGNALS)
@interruptible()
def test_a_signal_that_asks_to_end_interrupts_a_command_as_ctrl_c_does(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    fake_command(monkeypatch, lambda: wait_for_signal(number))
    assert cli.main(["table"]) == exit_code_of(number)
    assert capsys.readouterr().err == "mcp-asdf table: interrupted\n"


@interruptible()
def test_a_second_signal_does_not_interrupt_a_command_that_saves_its_results(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    saved: list[str] = []

    def work() -> int:
        try:
            return wait_for_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)  # as service managers and terminals send them
            signal.raise_signal(signal.SIGHUP)
            saved.append("all")

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)
    assert saved == ["all"]


@interruptible()
def test_a_command_leaves_the_handlers_of_signals_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    handlers = [signal.getsignal(number) for number in ENDING_SIGNALS]
    fake_command(monkeypatch, lambda: wait_for_signal(signal.SIGTERM))
    cli.main(["table"])
    assert [signal.getsignal(number) for number in ENDING_SIGNALS] == handlers


@interruptible()
def test_a_command_that_notices_a_signal_and_ends_by_itself_has_it_in_its_exit_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def work() -> int:
        with stopping() as is_requested:
            assert not is_requested()
            signal.raise_signal(signal.SIGTERM)
            assert is_requested()
        return INTERRUPTED

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)


@interruptible()
def test_ctrl_c_interrupts_a_command_that_does_not_end_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has been asked twice by SIGTERM, which it only notices."""

    def work() -> int:
        with stopping():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        return INTERRUPTED

    fake_command(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)


def test_a_signal_that_the_program_was_started_to_ignore_stays_ignored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def work() -> int:
        signal.raise_signal(signal.SIGHUP)
        with stopping() as is_requested:
            signal.raise_signal(signal.SIGHUP)
            assert not is_requested()
        return 0

    fake_command(monkeypatch, work)
    handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as by nohup
    try:
        assert cli.main(["table"]) == 0
    finally:
        signal.signal(signal.SIGHUP, handler)


@pytest.fixture
def finished_imports(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of modules whose import has ended; Ctrl-C comes while each of them is imported."""
    names: list[str] = []

    def import_with_ctrl_c(name: str) -> None:
        signal.raise_signal(signal.SIGINT)
        names.append(name)

    monkeypatch.setattr(cli, "import_module", import_with_ctrl_c)
    return names


@interruptible()
def test_ctrl_c_during_the_import_of_a_command_waits_for_its_end(
    finished_imports: list[str], capsys: Capture
) -> None:
    assert cli.main(["swarm"]) == exit_code_of(signal.SIGINT)
    assert capsys.readouterr() == ("", "mcp-asdf swarm: interrupted\n")
    assert finished_imports == ["mcp_asdf_tools.cli.swarm"]


@interruptible()
def test_ctrl_c_during_the_import_of_a_library_waits_for_its_end_and_runs_nothing(
    finished_imports: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def work() -> int:
        pytest.fail("the command ran")

    fake_command(monkeypatch, work, libraries=("numpy",))
    assert cli.main(["table"]) == exit_code_of(signal.SIGINT)
    assert finished_imports == ["numpy"]
