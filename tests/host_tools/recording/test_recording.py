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
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, RobotEvents, events_path
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.recording import NoRecording, Recording
from mcp_asdf_tools.recording.replay import verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from robots import ALPHA_ONE
from support import ROOT, require
from wire import record

HEADER = EventsHeader((record(5),), None, FrameFormat())


def frame(number: int) -> can.Message:
    frame = encode_estimate(Estimate(5, number, ALPHA_ONE, number % 32), FrameFormat())
    frame.timestamp = 1e9 + number
    return frame


def numbers(log: Path) -> list[int]:
    return [int(each.timestamp - 1e9) for each in read_log(log)]


@contextmanager
def recorded(log: Path, header: EventsHeader | None = HEADER) -> Iterator[Callable[[int], None]]:
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
    monkeypatch.setattr(module, "_MAX_UNFLUSHED", 20)
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
        events.recorders[5].record_observation(Observation.BLACK)  # not settled yet, and not lost
        told = r"run\.log\.part is there: another program writes it, or its run was cut off; rename"
        with pytest.raises(UsageError, match=told), recorded(log, None):
            pass
        raise ZeroDivisionError
    assert said == [
        f"the log {log} is not complete: the run did not end regularly; partial data is in {part} and "
        f"{events_path(part)}"
    ]
    assert log.read_text() == "of yesterday"
    assert numbers(part) == [1]
    with EventsReader(events_path(part)) as reader:
        assert list(reader.entries()) == [RobotEvents(5, [1])]
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
    assert len(said) == 3
    assert "full.log is not complete: File too large; what followed is lost, what" in said[2]
    left = ("full.log.part", "lost.log", "lost.log.part", "run.log", "run.log.events.part", "saved.log.part")
    assert names(tmp_path) == [*left]


@pytest.mark.parametrize("calls", range(5))
def test_a_kill_between_the_renames_splits_nothing(
    calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any number of renames and removals a log under its own name belongs with its events."""
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
        is_old_log = log.read_text() == "old"
        assert is_old_log == (events.exists() and events.read_bytes() == b"old")
    found = log if log.exists() and log.read_text() != "old" else tmp_path / "run.log.part"
    assert numbers(found) == [1]
    part = events_path(tmp_path / "run.log.part")
    with EventsReader(part if part.exists() else events) as reader:
        assert reader.header == HEADER


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
        EventsHeader([], None, FrameFormat(), {"fill_ratio": math.nan}).to_line()
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


def test_a_full_disk_ends_the_recording_but_not_the_swarm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    with disk_with_room_for(8000):
        assert main(["swarm", *["--robots", "3", "--steps", "200", "--json", "--log"], str(log)]) == 2
    captured = capsys.readouterr()
    assert captured.err == (
        f"mcp-asdf swarm: the log {log} is not complete: File too large; what followed is lost, what came "
        f"before is in {log}.part and {log}.events.part\n"
    )
    assert json.loads(captured.out)["results"]["steps"] == 200
    assert names(tmp_path) == ["run.log.events.part", "run.log.json", "run.log.part"]


def test_what_a_full_disk_left_can_be_replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    with disk_with_room_for(8000):
        main(["swarm", *["--robots", "3", "--steps", "200", "--quiet", "--log"], str(log)])
    capsys.readouterr()
    assert main(["replay", f"{log}.part", "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["difference"] is None
    assert verdict["reproduced"] + verdict["beyond"] > 100


def test_the_missing_log_of_a_full_disk_is_refused_with_the_name_of_its_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    with disk_with_room_for(8000):
        main(["swarm", *["--robots", "3", "--steps", "200", "--quiet", "--log"], str(log)])
    assert main(["replay", str(log)]) == 2
    assert f"its run was cut off, partial data is in {log}.part" in capsys.readouterr().err


@pytest.mark.parametrize("room", range(0, 1000, 100))
def test_the_frames_on_a_full_disk_are_explained_by_the_events_or_come_after_them(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any number of bytes."""
    log, warnings = tmp_path / "run.log", list[str]()

    class FileOnFullDisk(FileIO):
        def write(self, data: Any) -> int:
            left = room - sum(path.stat().st_size for path in tmp_path.iterdir())
            if left <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(bytes(data[:left])) or 0

    def open_on_full_disk(path: Path, mode: str = "r", **_: object) -> FileIO:
        return FileOnFullDisk(path, mode.replace("b", ""))

    robot = BusRobot(record(5), FrameFormat())
    monkeypatch.setattr(module, "_MAX_UNFLUSHED", 5)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", open_on_full_disk)
        with Recording(log, HEADER, warnings.append) as (write_frame, events):
            assert write_frame is not None and events is not None
            robot.recorder = events.recorders[5]
            for tick in range(16):
                robot.observe(Observation.BLACK)
                write_frame(robot.broadcast(float(tick)))
                robot.settle()
    assert len(warnings) == 1 and "No space left on device" in warnings[0]
    part = Path(f"{log}.part")
    complete_lines = part.read_bytes().count(b"\n")
    if complete_lines:
        with EventsReader(events_path(part)) as reader:
            verdict = verify(read_log(part), reader)
        assert verdict.difference is None
        assert verdict.reproduced + verdict.beyond == complete_lines


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
