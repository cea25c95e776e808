"""A recording is on disk once a second, survives a kill, and never stops a run."""

from __future__ import annotations

import json
import os
import random
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import FrameFormat, Message, encode
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import recording as module
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, input_log_of
from mcp_asdf_tools.recording.recording import Recording
from mcp_asdf_tools.recording.replay import verify
from robots import ALPHA_ONE
from support import PATIENCE, ROOT, require, slow
from wire import record

HEADER = InputLogHeader((record(5),), None, FrameFormat())
FORMATS = [".log", ".asc", ".blf", ".csv", ".trc"]


def frame(number: int) -> can.Message:
    frame = encode(Message(5, number, ALPHA_ONE, number % 32), FrameFormat())
    frame.timestamp = 1e9 + number
    return frame


def contents(frames: list[can.Message]) -> list[bytes]:
    return [bytes(frame.data) for frame in frames]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Time of recordings, which only calls of this move."""
    now = 0.0

    def advance(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    return advance


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_on_disk_after_a_second_is_read(
    suffix: str, clock: Callable[[float], None], tmp_path: Path
) -> None:
    """As after kill -9: the copy is what another process finds at that moment."""
    log, lost = tmp_path / f"run{suffix}", tmp_path / f"lost{suffix}.part"
    with Recording(log, None, print) as (write, _):
        assert write is not None
        for number in range(100):
            write(frame(number))
        clock(1.0)
        write(frame(100))
        part = tmp_path / f"run{suffix}.part"
        lost.write_bytes(part.read_bytes())
        assert not log.exists()
    found = contents(list(read_log(lost)))
    assert found == [bytes(frame(number).data) for number in range(len(found))]
    assert len(found) == 100 or (suffix == ".blf" and len(found) > 10)
    assert contents(list(read_log(log))) == [bytes(frame(number).data) for number in range(101)]
    assert sorted(path.name for path in tmp_path.iterdir()) == [lost.name, log.name]


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_part_is_read_up_to_any_cut(suffix: str, tmp_path: Path) -> None:
    """No cut gives a frame that was not written, and none loses frames long before it."""
    log, part = tmp_path / f"run{suffix}", tmp_path / f"cut{suffix}.part"
    with Recording(log, None, print) as (write, _):
        assert write is not None
        for number in range(50):
            write(frame(number))
    whole, written = log.read_bytes(), [bytes(frame(number).data) for number in range(50)]
    found = []
    for size in [*range(0, len(whole) - 60, 97), *range(len(whole) - 60, len(whole))]:
        part.write_bytes(whole[:size])
        try:
            read = contents(list(read_log(part)))
        except UsageError as error:
            assert "holds no frame" in str(error)
            read = []
        assert read == written[: len(read)], f"cut after {size} bytes"
        found.append(len(read))
    assert found == sorted(found)
    assert found[-1] >= 48 or suffix == ".blf"  # zlib passes the end of a container on late


def test_any_name_of_a_channel_can_be_read_back(tmp_path: Path) -> None:
    log, names = tmp_path / "run.log", ["can0", "bus 1", " x", "x ", "", None, "COM3: fast", "a\tb", 3]
    with Recording(log, None, print, "my bus") as (write, _):
        assert write is not None
        for name in names:
            each = frame(1)
            each.channel = name
            write(each)
            assert each.channel == name
    read = [each.channel for each in read_log(log)]
    assert read == ["can0", "bus_1", "x", "x", "my_bus", "my_bus", "COM3:_fast", "a_b", "can3"]


def test_a_run_that_does_not_end_regularly_leaves_parts(tmp_path: Path) -> None:
    log, said = tmp_path / "run.log", list[str]()
    log.write_text("of yesterday")
    with pytest.raises(ZeroDivisionError), Recording(log, HEADER, said.append) as (write, events):
        assert write is not None
        assert events is not None
        write(frame(1))
        events.robots[5].observe(Observation.BLACK)  # not settled yet, and not lost
        raise ZeroDivisionError
    part = tmp_path / "run.log.part"
    assert said == [
        f"the log {log} is not complete: the run did not end regularly; partial data is in {part}"
    ]
    assert log.read_text() == "of yesterday"
    assert len(list(read_log(part))) == 1
    assert input_log_of(part) == tmp_path / "run.log.events.part"
    with InputLogReader(input_log_of(part)) as input_log:
        assert list(input_log.lines()) == [(5, [1])]


def test_a_run_that_recorded_nothing_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), Recording(tmp_path / "run.log", HEADER, print):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_what_cannot_take_its_name_stays_a_part(suffix: str, tmp_path: Path) -> None:
    log, said = tmp_path / f"run{suffix}", list[str]()
    with Recording(log, HEADER, said.append) as (write, _):
        assert write is not None
        write(frame(1))
        log.mkdir()
    assert len(said) == 1
    assert f"cannot write {log}: it is not a regular file" in said[0]
    names = {log.name, f"{log.name}.part", f"{log.name}.events.part"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_a_recording_that_is_not_begun_leaves_nothing(tmp_path: Path) -> None:
    Recording(tmp_path / "run.log", HEADER, print)
    assert list(tmp_path.iterdir()) == []


def test_what_an_earlier_run_left_or_another_writes_is_kept(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with pytest.raises(ZeroDivisionError), Recording(log, HEADER, lambda text: None) as (write, _):
        assert write is not None
        write(frame(1))
        told = r"run\.log\.part is there: another program writes it, or its run was cut off; rename"
        with pytest.raises(UsageError, match=told), Recording(log, None, print):
            pass
        raise ZeroDivisionError
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "run.log.part").rename(tmp_path / "saved.log.part")
    with pytest.raises(UsageError, match=r"run\.log\.events\.part is there"), Recording(log, HEADER, print):
        pass
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert sorted(after.values()) == sorted(before.values())


@pytest.mark.parametrize("calls", range(6))
def test_a_kill_between_the_renames_splits_nothing(
    calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any number of renames and removals a log under its own name belongs with its input_log."""
    log, events = tmp_path / "run.log", tmp_path / "run.log.events"
    log.write_text("old")
    events.write_text("old")

    class Killed(BaseException):
        pass

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def guarded(*args: Any, **more: Any) -> Any:
            nonlocal calls
            calls -= 1
            if calls < 0:
                raise Killed
            return call(*args, **more)

        return guarded

    try:
        with Recording(log, HEADER, print) as (write, _):
            assert write is not None
            write(frame(1))
            monkeypatch.setattr(os, "replace", dying(os.replace))
            monkeypatch.setattr(Path, "unlink", dying(Path.unlink))
    except Killed:
        pass
    monkeypatch.undo()
    if log.exists():
        assert (log.read_text() == "old") == (events.exists() and events.read_text() == "old")
    found = log if log.exists() and log.read_text() != "old" else tmp_path / "run.log.part"
    assert len(list(read_log(found))) == 1
    with InputLogReader(input_log_of(found)) as input_log:
        assert input_log.header == HEADER


def test_a_log_without_input_log_leaves_no_other_runs_input_log(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with Recording(log, HEADER, print) as (write, _):
        assert write is not None
        write(frame(1))
    with Recording(log, None, print) as (write, _):
        assert write is not None
        write(frame(2))
    assert [path.name for path in tmp_path.iterdir()] == ["run.log"]


def test_what_cannot_be_recorded_is_told_beforehand(tmp_path: Path) -> None:
    for name, words in (
        ("run.db", "choose .log, .asc, .blf"),
        ("run.xyz", "choose .log, .asc, .blf"),
        ("run.mf4", "choose .log, .asc, .blf"),
        ("run.log.gz", "choose .log, .asc, .blf"),
        ("no/run.log", "its folder does not exist"),
    ):
        with pytest.raises(UsageError, match=words):
            Recording(tmp_path / name, HEADER, print)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_log_whose_run_was_cut_off_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.log.part").write_text("")
    with pytest.raises(
        UsageError, match=r"No such file.*its run was cut off, partial data is in .*run\.log\.part"
    ):
        list(read_log(tmp_path / "run.log"))
    assert main(["replay", str(tmp_path / "run.log")]) == 2
    assert "partial data is in" in capsys.readouterr().err


# A full disk


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_a_disk_that_is_really_full_ends_the_log_but_not_the_swarm(suffix: str, tmp_path: Path) -> None:
    """A small one in memory, which log and events share; what is on it is replayed."""
    disk, swarm = tmp_path / "disk", "swarm --robots 5 --steps 4000 --quiet --log"
    disk.mkdir()
    log = disk / f"run{suffix}"
    script = (
        f"mount -t tmpfs -o size=512k none {disk} || exit 77\n"
        f"{sys.executable} -m mcp_asdf_tools.cli.main {swarm} {log}; echo code $?\n"
        f"{sys.executable} -m mcp_asdf_tools.cli.main replay {log}.part --json"
    )
    unshare = [require("unshare", "util-linux"), "--map-root-user", "--mount", "sh", "-c", script]
    done = subprocess.run(unshare, cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE)
    if done.returncode in (1, 77) and "code" not in done.stdout:
        pytest.skip(f"no disk can be mounted here: {done.stderr.strip()}")
    line, code, report = done.stdout.split("\n", 2)
    assert "4000 steps" in line
    assert code == "code 2"
    assert done.stderr.count("is not complete: No space left on device") == 1
    assert json.loads(report)["incomplete"]
    assert json.loads(report)["verdict"]["reproduced"] > 100
    assert json.loads(report)["verdict"]["difference"] is None


@contextmanager
def disk_with_room_for(size: int) -> Iterator[None]:
    """Let no file become larger, which fails like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_log_but_not_the_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor the swarm: tests/host_tools/swarm/test_swarm.py tries that in every format."""
    log, options = tmp_path / "run.log", "--robots 3 --steps 200 --json"
    with disk_with_room_for(8000):
        assert main(["swarm", *shlex.split(options), "--log", str(log)]) == 2
    said = capsys.readouterr()
    assert said.err == (
        f"mcp-asdf swarm: the log {log} is not complete: File too large; partial data is in {log}.part\n"
    )
    assert json.loads(said.out)["results"]["steps"] == 200
    assert json.loads(Path(f"{log}.json").read_text()) == json.loads(said.out)
    assert main(["replay", f"{log}.part"]) == 0


# The whole way


@pytest.mark.parametrize(("suffix", "seconds"), [(".log", 0), *slow([(each, 3) for each in FORMATS])])
def test_a_run_that_is_killed_is_replayed_up_to_there(
    suffix: str, seconds: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Killed when the first part of it is on disk, or up to ``seconds`` later."""
    log = tmp_path / f"run{suffix}"
    command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", "swarm", "--robots", "5", "--log", str(log)]
    part = tmp_path / f"run{suffix}.part"
    faults = ["--fault", "liar=0.1", "--fault", "collide=0.1,id=2,robots=1", "--fault", "crash=0.01"]
    with subprocess.Popen([*command, *faults, "--steps", "1000000", "--quiet"], cwd=ROOT) as running:
        deadline = time.monotonic() + PATIENCE
        while not (part.exists() and part.stat().st_size):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(random.uniform(0, seconds))
        running.send_signal(signal.SIGKILL)
    assert not log.exists()
    assert main(["replay", str(part), "--json"]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert report["incomplete"]
    assert report["verdict"]["reproduced"] > 100
    assert "is incomplete: its run was cut off" in captured.err
    with InputLogReader(input_log_of(part)) as input_log:
        assert verify(read_log(part), input_log).plain() == report["verdict"]
