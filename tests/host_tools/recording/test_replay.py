"""Robots run again from a log send the same bits; any other value is found, in every format."""

from __future__ import annotations

import json
import random
import shlex
import shutil
from copy import copy
from pathlib import Path

import can
import pytest

from input_logs import input_log_in
from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import FrameFormat, Message, alpha_bits, decode, encode, float_of
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.input_log import InputLogHeader, InputLogReader, input_log_path
from mcp_asdf_tools.recording.replay import ReplayVerdict, rerun, verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.fault_spec import FaultKind
from robots import ALPHA_ONE
from wire import record

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

SMALL = "--robots 4 --steps 40 --filter-period 10 --flawed 0.5 --seed 3 --quiet"
BROADCASTS = 4 * 40


def swarm(log: Path, options: str = "") -> list[can.Message]:
    """Run a small swarm; returns what its log holds."""
    assert main(["swarm", *shlex.split(f"{SMALL} {options}"), "--log", str(log)]) == 0
    return list(read_log(log))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a small swarm, for reading only."""
    log = tmp_path_factory.mktemp("swarm") / "run.log"
    swarm(log)
    return log


def check(frames: list[can.Message], log: Path) -> ReplayVerdict:
    with InputLogReader(input_log_path(log)) as input_log:
        return verify(frames, input_log)


# Checking


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_every_format_is_reproduced(
    suffix: str, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Converted as can_logconvert does."""
    log = tmp_path / f"run{suffix}"
    with can.LogReader(recorded) as reader, can.Logger(log) as logger:
        for frame in reader:
            logger(frame)
    assert main(["replay", str(log), "--events", str(input_log_path(recorded)), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == vars(ReplayVerdict(reproduced=BROADCASTS, other=16))
    assert not report["incomplete"]


@pytest.mark.parametrize(
    "options",
    ["--firmware mirror", "--firmware reference", "--set comms-period=5", "--filter none --set subject=9"],
)
def test_every_robot_is_reproduced_and_gaps_are_no_difference(options: str, tmp_path: Path) -> None:
    frames, draw = swarm(tmp_path / "run.log", options), random.Random(8)
    made = BROADCASTS // (5 if "comms" in options else 1)
    assert check(frames, tmp_path / "run.log") == ReplayVerdict(reproduced=made, other=16)
    verdict = check([frame for frame in frames if draw.random() < 0.3], tmp_path / "run.log")
    assert verdict.difference is None, "replay: random.Random(8)"
    assert verdict.reproduced + verdict.not_logged == made
    assert made / 5 < verdict.reproduced < made / 2


FAULTS = " ".join(f"--fault {kind.value}=0.3" + ",id=2" * (kind is FaultKind.COLLIDE) for kind in FaultKind)


@pytest.mark.parametrize(
    "options",
    ["--seed 1", "--seed 4 --set comms-period=5", "--topology dynamic --density 2 --channel 'bus{robot}'"],
)
def test_what_faults_did_is_no_difference(options: str, tmp_path: Path) -> None:
    """Among so many frames of strangers some equal a broadcast that is still to come."""
    log = tmp_path / "run.log"
    verdict = check(swarm(log, f"--steps 120 {options} {FAULTS}"), log)
    assert verdict.difference is None, f"replay: mcp-asdf swarm {SMALL} --steps 120 {options} {FAULTS}"
    assert min(verdict.foreign, verdict.reproduced, verdict.falsified) > 0
    for fault in json.loads(Path(f"{log}.json").read_text())["results"]["faults"]:
        assert fault["injected"] > 0, fault


def values(x_hat: int, alpha: int, transfer_id: int) -> str:
    """Values as a difference tells them."""
    return (
        f"x_hat {x_hat:#08x} ({x_hat / 2**23:.7f}), alpha {alpha:#010x} ({float_of(alpha):.7g}), "
        f"transfer_id {transfer_id}"
    )


@pytest.mark.parametrize("seed", range(20))
def test_one_wrong_bit_is_found_where_it_is(seed: int, recorded: Path) -> None:
    frames, draw = list(read_log(recorded)), random.Random(seed)
    estimates = [n for n, frame in enumerate(frames) if isinstance(decode(frame, FrameFormat()), Message)]
    place = draw.choice(estimates)
    right = copy(frames[place])
    bit = draw.randrange(55) if seed else 24  # of alpha's last bit robots make no use
    content = int.from_bytes(frames[place].data, "little") ^ 1 << bit
    frames[place].data = bytearray(content.to_bytes(8, "little"))
    verdict = check(frames, recorded)
    said = decode(frames[place], FrameFormat())
    if isinstance(said, Message):
        assert verdict.difference is not None, f"replay: random.Random({seed})"
        assert verdict.difference.startswith(f"frame {place + 1} at ")
        told = (
            f"robot {said.sender} broadcast {values(said.x_hat, alpha_bits(frames[place]), said.transfer_id)}"
        )
        before = decode(right, FrameFormat())
        assert isinstance(before, Message)
        tick = 10 * (place // 44) + place % 44 // 4  # after 4 heartbeats
        made = values(before.x_hat, alpha_bits(right), before.transfer_id)
        assert verdict.difference.endswith(f"{told}, but in tick {tick} it makes {made}")
    else:  # no legal estimate any more: one that the log lacks
        assert (verdict.difference, verdict.not_logged) == (None, 1)


def test_a_wrong_observation_is_found(recorded: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    lines = input_log_path(recorded).read_text().splitlines()
    events = json.loads(lines[30])
    assert events[1] in (0, 1)
    events[1] = 1 - events[1]
    input_log_path(log).write_text("\n".join([*lines[:30], json.dumps(events), *lines[31:]]))
    assert f": robot {events[0]} broadcast " in (check(list(read_log(recorded)), log).difference or "")


def test_every_settle_shows_its_robot(recorded: Path) -> None:
    with InputLogReader(input_log_path(recorded)) as input_log:
        shown = [(robot, state.t) for robot, state in rerun(input_log)]
    assert shown == [(robot, tick) for tick in range(1, 41) for robot in range(4)]


def test_frames_under_a_robots_id_are_told_apart(tmp_path: Path) -> None:
    log, robot = tmp_path / "x", BusRobot(record(5), FrameFormat())
    stranger = encode(Message(5, 77, ALPHA_ONE, 1), FrameFormat())
    header = InputLogHeader([record(5)], None, FrameFormat())
    with input_log_in(input_log_path(log), header) as writer:
        writer.robots[5].observe(Observation.BLACK)
        writer.robots[5].foreign(stranger)
    (own,) = robot.broadcast(Observation.BLACK, 0)
    for order in ([own, stranger], [stranger, own]):
        assert check(order, log) == ReplayVerdict(reproduced=1, foreign=1)
    for order, told in (
        ([stranger, stranger, own], "frame 2 at 0.000000 s: robot 5 broadcast x_hat 0x00004d"),
        ([own, own], ", but makes no more broadcasts"),
    ):
        assert told in (check(order, log).difference or "")
    assert check([], log) == ReplayVerdict(not_logged=1)


def test_a_input_log_that_contradicts_itself_is_named(tmp_path: Path) -> None:
    header = InputLogHeader([record(5)], None, FrameFormat())
    with input_log_in(tmp_path / "x.events", header) as writer:
        writer.robots[5].settle()
        writer.robots[5].silent()
    with pytest.raises(UsageError, match="line 3: robot 5 has a broadcast silent before it made one"):
        check([], tmp_path / "x")


# The command

BAD = {
    "absent.log --events run.log.events": "cannot read the log absent.log: No such file",
    ". --events run.log.events": "cannot read the log .: Is a directory",
    "run.log --events absent": "cannot read absent: No such file",
    "run.log --events run.log": "run.log, line 1: not JSON",
    "lone.log": "there is no lone.log.events, without which nothing can be checked; give it as --events",
    "cut.log --events run.log.events": "the log cut.log is malformed after frame 3 ",
    "empty.log --events run.log.events": "the log empty.log holds no frame",
    "run.xyz --events run.log.events": "the log run.xyz is malformed after frame 0 ",
    "other.log --events run.log.events": "other.log holds no estimate of the robots in run.log.events",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str,
    recorded: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (recorded, input_log_path(recorded)):
        shutil.copy(path, tmp_path)
    lines = Path("run.log").read_text().splitlines(keepends=True)
    for name, text in (
        ("lone.log", lines),
        ("cut.log", [*lines[:3], lines[3][:20]]),
        ("empty.log", []),
        ("run.xyz", lines),
        ("other.log", ["(0.0) vcan0 123#00 R\n"]),
    ):
        Path(name).write_text("".join(text))
    assert main(["replay", *arguments.split()]) == 2
    captured = capsys.readouterr()
    assert BAD[arguments] in captured.err
