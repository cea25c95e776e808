"""Robots that run again from a log make the same bits, and any other value in the log is found."""

from __future__ import annotations

import json
import random
import shlex
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any

import can
import pytest

from events_files import events_file
from host_tools.recording.conftest import SMALL_SWARM
from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, events_path
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.replay import ReplayVerdict, rerun, verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS
from robots import ALPHA_ONE
from support import slow
from wire import record

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

Capture = pytest.CaptureFixture[str]
BROADCASTS = 4 * 40
"""Frames with an estimate in the log of the small swarm: one of each of 4 robots in each of 40 ticks."""
HEARTBEATS = 16
"""Its other frames: each robot sends a heartbeat in every tenth tick."""


def record_swarm(log: Path, options: str) -> list[can.Message]:
    """Run a small swarm with further options, and return the frames in its log."""
    assert main(["swarm", *shlex.split(f"{SMALL_SWARM} {options}"), "--log", str(log)]) == 0
    return list(read_log(log))


def replay(frames: Sequence[can.Message], log: Path) -> ReplayVerdict:
    """Compare frames with the broadcasts that follow from the events of a log."""
    with EventsReader(events_path(log)) as reader:
        return verify(frames, reader)


def all_reproduced() -> dict[str, Any]:
    """Return the verdict on the small swarm, as a report has it: each broadcast was computed again."""
    return vars(ReplayVerdict(reproduced=BROADCASTS, other=HEARTBEATS))


# --- Logs that are reproduced -------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_replay_reproduces_a_log_in_any_format(
    suffix: str, swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    """A log that can_logconvert has converted: replay computes all its broadcasts again, bit for bit."""
    log = tmp_path / f"run{suffix}"
    with can.LogReader(swarm_log) as frames, can.Logger(log) as write_frame:
        for frame in frames:
            write_frame(frame)

    assert main(["replay", str(log), "--events", str(events_path(swarm_log)), "--json"]) == 0

    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == all_reproduced()
    assert report["incomplete"] is False


@pytest.mark.parametrize(
    ("options", "broadcasts"),
    [
        ("--firmware mirror", BROADCASTS),
        ("--firmware reference", BROADCASTS),
        ("--comms-period 5", BROADCASTS // 5),
        ("--filter none --subject 9", BROADCASTS),
        ("--filter robust", BROADCASTS),
        ("--filter robust --firmware mirror --topology dynamic --density 2", BROADCASTS),
    ],
)
def test_replay_reproduces_robots_of_any_firmware_filter_and_period(
    options: str, broadcasts: int, tmp_path: Path
) -> None:
    frames = record_swarm(tmp_path / "run.log", options)
    verdict = replay(frames, tmp_path / "run.log")
    assert verdict == ReplayVerdict(reproduced=broadcasts, other=HEARTBEATS)


def test_frames_that_a_log_lacks_are_counted_and_no_difference(swarm_log: Path) -> None:
    """Of all frames 30 % are left, drawn with a fixed seed."""
    draw = random.Random(8)
    frames = [frame for frame in read_log(swarm_log) if draw.random() < 0.3]
    verdict = replay(frames, swarm_log)

    assert verdict.difference is None
    assert verdict.reproduced + verdict.not_logged == BROADCASTS
    assert BROADCASTS / 5 < verdict.reproduced < BROADCASTS / 2


FURTHER_OPTIONS_OF_FAULT = {
    "collide": ",id=2",
    "sybil": ",ids=2+100",
    "crash": ",rejoin=restored --fault crash=0.01",
}
ALL_FAULTS = " ".join(
    f"--fault {kind.name}=0.3{FURTHER_OPTIONS_OF_FAULT.get(kind.name, '')}" for kind in FAULT_KINDS
)


@pytest.mark.parametrize(
    "options",
    ["--seed 1", "--seed 4 --comms-period 5", "--topology dynamic --density 2 --channel 'bus{robot}'"],
)
def test_what_injected_faults_did_is_not_reported_as_a_difference(options: str, tmp_path: Path) -> None:
    """Faults of all kinds send so many frames that some equal a broadcast which is still to come."""
    frames = record_swarm(tmp_path / "run.log", f"--steps 120 {options} {ALL_FAULTS}")
    results = json.loads((tmp_path / "run.log.json").read_text())["results"]
    assert all(fault["injected"] > 0 for fault in results["faults"])

    verdict = replay(frames, tmp_path / "run.log")

    assert verdict.difference is None
    counts = (verdict.foreign, verdict.reproduced, verdict.falsified, verdict.other)
    assert min(counts) > 0
    assert sum(counts) == len(frames)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "ratio"), [("", 0.6), *slow([("--fault loss=0.3", 1.1)])])
def test_the_events_of_many_robots_are_hardly_larger_than_the_log(
    options: str, ratio: float, tmp_path: Path
) -> None:
    """The ratios are those of docs/internals/emulation.md."""
    log = tmp_path / "run.log"
    settings = ["--robots", "100", "--steps", "12", *options.split()]
    assert main(["swarm", *settings, "--quiet", "--log", str(log)]) == 0

    assert ratio - 0.2 < events_path(log).stat().st_size / log.stat().st_size < ratio
    assert replay(list(read_log(log)), log).reproduced == 100 * 12


def test_rerun_yields_each_robot_at_the_end_of_each_of_its_ticks(swarm_log: Path) -> None:
    """A robot observes once in each of the 40 ticks, so its number of observations, t, is that of ticks."""
    with EventsReader(events_path(swarm_log)) as reader:
        observation_counts = [(robot_id, robot.t) for robot_id, robot in rerun(reader)]

    assert observation_counts == [(robot_id, tick) for tick in range(1, 41) for robot_id in range(4)]


# --- Logs with another value --------------------------------------------------------------------------


def indices_of_estimates(frames: Sequence[can.Message]) -> list[int]:
    """Return the indices of those frames that are estimates."""
    return [
        index
        for index, frame in enumerate(frames)
        if isinstance(decode_estimate(frame, FrameFormat()), Estimate)
    ]


def flip_bit(frame: can.Message, bit: int) -> can.Message:
    """Return a copy of a frame with one of the 64 bits of its data flipped."""
    flipped_frame = copy(frame)
    data = int.from_bytes(frame.data, "little") ^ (1 << bit)
    flipped_frame.data = bytearray(data.to_bytes(8, "little"))
    return flipped_frame


LOWEST_BIT_OF_ALPHA = 24
"""It comes behind the 24 bits of x_hat. The firmware ignores it, but replay does not."""
BITS_OF_ESTIMATE = 55
"""24 bits of x_hat, and the 31 of alpha below its sign."""


@pytest.mark.parametrize("seed", range(20))
def test_replay_finds_one_wrong_bit_in_one_frame_of_a_log(seed: int, swarm_log: Path) -> None:
    """The bit may make the frame one that is no estimate any more; then the log lacks a broadcast.

    Frame and bit are drawn, but for seed 0: that flips the bit which the firmware ignores.
    """
    draw, frames = random.Random(seed), list(read_log(swarm_log))
    index = draw.choice(indices_of_estimates(frames))
    bit = draw.randrange(BITS_OF_ESTIMATE) if seed else LOWEST_BIT_OF_ALPHA
    frames[index] = flip_bit(frames[index], bit)

    verdict = replay(frames, swarm_log)

    estimate = decode_estimate(frames[index], FrameFormat())
    if isinstance(estimate, Estimate):
        earlier_ids = [frame.arbitration_id for frame in frames[:index]]
        tick = 1 + earlier_ids.count(frames[index].arbitration_id)  # one broadcast in each tick
        assert verdict.difference is not None
        assert verdict.difference.startswith(f"frame {index + 1} at ")
        assert f"robot {estimate.sender} broadcast x_hat {estimate.x_hat:#08x}" in verdict.difference
        assert f"but in tick {tick} it makes x_hat" in verdict.difference
    else:
        assert (verdict.difference, verdict.not_logged) == (None, 1)


def log_of_one_broadcast(log: Path) -> can.Message:
    """Write events of robot 5, which observes black once, and return its broadcast."""
    with events_file(events_path(log), EventsHeader([record(5)], None, FrameFormat())) as writer:
        writer.recorders[5].record_observation(Observation.BLACK)
    robot = BusRobot(record(5), FrameFormat())
    robot.observe(Observation.BLACK)
    return robot.broadcast(0)


def test_a_difference_is_described_with_both_values(tmp_path: Path) -> None:
    frame = log_of_one_broadcast(tmp_path / "x")
    frame.timestamp = 12.5
    verdict = replay([flip_bit(frame, LOWEST_BIT_OF_ALPHA)], tmp_path / "x")

    assert verdict.difference == (
        "frame 1 at 12.500000 s: robot 5 broadcast x_hat 0x800000 (1.0000000), alpha 0x3f100001 (0.5625001), "
        "transfer_id 0, but in tick 1 it makes x_hat 0x800000 (1.0000000), alpha 0x3f100000 (0.5625), "
        "transfer_id 0"
    )


def test_a_broadcast_that_is_twice_in_a_log_is_a_difference(tmp_path: Path) -> None:
    frame = log_of_one_broadcast(tmp_path / "x")
    verdict = replay([frame, frame], tmp_path / "x")

    assert verdict.reproduced == 1
    assert verdict.difference is not None
    assert verdict.difference.endswith(", but makes no more broadcasts")


def test_a_broadcast_that_the_log_lacks_is_counted(tmp_path: Path) -> None:
    log_of_one_broadcast(tmp_path / "x")
    assert replay([], tmp_path / "x") == ReplayVerdict(not_logged=1)


# --- Frames under a robot's id that it did not send ---------------------------------------------------

FOREIGN_FRAME = encode_estimate(Estimate(5, 77, ALPHA_ONE, 1), FrameFormat())


def log_with_foreign_frame(log: Path) -> can.Message:
    """Write events of robot 5, which observes black once while another node sends FOREIGN_FRAME.

    Returns the robot's broadcast.
    """
    with events_file(events_path(log), EventsHeader([record(5)], None, FrameFormat())) as writer:
        writer.recorders[5].record_observation(Observation.BLACK)
        writer.recorders[5].record_foreign_frame(FOREIGN_FRAME)
    robot = BusRobot(record(5), FrameFormat())
    robot.observe(Observation.BLACK)
    return robot.broadcast(0)


def test_a_foreign_frame_may_come_after_the_robots_broadcast(tmp_path: Path) -> None:
    """Foreign is a frame that another node sent under the id of the robot; the order on a bus is open."""
    broadcast = log_with_foreign_frame(tmp_path / "x")
    assert replay([broadcast, FOREIGN_FRAME], tmp_path / "x") == ReplayVerdict(reproduced=1, foreign=1)


def test_a_foreign_frame_may_come_before_the_robots_broadcast(tmp_path: Path) -> None:
    """Foreign is a frame that another node sent under the id of the robot; the order on a bus is open."""
    broadcast = log_with_foreign_frame(tmp_path / "x")
    assert replay([FOREIGN_FRAME, broadcast], tmp_path / "x") == ReplayVerdict(reproduced=1, foreign=1)


def test_a_foreign_frame_that_the_events_do_not_know_is_a_difference(tmp_path: Path) -> None:
    """The events know of one frame that another node sent under the id of the robot; the log has two."""
    broadcast = log_with_foreign_frame(tmp_path / "x")
    verdict = replay([FOREIGN_FRAME, FOREIGN_FRAME, broadcast], tmp_path / "x")

    assert verdict.foreign == 1
    assert verdict.difference is not None
    assert verdict.difference.startswith("frame 2 at 0.000000 s: robot 5 broadcast x_hat 0x00004d")


def test_rerun_yields_no_robot_in_a_tick_that_has_not_ended(tmp_path: Path) -> None:
    log_with_foreign_frame(tmp_path / "x")
    with EventsReader(events_path(tmp_path / "x")) as reader:
        assert list(rerun(reader)) == []


def test_broadcasts_after_the_events_were_cut_off_are_no_difference(tmp_path: Path) -> None:
    """The name of the events ends in ``.part``: the run was killed. The log has three frames more."""
    broadcast = log_of_one_broadcast(tmp_path / "x")
    events_path(tmp_path / "x").rename(events_path(tmp_path / "x.part"))
    later_frames = [encode_estimate(Estimate(5, 0, 0, number), FrameFormat()) for number in (1, 2, 3)]
    verdict = replay([broadcast, *later_frames], tmp_path / "x.part")

    assert verdict == ReplayVerdict(reproduced=1, beyond=3)


@pytest.mark.parametrize("event", ['"silent"', "[5,7]"])
def test_a_false_or_missing_broadcast_before_the_first_broadcast_is_refused(
    event: str, tmp_path: Path
) -> None:
    """Such an event tells what became of a broadcast; the 3 in the lines is the end of a tick."""
    log = tmp_path / "x"
    header = EventsHeader([record(5)], None, FrameFormat())
    events_path(log).write_text(f"{header.to_line()}[5,3]\n[5,3,{event}]")

    with pytest.raises(UsageError, match=r"x\.events, line 3: robot 5 has a broadcast .* before it made one"):
        replay([], log)


# --- The command --------------------------------------------------------------------------------------


def test_replay_prints_the_number_of_frames_of_each_kind(swarm_log: Path, capsys: Capture) -> None:
    assert main(["replay", str(swarm_log)]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]

    assert lines == [
        " 160  broadcasts reproduced bit for bit",
        "   0  broadcasts that a fault had given other values",
        "   0  frames under a robot's id that it did not send",
        "   0  broadcasts that the log lacks",
        "   0  broadcasts after the events were cut off",
        "  16  other frames",
        "ASDF-: only the flawed robots recalibrate",
        f"again: mcp-asdf replay {shlex.quote(str(swarm_log))}",
    ]


def test_replay_reports_the_events_of_another_run(swarm_log: Path, tmp_path: Path, capsys: Capture) -> None:
    record_swarm(tmp_path / "other.log", "--seed 4")
    assert main(["replay", str(swarm_log), "--events", str(tmp_path / "other.log.events")]) == 1
    assert capsys.readouterr().err.startswith("mcp-asdf replay: not reproduced: frame ")


def write_log_of_two_buses(swarm_log: Path, log: Path) -> None:
    """Write a log as ``candump any`` does where every frame passes on two buses."""
    with log.open("w") as file:
        for line in swarm_log.read_text().splitlines(keepends=True):
            file.write(line)
            file.write(line.replace(" vcan0 ", " vcan1 "))


def test_replay_names_the_buses_of_a_log_that_has_every_frame_twice(
    swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    log = tmp_path / "any.log"
    write_log_of_two_buses(swarm_log, log)
    assert main(["replay", str(log), "--events", str(events_path(swarm_log))]) == 1
    hint = f"{log} has frames of vcan0 and vcan1: if it has the same frames of each, choose one by --channel"

    assert f"mcp-asdf replay: {hint}\n" in capsys.readouterr().err


@pytest.mark.parametrize("channel", ["vcan0", "vcan1"])
def test_replay_checks_one_bus_of_a_log(
    channel: str, swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    log, events = tmp_path / "any.log", str(events_path(swarm_log))
    write_log_of_two_buses(swarm_log, log)
    assert main(["replay", str(log), "--events", events, "--channel", channel, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    frames_of_each_bus = BROADCASTS + HEARTBEATS
    assert report["channel"] == channel
    assert report["channels"] == {"vcan0": frames_of_each_bus, "vcan1": frames_of_each_bus}
    assert report["verdict"] == all_reproduced()


def test_replay_refuses_a_bus_that_the_log_lacks(swarm_log: Path, capsys: Capture) -> None:
    assert main(["replay", str(swarm_log), "--channel", "vcan7"]) == 2
    assert "has no frame of vcan7, but of vcan0; choose one of them" in capsys.readouterr().err


def test_replay_counts_the_lines_that_are_no_frames(swarm_log: Path, tmp_path: Path, capsys: Capture) -> None:
    log, events = tmp_path / "odd.log", str(events_path(swarm_log))
    comment_and_half_a_byte = "# the end\n(1.0) vcan0 186BB92A#0\n"
    log.write_text(f"\ufeff{swarm_log.read_text()}{comment_and_half_a_byte}")
    assert main(["replay", str(log), "--events", events, "--json"]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert report["skipped_lines"] == 2
    assert report["verdict"]["reproduced"] == BROADCASTS
    first_line = BROADCASTS + HEARTBEATS + 1
    warning = f"2 lines are no frames and were left out; the first is line {first_line}, '# the end'"

    assert captured.err == f"mcp-asdf replay: of {log} {warning}\n"


@pytest.fixture
def folder_of_odd_files(swarm_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the working directory one with a log, its events, and files that cannot be replayed."""
    monkeypatch.chdir(tmp_path)
    Path("run.log.events").write_bytes(events_path(swarm_log).read_bytes())
    for name in ("run.log", "lone.log", "run.xyz"):
        Path(name).write_text(swarm_log.read_text())
    Path("empty.log").touch()
    Path("late.log").write_text("(100000000000.0) vcan0 123#00 R\n")
    Path("other.log").write_text("(0.0) vcan0 123#00 R\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("absent.log --events run.log.events", "cannot read the log absent.log: No such file"),
        (". --events run.log.events", "cannot read the log .: Is a directory"),
        ("run.log --events absent", "cannot read absent: No such file"),
        ("run.log --events run.log", "run.log, line 1: not JSON"),
        ("lone.log", "there is no lone.log.events, without which nothing can be checked: swarm, radio and"),
        ("late.log --events run.log.events", "the log late.log holds no frame: line 1, '(100000000000.0) v"),
        ("run.log.events", "run.log.events is what happened to the robots of a log; give the log, run.log"),
        ("empty.log", "the log empty.log is empty: the disk was full, or nothing was sent yet"),
        ("run.xyz --events run.log.events", "the log run.xyz cannot be opened, or its suffix is wrong: it"),
        ("other.log --events run.log.events", "other.log holds no estimate of the robots in run.log.events"),
    ],
)
@pytest.mark.usefixtures("folder_of_odd_files")
def test_replay_names_the_file_that_it_cannot_use(arguments: str, message: str, capsys: Capture) -> None:
    assert main(["replay", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
