"""Robots that run elsewhere end in the same bits as those in this process."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import Mock

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import ON_OWN_BUSES, content, own_bus, record, small, states
from host_tools.swarm.test_swarm_faults import MIX
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from mcp_asdf_tools.cli import swarm
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.events import EventsReader, events_path
from mcp_asdf_tools.robots.node import BusLink, RobotNode, run_node
from mcp_asdf_tools.swarm import remote_robot
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from multicast import multicast
from support import slow
from wire import meanwhile
from wire import record as robot_record

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

UDP_PORT = 10_030 + os.getpid() % 500 * 40
"""And some more: of this process, for tests in others run at the same time."""
FAULTS = tuple(fault for fault in MIX if not fault.startswith("crash"))


class Orderly(virtual.VirtualBus):
    """Delivers one frame to all before the next, as a real bus does and as lockstep needs."""

    one_at_a_time = threading.Lock()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        with Orderly.one_at_a_time:
            super().send(msg, timeout)


def with_buses(*robots: int) -> Wiring:
    """A bus for each robot; these run elsewhere."""
    return Wiring(own_bus, False, frozenset(robots))


ORDERLY = Wiring(lambda robot: Orderly("one", preserve_timestamps=True), True, frozenset(range(4)))


@contextmanager
def robot_elsewhere(node: RobotNode, bus: can.BusABC) -> Iterator[None]:
    """A robot that runs in a thread and knows nothing but its bus."""
    is_over = threading.Event()
    with meanwhile(lambda: run_node(node, BusLink(bus, is_over.is_set))):
        try:
            yield
        finally:
            is_over.set()


def run_elsewhere(
    settings: SwarmSettings, wiring: Wiring
) -> tuple[SwarmRun, list[can.Message], dict[int, RobotNode]]:
    """A run whose remote robots are in threads; with the frames it sent and those robots."""
    records = settings.robot_setups()
    assert wiring.open_bus is not None
    nodes = {robot: RobotNode(records[robot]) for robot in sorted(wiring.remote)}
    frames: list[can.Message] = []
    with ExitStack() as stack:
        driven = stack.enter_context(Swarm(settings, wiring, frames.append))
        for robot, node in nodes.items():
            stack.enter_context(robot_elsewhere(node, stack.enter_context(wiring.open_bus(robot))))
        driven.wait_until_up(10)
        run = run_swarm(driven)
    assert run.failure is None
    return run, frames, nodes


CRASHES = (*FAULTS, "crash=0.05,ticks=4,robots=0+2-3")


@pytest.mark.parametrize(
    ("wiring", "faults", "comms_period", "filtering"),
    [
        (ORDERLY, (), 4, "asdf-plus"),
        (ORDERLY, (), 1, "robust"),
        (with_buses(*range(4)), (), 1, "asdf-plus"),
        (with_buses(*range(4)), FAULTS, 4, "robust"),
        (with_buses(1), (), 4, "robust"),
        (with_buses(1), CRASHES, 1, "asdf-plus"),
    ],
    ids=["one bus", "one bus, robust", "all", "all, faults", "one", "one, faults"],
)
def test_robots_elsewhere_end_in_the_same_bits(
    wiring: Wiring, faults: tuple[str, ...], comms_period: int, filtering: str
) -> None:
    settings = small(*faults, robots=4, comms_period=comms_period, filter=filtering)
    run, frames, nodes = run_elsewhere(settings, wiring)
    here, same = record(settings, ON_OWN_BUSES)
    for robot, node in nodes.items():
        assert states([node.bus_robot]) == states([here.nodes[robot]])
        known, true = run.nodes[robot].robot, here.nodes[robot].robot
        assert (known.t, known.x) == (true.t, true.x)
        assert known.counters.updates == true.counters.updates
        assert known.b_hat == int(true.b_hat * 2**24) / 2**24
        # Between broadcasts its estimate is unknown.
        assert comms_period > 1 or known.x_hat == true.x_hat
    assert [node.robot.x for node in run.nodes] == [node.robot.x for node in here.nodes]
    assert run.results["tests"] is None
    # Liars and id collisions do not change what the robot itself puts on its bus.
    if not faults:
        said, expected = (
            sorted(
                content([each for each in sent if isinstance(decode_estimate(each, FrameFormat()), Estimate)])
            )
            for sent in (frames, same)  # in a round another may be first
        )
        assert said == expected
        for figure in ("sent", "heartbeats_sent", "delivered"):
            assert run.results["frames"][figure] == here.results["frames"][figure]


def test_126_robots_and_the_tool_have_ids() -> None:
    remote_robot.check_remote(small(robots=126), with_buses(1))


def test_a_robot_that_falls_silent_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the driver asks its caller while it waits."""
    monkeypatch.setattr(remote_robot, "ANSWER_TIMEOUT", 0.1)
    settings, asked = small(), list[bool]()
    with Swarm(settings, with_buses(1)) as driven, own_bus(1) as bus:
        with robot_elsewhere(RobotNode(settings.robot_setups()[1]), bus):
            driven.wait_until_up(10, lambda: asked.append(True))
            driven.tick()
        asked.clear()
        run = run_swarm(driven)
    assert run.failure is not None
    assert "tick 2: robot 1 did not broadcast its estimate within" in run.failure
    assert run.results["steps"] == 1 and asked


SMALL = ["swarm", "--robots", "3", "--steps", "25", "--filter-period", "10", "--seed", "5", "--json"]


@pytest.mark.parametrize("filtering", ["robust", *slow(["asdf-plus"])])
def test_processes_end_in_the_same_bits(
    filtering: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """With faults between them; the log can be replayed, and has of each what it has of one here."""
    multicast(251)
    log, other = tmp_path / "run.log", tmp_path / "other.log"
    bus = ["--interface", "udp_multicast", "--channel", "239.74.163.{robot}"]
    bus += ["--bus-kwargs", f"port={UDP_PORT}", "--processes", "--log", str(log)]
    faults = ("--fault", "loss=0.2", "--fault", "corrupt=0.1", "--filter", filtering, "--allow", "0+2")
    assert main([*SMALL, *bus, *faults]) == 0
    elsewhere = json.loads(capsys.readouterr().out)
    assert main([*SMALL, *faults, "--log", str(other)]) == 0
    here = json.loads(capsys.readouterr().out)
    for robot, known in enumerate(here["results"]["robots"]):
        report = elsewhere["processes"][str(robot)]["results"]
        assert report["steps"] == 25
        unknown = [each["sender"] for each in report["frames"]["events"] if each["event"] == "unknown"]
        assert unknown == [1] * (robot != 1)
        assert report["robot"]["b_hat"] == known["b_hat"]
        assert report["robot"]["x"] == known["x"] == elsewhere["results"]["robots"][robot]["x"]
        assert report["robot"]["counters"]["tests"] == known["tests"]
    assert main(["replay", str(log)]) == 0
    with EventsReader(events_path(log)) as one, EventsReader(events_path(other)) as two:
        assert [*one.entries()] == [*two.entries()]


def test_a_device_that_is_not_there_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(swarm, "_STARTING_TIMEOUT", 0.05)
    assert main([*SMALL, "--channel", "v{robot}", "--device", "1=virtual:v1"]) == 1
    failure = json.loads(capsys.readouterr().err)
    assert failure["error"].startswith("robot 1 did not send a heartbeat within 0.05 s")


def test_an_error_frame_is_counted_and_is_no_robot_s_frame() -> None:
    """The identifier of an error frame, 8 for damaged input, is no node id."""
    robot = remote_robot.remote_robot(robot_record(8), FrameFormat())
    driver = remote_robot.Driver(Mock(), [robot], FrameFormat())
    driver._handle_frame(can.Message(arbitration_id=8, is_error_frame=True))
    assert driver._frames_for_next_tick == []
    assert robot.reception.errors == 1
