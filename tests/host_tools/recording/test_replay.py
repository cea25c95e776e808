"""Robots run again from a log send the same bits; any other value is found, and no malformed file is read."""

from __future__ import annotations

import gzip
import json
import random
import shlex
from copy import copy
from decimal import Decimal
from pathlib import Path
from typing import Any

import can
import pytest

from events_files import events_file
from mcp_asdf.robot import Config, Filter, Observation
from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    alpha_float32_bits,
    decode_estimate,
    encode_estimate,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.events import (
    EventsHeader,
    EventsReader,
    InjectedFrame,
    RobotEvents,
    events_path,
)
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.recording.replay import ReplayVerdict, rerun, verify
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.fault_injection.kinds import FAULT_KINDS
from mcp_asdf_tools.tables.thresholds import generate
from messages import FRAMES
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
    with EventsReader(events_path(log)) as reader:
        return verify(frames, reader)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_every_format_is_reproduced(
    suffix: str, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Converted as can_logconvert does."""
    log = tmp_path / f"run{suffix}"
    with can.LogReader(recorded) as reader, can.Logger(log) as logger:
        for frame in reader:
            logger(frame)
    assert main(["replay", str(log), "--events", str(events_path(recorded)), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == vars(ReplayVerdict(reproduced=BROADCASTS, other=16))
    assert not report["incomplete"]


@pytest.mark.parametrize(
    "options",
    [
        "--firmware mirror",
        "--firmware reference",
        "--comms-period 5",
        "--filter none --subject 9",
        "--filter robust",
        "--filter robust --firmware mirror --topology dynamic --density 2",
    ],
)
def test_every_robot_is_reproduced_and_gaps_are_no_difference(options: str, tmp_path: Path) -> None:
    frames, draw = swarm(tmp_path / "run.log", options), random.Random(8)
    made = BROADCASTS // (5 if "comms" in options else 1)
    assert check(frames, tmp_path / "run.log") == ReplayVerdict(reproduced=made, other=16)
    verdict = check([frame for frame in frames if draw.random() < 0.3], tmp_path / "run.log")
    assert verdict.difference is None, "replay: random.Random(8)"
    assert verdict.reproduced + verdict.not_logged == made
    assert made / 5 < verdict.reproduced < made / 2


NEEDED = {"collide": ",id=2", "sybil": ",ids=2+100", "crash": ",rejoin=restored --fault crash=0.01"}
FAULTS = " ".join(f"--fault {kind.name}=0.3{NEEDED.get(kind.name, '')}" for kind in FAULT_KINDS)


@pytest.mark.parametrize(
    "options",
    ["--seed 1", "--seed 4 --comms-period 5", "--topology dynamic --density 2 --channel 'bus{robot}'"],
)
def test_what_faults_did_is_no_difference(options: str, tmp_path: Path) -> None:
    """Among so many frames of strangers some equal a broadcast that is still to come."""
    log = tmp_path / "run.log"
    frames = swarm(log, f"--steps 120 {options} {FAULTS}")
    verdict = check(frames, log)
    assert verdict.difference is None, f"replay: mcp-asdf swarm {SMALL} --steps 120 {options} {FAULTS}"
    counts = (verdict.foreign, verdict.reproduced, verdict.falsified, verdict.other)
    assert min(counts) > 0 and sum(counts) == len(frames)
    for fault in json.loads(Path(f"{log}.json").read_text())["results"]["faults"]:
        assert fault["injected"] > 0, fault


def values(frame: can.Message) -> str:
    """Values as a difference tells them."""
    said, alpha = decode_estimate(frame, FrameFormat()), alpha_float32_bits(frame)
    assert isinstance(said, Estimate)
    return (
        f"x_hat {said.x_hat:#08x} ({said.x_hat / 2**23:.7f}), "
        f"alpha {alpha:#010x} ({float32_value(alpha):.7g}), "
        f"transfer_id {said.transfer_id}"
    )


@pytest.mark.parametrize("seed", range(20))
def test_one_wrong_bit_is_found_where_it_is(seed: int, recorded: Path) -> None:
    frames, draw = list(read_log(recorded)), random.Random(seed)
    estimates = [
        n for n, frame in enumerate(frames) if isinstance(decode_estimate(frame, FrameFormat()), Estimate)
    ]
    place = draw.choice(estimates)
    right = copy(frames[place])
    bit = draw.randrange(55) if seed else 24  # of alpha's last bit robots make no use
    content = int.from_bytes(frames[place].data, "little") ^ 1 << bit
    frames[place].data = bytearray(content.to_bytes(8, "little"))
    verdict = check(frames, recorded)
    said = decode_estimate(frames[place], FrameFormat())
    if isinstance(said, Estimate):
        tick = 10 * (place // 44) + place % 44 // 4  # after 4 heartbeats
        told = f"robot {said.sender} broadcast {values(frames[place])}, but in tick {tick} it makes "
        assert verdict.difference is not None, f"replay: random.Random({seed})"
        assert verdict.difference.startswith(f"frame {place + 1} at ")
        assert verdict.difference.endswith(told + values(right))
    else:  # no legal estimate any more: one that the log lacks
        assert (verdict.difference, verdict.not_logged) == (None, 1)


def test_the_command_says_what_it_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swarm(tmp_path / "other.log", "--seed 4")
    others = events_path(tmp_path / "other.log")
    capsys.readouterr()
    assert main(["replay", str(recorded)]) == 0
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        *(" 160  broadcasts reproduced bit for bit", "   0  broadcasts that a fault had given other values"),
        *("   0  frames under a robot's id that it did not send", "   0  broadcasts that the log lacks"),
        *("   0  broadcasts after the events were cut off", "  16  other frames"),
        "ASDF-: only the flawed robots recalibrate",
        f"again: mcp-asdf replay {recorded}",
    ]
    assert main(["replay", str(recorded), "--events", str(others)]) == 1
    assert capsys.readouterr().err.startswith("mcp-asdf replay: not reproduced: frame ")


def test_every_settle_shows_its_robot(recorded: Path) -> None:
    with EventsReader(events_path(recorded)) as reader:
        shown = [(robot, state.t) for robot, state in rerun(reader)]
    assert shown == [(robot, tick) for tick in range(1, 41) for robot in range(4)]


def test_frames_under_a_robots_id_are_told_apart(tmp_path: Path) -> None:
    log, robot = tmp_path / "x", BusRobot(record(5), FrameFormat())
    stranger = encode_estimate(Estimate(5, 77, ALPHA_ONE, 1), FrameFormat())
    header = EventsHeader([record(5)], None, FrameFormat())
    with events_file(events_path(log), header) as writer:
        writer.recorders[5].record_observation(Observation.BLACK)
        writer.recorders[5].record_foreign_frame(stranger)
    robot.observe(Observation.BLACK)
    own = robot.broadcast(0)
    for order in ([own, stranger], [stranger, own]):
        assert check(order, log) == ReplayVerdict(reproduced=1, foreign=1)
    for order, told in (
        ([stranger, stranger, own, own], "frame 2 at 0.000000 s: robot 5 broadcast x_hat 0x00004d"),
        ([own, own], ", but makes no more broadcasts"),
    ):
        verdict = check(order, log)
        assert told in (verdict.difference or "") and verdict.not_logged == 0
    assert check([], log) == ReplayVerdict(not_logged=1)
    with EventsReader(events_path(log)) as reader:
        assert [*rerun(reader)] == []  # a tick that is open, and a frame
    events_path(log).rename(events_path(log.with_name("x.part")))  # of a run that was cut off
    with gzip.open(events_path(log.with_name("x.part")), "at") as part:
        part.write("[5,")
    later = [encode_estimate(Estimate(5, 0, 0, turn), FrameFormat()) for turn in (1, 2, 3)]
    assert check([own, *later], log.with_name("x.part")) == ReplayVerdict(reproduced=1, beyond=3)


# Logs of several buses, and lines that are no frames


def of_two_buses(recorded: Path, log: Path) -> None:
    """Write a log as ``candump any`` does where each frame passes on two buses."""
    lines = recorded.read_text().splitlines(keepends=True)
    log.write_text("".join(copy for line in lines for copy in (line, line.replace(" vcan0 ", " vcan1 "))))


def test_replay_names_the_buses_of_a_log_that_has_every_frame_twice(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "any.log"
    of_two_buses(recorded, log)
    assert main(["replay", str(log), "--events", str(events_path(recorded))]) == 1
    assert (
        f"mcp-asdf replay: {log} has frames of vcan0 and vcan1: if it has the same frames of each, "
        "choose one by --channel\n"
    ) in capsys.readouterr().err


@pytest.mark.parametrize("channel", ["vcan0", "vcan1"])
def test_replay_checks_one_bus_of_a_log(
    channel: str, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, events = tmp_path / "any.log", str(events_path(recorded))
    of_two_buses(recorded, log)
    assert main(["replay", str(log), "--events", events, "--channel", channel, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["channel"], report["channels"]) == (channel, {"vcan0": 176, "vcan1": 176})
    assert report["verdict"] == vars(ReplayVerdict(reproduced=BROADCASTS, other=16))


def test_replay_refuses_a_bus_that_the_log_has_not(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recorded), "--channel", "vcan7"]) == 2
    assert "has no frame of vcan7, but of vcan0; choose one of them" in capsys.readouterr().err


def test_replay_counts_the_lines_that_are_no_frames(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, events = tmp_path / "odd.log", str(events_path(recorded))
    log.write_text(f"\ufeff{recorded.read_text()}# the end\n(1.0) vcan0 186BB92A#0\n")
    assert main(["replay", str(log), "--events", events, "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["skipped_lines"] == 2
    assert json.loads(said.out)["verdict"]["reproduced"] == BROADCASTS
    told = "2 lines are no frames and were left out; the first is line 177, '# the end'"
    assert said.err == f"mcp-asdf replay: of {log} {told}\n"


# The file of events

RECORDS = (
    record(0, "native", 0.1 + 0.2),
    record(7, "mirror", filter=Filter.ALWAYS, comms_period=5, memory=64),
    RobotSetup(127, "reference", 0.95, Config(None, Filter.OFF, filter_period=3)),
    RobotSetup(3, "native", 2.0**-20, Config(generate(Decimal("0.123456789"), 2))),
)
HEADER = EventsHeader(RECORDS, 5, FrameFormat(17, 2), {"fill_ratio": 0.55, "faults": ["loss=0.5"]})


def test_the_events_of_a_robot_come_back_in_their_order(tmp_path: Path) -> None:
    with events_file(tmp_path / "x", HEADER) as writer:
        recorder = writer.recorders[7]
        recorder.record_observation(Observation.BLACK)
        recorder.record_estimates([[3, 2**23, 2**32 - 1], [127, 0, 0]])
        recorder.record_settle()
        recorder.record_observation(None)
        recorder.record_false_values(5, 2**31)
        recorder.record_silence()
        recorder.record_restart()
    with EventsReader(tmp_path / "x") as reader:
        assert list(reader.entries()) == [
            RobotEvents(7, [1, [3, 2**23, 2**32 - 1], [127, 0, 0], 3]),
            RobotEvents(7, [2, [5, 2**31], "silent", "restart"]),
        ]


def test_injected_frames_come_back_as_candump_writes_them(tmp_path: Path) -> None:
    with events_file(tmp_path / "x", HEADER) as writer:
        for frame in FRAMES.values():
            writer.record_injected_frame(frame)
    with EventsReader(tmp_path / "x") as reader:
        assert list(reader.entries()) == [InjectedFrame(text) for text in FRAMES]


def test_the_header_comes_back(tmp_path: Path) -> None:
    with events_file(tmp_path / "x", HEADER):
        pass
    with EventsReader(tmp_path / "x") as reader:
        assert reader.header == HEADER


def test_a_flood_of_estimates_is_written_in_lines_that_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mcp_asdf_tools.recording.events._MAX_EVENTS_PER_LINE", 10)
    with events_file(tmp_path / "x", HEADER) as writer:
        for _ in range(4):
            writer.recorders[7].record_estimates([[3, 1, 2]] * 6)
    with EventsReader(tmp_path / "x") as reader:
        assert [entry.events for entry in reader.entries() if isinstance(entry, RobotEvents)] == [
            [[3, 1, 2]] * 12,
            [[3, 1, 2]] * 12,
        ]


VERSION_3 = HEADER.to_line().replace('"version": 4', '"version": 3')


def test_events_of_version_3_are_read(tmp_path: Path) -> None:
    """They are plain text, and a mask stands for the last estimates of its senders, here of 0 and 3."""
    (tmp_path / "x").write_text(f'{VERSION_3}[7,1,[3,9,8],[0,1,2],3]\n[0,1,"9",[3,5,5],3]\n')
    with EventsReader(tmp_path / "x") as reader:
        assert list(reader.entries()) == [
            RobotEvents(7, [1, [3, 9, 8], [0, 1, 2], 3]),
            RobotEvents(0, [1, [0, 1, 2], [3, 9, 8], [3, 5, 5], 3]),
        ]


def test_a_log_with_events_of_version_3_is_replayed() -> None:
    """Both were written before version 4."""
    log = Path(__file__).parent / "version_3.log"
    assert check(list(read_log(log)), log) == ReplayVerdict(reproduced=51, falsified=5, foreign=2, other=8)


def test_compressed_events_that_were_cut_are_refused_with_the_line(recorded: Path, tmp_path: Path) -> None:
    data = events_path(recorded).read_bytes()
    (tmp_path / "x").write_bytes(data[: len(data) // 2])
    with (
        EventsReader(tmp_path / "x") as reader,
        pytest.raises(UsageError, match=r"x, line \d+: .*was it cut"),
    ):
        list(reader.entries())


def test_damaged_compressed_events_are_refused(recorded: Path, tmp_path: Path) -> None:
    data = bytearray(events_path(recorded).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "x").write_bytes(data)
    with pytest.raises(UsageError, match=r"x, line \d+: "), EventsReader(tmp_path / "x") as reader:
        list(reader.entries())


def test_a_part_of_compressed_events_is_read_up_to_any_cut(tmp_path: Path) -> None:
    whole, part = tmp_path / "x.events", tmp_path / "x.events.part"
    with events_file(whole, HEADER) as writer:
        for tick in range(5):
            writer.recorders[7].record_estimates([[3, tick, tick]])
            writer.recorders[7].record_settle()
    with EventsReader(whole) as reader:
        entries = list(reader.entries())
    data = whole.read_bytes()
    for size in range(len(data) - 30, len(data) + 1):
        part.write_bytes(data[:size])
        with EventsReader(part) as reader:
            read_entries = list(reader.entries())
        assert read_entries == entries[: len(read_entries)]
    assert read_entries == entries


def test_a_line_without_an_end_does_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mcp_asdf_tools.recording.events.MAX_LINE_LENGTH", 2000)
    with gzip.open(tmp_path / "x", "wt") as file:
        file.write(HEADER.to_line() + "[" + 10**6 * "0,")
    reader = EventsReader(tmp_path / "x")
    with reader, pytest.raises(UsageError, match="line 2: not JSON of at most 2000 characters"):
        list(reader.entries())


@pytest.mark.parametrize(("options", "ratio"), [("", 0.6), ("--fault loss=0.3", 1.1)])
def test_the_events_of_many_robots_are_hardly_larger_than_the_log(
    options: str, ratio: float, tmp_path: Path
) -> None:
    """The sizes of docs/radio.md."""
    log = tmp_path / "run.log"
    assert main(["swarm", *f"--robots 100 --steps 12 --quiet --log {log} {options}".split()]) == 0
    assert ratio - 0.2 < events_path(log).stat().st_size / log.stat().st_size < ratio
    assert check([*read_log(log)], log).reproduced == 1200


# Malformed files


def spoiled(**changes: Any) -> str:
    """A header with changes, of the first robot if they name something of robots."""
    plain = json.loads(HEADER.to_line())
    for name, value in changes.items():
        target = plain if name in plain else plain["robots"][0]
        target[name] = value
    return json.dumps(plain)


GOOD = HEADER.to_line()
EVENTS = {
    "": '1: "format": "mcp-asdf events" is missing',
    "\n": "1: not JSON",
    "{}": '1: "format": "mcp-asdf events" is missing',
    "(1.0) vcan0 1#00": "1: not JSON",
    "[" * 100_000: "1: not JSON",
    "\xff\xfe": "1: not JSON",
    spoiled(version=2): "1: the format is version 2, and versions 3 and 4 are read here; replay",
    spoiled(version=5): "1: the format is version 5, and versions 3 and 4 are read here",
    spoiled(robots=5): "1: ",
    spoiled(frames={"subject": 6144, "priority": 4}): "1: subject is 6144",
    spoiled(filter="sometimes"): "1: filter is 'sometimes'; it must be one of adaptive, always, off",
    spoiled(table={"omega": "x", "q": 20, "checksum": 1}): "1: ",
    spoiled(table={"omega": "0.05", "q": 20}): "1: 'checksum' is missing",
    f"{GOOD}[0,1": "2: not JSON",
    f"{GOOD}\n": "2: not JSON",
    f"{GOOD}[0,1,3]\n{{}}": "3: neither a robot with its events nor a frame",
    f"{GOOD}[]": "2: neither a robot",
    f"{GOOD}[5,1]": "2: robot 5 is not in the first line",
    f'{GOOD}[0,1,[1,2,3],"2"]\n[7,1,"6",3]': "3: '6' refers to a robot of which no message is told before",
    f'{GOOD}[0,3]\n[0,3,"silent"]': "3: robot 0 has a broadcast silent before it made one",
    **{
        f"{GOOD}[0,{event}]": f"2: {event.replace(',', ', ').replace(chr(34), chr(39))} is no event"
        for event in (
            "4",
            "-1",
            "1.0",
            "[1]",
            "[1,2,-3]",
            "[1,2,4294967296]",
            '"lost"',
            '""',
            f'"{"1" * 33}"',
        )
    },
}
"""Files of events, and what is told of which line."""
FILES = {
    "absent.log --events run.log.events": "cannot read the log absent.log: No such file",
    ". --events run.log.events": "cannot read the log .: Is a directory",
    "run.log --events absent": "cannot read absent: No such file",
    "run.log --events run.log": "run.log, line 1: not JSON",
    "lone.log": "there is no lone.log.events, without which nothing can be checked: swarm, radio and node",
    "late.log --events run.log.events": "the log late.log holds no frame: line 1, '(100000000000.0) vcan0 1",
    "run.log.events": "run.log.events is what happened to the robots of a log; give the log, run.log",
    "empty.log": "the log empty.log is empty: the disk was full, or nothing was sent yet",
    "run.xyz --events run.log.events": "the log run.xyz cannot be opened, or its suffix is wrong: it must be",
    "other.log --events run.log.events": "other.log holds no estimate of the robots in run.log.events",
}
"""Arguments of ``replay``, and what is told of the files."""


MALFORMED = [
    *(("run.log --events x.events", text, f"x.events, line {told}") for text, told in EVENTS.items()),
    *((arguments, "", told) for arguments, told in FILES.items()),
]


@pytest.fixture
def place(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Be where these files are."""
    monkeypatch.chdir(tmp_path)
    lines = recorded.read_text().splitlines(keepends=True)
    Path("run.log.events").write_bytes(events_path(recorded).read_bytes())
    for name in ("run.log", "lone.log", "run.xyz"):
        Path(name).write_text("".join(lines))
    Path("empty.log").touch()
    Path("late.log").write_text("(100000000000.0) vcan0 123#00 R\n")
    Path("other.log").write_text("(0.0) vcan0 123#00 R\n")


@pytest.mark.parametrize(("arguments", "events", "told"), MALFORMED, ids=lambda text: text[-60:])
@pytest.mark.usefixtures("place")
def test_a_malformed_file_is_refused(
    arguments: str, events: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("x.events").write_text(events, "latin-1")
    assert main(["replay", *arguments.split()]) == 2
    assert told in capsys.readouterr().err
