"""A recording is on disk once a second, survives a kill, and never stops a run."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
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
import can.logconvert
import pytest

from events_files import read_entries
from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording import recording as recording_module
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, RobotEvents, events_path
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.recording import NoRecording, Recording
from mcp_asdf_tools.recording.replay import ReplayVerdict, verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import RunOutcome
from robots import ALPHA_ONE
from support import ROOT, limited_file_size, names_in, require, run
from wire import setup_of_robot

HEADER_OF_ROBOT_5 = EventsHeader((setup_of_robot(robot=5),), seed=None, frames=FrameFormat())
FIRST_TIME = 1e9
"""Time of the frame with number 0."""

Capture = pytest.CaptureFixture[str]


def make_frame(number: int) -> can.Message:
    """Return an estimate of robot 5 with this number as x_hat, sent that many seconds after the first."""
    estimate = Estimate(sender=5, x_hat=number, alpha=ALPHA_ONE, transfer_id=number % 32)
    frame = encode_estimate(estimate, FrameFormat())
    frame.timestamp = FIRST_TIME + number
    return frame


def frame_numbers(log: Path) -> list[int]:
    """Return the numbers of the frames in a log."""
    return [int(frame.timestamp - FIRST_TIME) for frame in read_log(log)]


def fail_on_warning(warning: str) -> None:
    """Fail, as a warning of a recording is not expected."""
    raise AssertionError(warning)


@contextmanager
def recording_frames(
    log: Path, with_events: bool = False, warn: Callable[[str], object] = fail_on_warning
) -> Iterator[Callable[[int], None]]:
    """Record to a log, and maybe to a file of events of robot 5 beside it.

    Yields a function that records the frame with a number.
    """
    header = HEADER_OF_ROBOT_5 if with_events else None
    with Recording(log, header, warn) as outputs:

        def record_frame(number: int) -> None:
            outputs.record_frame(make_frame(number))

        yield record_frame


# --- On disk while the run goes on --------------------------------------------------------------------


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Clock of recordings that stands still unless a test sets its attribute ``now``."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(recording_module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return clock


def test_frames_are_on_disk_after_a_second(clock: SimpleNamespace, tmp_path: Path) -> None:
    """The first frame after a second, frame 2, lets those before it be written, and waits itself.

    A power cut loses no more than the last second. While the run goes on, the log's name ends in ``.part``.
    """
    part = tmp_path / "run.log.part"
    with recording_frames(tmp_path / "run.log") as record_frame:
        clock.now = 0.9
        record_frame(0)
        record_frame(1)
        assert part.stat().st_size == 0
        clock.now = 1.0
        record_frame(2)
        assert frame_numbers(part) == [0, 1]


def test_four_frames_that_wait_are_written_when_a_fifth_comes_before_the_second_is_over(
    clock: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most four frames wait in memory here, many more in a real run, so that memory does not grow.

    The clock stands still. The fifth frame waits in turn, and so do the three after it.
    """
    monkeypatch.setattr(recording_module, "_MAX_UNFLUSHED", 4)
    part = tmp_path / "run.log.part"
    numbers_of_lines_on_disk = []
    with recording_frames(tmp_path / "run.log") as record_frame:
        for number in range(8):
            record_frame(number)
            numbers_of_lines_on_disk.append(part.read_text().count("\n"))

    assert numbers_of_lines_on_disk == [0, 0, 0, 0, 4, 4, 4, 4]


def test_a_log_has_its_name_and_all_frames_when_the_run_has_ended(tmp_path: Path) -> None:
    """As long as the run goes on, ``.part`` stands behind the name."""
    with recording_frames(tmp_path / "run.log") as record_frame:
        record_frame(0)
        record_frame(1)
        assert names_in(tmp_path) == ["run.log.part"]

    assert names_in(tmp_path) == ["run.log"]
    assert frame_numbers(tmp_path / "run.log") == [0, 1]


@pytest.mark.parametrize(
    ("channel", "logged_channel"),
    [("can0", "can0"), (" COM3: fast\t1 ", "COM3:_fast_1"), (3, "can3"), ("", "my_bus"), (None, "my_bus")],
)
def test_the_name_of_any_bus_becomes_one_word_in_the_log(
    channel: str | int | None, logged_channel: str, tmp_path: Path
) -> None:
    """Candump's lines are words: spaces become _, and a frame without a name gets the name of the recording.

    The frame itself, which others may read, keeps its channel.
    """
    frame = make_frame(1)
    frame.channel = channel
    recording = Recording(tmp_path / "run.log", header=None, warn=fail_on_warning, channel="my bus")
    with recording as outputs:
        outputs.record_frame(frame)
    (logged_frame,) = read_log(tmp_path / "run.log")

    assert logged_frame.channel == logged_channel
    assert frame.channel == channel


def test_a_run_without_a_log_gets_no_recorders_of_events() -> None:
    """A ``NoRecording`` stands in for the recording of a run that the user does not want recorded."""
    with NoRecording() as outputs:
        outputs.record_frame(can.Message())
        assert outputs.recorder_of(0) is None


# --- Runs that do not end regularly -------------------------------------------------------------------


def warnings_of_run_that_fails(log: Path, with_events: bool) -> list[str]:
    """Record frame 1, and maybe events, in a run that then raises an error; return the warnings."""
    warnings: list[str] = []
    with suppress(ZeroDivisionError), recording_frames(log, with_events, warnings.append) as record_frame:
        record_frame(1)
        raise ZeroDivisionError
    return warnings


def test_a_run_that_fails_leaves_what_it_recorded_in_part_files_and_warns(tmp_path: Path) -> None:
    """The run records frame 1 and then fails. Names without .part stand for complete files.

    A command prints the warning as an error.
    """
    log = tmp_path / "run.log"
    (warning,) = warnings_of_run_that_fails(log, with_events=True)

    assert names_in(tmp_path) == ["run.log.events.part", "run.log.part"]
    assert frame_numbers(tmp_path / "run.log.part") == [1]
    assert warning == (
        f"the log {log} is not complete: the run did not end regularly; partial data is in {log}.part and "
        f"{log}.events.part"
    )


def test_a_run_that_fails_leaves_the_events_of_its_last_tick(tmp_path: Path) -> None:
    """Robot 5 observes black, and the run fails before the tick is over.

    The file run.log.events.part has the observation as the number 1, which stands for black.
    """
    recording = Recording(tmp_path / "run.log", HEADER_OF_ROBOT_5, warn=print)
    with pytest.raises(ZeroDivisionError), recording as outputs:
        recorder_of_robot_5 = outputs.recorder_of(5)
        assert recorder_of_robot_5 is not None
        recorder_of_robot_5.record_observation(Observation.BLACK)
        raise ZeroDivisionError  # stands for any error

    black = 1
    assert read_entries(tmp_path / "run.log.events.part") == [RobotEvents(5, [black])]


@pytest.mark.parametrize("name", ["run.log.part", "run.log.events.part"])
def test_a_recording_is_refused_while_there_is_the_part_file_of_another_run(
    name: str, tmp_path: Path
) -> None:
    """A run writes to files whose names end in .part until it is complete. The other run's stays as it is."""
    (tmp_path / name).write_text("of another run")
    message = f"{re.escape(name)} is there: another program writes it, or its run was cut off; rename"

    with pytest.raises(UsageError, match=message), recording_frames(tmp_path / "run.log", with_events=True):
        pass
    assert (tmp_path / name).read_text() == "of another run"


def test_a_run_that_fails_before_its_first_frame_leaves_no_files(tmp_path: Path) -> None:
    """Neither a log nor a part of one is there, so the next run can record under the same name."""
    with pytest.raises(ZeroDivisionError), recording_frames(tmp_path / "run.log", with_events=True):
        raise ZeroDivisionError  # stands for any error
    assert names_in(tmp_path) == []


def test_a_run_that_fails_raises_its_own_error_if_somebody_has_deleted_its_part_file(tmp_path: Path) -> None:
    """The run's error is a ZeroDivisionError here.

    At the end the recording would remove the part file, as it has no frames, but it is not there.
    """
    with pytest.raises(ZeroDivisionError), recording_frames(tmp_path / "run.log"):
        (tmp_path / "run.log.part").unlink()
        raise ZeroDivisionError


def test_a_log_whose_name_a_folder_takes_during_the_run_keeps_its_part_name(tmp_path: Path) -> None:
    """Somebody makes a folder run.log while the run is recorded in run.log.part.

    The recording warns that it cannot rename its file, and no frame is lost.
    """
    warnings: list[str] = []
    with recording_frames(tmp_path / "run.log", warn=warnings.append) as record_frame:
        record_frame(1)
        (tmp_path / "run.log").mkdir()

    (warning,) = warnings
    assert f"cannot write {tmp_path}/run.log: it is not a regular file" in warning
    assert frame_numbers(tmp_path / "run.log.part") == [1]


def test_a_killed_process_leaves_no_log_beside_the_events_of_another_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Replay would take such a pair for one run and report differences that do not exist.

    So the old files go before the new ones get their names, and of these the log is the last. A process may
    be killed between any two of the system calls.
    """
    (tmp_path / "run.log").write_text("old frames")
    (tmp_path / "run.log.events").write_text("old events")
    system_calls = Mock(unlink=Mock(wraps=os.unlink), replace=Mock(wraps=os.replace))
    with recording_frames(tmp_path / "run.log", with_events=True) as record_frame:
        record_frame(1)
        monkeypatch.setattr(os, "unlink", system_calls.unlink)
        monkeypatch.setattr(os, "replace", system_calls.replace)
    # The last argument of either call is the file that goes, or that gets its name.
    calls = [(name, Path(arguments[-1]).name) for name, arguments, _keywords in system_calls.mock_calls]

    assert calls == [
        ("unlink", "run.log"),
        ("unlink", "run.log.events"),
        ("replace", "run.log.events"),
        ("replace", "run.log"),
    ]


def test_files_get_their_names_only_when_their_contents_are_on_disk(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """After a power cut, too, a file with its final name is complete: fsync waits for the disk.

    The run has two files, a log and its events. The last fsync is that of the names in the folder.
    """
    system_calls = Mock(fsync=Mock(wraps=os.fsync), replace=Mock(wraps=os.replace))
    monkeypatch.setattr(os, "fsync", system_calls.fsync)
    monkeypatch.setattr(os, "replace", system_calls.replace)
    with recording_frames(tmp_path / "run.log", with_events=True) as record_frame:
        record_frame(1)
    names_of_calls = [name for name, _arguments, _keywords in system_calls.mock_calls]
    assert names_of_calls == ["fsync", "fsync", "replace", "replace", "fsync"]


# --- Names of logs ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected_message"),
    [
        ("run.blf", "cannot log to run.blf: choose .log, candump's format"),
        ("run.log.gz", "cannot log to run.log.gz: choose .log"),
        ("no/run.log", "its folder does not exist; make it first"),
    ],
)
def test_a_log_that_cannot_be_written_is_refused_before_the_run(
    name: str, expected_message: str, tmp_path: Path
) -> None:
    """The user learns at once that the recording will not work, and no file is made."""
    with pytest.raises(UsageError, match=expected_message):
        Recording(tmp_path / name, HEADER_OF_ROBOT_5, warn=fail_on_warning)
    assert names_in(tmp_path) == []


def test_the_suffix_of_a_log_may_be_in_capitals(tmp_path: Path) -> None:
    """A log ``run.LOG`` and its events are written under just these names."""
    with recording_frames(tmp_path / "run.LOG", with_events=True) as record_frame:
        record_frame(1)
    assert names_in(tmp_path) == ["run.LOG", "run.LOG.events"]


def test_a_new_log_without_events_removes_the_events_of_the_old_one(tmp_path: Path) -> None:
    """The old events would be taken for what happened in the new run."""
    (tmp_path / "run.log").write_text("old frames")
    (tmp_path / "run.log.events").write_text("old events")
    with recording_frames(tmp_path / "run.log", with_events=False) as record_frame:
        record_frame(2)

    assert names_in(tmp_path) == ["run.log"]


# --- Full disks ---------------------------------------------------------------------------------------


def test_a_full_disk_and_a_run_that_fails_give_one_warning(tmp_path: Path) -> None:
    """The warning is about the disk. A file may have 0 bytes here, which fails like a full disk."""
    with limited_file_size(0):
        (warning,) = warnings_of_run_that_fails(tmp_path / "run.log", with_events=False)
    assert "run.log is not complete: File too large; what followed is lost, what" in warning


def test_a_full_disk_ends_the_recording_but_not_the_swarm(tmp_path: Path, capsys: Capture) -> None:
    """The user gets the results of all 200 steps, the exit code 2, and a warning that names what is left.

    A file may have 8000 bytes here, which fails like a full disk. The log would have more than 600 lines.
    The file of results, run.log.json, is shorter, so it is complete.
    """
    log = tmp_path / "run.log"
    with limited_file_size(8000):
        exit_code = main(["swarm", "--robots", "3", "--steps", "200", "--json", "--log", str(log)])
    output, errors = capsys.readouterr()

    assert exit_code == 2
    assert errors == (
        f"mcp-asdf swarm: the log {log} is not complete: File too large; what followed is lost, what came "
        f"before is in {log}.part and {log}.events.part\n"
    )
    assert json.loads(output)["results"]["steps"] == 200
    assert names_in(tmp_path) == ["run.log.events.part", "run.log.json", "run.log.part"]


def test_a_bus_that_fails_sets_the_exit_code_even_if_the_disk_is_full(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exit code is 1. A full disk alone gives 2, but then a script would blame only the log.

    The run of the node is replaced by one whose bus fails. A file may have 0 bytes, as on a full disk.
    """
    bus_failure = RunOutcome("the bus failed: no luck", has_failed=True)
    monkeypatch.setattr("mcp_asdf_tools.robots.node.run_node", Mock(return_value=bus_failure))
    with limited_file_size(0):
        exit_code = main(["node", "--id", "5", "--quiet", "--log", str(tmp_path / "run.log")])

    assert exit_code == 1
    warning_of_the_log, failure_of_the_bus = capsys.readouterr().err.splitlines()
    assert "run.log is not complete: File too large" in warning_of_the_log
    assert failure_of_the_bus == "mcp-asdf node: the bus failed: no luck"


@pytest.fixture(scope="module")
def unfinished_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The name of a log of a swarm on a full disk: there are only ``.part`` files of 8000 bytes beside it."""
    log = tmp_path_factory.mktemp("full") / "run.log"
    with limited_file_size(8000):
        main(["swarm", "--robots", "3", "--steps", "200", "--quiet", "--log", str(log)])
    return log


def test_replay_names_the_part_of_a_log_that_is_not_there(unfinished_log: Path, capsys: Capture) -> None:
    """The disk was full in that run, so the log has only a partial file, with .part behind its name."""
    assert main(["replay", str(unfinished_log)]) == 2
    assert f"its run was cut off, partial data is in {unfinished_log}.part" in capsys.readouterr().err


@contextmanager
def disk_of_size(max_bytes: int, folder: Path) -> Iterator[None]:
    """Let the files in a folder have this size together; a write of more stores what there is room for."""

    class FileOnSmallDisk(FileIO):
        def write(self, data: Any) -> int:
            free_bytes = max_bytes - sum(path.stat().st_size for path in folder.iterdir())
            if free_bytes <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(bytes(data[:free_bytes])) or 0

    def open_on_small_disk(path: Path, mode: str = "r", **_: object) -> FileIO:
        return FileOnSmallDisk(path, mode.replace("b", ""))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "open", open_on_small_disk)
        yield


def warnings_of_record_of_16_broadcasts(log: Path) -> list[str]:
    """Record robot 5 as it observes 16 black tiles and broadcasts 16 estimates; return the warnings."""
    warnings: list[str] = []
    with Recording(log, HEADER_OF_ROBOT_5, warnings.append) as outputs:
        robot = BusRobot(setup_of_robot(robot=5), FrameFormat(), outputs.recorder_of(5))
        for tick in range(16):
            robot.observe(Observation.BLACK)
            outputs.record_frame(robot.broadcast(float(tick)))
            robot.settle()
    return warnings


def replay_part(part: Path) -> ReplayVerdict:
    """Compare the frames of an incomplete log with the broadcasts that follow from its events."""
    with EventsReader(events_path(part)) as reader:
        return verify(read_log(part), reader)


@pytest.mark.parametrize("disk_size", range(0, 1000, 100))
def test_the_frames_on_a_full_disk_are_explained_by_the_events_or_come_after_them(
    disk_size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk of 0 to 900 bytes has no room for 16 estimates of a robot and the events that led to them.

    Replay computes the frames again from the events: there is no difference, and those that come after the
    last event are counted as ``beyond``.
    """
    monkeypatch.setattr(recording_module, "_MAX_UNFLUSHED", 5)  # so that frames are written before the end
    with disk_of_size(disk_size, tmp_path):
        (warning,) = warnings_of_record_of_16_broadcasts(tmp_path / "run.log")
    assert "No space left on device" in warning

    part = tmp_path / "run.log.part"
    complete_frames_on_disk = part.read_text().count("\n")  # a line of the log has a frame
    if complete_frames_on_disk > 0:  # otherwise maybe not even the header of the events had room
        verdict = replay_part(part)
        assert verdict.difference is None
        assert verdict.reproduced + verdict.beyond == complete_frames_on_disk


# --- Other programs -----------------------------------------------------------------------------------


@pytest.fixture
def output_of_tshark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Output of Wireshark's tshark on a swarm, by the three commands of docs/platforms/can_tools.md.

    One writes a log, one converts it, and tshark reads it.
    """
    tshark = require("tshark", "tshark")
    page = (ROOT / "docs/platforms/can_tools.md").read_text(encoding="utf-8")
    commands = re.search(r"```text\nmcp-asdf (swarm .*)\ncan_logconvert (.*)\ntshark (.*)\n```", page)
    assert commands is not None
    swarm_options, converter_options, tshark_options = commands.groups()
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(swarm_options)) == 0
    monkeypatch.setattr(sys, "argv", ["can_logconvert", *shlex.split(converter_options)])
    can.logconvert.main()
    return run(tshark, *shlex.split(tshark_options), cwd=tmp_path)


def test_wireshark_shows_every_frame_as_a_transfer(output_of_tshark: str) -> None:
    """Of 3 robots in 50 steps it shows an estimate in each step, and a heartbeat in every tenth.

    A transfer is a message of Cyphal, the protocol of the frames, and its subject the kind of the message:
    3000 stands for estimates and 7509 for heartbeats.
    """
    subjects = re.findall(r"Message: (\d+)", output_of_tshark)

    assert Counter(subjects) == {"3000": 3 * 50, "7509": 3 * 5}
    assert "Heartbeat.1.0" in output_of_tshark
