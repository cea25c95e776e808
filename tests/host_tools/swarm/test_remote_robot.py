"""Robots that run elsewhere end in the same bits as those in this process."""

from __future__ import annotations

import gc
import json
import os
import random
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces import virtual

from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.bus.frames import FrameFormat, Message, decode, encode
from mcp_asdf_tools.bus.slcan_server import SlcanServer
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot, Recorder
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.node import RobotNode
from mcp_asdf_tools.swarm import remote_robot
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_spec import parse_fault
from mcp_asdf_tools.swarm.remote_robot import remote_robot as half_here
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, SwarmRun, run_swarm
from multicast import multicast

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

MIX = (
    *("loss=0.1", "corrupt=0.1,bits=2", "delay=0.2,ticks=3", "duplicate=0.2,ticks=1", "busoff=0.01,ticks=3"),
    *("babble=0.1,frames=3", "freeze=0.05", "liar=0.05,x=1,alpha=1e5", "collide=0.05,id=2"),
)
UDP_PORT = 10_030 + os.getpid() % 500 * 40
"""And some more: of this process, for tests in others run at the same time."""


def make(*faults: str, **changes: Any) -> SwarmSettings:
    plain = {"robots": 4, "flawed": 0.5, "steps": 50, "filter_period": 20, "seed": 11}
    return SwarmSettings(**{**plain, **changes, "faults": tuple(map(parse_fault, faults))})


def own_bus(robot: int) -> can.BusABC:
    return can.Bus(interface="virtual", channel=f"of {robot}", preserve_timestamps=True, ignore_config=True)


class Orderly(virtual.VirtualBus):
    """Delivers one frame to all before the next, as a real bus does and as lockstep needs."""

    one_at_a_time = threading.Lock()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        with Orderly.one_at_a_time:
            super().send(msg, timeout)


def one_bus(robot: int) -> can.BusABC:
    return Orderly("one", preserve_timestamps=True)


@contextmanager
def robot_elsewhere(node: RobotNode, bus: can.BusABC, hello: float | None = None) -> Iterator[None]:
    """A robot that runs in a thread and knows nothing but its bus; greets every ``hello`` seconds."""
    is_over = threading.Event()

    def live() -> None:
        for frame in node.start():
            bus.send(frame, timeout=1)
        while not is_over.is_set():
            heard = bus.recv(hello or 0.05)
            answers = (
                node.hear(heard) if heard is not None else node.start() if hello and not node.ticks else []
            )
            for frame in answers:
                bus.send(frame, timeout=1)

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def run_elsewhere(
    settings: SwarmSettings, wiring: Wiring
) -> tuple[SwarmRun, list[can.Message], dict[int, RobotNode]]:
    """A run whose remote robots are in threads; with the frames it sent and those robots."""
    records = settings.records()
    assert wiring.open_bus is not None
    nodes = {robot: RobotNode(records[robot]) for robot in sorted(wiring.remote)}
    frames: list[can.Message] = []
    with ExitStack() as stack:
        swarm = stack.enter_context(Swarm(settings, wiring, frames.append))
        for robot, node in nodes.items():
            bus = stack.enter_context(wiring.open_bus(robot))
            stack.enter_context(robot_elsewhere(node, bus))
        swarm.wait_until_up(10)
        return run_swarm(swarm), frames, nodes


def run_here(settings: SwarmSettings) -> tuple[SwarmRun, list[can.Message]]:
    frames: list[can.Message] = []
    with Swarm(settings, Wiring(own_bus, is_shared=False), frames.append) as swarm:
        return run_swarm(swarm), frames


def estimates(frames: list[can.Message]) -> list[tuple[int, bytes]]:
    """Apart from who was first in a round."""
    return sorted(
        (frame.arbitration_id, bytes(frame.data))
        for frame in frames
        if isinstance(decode(frame, FrameFormat()), Message)
    )


def state(robot: Any) -> dict[str, int]:
    assert isinstance(robot, FixedPointRobot)
    return robot.state()


@pytest.mark.parametrize("comms_period", [1, 4])
@pytest.mark.parametrize("faults", [(), MIX], ids=["lossless", "mix"])
@pytest.mark.parametrize("away", [{0, 1, 2, 3}, {1}], ids=["all", "one"])
def test_with_a_bus_each(away: set[int], faults: tuple[str, ...], comms_period: int) -> None:
    settings = make(*faults, comms_period=comms_period)
    run, frames, nodes = run_elsewhere(settings, Wiring(own_bus, False, frozenset(away)))
    here, same = run_here(settings)
    assert run.failure is None
    for robot, node in nodes.items():
        assert state(node.robot) == state(here.nodes[robot].robot)
        known, true = run.nodes[robot].robot, here.nodes[robot].robot
        assert (known.t, known.n, known.x, known.counters.updates) == (
            *(true.t, true.n, true.x, true.counters.updates),
        )
        assert known.b_hat == int(true.b_hat * 2**24) / 2**24
        # Between broadcasts its estimate is unknown.
        assert comms_period > 1 or known.x_hat == true.x_hat
    x = [node.robot.x for node in run.nodes]
    assert x == [node.robot.x for node in here.nodes]
    # Liars and id collisions do not change what the robot itself puts on its bus.
    if not faults:
        assert estimates(frames) == estimates(same)
        assert run.results["frames"]["sent"] == here.results["frames"]["sent"]
        assert run.results["frames"]["delivered"] == here.results["frames"]["delivered"]


def test_all_on_one_bus() -> None:
    settings = make(robots=3)
    run, frames, nodes = run_elsewhere(settings, Wiring(one_bus, True, frozenset(range(3))))
    here, same = run_here(settings)
    assert run.failure is None
    assert [state(node.robot) for node in nodes.values()] == [state(node.robot) for node in here.nodes]
    assert estimates(frames) == estimates(same)
    assert run.results["tests"] is None
    assert run.results["frames"]["delivered"] == here.results["frames"]["delivered"]


def test_a_robot_that_is_not_there_is_named() -> None:
    wiring = Wiring(own_bus, False, frozenset({2}))
    with (
        Swarm(make(), wiring) as swarm,
        pytest.raises(LockstepError, match="robot 2 did not send a heartbeat"),
    ):
        swarm.wait_until_up(0.05)


def test_a_robot_that_falls_silent_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_robot, "ANSWER_TIMEOUT", 0.1)
    settings = make()
    node = RobotNode(settings.records()[1])
    with Swarm(settings, Wiring(own_bus, False, frozenset({1}))) as swarm, own_bus(1) as bus:
        with robot_elsewhere(node, bus):
            swarm.wait_until_up(10)
            swarm.tick()
        run = run_swarm(swarm)
    assert run.failure is not None
    assert "tick 2: robot 1 did not broadcast its estimate within" in run.failure
    assert run.results["steps"] == 1


@pytest.mark.parametrize(
    ("changes", "faults", "wiring", "complaint"),
    [
        (
            {"robots": 127},
            (),
            Wiring(own_bus, False, frozenset({1})),
            "at most 126, since id 126 commands",
        ),
        ({}, (), Wiring(own_bus, False, frozenset({7})), "robot 7 is to run elsewhere, but ids are 0 to 3"),
        (
            {},
            ("crash=0.1",),
            Wiring(own_bus, False, frozenset({1})),
            "cannot affect robots that run else",
        ),
        ({}, (), Wiring(one_bus, True, frozenset({1})), "need a bus each: write {robot}"),
        (
            {},
            ("loss",),
            Wiring(one_bus, True, frozenset(range(4))),
            "for faults, latency or a topology write {robot}",
        ),
        (
            {"topology": "dynamic"},
            (),
            Wiring(one_bus, True, frozenset(range(4))),
            "for faults, latency or a topology write",
        ),
    ],
)
def test_what_cannot_be(
    changes: dict[str, Any], faults: tuple[str, ...], wiring: Wiring, complaint: str
) -> None:
    with pytest.raises(UsageError) as caught:
        Swarm(make(*faults, **changes), wiring)
    assert complaint in str(caught.value)


def test_crashes_of_others_are_possible() -> None:
    settings = make("crash,robots=0,from=5,to=9")
    run, _, nodes = run_elsewhere(settings, Wiring(own_bus, False, frozenset({1})))
    here, _ = run_here(settings)
    assert state(nodes[1].robot) == state(here.nodes[1].robot)
    assert run.nodes[0].robot.t == 50 - 9


# The command

SMALL = ("--robots", "3", "--steps", "25", "--filter-period", "10", "--seed", "5")


def command(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["swarm", *SMALL, "--json", *arguments]) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_processes_end_in_the_same_bits(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """With faults between them, and so that the log can be replayed."""
    multicast(251)
    log = tmp_path / "run.log"
    bus = ["--interface", "udp_multicast", "--channel", "239.74.163.{robot}"]
    bus += ["--bus-kwargs", f"port={UDP_PORT}"]
    faults = ("--fault", "loss=0.2", "--fault", "liar=0.2,robots=1")
    elsewhere = command(capsys, *bus, *faults, "--processes", "--log", str(log))
    here = command(capsys, *faults)
    assert [robot["x"] for robot in elsewhere["results"]["robots"]] == [
        robot["x"] for robot in here["results"]["robots"]
    ]
    for robot, known in enumerate(here["results"]["robots"]):
        report = elsewhere["processes"][str(robot)]["results"]
        assert report["steps"] == 25
        assert report["robot"]["b_hat"] == known["b_hat"]
        assert report["robot"]["x"] == known["x"]
        assert report["robot"]["counters"]["tests"] == known["tests"]
    assert main(["replay", str(log)]) == 0


def test_a_device_behind_slcan_is_one_of_the_robots(capsys: pytest.CaptureFixture[str]) -> None:
    settings = SwarmSettings(robots=3, steps=25, filter_period=10, seed=5)
    node = RobotNode(settings.records()[1])
    with (
        own_bus(77) as adapter,
        own_bus(77) as bus,
        SlcanServer(adapter, 0) as server,
        robot_elsewhere(node, bus, hello=0.02),
    ):
        place = f"slcan:socket://127.0.0.1:{server.port}"
        report = command(capsys, "--channel", "v{robot}", "--device", f"1={place}")
    here = command(capsys)
    assert node.robot.t == 25
    assert [robot["x"] for robot in report["results"]["robots"]] == [
        robot["x"] for robot in here["results"]["robots"]
    ]


@contextmanager
def adapter_that_is_unplugged() -> Iterator[str]:
    """An slcan adapter that vanishes when its bus is open; yields its channel."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def vanish() -> None:
            connection, _ = listener.accept()
            with connection:
                text = b""
                while not text.endswith(b"O\r"):
                    text += connection.recv(1)
                reset = struct.pack("ii", 1, 0)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)

        thread = threading.Thread(target=vanish)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
        thread.join()


@pytest.fixture
def warnings_of_pyserial() -> Iterator[None]:
    """It forgets to close a socket whose other end has gone; that shall show here and in no later test."""
    yield
    gc.collect()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")
@pytest.mark.usefixtures("warnings_of_pyserial")
@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        ("radio --id 0 --verify --steps 3 {bus}", 1, "FAILED: 0 of"),
        ("radio --id 0 --steps-per-second 100 --steps 30 {bus}", 0, "30 steps; all ticks done"),
        ("node --id 0 {bus}", 1, "the bus failed"),
        ("swarm --robots 2 --steps 3 --channel v{{robot}} --device 0=slcan:{channel}", 1, "mcp-asdf swarm: "),
    ],
)
def test_an_adapter_that_is_unplugged_costs_no_result(
    arguments: str, code: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with adapter_that_is_unplugged() as channel:
        bus = f"--interface slcan --channel {channel} --bus-kwargs sleep_after_open=0"
        assert main(arguments.format(bus=bus, channel=channel).split()) == code
    captured = capsys.readouterr()
    assert told in " ".join((captured.out + captured.err).split())


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("--processes", "inside this process, so no other can join it"),
        ("--device 1", "device is '1'; write ID=INTERFACE:CHANNEL"),
        ("--device 1=nonsense:x", "device is '1=nonsense:x'"),
        ("--device one=slcan:socket://127.0.0.1:1", "device is 'one=slcan"),
        ("--device 9=slcan:socket://127.0.0.1:1", "robot 9 is to run elsewhere, but ids are 0 to 2"),
        ("--device 1=slcan:socket://127.0.0.1:1", "robots here and elsewhere need a bus each"),
        (
            "--device 1=slcan:socket://127.0.0.1:1 --channel v{robot}",
            "cannot open the device at slcan:",
        ),
        ("--device 1=slcan:socket://127.0.0.1:1 --processes", "not allowed with"),
        ("--device 1=virtual:a --device 1=virtual:b --channel v{robot}", "two devices are one robot"),
        ("--device 1=virtual:a --channel v{robot} --set subject=3002", "choose three different ones"),
    ],
)
def test_bad_usage(arguments: str, complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["swarm", *SMALL, *arguments.split()]) == 2
    captured = capsys.readouterr()
    assert complaint in captured.err
    assert captured.out == ""


def test_the_events_of_a_robot_elsewhere_are_those_of_one_here() -> None:
    """From the same commands and frames. Its firmware is elsewhere, so its state is known only in part."""
    settings = make(comms_period=2)
    lines: dict[str, list[str]] = {"here": [], "elsewhere": []}
    start = settings.records()[1]
    here = BusRobot(start, settings.frames, Recorder(1, lines["here"].append))
    elsewhere = half_here(start, settings.frames, Recorder(1, lines["elsewhere"].append))
    known = elsewhere.robot
    assert (known.x_hat, known.alpha, known.x, known.b_hat) == (0.5, 0.0, 0.5, start.b_hat)
    draw = random.Random(5)
    for tick in range(60):
        z = draw.choice([None, Observation.WHITE, Observation.BLACK])
        assert here.begin(z) == elsewhere.begin(z)
        for sender in draw.sample([0, 2, 3], 2):
            frame = encode(Message(sender, draw.randrange(1 << 23), 1 << 30, tick % 32), settings.frames)
            here.listen([frame])
            elsewhere.listen([frame])
        here.end()
        elsewhere.end()
        assert (here.robot.t, here.robot.n) == (elsewhere.robot.t, elsewhere.robot.n)
    assert lines["here"] == lines["elsewhere"]
    assert here.reception.delivered == elsewhere.reception.delivered == 120
