"""A recording is on disk once a second, survives a kill, and never stops a run."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import resource
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import recording as module
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, input_log_path
from mcp_asdf_tools.recording.recording import NoRecording, Recording
from robots import ALPHA_ONE
from support import ROOT, require
from wire import record

HEADER = InputLogHeader((record(5),), None, FrameFormat())
LOST = "mcp-asdf replay cannot check this log, as it needs the events, but mcp-asdf view shows its frames"


def frame(number: int) -> can.Message:
    frame = encode_estimate(Estimate(5, number, ALPHA_ONE, number % 32), FrameFormat())
    frame.timestamp = 1e9 + number
    return frame


def numbers(log: Path) -> list[int]:
    return [int(each.timestamp - 1e9) for each in read_log(log)]


@contextmanager
def recorded(log: Path, header: InputLogHeader | None = HEADER) -> Iterator[Callable[[int], None]]:
    """A recording in which nothing may go wrong; yields what writes the frame of a number."""
    recording = Recording(log, header, print)
    with recording as (write, events):
        assert write is not None
        assert (events is None) == (header is None)
        yield lambda number: write(frame(number))
    assert recording.failure is None


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_on_disk_after_a_second_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As after kill -9: the copy is what another process finds at that moment."""
    log, part, lost = (tmp_path / name for name in ("run.log", "run.log.part", "lost.log.part"))
    clock, on_disk = SimpleNamespace(now=0.0), list[int]()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(module, "_MOST_WAITING", 20)
    with recorded(log, None) as write:
        for number, clock.now in enumerate([*[0.9] * 21, 1.89, 1.9, *[1.91] * 25]):
            write(number)
            lost.write_bytes(part.read_bytes())
            on_disk.append(len(numbers(lost)) if lost.stat().st_size else 0)
        assert on_disk == [*[0] * 20, 20, 20, *[22] * 21, *[43] * 5], "many do not wait for the second"
        assert not log.exists()
    assert numbers(log) == list(range(48))
    assert names(tmp_path) == [lost.name, log.name]


def test_a_part_is_read_up_to_any_cut(tmp_path: Path) -> None:
    """No cut gives a frame that was not written, and none loses a frame that is whole."""
    log, part = tmp_path / "run.log", tmp_path / "cut.log.part"
    with recorded(log, None) as write:
        for number in range(3):
            write(number)
    whole = log.read_bytes()
    for size in range(1, len(whole)):
        part.write_bytes(whole[:size])
        if found := whole[:size].count(b"\n"):
            assert numbers(part) == list(range(found)), f"cut after {size} bytes"
        else:
            with pytest.raises(UsageError, match="holds no frame"):
                numbers(part)
    with pytest.raises(UsageError, match=r"cannot read the log .*absent\.db: No such file"):
        numbers(tmp_path / "absent.db")
    assert names(tmp_path) == ["cut.log.part", "run.log"]


def test_any_name_of_a_channel_can_be_read_back(tmp_path: Path) -> None:
    log, channels = tmp_path / "run.log", ["can0", "bus 1", " x", "x ", "", None, "COM3: fast", "a\tb", 3]
    with Recording(log, None, print, "my bus") as (write, _):
        assert write is not None
        for name in channels:
            each = frame(1)
            each.channel = name
            write(each)
            assert each.channel == name
    read = [each.channel for each in read_log(log)]
    assert read == ["can0", "bus_1", "x", "x", "my_bus", "my_bus", "COM3:_fast", "a_b", "can3"]


def test_a_run_that_does_not_end_regularly_leaves_parts(tmp_path: Path) -> None:
    """What they hold is kept by the next run; one that recorded nothing leaves nothing."""
    log, part, said = tmp_path / "run.log", tmp_path / "run.log.part", list[str]()
    log.write_text("of yesterday")
    with pytest.raises(ZeroDivisionError), Recording(log, HEADER, said.append) as (write, events):
        assert write is not None and events is not None
        write(frame(1))
        events.robots[5].observe(Observation.BLACK)  # not settled yet, and not lost
        told = r"run\.log\.part is there: another program writes it, or its run was cut off; rename"
        with pytest.raises(UsageError, match=told), recorded(log, None):
            pass
        raise ZeroDivisionError
    assert said == [
        f"the log {log} is not complete: the run did not end regularly; partial data is in {part}"
    ]
    assert log.read_text() == "of yesterday"
    assert numbers(part) == [1]
    with InputLogReader(input_log_path(part)) as input_log:
        assert list(input_log.lines()) == [(5, [1])]
    part.rename(tmp_path / "saved.log.part")
    with pytest.raises(UsageError, match=r"run\.log\.events\.part is there"), recorded(log):
        pass
    with Recording(tmp_path / "lost.log", None, said.append) as (write, _):
        assert write is not None
        write(frame(1))
        (tmp_path / "lost.log").mkdir()  # so that the part cannot take its name
    assert "cannot write" in said[1] and "lost.log: it is not a regular file" in said[1]
    with pytest.raises(ZeroDivisionError), recorded(tmp_path / "empty.log"):
        (tmp_path / "empty.log.part").unlink()  # which is no error any more
        raise ZeroDivisionError
    full = Recording(tmp_path / "full.log", None, said.append)
    with disk_with_room_for(0), pytest.raises(ZeroDivisionError), full as (write, _):
        assert write is not None
        write(frame(1))
        raise ZeroDivisionError
    assert len(said) == 3 and "full.log is not complete: File too large; partial data" in said[2]
    left = ("full.log.part", "lost.log", "lost.log.part", "run.log", "run.log.events.part", "saved.log.part")
    assert names(tmp_path) == [*left]


@pytest.mark.parametrize("calls", range(5))
def test_a_kill_between_the_renames_splits_nothing(
    calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any number of renames and removals a log under its own name belongs with its input_log."""
    log, events = tmp_path / "run.log", tmp_path / "run.log.events"
    log.write_text("old")
    events.write_text("old")
    left = [None] * calls

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def guarded(*args: Any, **more: Any) -> Any:
            left.pop()
            return call(*args, **more)

        return guarded

    with suppress(IndexError), recorded(log) as write:
        write(1)
        monkeypatch.setattr(os, "replace", dying(os.replace))
        monkeypatch.setattr(Path, "unlink", dying(Path.unlink))
    monkeypatch.undo()
    if log.exists():
        assert (log.read_text() == "old") == (events.exists() and events.read_text() == "old")
    found = log if log.exists() and log.read_text() != "old" else tmp_path / "run.log.part"
    assert numbers(found) == [1]
    part = input_log_path(tmp_path / "run.log.part")
    with InputLogReader(part if part.exists() else events) as input_log:
        assert input_log.header == HEADER


def test_a_file_is_on_disk_before_it_has_its_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls = Mock(fsync=Mock(wraps=os.fsync), replace=Mock(wraps=os.replace))
    for name in ("fsync", "replace"):
        monkeypatch.setattr(os, name, getattr(calls, name))
    with recorded(tmp_path / "run.log") as write:
        write(1)
    assert [call[0] for call in calls.mock_calls] == [*["fsync"] * 2, *["replace"] * 2, "fsync"]


@pytest.mark.parametrize(
    ("name", "words"),
    [("run.blf", "choose .log, candump's"), ("run.log.gz", "choose .log"), ("no/run.log", "make it")],
)
def test_what_cannot_be_recorded_is_told_beforehand(name: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=words):
        Recording(tmp_path / name, HEADER, print)
    assert names(tmp_path) == []
    for header in (HEADER, None):  # a log without events leaves no other run's
        with recorded(tmp_path / "run.LOG", header) as write:
            write(1)
    with pytest.raises(ValueError, match="not JSON compliant"):
        InputLogHeader([], None, FrameFormat(), {"fill_ratio": math.nan}).line()
    assert NoRecording().enter_result == (None, None)
    assert names(tmp_path) == ["run.LOG"]


@contextmanager
def disk_with_room_for(size: int) -> Iterator[None]:
    """Let no file become larger, which fails like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_log_but_not_the_swarm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, options = tmp_path / "run.log", "--robots 3 --steps 200 --json"
    with disk_with_room_for(8000):
        assert main(["swarm", *shlex.split(options), "--log", str(log)]) == 2
    said, told = capsys.readouterr(), "mcp-asdf swarm: "
    assert said.err == (
        f"{told}{log}.events.part is given up to leave room for the log, which goes on: File too large; "
        f"{LOST}\n"
        f"{told}the log {log} is not complete: File too large; partial data is in {log}.part\n"
    )
    assert json.loads(said.out)["results"]["steps"] == 200
    assert json.loads(Path(f"{log}.json").read_text()) == json.loads(said.out)
    assert len(list(read_log(Path(f"{log}.part")))) > 100
    assert main(["replay", str(log)]) == 2
    assert (
        f"No such file or directory; its run was cut off, partial data is in {log}.part"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("room", [*range(900, 3000, 300), -1])
def test_events_never_take_the_last_byte_from_the_log(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk with room for the log and some of the events: the log is whole, whichever is flushed first."""
    log, said = tmp_path / "run.log", list[str]()
    size = len(HEADER.line()) + 16 * (len("[5,1,3]\n") + 54)
    room += size * (room < 0)

    class Full(FileIO):
        def write(self, data: Any) -> int:
            left = room - sum(path.stat().st_size for path in tmp_path.iterdir())
            if left <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(bytes(data[:left])) or 0

    def opened(path: Path, mode: str = "r", **_: object) -> FileIO:
        return Full(path, mode.replace("b", ""))

    monkeypatch.setattr(Path, "open", opened)
    monkeypatch.setattr(module, "_MOST_WAITING", 5)
    recording = Recording(log, HEADER, said.append)
    with recording as (write, events):
        assert write is not None and events is not None
        for number in range(16):
            events.robots[5].observe(Observation.BLACK)
            write(frame(number))
            events.robots[5].settle()
    monkeypatch.undo()
    assert numbers(log) == [*range(16)] and log.stat().st_size == 16 * 54
    if size <= room:
        assert names(tmp_path) == ["run.log", "run.log.events"] and not said
        return
    assert names(tmp_path) == ["run.log"]
    assert said == [
        f"{log}.events.part is given up to leave room for the log, which goes on: {recording.failure}; {LOST}"
    ]


def test_replay_says_why_a_log_of_a_full_disk_cannot_be_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, said = tmp_path / "run.log", list[str]()
    with disk_with_room_for(len(HEADER.line()) - 1), Recording(log, HEADER, said.append) as (write, _):
        assert write is not None
        write(frame(1))
    assert said == [
        f"{log}.events.part is given up to leave room for the log, which goes on: File too large; {LOST}"
    ]
    assert names(tmp_path) == ["run.log"]
    assert main(["replay", str(log)]) == 2
    reason = "swarm, radio and node write it, but not if the disk was full"
    assert (
        f"there is no {log}.events, without which nothing can be checked: {reason}" in capsys.readouterr().err
    )


def test_wireshark_shows_every_frame_as_a_transfer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's commands: one writes a log, one converts it, one reads it."""
    tshark, page = require("tshark", "tshark"), (ROOT / "docs/frame.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    found = re.search(r"```text\nmcp-asdf (swarm .*)\ncan_logconvert (.*)\ntshark (.*)\n```", page)
    assert found is not None
    swarm, converting, reading = map(shlex.split, found.groups())
    assert main(swarm) == 0
    subprocess.run([sys.executable, "-m", "can.logconvert", *converting], check=True)
    done = subprocess.run([tshark, *reading], capture_output=True, text=True, check=True)
    kinds = Counter(re.findall(r"Message: (\d+)", done.stdout))
    assert kinds == {"3000": 3 * 50, "7509": 3 * 5}
    assert "Heartbeat.1.0" in done.stdout
