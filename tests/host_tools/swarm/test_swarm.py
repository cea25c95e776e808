"""The swarm on python-can's virtual bus: lockstep, exactness, reproducibility, and every way to end."""

from __future__ import annotations

import io
import json
import os
import resource
import shlex
import signal
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any, cast

import can
import numpy as np
import pytest
from can.interfaces import virtual
from rich.console import Console

from mcp_asdf.fixed_point import alpha_units, word_to_alpha
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Filter, FixedPointRobot, Robot, Status
from mcp_asdf_tools.bus.frames import (
    ONE,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
    encode,
)
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import read_log
from mcp_asdf_tools.robots import record as robot_record
from mcp_asdf_tools.robots.bus_robot import RoundingPort
from mcp_asdf_tools.robots.firmwares import FIRMWARES, load_firmware
from mcp_asdf_tools.robots.population import Filtering
from mcp_asdf_tools.swarm import carrier as connection
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.plot import draw
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.summary import summary, summary_table
from mcp_asdf_tools.swarm.swarm import MAX_SAMPLES, QUANTITIES, Swarm, SwarmHook, SwarmRun, run_swarm
from mcp_asdf_tools.tables.thresholds import generate
from support import interruptible, slow

pytestmark = pytest.mark.usefixtures("private_setup")

SMALL = ("--robots", "4", "--steps", "30", "--filter-period", "10")
EXACT = ("native", "mirror")


def open_bus(robot: int = 0) -> can.BusABC:
    """Join a virtual bus of this test's own, the same for all robots."""
    return can.Bus(interface="virtual", channel="test", preserve_timestamps=True, ignore_config=True)


def small(**changes: Any) -> SwarmSettings:
    """SwarmSettings of a short run with several filter periods."""
    return SwarmSettings(
        **{"robots": 5, "flawed": 0.4, "steps": 60, "filter_period": 20, "seed": 11} | changes
    )


def record(
    settings: SwarmSettings, hooks: list[SwarmHook] | None = None
) -> tuple[SwarmRun, list[can.Message]]:
    """A run and the frames it sent."""
    frames: list[can.Message] = []
    with Swarm(settings, Wiring(open_bus), frames.append) as swarm:
        return run_swarm(swarm, hooks or []), frames


def content(frames: list[can.Message]) -> list[tuple[int, bytes]]:
    """Identity of frames, without time and place."""
    return [(frame.arbitration_id, bytes(frame.data)) for frame in frames]


def rounds(frames: list[can.Message], robots: int) -> list[list[Message]]:
    """The messages among ``frames``, a list for each round."""
    decoded = [decode(frame, FrameFormat()) for frame in frames]
    found = iter([message for message in decoded if isinstance(message, Message)])
    return list(iter(lambda: list(islice(found, robots)), []))


# Lockstep


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("robots", [1, 2, 5])
def test_every_message_reaches_every_neighbour_once(firmware: str, robots: int) -> None:
    outcome, frames = record(small(firmware=firmware, robots=robots))
    figures = outcome.results["frames"]
    assert figures["sent"] == 60 * robots
    assert figures["delivered"] == 60 * robots * (robots - 1)
    assert figures["heartbeats_sent"] == 6 * robots
    assert figures["heartbeats_heard"] == 6 * robots * (robots - 1)
    assert (figures["refused"], figures["strays"], figures["rejected"]) == (0, 0, {})
    assert figures["id_conflicts"] == {}
    assert len(frames) == 66 * robots
    for node in outcome.nodes:
        assert node.heard == robots - 1
        assert node.robot.counters.accepted == 60 * (robots - 1)
        assert node.robot.t == 60


def test_rounds_are_complete_and_numbered() -> None:
    _, frames = record(small())
    every_round = rounds(frames, 5)
    assert len(every_round) == 60
    for number, messages in enumerate(every_round):
        assert [message.sender for message in messages] == list(range(5))
        assert {message.transfer_id for message in messages} == {number % 32}


def test_heartbeats_come_once_a_second_of_simulated_time() -> None:
    _, frames = record(small(steps_per_second=25))
    beats = [(frame.timestamp, decode_heartbeat(frame)) for frame in frames]
    found = [(when, beat) for when, beat in beats if isinstance(beat, Heartbeat)]
    assert [(when, beat.sender, beat.uptime, beat.transfer_id) for when, beat in found] == [
        (float(second), robot, second, second) for second in range(3) for robot in range(5)
    ]


def test_a_longer_period_sends_less_and_keeps_step() -> None:
    outcome, frames = record(small(comms_period=4))
    assert outcome.results["frames"]["sent"] == 60 // 4 * 5
    assert outcome.results["frames"]["delivered"] == 60 // 4 * 5 * 4
    assert len(rounds(frames, 5)) == 15
    # Heartbeats fall into ticks without a broadcast too; the log has them all.
    assert len(frames) == 15 * 5 + 6 * 5


@pytest.mark.parametrize("firmware", EXACT)
def test_all_informed_estimates_are_the_same_to_the_bit(firmware: str) -> None:
    """And equal what exact arithmetic makes of the frames alone (eq. 7, floored)."""
    estimates: list[set[int]] = []

    def note(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes]
        estimates.append({robot.x_raw for robot in robots if isinstance(robot, FixedPointRobot)})

    outcome, frames = record(small(firmware=firmware, steps=120), [note])
    assert outcome.results["updates"] > 0
    for found, messages in zip(estimates, rounds(frames, 5), strict=True):
        weights = [Fraction(word_to_alpha(message.alpha)) for message in messages]
        products = [weight * message.x_hat for weight, message in zip(weights, messages, strict=True)]
        assert found == {sum(products) // sum(weights) if sum(weights) else ONE // 2}


@pytest.mark.parametrize("firmware", EXACT)
@pytest.mark.parametrize(
    ("accuracy", "other", "weak", "strong"),
    [
        (0.95, 0.55, 2**24, 2**33),
        (1.0, 0.501, 2**10, 2**33),
        (0.5002, 0.3, 2**4, 2**31),
        (0.5, 0.4998, 0, 2**10),
    ],
)
def test_what_a_robot_uses_for_itself_is_what_its_neighbours_hear(
    firmware: str, accuracy: float, other: float, weak: int, strong: int
) -> None:
    """To the bit, over the bus: the social estimate of a robot with one neighbour is what that one uses."""
    heard: list[list[tuple[int, int]]] = []
    used: list[list[tuple[int, int]]] = []

    def note(swarm: Swarm) -> None:
        robots = [node.robot for node in swarm.nodes if isinstance(node.robot, FixedPointRobot)]
        own = [(robot.x_hat_raw, alpha_units(robot.alpha_raw)) for robot in robots]
        used.append([(x, alpha) if alpha else (ONE // 2, 0) for x, alpha in own])
        heard.append([(robot.x_bar_raw, robot.beta_raw) for robot in reversed(robots)])

    changes = {"true_accuracy": accuracy, "flawed_accuracy": other, "flawed": 0.5, "filter": "none"}
    record(small(robots=2, steps=200, firmware=firmware, **changes), [note])
    assert heard == used
    confidences = [alpha for pair in used for _, alpha in pair]
    assert min(confidences) <= weak < strong <= max(confidences)


def test_native_and_mirror_say_the_same_on_the_bus() -> None:
    logs = [content(record(small(firmware=firmware, steps=150))[1]) for firmware in EXACT]
    assert logs[0] == logs[1]


@pytest.mark.parametrize(
    ("deployment", "filtering"),
    [("asdf-plus", [0, 1, 2, 3, 4]), ("asdf-minus", [0, 1]), ("none", [])],
)
def test_who_filters(deployment: Filtering, filtering: list[int]) -> None:
    outcome, _ = record(small(filter=deployment))
    assert [node.id for node in outcome.nodes if node.robot.counters.tests] == filtering
    assert [node.id for node in outcome.nodes if outcome.settings.is_flawed(node.id)] == [0, 1]


def test_flawed_robots_recalibrate() -> None:
    """The point of it all: three of ten start at 0.55 and end near the true 0.95; unfiltered they stay."""
    changes = {"robots": 10, "flawed": 0.3, "fill_ratio": 0.95, "steps": 500, "filter_period": 125}
    filtered, _ = record(small(**changes))
    plain, _ = record(small(**changes, filter="none"))
    assert filtered.results["b_hat"]["flawed"]["robots"] == 3
    assert abs(filtered.results["b_hat"]["flawed"]["after"] - 0.95) < 0.03
    assert plain.results["b_hat"]["flawed"]["after"] == pytest.approx(0.55, abs=1e-6)
    assert plain.results["updates"] == 0


# SwarmSettings


@pytest.mark.parametrize(
    ("robots", "flawed", "count"),
    [(20, 0.3, 6), (10, 0.25, 3), (10, 0.24, 2), (7, 1.0, 7), (7, 0.0, 0), (1, 0.5, 1)],
)
def test_how_many_are_flawed(robots: int, flawed: float, count: int) -> None:
    assert SwarmSettings(robots=robots, flawed=flawed).flawed == count


@pytest.mark.parametrize("accuracy", [0.0, 1.0])
def test_certain_accuracies_are_kept_inside_what_the_firmware_takes(accuracy: float) -> None:
    outcome, _ = record(small(true_accuracy=accuracy, flawed_accuracy=1 - accuracy, steps=20))
    assert outcome.failure is None
    assert all(node.robot.t == 20 for node in outcome.nodes)


def test_robots_are_made_as_the_settings_say(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Config, int, float]] = []

    def make(config: Config, robot_id: int, b_hat: float) -> Robot:
        made.append((config, robot_id, b_hat))
        return load_firmware("mirror")(config, robot_id, b_hat)

    monkeypatch.setattr(robot_record, "load_firmware", lambda name: make)
    changes = {"omega": Decimal("0.2"), "memory": 64, "comms_period": 2, "filter": "asdf-minus"}
    record(small(**changes, flawed=0.2, robots=9))
    adaptive = Config(generate(Decimal("0.2"), 8), Filter.ADAPTIVE, filter_period=20 // 2, memory=64)
    off = replace(adaptive, table=None, filter=Filter.OFF)
    assert made == [(adaptive if i < 2 else off, i, 0.55 if i < 2 else 0.95) for i in range(9)]


def test_results_count_on_where_the_firmware_s_counters_wrap(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, _ = record(small(firmware="mirror"))
    assert plain.results["tests"] > plain.results["updates"] > 0

    def tested(config: Config, robot_id: int, b_hat: float) -> Robot:
        """A robot whose next test and next update are the last that it can count."""
        robot = MirrorRobot(config, robot_id, b_hat)
        robot.s.tests = robot.s.updates = 2**16 - 1
        return robot

    monkeypatch.setattr(robot_record, "load_firmware", lambda name: tested)
    later, _ = record(small(firmware="mirror"))
    for counter in ("tests", "updates"):
        assert later.results[counter] == 5 * (2**16 - 1) + plain.results[counter]
    assert any(node.robot.counters.tests < 2**15 for node in later.nodes)


class Confidant:
    """A robot's outside that notes its calls."""

    x_hat, alpha = 0.3, 2.0 / 3

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        self.told = (sender, x_hat, alpha)
        return Status.OK


def test_a_float_robot_speaks_rounded_integers_and_hears_exact_floats() -> None:
    robot = Confidant()
    port = RoundingPort(cast(Robot, robot))
    assert abs(Fraction(port.x_hat_raw, ONE) - Fraction(robot.x_hat)) <= Fraction(1, 2 * ONE)
    assert Fraction(alpha_units(port.alpha_raw), 2**24) == Fraction(robot.alpha) // Fraction(1, 2**24) / 2**24
    robot.x_hat, robot.alpha = 1 - 2.0**-25, 1e20
    assert (port.x_hat_raw, word_to_alpha(port.alpha_raw)) == (ONE, 2.0**31 - 2.0**7)
    assert port.receive_all(np.array([(3, ONE // 4, 0xA0000002)], np.uint32)) == 1
    assert robot.told == (3, 0.25, 2.5)


# Trouble on the bus


class Deaf(virtual.VirtualBus):
    """Loses every frame of robot 2 from the third round on."""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        frame, filtered = super()._recv_internal(timeout)
        message = None if frame is None else decode(frame, FrameFormat())
        if isinstance(message, Message) and message.sender == 2 and message.transfer_id >= 2:
            frame, filtered = super()._recv_internal(0)
        return frame, filtered


def test_a_lost_frame_ends_the_run_with_a_clear_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TIMEOUT", 0.05)
    with Swarm(small(), Wiring(lambda robot: Deaf("test"))) as swarm:
        outcome = run_swarm(swarm)
    assert outcome.failure is not None
    for part in ("tick 3", "the carrier did not hear frame 106BB802 within", "test"):
        assert part in outcome.failure
    assert outcome.results["steps"] == 2
    assert not outcome.interrupted


def test_foreign_traffic_is_counted_and_changes_nothing() -> None:
    """Garbage, and legal messages from outside the swarm or of another round."""
    undisturbed, clean = record(small())
    junk = [
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"1234"),
        can.Message(arbitration_id=0x106BB82A, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=0x106BB801, data=b"\xff" * 8),
        can.Message(arbitration_id=0x106BB801, data=b"\0" * 7),
        encode(Message(99, ONE, 0x4F000000, 5), FrameFormat()),
        encode(Message(1, ONE, 0x4F000000, 4), FrameFormat()),
    ]

    def disturb(swarm: Swarm) -> None:
        if swarm.ticks == 5:
            with open_bus() as other:
                for frame in junk:
                    other.send(frame, timeout=1)

    disturbed, frames = record(small(), [disturb])
    foreign = content(junk)
    assert [each for each in content(frames) if each in foreign] == foreign
    assert [each for each in content(frames) if each not in foreign] == content(clean)
    for quantity in QUANTITIES:
        assert np.array_equal(disturbed.history.values(quantity), undisturbed.history.values(quantity))
    figures = disturbed.results["frames"]
    assert figures["strays"] == 2 * 5
    assert figures["id_conflicts"] == {"1": 1}
    reasons = (Rejection.STANDARD_ID, Rejection.REMOTE_FRAME, Rejection.X_HAT, Rejection.LENGTH)
    assert figures["rejected"] == {reason.name: 5 for reason in reasons}


@pytest.mark.parametrize("returns_own", [False, True])
def test_a_second_node_with_a_robots_id_is_reported(returns_own: bool) -> None:
    """The bus may also return a robot's own frames; those are no collision."""

    def open_own(robot: int) -> can.BusABC:
        return can.Bus(interface="virtual", channel="shared id", receive_own_messages=returns_own)

    with (
        Swarm(small(), Wiring(open_own)) as swarm,
        can.Bus(interface="virtual", channel="shared id") as other,
    ):
        for turn in range(4):
            other.send(encode(Message(2, turn, turn, 30), FrameFormat()), timeout=1)
            swarm.tick()
        assert swarm.traffic.id_conflicts == {2: 4}
        run = run_swarm(swarm)
    text = io.StringIO()
    Console(file=text, width=200).print(summary_table(summary(run, "virtual", 1.0)))
    assert "another node sent 4 messages as robot 2" in text.getvalue()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_telemetry_is_every_robots_state_and_changes_nothing(firmware: str) -> None:
    """A frame of each robot every 7 ticks, with what the history says of that moment."""
    updates = {0: [0] * 5}

    def note(swarm: Swarm) -> None:
        updates[swarm.ticks] = [node.robot.counters.updates for node in swarm.nodes]

    silent, _ = record(small(firmware=firmware))
    outcome, frames = record(small(firmware=firmware, telemetry_period=7), [note])
    decoded = [decode_telemetry(frame) for frame in frames]
    found = [each for each in decoded if isinstance(each, Telemetry)]
    x, b_hat = (outcome.history.values(name) for name in ("x", "b_hat"))
    assert np.array_equal(x, silent.history.values("x"))
    assert [(each.sender, each.transfer_id) for each in found] == [
        (robot, turn % 32) for turn in range(9) for robot in range(5)
    ]
    for each in found:
        tick = 7 * each.transfer_id
        assert each.x == int(x[tick, each.sender] * ONE)
        assert each.b_hat == int(b_hat[tick, each.sender] * 2**24)
        assert each.updates == updates[tick][each.sender]
    figures = outcome.results["frames"]
    assert (figures["telemetry_sent"], figures["telemetry_heard"]) == (9 * 5, 9 * 5 * 4)
    assert figures["rejected"] == {}


def test_estimates_do_not_use_the_subject_of_telemetry() -> None:
    with pytest.raises(UsageError, match="subject 3001 is that of telemetry"):
        small(frames=FrameFormat(3001), telemetry_period=1)
    small(frames=FrameFormat(3001))


# Reproducibility and logs


def swarm_command(*arguments: str) -> int:
    return main(["swarm", *arguments])


def test_equal_seeds_give_equal_logs(tmp_path: Path) -> None:
    first, second, third = (tmp_path / name for name in ("1.log", "2.log", "3.log"))
    assert swarm_command(*SMALL, "--seed", "5", "--log", str(first)) == 0
    assert swarm_command(*SMALL, "--seed", "5", "--log", str(second)) == 0
    assert swarm_command(*SMALL, "--seed", "6", "--log", str(third)) == 0
    assert first.read_bytes() == second.read_bytes()
    assert Path(f"{first}.json").read_bytes() == Path(f"{second}.json").read_bytes()
    assert first.read_bytes() != third.read_bytes()


def test_a_log_keeps_every_frame(tmp_path: Path) -> None:
    _, frames = record(SwarmSettings(robots=4, steps=30, filter_period=10))
    path = tmp_path / "my.run.log"
    assert swarm_command(*SMALL, "--log", str(path), "--quiet") == 0
    with can.LogReader(path) as reader:
        read = list(reader)
    assert content(read) == content(frames)
    first = read[0].timestamp
    assert [round(frame.timestamp - first, 3) for frame in read] == [round(f.timestamp, 3) for f in frames]
    assert sorted(tmp_path.iterdir()) == sorted([path, Path(f"{path}.json"), Path(f"{path}.events")])


# The command


def test_json_is_one_object_and_stands_beside_the_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plot, log = tmp_path / "run.svg", tmp_path / "run.log"
    assert swarm_command(*SMALL, "--json", "--plot", str(plot), "--log", str(log)) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["parameters"]["seed"] == 1
    assert report["parameters"]["frames"] == {"subject": 3000, "priority": 4}
    assert report["bus"] == {"interface": "virtual", "channel": "vcan0", "slcan": None}
    assert report["results"]["frames"]["delivered"] == 30 * 4 * 3
    for path in (plot, log):
        assert json.loads(Path(f"{path}.json").read_text()) == report


@pytest.mark.parametrize(("seed", "is_low"), [(11, False), (15, True)])
def test_results_are_what_the_robots_hold(seed: int, is_low: bool) -> None:
    outcome, _ = record(small(seed=seed))
    assert (outcome.results["mean_x"] < 0.55) == is_low
    x = [Fraction(node.robot.x) for node in outcome.nodes]
    results = outcome.results
    assert results["mean_x"] == pytest.approx(float(sum(x) / 5), abs=1e-15)
    assert results["mean_error"] == pytest.approx(
        float(sum(abs(each - Fraction(0.55)) for each in x) / 5), abs=1e-15
    )
    assert results["spread_x"] == float(max(x) - min(x))
    flawed = [node.robot.b_hat for node in outcome.nodes[:2]]
    assert results["b_hat"]["flawed"]["before"] == pytest.approx(0.55, abs=1e-6)
    assert results["b_hat"]["other"]["before"] == pytest.approx(0.95, abs=1e-6)
    assert results["b_hat"]["flawed"]["after"] == pytest.approx(sum(flawed) / 2, abs=1e-15)
    assert results["updates"] == sum(node.robot.counters.updates for node in outcome.nodes)


def test_a_summary_names_the_seed_and_what_is_piped_has_fields(capsys: pytest.CaptureFixture[str]) -> None:
    """One line each, however long, so that cut and grep find what they look for."""
    assert swarm_command(*SMALL, "--seed", "42") == 0
    *lines, again = capsys.readouterr().out.splitlines()
    assert again.startswith("again: mcp-asdf swarm ") and again.endswith("--seed 42")
    rows = [line.split("\t") for line in lines]
    names = [name for name, *_ in rows]
    assert names[-6:] == ["estimate", "b_hat, flawed", "b_hat, other", "filter", "frames", "bus load"]
    assert set(names[:-7]) <= {"step", "robot"}
    assert [row[1] for row in rows if row[0] == "step"][-1] == "30"


def test_quiet_prints_one_line_with_the_seed(capsys: pytest.CaptureFixture[str]) -> None:
    assert swarm_command(*SMALL, "--seed", "42", "--quiet") == 0
    shown = capsys.readouterr().out
    assert shown.startswith("seed 42: ")
    assert shown.count("\n") == 1


BAD = {
    "--robots 0": "robots is 0",
    "--robots 129": "robots is 129",
    "--robots 127 --slcan 0": "with --slcan take at most 126",
    "--slcan 0 --channel vcan{robot}": "--slcan needs one bus for all",
    "--topology dynamic --density 0": "--density is 0.0; it must be 1e-06 to 1e+06",
    "--topology dynamic --density 1e5": "20 robots of 0.1408 m are too many for",
    "--set radio-range=1": "--set radio-range is 1.0 but robots do not move; choose topology dynamic",
    "--topology graph --graph none.txt": "cannot read the graph none.txt",
    "--fault lose": "no kind is called 'lose'",
    "--fault loss,robots=20": "names robot 20, but the ids of 20 robots are 0 to 19",
    "--clock none": "none",
    "--robots many": "many",
    "--flawed 1.5": "--flawed is '1.5'; give a count, 0 to 20, or a share such as '30%' or 0.3",
    "--flawed nan": "--flawed is 'nan'",
    "--fill-ratio -0.1": "fill-ratio is -0.1",
    "--set true-accuracy=2": "true-accuracy is 2",
    "--set flawed-accuracy=inf": "flawed-accuracy is inf",
    "--steps 0": "--steps is 0; it must be 1 to 1000000000",
    "--steps-per-second 0": "steps-per-second is 0",
    "--set comms-period=0": "comms-period is 0",
    "--filter-period 0": "filter-period is 0",
    "--set comms-period=3": "filter-period is 1000",
    "--set memory=63": "memory is 63",
    "--set memory=65": "memory is 65",
    "--set memory=4294967296": "memory is 4294967296",
    "--set omega=0": "omega is 0",
    "--set omega=0.95": "omega is 0.95",
    "--set omega=nan": "nan",
    "--filter none --set omega=0.1": "--set omega would do nothing: filter is none; leave it out",
    "--filter none --set activation=always": "--set activation would do nothing",
    "--seed -1": "seed is -1",
    "--set subject=6144": "subject is 6144",
    "--set priority=8": "priority is 8",
    "--filter some": "some",
    "--firmware perfect": "perfect",
    "--log run.db": "cannot log to run.db: choose .log",
    "--log run.xyz": ".xyz",
    "--log run": "run",
    "--log no/such/folder/run.log": "cannot write no/such/folder/run.log: its folder does not exist",
    "--log .": "regular file",
    "--plot run.gif": "run.gif",
    "--plot no/such/folder/run.png": "cannot write no/such/folder/run.png: its folder does not exist",
    "--interface nonsense": "nonsense",
    "--interface socketcan --channel nowhere0": "socketcan nowhere0",
    "--no-such-option": "--no-such-option",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert swarm_command("--steps", "3", *shlex.split(arguments)) == 2
    captured = capsys.readouterr()
    assert BAD[arguments] in captured.err
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_firmware_that_is_not_built_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FIRMWARES, "native", ("firmware_py.absent", "NativeRobot"))
    with pytest.raises(UsageError, match=r"firmware native cannot be loaded .*choose mirror"):
        record(small())


# Which bus


def channel_of(log: Path, *arguments: str) -> str:
    """The channel that a run reports; the frames in the log must be from there."""
    assert swarm_command(*SMALL, "--quiet", "--log", str(log), *arguments) == 0
    channel: str = json.loads(Path(f"{log}.json").read_text())["bus"]["channel"]
    assert {line.split()[1] for line in log.read_text().splitlines()} == {channel}
    return channel


def test_bus_options_variables_and_files_in_this_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    log = tmp_path / "run.log"
    assert channel_of(log) == "vcan0"
    (tmp_path / "can.conf").write_text("[default]\ninterface = virtual\nchannel = of_file\n")
    assert channel_of(log) == "of_file"
    monkeypatch.setenv("CAN_CHANNEL", "of_variable")
    assert channel_of(log) == "of_variable"
    monkeypatch.setitem(can.rc, "channel", "of_program")
    assert channel_of(log) == "of_program"
    assert channel_of(log, "--channel", "of_option") == "of_option"


@pytest.mark.parametrize(
    ("variable", "value"), [("CAN_INTERFACE", "nonsense"), ("CAN_CONFIG", "not json"), ("CAN_CONFIG", "[1]")]
)
def test_bad_variables(
    variable: str, value: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    assert swarm_command(*SMALL) == 2
    assert "nonsense" in capsys.readouterr().err or variable == "CAN_CONFIG"


def test_wall_clock_time_stamps_can_be_had(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    assert swarm_command(*SMALL, "--bus-kwargs", "preserve_timestamps=False", "--log", str(log)) == 0
    with can.LogReader(log) as reader:
        assert all(frame.timestamp > 10**9 for frame in reader)


# Ends


def sending(number: signal.Signals) -> Callable[[Swarm], None]:
    def hook(swarm: Swarm) -> None:
        if swarm.ticks == 7:
            os.kill(os.getpid(), number)

    return hook


def raise_interrupt(swarm: Swarm) -> None:
    if swarm.ticks == 7:
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("interrupt", "code"),
    [
        (sending(signal.SIGINT), 130),
        (sending(signal.SIGTERM), 143),
        (sending(signal.SIGHUP), 129),
        (raise_interrupt, 130),
    ],
    ids=["ctrl-c", "kill", "hang-up", "hook"],
)
@interruptible()
def test_a_signal_saves_what_is_done(
    interrupt: Callable[[Swarm], None],
    code: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(LiveView, "__call__", lambda self, swarm: interrupt(swarm))
    handler = signal.getsignal(signal.SIGINT)
    log, plot = tmp_path / "run.log", tmp_path / "run.png"
    assert swarm_command(*SMALL, "--json", "--log", str(log), "--plot", str(plot)) == code
    assert signal.getsignal(signal.SIGINT) is handler
    report = json.loads(capsys.readouterr().out)
    assert report["interrupted"]
    assert report["results"]["steps"] == 7
    assert len(log.read_text().splitlines()) == 4 * (7 + 1)
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert json.loads(Path(f"{plot}.json").read_text()) == report


def test_a_failing_bus_gives_exit_code_1_and_saves_what_is_done(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Failing(virtual.VirtualBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            assert timeout is not None
            if msg.timestamp > 0.75:
                raise can.CanOperationError("bus off")
            super().send(msg, timeout)

    monkeypatch.setattr(virtual, "VirtualBus", Failing)
    log = tmp_path / "run.log"
    over_a_bus = ("--bus-kwargs", "preserve_timestamps=True")
    assert swarm_command(*SMALL, *over_a_bus, "--log", str(log)) == 1
    assert "failed in tick 9: bus off" in capsys.readouterr().err
    assert len(log.read_text().splitlines()) == 4 * (8 + 1)


def test_a_bus_that_takes_no_more_frames_does_not_block_for_ever(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "TIMEOUT", 0.05)
    assert swarm_command(*SMALL, "--bus-kwargs", "rx_queue_size=2") == 1
    assert "failed in tick 1: Could not send" in capsys.readouterr().err


def test_a_crash_leaves_what_was_and_a_part(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def crash(self: LiveView, swarm: Swarm) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(LiveView, "__call__", crash)
    (tmp_path / "run.log").write_text("the log of yesterday")
    with suppress(ZeroDivisionError):
        swarm_command(*SMALL, "--log", str(tmp_path / "run.log"), "--plot", str(tmp_path / "run.png"))
    names = {"run.log", "run.log.part", "run.log.events.part"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert (tmp_path / "run.log").read_text() == "the log of yesterday"
    assert len(list(read_log(tmp_path / "run.log.part"))) == 4 * 2


@pytest.mark.parametrize(
    "obstructed", ["run.log", "run.log.events", "run.log.json", "run.png", "run.png.json"]
)
def test_what_cannot_be_written_is_told_before_the_first_tick(
    obstructed: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Swarm, "tick", lambda self: pytest.fail("it ran"))
    names = {"run.log", "run.log.events", "run.log.json", "run.png", "run.png.json"}
    for name in names - {obstructed}:
        (tmp_path / name).write_text("of yesterday")
    (tmp_path / obstructed).mkdir()
    assert swarm_command(*SMALL, "--log", f"{tmp_path}/run.log", "--plot", f"{tmp_path}/run.png") == 2
    assert f"cannot write {tmp_path / obstructed}: it is not a regular file" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == names
    assert all((tmp_path / name).read_text() == "of yesterday" for name in names - {obstructed})


@pytest.mark.parametrize(
    ("lost", "kept"),
    [
        ("run.log", {"run.log.part", "run.log.events.part", "run.log.json"}),
        ("run.log.events", {"run.log.part", "run.log.events.part", "run.log.json"}),
        ("run.log.json", {"run.log", "run.log.events"}),
    ],
)
def test_a_file_that_fails_at_the_end_costs_neither_the_summary_nor_its_pair(
    lost: str,
    kept: set[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    def obstruct(self: LiveView, swarm: Swarm) -> None:
        (tmp_path / lost).mkdir(exist_ok=True)

    monkeypatch.setattr(LiveView, "__call__", obstruct)
    assert swarm_command(*SMALL, "--quiet", "--log", f"{tmp_path}/run.log") == 2
    out, err = capsys.readouterr()
    assert out.startswith("seed 1: 4 robots, 30 steps")
    assert f"cannot write {tmp_path / lost}" in err
    assert {path.name for path in tmp_path.iterdir()} == kept | {lost}


@pytest.mark.parametrize("bytes_left", [0, 9000, 20_000])
def test_a_full_disk_costs_the_log_but_not_the_run(bytes_left: int, tmp_path: Path) -> None:
    """Full at once, during the run, or when the files are completed."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    log, part = tmp_path / "run.log", tmp_path / "run.log.part"
    options = ("--steps", "100", "--quiet", "--log", str(log))
    said = io.StringIO()  # pytest captures in files, which are limited, too
    with redirect_stdout(said), redirect_stderr(said):
        resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_left, before[1]))
        try:
            code = swarm_command(*SMALL, *options)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert code == 2
    told = f"mcp-asdf swarm: the log {log} is not complete: File too large; partial data is in {part}\n"
    assert said.getvalue().count(told) == 1
    assert "seed 1: 4 robots, 100 steps" in said.getvalue()
    names = {path.name for path in tmp_path.iterdir()}
    assert names - {f"{log.name}.json"} == {part.name, f"{log.name}.events.part"}
    assert (f"error: cannot write {log}.json" in said.getvalue()) == (f"{log.name}.json" not in names)
    if bytes_left == 20_000:
        assert main(["replay", str(part)]) == 0


@pytest.mark.parametrize("output", ["--quiet", "--json"])
def test_a_free_port_is_told_however_little_is_printed(
    output: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert swarm_command(*SMALL, "--slcan", "0", output, "--log", str(tmp_path / "run.log")) == 0
    port = json.loads((tmp_path / "run.log.json").read_text())["bus"]["slcan"]
    assert capsys.readouterr().err == f"the bus is an slcan adapter, too: socket://127.0.0.1:{port}\n"
    assert port > 0


# History and picture


@pytest.mark.parametrize("ticks", [MAX_SAMPLES - 1, MAX_SAMPLES + 1, *slow([3 * MAX_SAMPLES + 1])])
def test_a_history_is_thinned_and_has_both_ends(ticks: int) -> None:
    outcome, _ = record(small(robots=2, steps=ticks))
    found = outcome.history.ticks
    assert len(found) <= MAX_SAMPLES + 2
    assert (found[0], found[-1]) == (0, ticks)
    assert (np.diff(found) > 0).all()
    assert outcome.history.values("x").shape == (len(found), 2)


def test_a_history_holds_what_the_robots_held() -> None:
    held: list[list[float]] = []
    outcome, _ = record(small(), [lambda swarm: held.append([node.robot.b_hat for node in swarm.nodes])])
    b_hat = outcome.history.values("b_hat")
    assert b_hat[1:].tolist() == held
    assert b_hat[0] == pytest.approx([0.55, 0.55, 0.95, 0.95, 0.95])


def test_the_picture_shows_every_robot_and_the_truth() -> None:
    outcome, _ = record(small())
    panels = draw(outcome).axes
    meaning = {line.get_color(): line.get_label() for line in draw(outcome).legends[0].get_lines()}
    for axes, quantity, truth in zip(panels, QUANTITIES, (0.95, 0.55, 0.55), strict=True):
        *robots, true_line = axes.lines
        values = outcome.history.values(quantity)
        count = len(values)  # of b_hat, the last value is drawn on beyond the last step
        drawn = sorted(
            (meaning[line.get_color()], np.asarray(line.get_ydata())[:count].tolist()) for line in robots
        )
        kinds = ["flawed robots"] * 2 + ["healthy robots"] * 3
        assert drawn == sorted(zip(kinds, values.T.tolist(), strict=True))
        assert {line.get_drawstyle() for line in robots} == {
            "steps-post" if quantity == "b_hat" else "default"
        }
        assert set(np.asarray(true_line.get_ydata()).tolist()) == {truth}
        low, high = axes.get_ylim()
        assert low < min(truth, values[-1].min())
        assert high > max(truth, values[-1].max())
        assert meaning[true_line.get_color()] == "true value"


def test_the_picture_names_parameters_and_faults() -> None:
    outcome, _ = record(small(faults=("loss=0.25", "delay=0.5")))
    title = draw(outcome).axes[0].get_title("left")
    assert "5 robots, 2 flawed" in title
    assert "seed" in title
    assert "loss=0.25" in title
    assert "delay=0.5" in title


@pytest.mark.parametrize(
    ("suffix", "magic"), [("svg", b"<?xml"), *slow([("png", b"\x89PNG"), ("pdf", b"%PDF")])]
)
def test_equal_runs_give_equal_pictures(suffix: str, magic: bytes, tmp_path: Path) -> None:
    pictures = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for picture in pictures:
        assert swarm_command(*SMALL, "--plot", str(picture), "--quiet") == 0
    first, second = (picture.read_bytes() for picture in pictures)
    assert first.startswith(magic)
    assert first == second


def test_a_neighbour_of_this_computer_is_a_stranger_though_socketcan_calls_its_frames_sent() -> None:
    """And in the log every frame has come."""

    class Local(virtual.VirtualBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            frame, is_filtered = super()._recv_internal(timeout)
            if frame is not None:
                frame.is_rx = False
            return frame, is_filtered

    frames: list[can.Message] = []
    with (
        Swarm(small(), Wiring(lambda robot: Local("local")), frames.append) as swarm,
        Local("local") as other,
    ):
        other.send(encode(Message(2, 5, 5, 30), FrameFormat()), timeout=1)
        swarm.tick()
        assert swarm.traffic.id_conflicts == {2: 1}
        assert swarm.traffic.total("strays") == 5
    assert len(frames) == 1 + 5 + 5
    assert all(frame.is_rx for frame in frames)
