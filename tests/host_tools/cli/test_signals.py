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
from unittest.mock import Mock

import pytest

from host_tools.cli.test_main import replace_command_table
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from mcp_asdf_tools.recording.events import events_path
from multicast import multicast
from support import PATIENCE, interruptible, slow

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
    """Return whether a process has a handler for a signal by now. Skips the test if there is no /proc."""
    if not Path("/proc/self/status").exists():
        pytest.skip("needs Linux's /proc")
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
    ("line", "signal_number", "exit_code_at_work"),
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
def test_a_signal_at_any_time_ends_a_command_with_the_exit_code_of_the_signal_or_of_success(
    line: str, signal_number: signal.Signals, exit_code_at_work: int | None, tmp_path: Path
) -> None:
    """One command is ``node``, which succeeds when it is asked to end at work, unless it is still starting.

    The signal comes at random in the first half second in which the command handles it. ``exit_code_at_work``
    is 0 for such commands, and None for those that are then interrupted, too.
    """
    with start_command(line, tmp_path) as process:
        wait_until(process, lambda: handles_signal(process, signal_number))
        errors = end_by_signal(process, signal_number)

    exit_code_at_start = exit_code_of(signal_number)
    assert process.returncode in {exit_code_at_start, exit_code_at_work}, errors
    assert "Traceback" not in errors


def has_frames(log: Path) -> bool:
    """Return whether a log, or the part of one, holds anything yet."""
    return log.exists() and log.stat().st_size > 0


def end_command_while_it_logs(line: str, number: signal.Signals, folder: Path) -> tuple[int, str]:
    """Start a command that writes run.log, and end it by a signal when the log has frames.

    Returns its exit code and what it wrote to standard error. Until it ends, the log is called run.log.part.
    """
    part = folder / "run.log.part"
    with start_command(line, folder) as process:
        wait_until(process, lambda: handles_signal(process, number) and has_frames(part))
        errors = end_by_signal(process, number)
    return process.returncode, errors


BUS_OF_PROCESSES = shlex.join(multicast(group=31).arguments())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "signal_number"),
    [("--robots 4", signal.SIGTERM), *slow([(f"--robots 2 --processes {BUS_OF_PROCESSES}", signal.SIGHUP)])],
)
@interruptible()
def test_a_swarm_that_is_ended_by_a_signal_leaves_a_complete_log(
    options: str, signal_number: signal.Signals, tmp_path: Path, capsys: Capture
) -> None:
    """The swarm of 100 million steps gets SIGTERM or SIGHUP while it writes its log.

    A replay calculates all steps of the log again, and finds no difference. Until the log is complete it is
    called run.log.part.
    """
    line = f"swarm --steps 100000000 --quiet --log run.log {options}"
    exit_code, errors = end_command_while_it_logs(line, signal_number, tmp_path)
    assert exit_code == exit_code_of(signal_number), errors
    assert cli.main(["replay", str(tmp_path / "run.log"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    assert "Traceback" not in errors
    assert not (tmp_path / "run.log.part").exists()
    assert report["incomplete"] is False
    assert report["verdict"]["reproduced"] > 0
    assert report["verdict"]["difference"] is None


@pytest.mark.slow
@interruptible()
def test_emulated_neighbours_that_are_ended_by_a_signal_leave_a_complete_log(tmp_path: Path) -> None:
    """``mcp-asdf radio`` emulates neighbours of a robot until it is asked to end, which is a success.

    Until the log is complete it is called run.log.part.
    """
    line = "radio --id 3 --robots 4 --interface virtual --log run.log"
    exit_code, errors = end_command_while_it_logs(line, signal.SIGTERM, tmp_path)

    assert exit_code == 0, errors
    assert has_frames(tmp_path / "run.log")
    assert not (tmp_path / "run.log.part").exists()


@pytest.fixture
def log_of_killed_swarm(tmp_path: Path) -> Path:
    """The unfinished log of a swarm with faults that was killed by SIGKILL while it ran."""
    line = "swarm --steps 100000000 --quiet --log run.log --robots 5"
    faults = "--fault liar=0.1 --fault collide=0.1,id=2,robots=1 --fault crash=0.01"
    part = tmp_path / "run.log.part"
    with start_command(f"{line} {faults}", tmp_path) as process:
        wait_until(process, lambda: has_frames(part) and has_frames(events_path(part)))
        end_by_signal(process, signal.SIGKILL)
    return part


@pytest.mark.slow
@interruptible()
def test_the_unfinished_log_of_a_killed_swarm_can_be_replayed_as_far_as_it_goes(
    log_of_killed_swarm: Path, capsys: Capture
) -> None:
    """A replay calculates the steps of the log again, and finds no difference but that the end is missing.

    The log of a swarm that was killed is still called run.log.part.
    """
    assert cli.main(["replay", str(log_of_killed_swarm), "--json"]) == 0
    output, errors = capsys.readouterr()
    report = json.loads(output)

    assert report["incomplete"] is True
    assert "is incomplete: its run was cut off" in errors
    assert report["verdict"]["reproduced"] > 0
    assert report["verdict"]["difference"] is None
    assert not log_of_killed_swarm.with_name("run.log").exists()


# --- In this process -------------------------------------------------------------------------------------

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def exit_code_of(number: signal.Signals) -> int:
    """Return the exit code that a shell reports of a process that a signal has ended."""
    return 128 + number


def raise_signal_and_wait(number: signal.Signals) -> int:
    """Send this process a signal and wait for it; return exit code 0 if it raises nothing."""
    signal.raise_signal(number)
    signal.pause()
    return 0


@pytest.mark.parametrize("signal_number", ENDING_SIGNALS)
@interruptible()
def test_a_command_that_is_interrupted_by_a_signal_says_so_and_has_the_exit_code_of_the_signal(
    signal_number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """SIGTERM and SIGHUP do the same as SIGINT, which Ctrl-C sends.

    The command ``table`` is replaced by one that gets the signal at its work.
    """

    def work() -> int:
        return raise_signal_and_wait(signal_number)

    replace_command_table(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal_number)
    assert capsys.readouterr().err == "mcp-asdf table: interrupted\n"


@interruptible()
def test_a_second_signal_does_not_interrupt_a_command_that_saves_its_results(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Service managers and terminals send several. Here they come while the interrupted command saves.

    The command ``table`` is replaced by one that waits for the first signal.
    """
    steps: list[str] = []

    def wait_and_save() -> int:
        try:
            return raise_signal_and_wait(signal.SIGTERM)
        finally:
            steps.append("begins to save")
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGHUP)
            steps.append("has saved")

    replace_command_table(monkeypatch, wait_and_save)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)
    assert steps == ["begins to save", "has saved"]


@interruptible()
def test_after_an_interrupted_command_the_handlers_of_signals_are_those_from_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """These signals are SIGINT, SIGTERM and SIGHUP. Here SIGTERM interrupts the command ``table`` at work."""
    handlers_before = [signal.getsignal(number) for number in ENDING_SIGNALS]

    def work() -> int:
        return raise_signal_and_wait(signal.SIGTERM)

    replace_command_table(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)

    handlers_after = [signal.getsignal(number) for number in ENDING_SIGNALS]
    assert handlers_after == handlers_before


@interruptible()
def test_a_command_that_ends_by_itself_after_a_signal_has_the_exit_code_of_the_signal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within ``stopping()`` a signal interrupts nothing. The command asks whether it should stop.

    It returns INTERRUPTED, for which ``main`` puts the exit code of the signal.
    """
    answers = []

    def work() -> int:
        with stopping() as should_stop:
            answers.append(should_stop())
            signal.raise_signal(signal.SIGTERM)
            answers.append(should_stop())
        return INTERRUPTED

    replace_command_table(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)
    before_signal, after_signal = answers
    assert before_signal is False
    assert after_signal is True


@interruptible()
def test_ctrl_c_interrupts_a_command_that_has_not_ended_after_two_signals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within ``stopping()`` two SIGTERM are only noticed, but a SIGINT then raises KeyboardInterrupt.

    The exit code is that of the first signal.
    """

    def work() -> int:
        with stopping():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        return INTERRUPTED

    replace_command_table(monkeypatch, work)
    assert cli.main(["table"]) == exit_code_of(signal.SIGTERM)


@pytest.fixture
def hangups_ignored() -> Iterator[None]:
    """Ignore the signal SIGHUP, as the program ``nohup`` does for a command that it starts."""
    handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGHUP, handler)


@pytest.mark.usefixtures("hangups_ignored")
def test_a_command_that_was_started_by_nohup_ignores_hangups(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hangup does not interrupt the command. Within ``stopping()`` it does not ask it to stop either."""
    answers = []

    def work() -> int:
        signal.raise_signal(signal.SIGHUP)
        with stopping() as should_stop:
            signal.raise_signal(signal.SIGHUP)
            answers.append(should_stop())
        return 0

    replace_command_table(monkeypatch, work)
    assert cli.main(["table"]) == 0
    [should_stop_after_hangup] = answers
    assert should_stop_after_hangup is False


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
def test_ctrl_c_while_a_command_is_imported_interrupts_it_when_the_import_has_ended(
    finished_imports: list[str], capsys: Capture
) -> None:
    """In the middle of an import its exception could become any error. Here Ctrl-C comes in each import."""
    assert cli.main(["swarm"]) == exit_code_of(signal.SIGINT)
    out, err = capsys.readouterr()

    assert out == ""
    assert err == "mcp-asdf swarm: interrupted\n"
    assert finished_imports == ["mcp_asdf_tools.cli.swarm"]


@interruptible()
def test_ctrl_c_while_a_command_imports_numpy_interrupts_it_after_the_import_and_before_its_work(
    finished_imports: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C comes during each import here, and the command, ``table``, never begins its work."""
    work = Mock(return_value=0)
    replace_command_table(monkeypatch, work, libraries=("numpy",))

    assert cli.main(["table"]) == exit_code_of(signal.SIGINT)
    assert finished_imports == ["numpy"]
    work.assert_not_called()
