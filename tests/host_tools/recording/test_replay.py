"""Robots that run again from a log make the same bits, and any other value in the log is found."""

from __future__ import annotations

import json
import random
import shlex
from collections.abc import Sequence
from copy import copy
from pathlib import Path

import can
import pytest

from events_files import events_file
from host_tools.recording.conftest import FOUR_ROBOTS_IN_40_STEPS
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
from wire import setup_of_robot

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

Capture = pytest.CaptureFixture[str]
HEADER_OF_ROBOT_5 = EventsHeader([setup_of_robot(robot=5)], seed=None, frames=FrameFormat())


def record_swarm(log: Path, options: str) -> list[can.Message]:
    """Run a swarm with these options of the command, and return the frames in its log."""
    assert main(["swarm", *shlex.split(options), "--quiet", "--log", str(log)]) == 0
    return list(read_log(log))


def replay(frames: Sequence[can.Message], events_beside: Path) -> ReplayVerdict:
    """Compare frames with the broadcasts that follow from the events beside a log."""
    with EventsReader(events_path(events_beside)) as reader:
        return verify(frames, reader)


# --- Logs that are reproduced -------------------------------------------------------------------------


def convert(log: Path, converted_log: Path) -> None:
    """Write the frames of a log to a second log, in the format of its suffix, as can_logconvert does."""
    with can.LogReader(log) as frames, can.Logger(converted_log) as write_frame:
        for frame in frames:
            write_frame(frame)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_replay_reproduces_a_log_in_any_format(
    suffix: str, swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    """Replay computes all broadcasts of a converted log again, bit for bit; the suffix gives the format.

    The log of four robots in 40 steps has 4 * 40 broadcasts, and 16 other frames, which are heartbeats. The
    report says that the log is not an incomplete one, as that of a killed run would be.
    """
    converted_log = tmp_path / f"run{suffix}"
    convert(swarm_log, converted_log)
    assert main(["replay", str(converted_log), "--events", str(events_path(swarm_log)), "--json"]) == 0

    report = json.loads(capsys.readouterr().out)
    expected_verdict = ReplayVerdict(reproduced=4 * 40, other=16)
    assert report["verdict"] == vars(expected_verdict)  # its attributes by their names
    assert report["incomplete"] is False


@pytest.mark.parametrize(
    ("options", "expected_broadcasts"),
    [
        ("--firmware mirror", 4 * 40),
        ("--firmware reference", 4 * 40),
        ("--comms-period 5", 4 * 8),
        ("--filter none --subject 9", 4 * 40),
        ("--filter robust", 4 * 40),
        ("--filter robust --firmware mirror --topology dynamic --density 2", 4 * 40),
    ],
)
def test_replay_reproduces_robots_of_any_firmware_filter_and_period(
    options: str, expected_broadcasts: int, tmp_path: Path
) -> None:
    """A robot's broadcasts depend on what its events file says of it: firmware, filter and period.

    Each of 4 robots broadcasts in all 40 ticks, or in every fifth tick with ``--comms-period 5``.
    Each sends a heartbeat in every tenth tick.
    """
    frames = record_swarm(tmp_path / "run.log", f"{FOUR_ROBOTS_IN_40_STEPS} {options}")
    verdict = replay(frames, events_beside=tmp_path / "run.log")
    assert verdict == ReplayVerdict(reproduced=expected_broadcasts, other=4 * 4)


def test_broadcasts_that_a_log_lacks_are_counted_and_are_no_difference(swarm_log: Path) -> None:
    """A receiver may miss frames. Some 30 % of all frames are left, drawn with a fixed seed.

    The whole log has 4 * 40 broadcasts. Those that were taken out are counted as ``not_logged``. The frames
    that are left and are no broadcasts are heartbeats, which count as ``other``.
    """
    random_numbers = random.Random(8)
    frames_left = [frame for frame in read_log(swarm_log) if random_numbers.random() < 0.3]
    broadcasts_left = count_estimates(frames_left)

    verdict = replay(frames_left, events_beside=swarm_log)

    assert verdict == ReplayVerdict(
        difference=None,
        reproduced=broadcasts_left,
        not_logged=4 * 40 - broadcasts_left,
        other=len(frames_left) - broadcasts_left,
    )


FURTHER_OPTIONS_OF_FAULT = {
    "collide": ",id=2",
    "sybil": ",ids=2+100",
    "crash": ",rejoin=restored --fault crash=0.03",
}
FAULTS_OF_ALL_KINDS = " ".join(
    f"--fault {kind.name}=0.3{FURTHER_OPTIONS_OF_FAULT.get(kind.name, '')}" for kind in FAULT_KINDS
)
"""Options for a fault of each kind. Each fault hits about 30 % of the ticks or frames."""


@pytest.mark.parametrize(
    "options",
    [
        "--seed 1",
        "--seed 4 --comms-period 5",
        "--seed 3 --topology dynamic --density 2 --channel 'bus{robot}'",
    ],
)
def test_what_injected_faults_did_is_not_reported_as_a_difference(options: str, tmp_path: Path) -> None:
    """Faults of all kinds send many frames. Some of these equal a broadcast that is still to come.

    So each frame of the log is counted as a broadcast, as one with false values, as one of another sender
    under a robot's id (foreign), or as none of these. There are frames of each of these four kinds, and each
    fault has occurred.
    """
    frames = record_swarm(
        tmp_path / "run.log", f"--robots 4 --steps 60 --filter-period 10 {options} {FAULTS_OF_ALL_KINDS}"
    )
    results = json.loads((tmp_path / "run.log.json").read_text())["results"]
    assert all(fault["injected"] > 0 for fault in results["faults"])

    verdict = replay(frames, events_beside=tmp_path / "run.log")

    assert verdict.difference is None
    counts = (verdict.foreign, verdict.reproduced, verdict.falsified, verdict.other)
    assert min(counts) > 0
    assert sum(counts) == len(frames)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "largest_ratio"), [("", 0.6), *slow([("--fault loss=0.3", 1.1)])])
def test_the_events_of_many_robots_are_hardly_larger_than_the_log(
    options: str, largest_ratio: float, tmp_path: Path
) -> None:
    """docs/internals/emulation.md has the largest ratios of the two sizes, without and with lost frames.

    The ratio that is measured lies below, but by less than 0.2. Replay reproduces all broadcasts.
    """
    log = tmp_path / "run.log"
    frames = record_swarm(log, f"--robots 100 --steps 12 --filter-period 10 --seed 3 {options}")

    ratio = events_path(log).stat().st_size / log.stat().st_size
    assert largest_ratio - 0.2 < ratio < largest_ratio
    assert replay(frames, events_beside=log).reproduced == 100 * 12


def test_rerun_yields_each_robot_at_the_end_of_each_of_its_ticks(swarm_log: Path) -> None:
    """``rerun`` computes the robots of a recorded run again: here four robots in 40 ticks.

    A robot observes once in each tick, so its number of observations t equals its number of ticks.
    """
    with EventsReader(events_path(swarm_log)) as reader:
        robots_and_ticks = [(robot_id, robot.t) for robot_id, robot in rerun(reader)]

    every_robot_in_every_tick = []
    for tick in range(1, 41):
        every_robot_in_every_tick += [(0, tick), (1, tick), (2, tick), (3, tick)]
    assert robots_and_ticks == every_robot_in_every_tick


# --- Logs with another value --------------------------------------------------------------------------


def is_estimate(frame: can.Message) -> bool:
    """Return whether a frame is a legal estimate."""
    return isinstance(decode_estimate(frame, FrameFormat()), Estimate)


def count_estimates(frames: Sequence[can.Message]) -> int:
    """Return the number of those frames that are estimates."""
    return [is_estimate(frame) for frame in frames].count(True)


def with_flipped_bit(frame: can.Message, bit: int) -> can.Message:
    """Return a copy of a frame with one of the 64 bits of its data flipped."""
    flipped_frame = copy(frame)
    data = int.from_bytes(frame.data, "little") ^ (1 << bit)
    flipped_frame.data = bytearray(data.to_bytes(8, "little"))
    return flipped_frame


LOWEST_BIT_OF_X_HAT, HIGH_BIT_OF_X_HAT, HIGHEST_BIT_OF_X_HAT = 0, 21, 23
LOWEST_BIT_OF_ALPHA, HIGHEST_BIT_OF_ALPHA = 24, 54
"""Alpha stands behind the 24 bits of x_hat. Above its highest bit here is only its sign.

The firmware ignores the lowest one, but replay does not.
"""


@pytest.mark.parametrize(
    "bit", [LOWEST_BIT_OF_X_HAT, HIGH_BIT_OF_X_HAT, LOWEST_BIT_OF_ALPHA, HIGHEST_BIT_OF_ALPHA]
)
def test_replay_finds_one_wrong_bit_in_one_frame_of_a_log(bit: int, swarm_log: Path) -> None:
    """The bit is flipped in the 51st frame, the estimate of robot 2 in tick 11. It is of x_hat or alpha.

    The difference that replay finds has the frame, and what robot 2 makes in tick 11. Before that frame are
    ten ticks of four estimates, two times four heartbeats, and the estimates of robots 0 and 1: 50 frames.
    """
    frames = list(read_log(swarm_log))
    frames[50] = with_flipped_bit(frames[50], bit)

    verdict = replay(frames, events_beside=swarm_log)

    assert verdict.difference is not None
    assert verdict.difference.startswith("frame 51 at 1.000000 s: robot 2 broadcast x_hat ")
    assert ", but in tick 11 it makes x_hat 0x6052c0 " in verdict.difference  # in units of 2**-23


def test_an_estimate_that_a_wrong_bit_makes_illegal_counts_as_not_logged(swarm_log: Path) -> None:
    """With its highest bit flipped, the x_hat of the 51st frame is larger than 1, which no robot sends.

    It may be a frame of another program, so replay reports no difference.
    """
    frames = list(read_log(swarm_log))
    assert is_estimate(frames[50])
    frames[50] = with_flipped_bit(frames[50], HIGHEST_BIT_OF_X_HAT)
    assert not is_estimate(frames[50])

    verdict = replay(frames, events_beside=swarm_log)

    assert verdict.difference is None
    assert verdict.not_logged == 1


def write_events_and_return_broadcast(log: Path, foreign_frame: can.Message | None = None) -> can.Message:
    """Let robot 5 observe black once; write that into the events beside a log, and return its broadcast.

    The events may also have a foreign frame: one that another node sent under the id of the robot.
    """
    with events_file(events_path(log), HEADER_OF_ROBOT_5) as writer:
        writer.recorders[5].record_observation(Observation.BLACK)
        if foreign_frame is not None:
            writer.recorders[5].record_foreign_frame(foreign_frame)
    robot = BusRobot(setup_of_robot(robot=5), FrameFormat())
    robot.observe(Observation.BLACK)
    return robot.broadcast(0)


def test_a_difference_is_described_with_both_values(tmp_path: Path) -> None:
    """The only frame of the log, an estimate of robot 5, has a wrong bit: the lowest one of alpha.

    So the log has the alpha 0x3f100001, and robot 5 makes 0x3f100000 of the events.
    """
    broadcast = write_events_and_return_broadcast(tmp_path / "x")
    broadcast.timestamp = 12.5
    verdict = replay([with_flipped_bit(broadcast, LOWEST_BIT_OF_ALPHA)], events_beside=tmp_path / "x")

    assert verdict.difference == (
        "frame 1 at 12.500000 s: robot 5 broadcast x_hat 0x800000 (1.0000000), alpha 0x3f100001 (0.5625001), "
        "transfer_id 0, but in tick 1 it makes x_hat 0x800000 (1.0000000), alpha 0x3f100000 (0.5625), "
        "transfer_id 0"
    )


def test_a_wrong_broadcast_is_compared_with_that_of_its_transfer_id_behind_a_gap_of_the_log(
    tmp_path: Path,
) -> None:
    """The log lacks the first of two broadcasts of robot 5, and alpha is wrong in the second one."""
    with events_file(events_path(tmp_path / "x"), HEADER_OF_ROBOT_5) as writer:
        robot = BusRobot(setup_of_robot(robot=5), FrameFormat(), writer.recorders[5])
        robot.observe(Observation.BLACK)
        robot.broadcast(0)
        robot.settle()
        robot.observe(Observation.BLACK)
        second_broadcast = robot.broadcast(1)
    verdict = replay([with_flipped_bit(second_broadcast, LOWEST_BIT_OF_ALPHA)], events_beside=tmp_path / "x")

    assert verdict.difference is not None
    assert "transfer_id 1, but in tick 2 it makes" in verdict.difference


def test_a_broadcast_that_is_twice_in_a_log_is_a_difference(tmp_path: Path) -> None:
    """Robot 5 has observed once, and so makes one broadcast. Replay reports the second one in the log."""
    broadcast = write_events_and_return_broadcast(tmp_path / "x")
    verdict = replay([broadcast, broadcast], events_beside=tmp_path / "x")

    assert verdict.reproduced == 1
    assert verdict.difference is not None
    assert verdict.difference.endswith(", but makes no more broadcasts")


# --- Frames under a robot's id that it did not send ---------------------------------------------------


def estimate_of_robot_5(x_hat: int, transfer_id: int) -> can.Message:
    """Return the frame of an estimate under the id of robot 5."""
    return encode_estimate(Estimate(5, x_hat, ALPHA_ONE, transfer_id), FrameFormat())


@pytest.mark.parametrize("is_foreign_first", [False, True])
def test_a_foreign_frame_may_come_before_or_after_the_robots_broadcast(
    is_foreign_first: bool, tmp_path: Path
) -> None:
    """Foreign is a frame that another node sent under the robot's id. Replay counts it in either order."""
    foreign_frame = estimate_of_robot_5(x_hat=77, transfer_id=1)
    broadcast = write_events_and_return_broadcast(tmp_path / "x", foreign_frame=foreign_frame)
    frames = [foreign_frame, broadcast] if is_foreign_first else [broadcast, foreign_frame]
    assert replay(frames, events_beside=tmp_path / "x") == ReplayVerdict(reproduced=1, foreign=1)


def test_a_foreign_frame_that_the_events_do_not_know_is_a_difference(tmp_path: Path) -> None:
    """The events know of one frame that another node sent under the id of the robot; the log has two."""
    foreign_frame = estimate_of_robot_5(x_hat=0x77, transfer_id=1)
    broadcast = write_events_and_return_broadcast(tmp_path / "x", foreign_frame=foreign_frame)
    verdict = replay([foreign_frame, foreign_frame, broadcast], events_beside=tmp_path / "x")

    assert verdict.foreign == 1
    assert verdict.difference is not None
    assert verdict.difference.startswith("frame 2 at 0.000000 s: robot 5 broadcast x_hat 0x000077")


def test_rerun_yields_no_robot_in_a_tick_that_has_not_ended(tmp_path: Path) -> None:
    """The events tell of an observation and a foreign frame, but not of the end of the tick."""
    foreign_frame = estimate_of_robot_5(x_hat=77, transfer_id=1)
    write_events_and_return_broadcast(tmp_path / "x", foreign_frame=foreign_frame)
    with EventsReader(events_path(tmp_path / "x")) as reader:
        assert list(rerun(reader)) == []


def test_broadcasts_after_the_events_were_cut_off_are_no_difference(tmp_path: Path) -> None:
    """The run was killed, so the names end in ``.part``. The events explain the first broadcast alone.

    The three later ones of the log are counted as beyond.
    """
    broadcast = write_events_and_return_broadcast(tmp_path / "x")
    events_path(tmp_path / "x").rename(events_path(tmp_path / "x.part"))
    later_broadcasts = [estimate_of_robot_5(x_hat=0, transfer_id=number) for number in (1, 2, 3)]
    verdict = replay([broadcast, *later_broadcasts], events_beside=tmp_path / "x.part")

    assert verdict == ReplayVerdict(reproduced=1, beyond=3)


@pytest.mark.parametrize("event", ['"silent"', "[5,7]"])
def test_events_with_a_false_or_missing_broadcast_before_the_first_broadcast_are_refused(
    event: str, tmp_path: Path
) -> None:
    """A fault can only hold back a broadcast that was made ("silent"), or change it ([x_hat, alpha]).

    In line 2 robot 5 ends a tick (3). In line 3 it ends another, in which it has not broadcast before the
    fault.
    """
    header = HEADER_OF_ROBOT_5.to_line()
    events_path(tmp_path / "x").write_text(f"{header}[5,3]\n[5,3,{event}]")

    with pytest.raises(UsageError, match=r"x\.events, line 3: robot 5 has a broadcast .* before it made one"):
        replay([], events_beside=tmp_path / "x")


# --- The command --------------------------------------------------------------------------------------


def test_replay_prints_the_number_of_frames_of_each_kind(swarm_log: Path, capsys: Capture) -> None:
    """The log has 160 estimates and 16 heartbeats of four robots in 40 steps."""
    assert main(["replay", str(swarm_log)]) == 0
    output = capsys.readouterr().out

    assert [line.rstrip() for line in output.splitlines()] == [
        " 160  broadcasts reproduced bit for bit",
        "   0  broadcasts that a fault had given other values",
        "   0  frames under a robot's id that it did not send",
        "   0  broadcasts that the log lacks",
        "   0  broadcasts after the events were cut off",
        "  16  other frames",
        "ASDF-: only the flawed robots recalibrate",
        f"again: mcp-asdf replay {shlex.quote(str(swarm_log))}",
    ]


def test_replay_reports_a_difference_if_the_events_are_of_another_run(
    swarm_log: Path, tmp_path: Path, capsys: Capture
) -> None:
    """The other run has the seed 4 and not 3, so its robots observe other tiles.

    Replay ends with exit code 1.
    """
    record_swarm(tmp_path / "other.log", f"{FOUR_ROBOTS_IN_40_STEPS} --seed 4")
    assert main(["replay", str(swarm_log), "--events", str(tmp_path / "other.log.events")]) == 1
    assert capsys.readouterr().err.startswith("mcp-asdf replay: not reproduced: frame ")


@pytest.fixture(scope="module")
def log_of_two_buses(swarm_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log, and its events, of a swarm whose 176 frames passed on vcan0 and on vcan1: ``candump any``."""
    log = tmp_path_factory.mktemp("two_buses") / "any.log"
    with log.open("w") as file:
        for line in swarm_log.read_text().splitlines(keepends=True):
            file.write(line)
            file.write(line.replace(" vcan0 ", " vcan1 "))
    events_path(log).write_bytes(events_path(swarm_log).read_bytes())
    return log


def test_replay_advises_to_choose_a_bus_if_a_log_has_every_frame_twice(
    log_of_two_buses: Path, capsys: Capture
) -> None:
    """The log has the frames of vcan0 and of vcan1, which are the same.

    The second copy of a frame is a difference, as a robot makes each broadcast once: exit code 1.
    """
    assert main(["replay", str(log_of_two_buses)]) == 1
    assert (
        f"mcp-asdf replay: {log_of_two_buses} has frames of vcan0 and vcan1: if it has the same frames of "
        "each, choose one by --channel\n"
    ) in capsys.readouterr().err


@pytest.mark.parametrize("channel", ["vcan0", "vcan1"])
def test_replay_reproduces_the_frames_of_the_bus_that_is_chosen(
    channel: str, log_of_two_buses: Path, capsys: Capture
) -> None:
    """The report counts the frames of both buses. The verdict is on the frames of the chosen bus.

    Each bus has 160 broadcasts and 16 heartbeats.
    """
    assert main(["replay", str(log_of_two_buses), "--channel", channel, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)

    assert report["channel"] == channel
    assert report["channels"] == {"vcan0": 160 + 16, "vcan1": 160 + 16}
    expected_verdict = ReplayVerdict(reproduced=160, other=16)
    assert report["verdict"] == vars(expected_verdict)  # its attributes by their names


def test_replay_refuses_a_bus_that_the_log_lacks(swarm_log: Path, capsys: Capture) -> None:
    """The error offers the buses of the log. Exit code 2 stands for a wrong use."""
    assert main(["replay", str(swarm_log), "--channel", "vcan7"]) == 2
    assert "has no frame of vcan7, but of vcan0; choose one of them" in capsys.readouterr().err


def test_replay_warns_of_lines_that_are_no_frames(swarm_log: Path, tmp_path: Path, capsys: Capture) -> None:
    """Behind the 176 frames of the log there are a comment and a frame with half a byte."""
    log = tmp_path / "odd.log"
    comment, frame_with_half_a_byte = "# the end\n", "(1.0) vcan0 186BB92A#0\n"
    log.write_text(swarm_log.read_text() + comment + frame_with_half_a_byte)
    assert main(["replay", str(log), "--events", str(events_path(swarm_log)), "--json"]) == 0
    output, errors = capsys.readouterr()

    assert json.loads(output)["skipped_lines"] == 2
    assert errors == (
        f"mcp-asdf replay: of {log} 2 lines are no frames and were left out; the first is line 177, "
        "'# the end'\n"
    )


@pytest.fixture
def folder_of_odd_files(swarm_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the working directory one with a log, its events, and files that cannot be replayed.

    run.log and run.log.events are of a swarm, lone.log has no events beside it, run.xyz has a suffix of no
    format, and late.log and other.log have one frame: with a time beyond 3000 years, and of another sender.
    """
    monkeypatch.chdir(tmp_path)
    Path("run.log.events").write_bytes(events_path(swarm_log).read_bytes())
    for name in ("run.log", "lone.log", "run.xyz"):
        Path(name).write_text(swarm_log.read_text())
    Path("empty.log").touch()
    Path("late.log").write_text("(100000000000.0) vcan0 123#00 R\n")
    Path("other.log").write_text("(0.0) vcan0 123#00 R\n")


@pytest.mark.parametrize(
    ("arguments", "expected_message"),
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
def test_replay_names_the_file_that_it_cannot_use(
    arguments: str, expected_message: str, capsys: Capture
) -> None:
    """Only run.log and its events can be replayed; each other file is missing, empty or of another kind.

    Exit code 2 stands for a wrong use.
    """
    assert main(["replay", *arguments.split()]) == 2
    assert expected_message in capsys.readouterr().err
