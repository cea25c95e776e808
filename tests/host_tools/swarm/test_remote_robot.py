"""Remote robots, which run in other programs, against the same robots in this process."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import (
    ON_OWN_BUSES,
    identifiers_and_data,
    own_bus,
    run_and_record,
    saved_robots,
    small_swarm,
)
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


class OrderlyBus(virtual.VirtualBus):
    """Virtual bus that delivers one frame to all before the next, as real ones do and lockstep needs."""

    one_at_a_time = threading.Lock()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        with OrderlyBus.one_at_a_time:
            super().send(msg, timeout)


ONE_BUS = Wiring(
    lambda robot: OrderlyBus("one", preserve_timestamps=True), is_shared=True, remote=frozenset(range(4))
)


def bus_for_each(*remote_robots: int) -> Wiring:
    """Return a wiring in which each robot has its own bus, and these robots are remote."""
    return Wiring(own_bus, is_shared=False, remote=frozenset(remote_robots))


@contextmanager
def remote_robot_in_a_thread(node: RobotNode, bus: can.BusABC) -> Iterator[None]:
    """Run a robot that knows nothing but its bus, until the block ends."""
    is_over = threading.Event()
    with meanwhile(lambda: run_node(node, BusLink(bus, is_over.is_set))):
        try:
            yield
        finally:
            is_over.set()


@dataclass(frozen=True)
class Comparison:
    """A run with remote robots, and the same swarm with all robots in this process.

    Attributes:
        run: The run with remote robots, which are in threads.
        frames: The frames of that run.
        remote_nodes: The remote robots, by id.
        local_run: The run with all robots in this process.
        local_frames: Its frames.
    """

    run: SwarmRun
    frames: list[can.Message]
    remote_nodes: dict[int, RobotNode]
    local_run: SwarmRun
    local_frames: list[can.Message]


def compare_runs(settings: SwarmSettings, wiring: Wiring) -> Comparison:
    """Run a swarm with the remote robots of a wiring, and without any."""
    setups = settings.robot_setups()
    open_bus = wiring.open_bus
    assert open_bus is not None
    nodes = {robot: RobotNode(setups[robot]) for robot in sorted(wiring.remote)}
    frames: list[can.Message] = []
    with ExitStack() as stack:
        driven_swarm = stack.enter_context(Swarm(settings, wiring, frames.append))
        for robot, node in nodes.items():
            bus = stack.enter_context(open_bus(robot))
            stack.enter_context(remote_robot_in_a_thread(node, bus))
        driven_swarm.wait_until_up(10)
        run = run_swarm(driven_swarm)
    assert run.failure is None
    local_run, local_frames = run_and_record(settings, ON_OWN_BUSES)
    return Comparison(run, frames, nodes, local_run, local_frames)


FAULTS_AND_CRASHES = (*FAULTS, "crash=0.05,ticks=4,robots=0+2-3")
LOSSLESS: dict[str, tuple[Wiring, int, str]] = {
    "one bus": (ONE_BUS, 4, "asdf-plus"),
    "one bus, robust": (ONE_BUS, 1, "robust"),
    "all remote": (bus_for_each(*range(4)), 1, "asdf-plus"),
    "one remote": (bus_for_each(1), 4, "robust"),
}
"""Wirings of four robots, with their comms_period and their filter."""


@pytest.fixture(scope="module", params=list(LOSSLESS.values()), ids=list(LOSSLESS))
def lossless(request: pytest.FixtureRequest) -> Comparison:
    wiring, comms_period, swarm_filter = request.param
    return compare_runs(small_swarm(robots=4, comms_period=comms_period, filter=swarm_filter), wiring)


def test_robots_in_other_programs_end_in_the_same_bits_as_robots_in_this_one(lossless: Comparison) -> None:
    for robot, node in lossless.remote_nodes.items():
        assert saved_robots([node.bus_robot]) == saved_robots([lossless.local_run.nodes[robot]])


def estimates_among(frames: list[can.Message]) -> list[can.Message]:
    """Return the frames that carry estimates, in their order."""
    return [frame for frame in frames if isinstance(decode_estimate(frame, FrameFormat()), Estimate)]


def test_remote_robots_broadcast_the_same_estimates_as_robots_in_this_process(lossless: Comparison) -> None:
    """Only their order may differ, as any robot may be the first in a tick; so both are sorted."""
    estimates_with_remote_robots = estimates_among(lossless.frames)
    estimates_of_local_robots = estimates_among(lossless.local_frames)

    assert sorted(identifiers_and_data(estimates_with_remote_robots)) == sorted(
        identifiers_and_data(estimates_of_local_robots)
    )


@pytest.mark.parametrize("count", ["sent", "heartbeats_sent", "delivered"])
def test_the_frames_of_remote_robots_are_counted_alike(lossless: Comparison, count: str) -> None:
    assert lossless.run.results["frames"][count] == lossless.local_run.results["frames"][count]


def test_the_tests_of_remote_robots_are_not_known(lossless: Comparison) -> None:
    """How often a filter made its test stands in no frame, so it cannot be reported of robots elsewhere."""
    assert lossless.run.results["tests"] is None


def test_what_is_known_of_a_robot_in_another_program_comes_from_its_telemetry(lossless: Comparison) -> None:
    for robot in lossless.remote_nodes:
        known_robot = lossless.run.nodes[robot].robot
        local_robot = lossless.local_run.nodes[robot].robot
        assert (known_robot.t, known_robot.x) == (local_robot.t, local_robot.x)
        assert known_robot.counters.updates == local_robot.counters.updates
        assert known_robot.b_hat == int(local_robot.b_hat * 2**24) / 2**24


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wiring", "faults", "comms_period", "swarm_filter"),
    [
        (bus_for_each(*range(4)), FAULTS, 4, "robust"),
        (bus_for_each(1), FAULTS_AND_CRASHES, 1, "asdf-plus"),
    ],
    ids=["all remote", "one remote, others crash"],
)
def test_remote_robots_end_in_the_same_state_among_faults(
    wiring: Wiring, faults: tuple[str, ...], comms_period: int, swarm_filter: str
) -> None:
    settings = small_swarm(*faults, robots=4, comms_period=comms_period, filter=swarm_filter)
    comparison = compare_runs(settings, wiring)
    for robot, node in comparison.remote_nodes.items():
        assert saved_robots([node.bus_robot]) == saved_robots([comparison.local_run.nodes[robot]])

    assert [node.robot.x for node in comparison.run.nodes] == [
        node.robot.x for node in comparison.local_run.nodes
    ]


def test_the_local_estimate_of_a_remote_robot_is_known_from_its_broadcasts() -> None:
    """Here it broadcasts in each tick; between broadcasts it is not known."""
    comparison = compare_runs(small_swarm(robots=4), bus_for_each(1))
    assert comparison.run.nodes[1].robot.x_hat == comparison.local_run.nodes[1].robot.x_hat


def test_126_robots_with_one_in_another_program_are_accepted() -> None:
    """They have ids 0 to 125, which leaves 126 for the program that drives them."""
    remote_robot.check_remote(small_swarm(robots=126), bus_for_each(1))


@contextmanager
def swarm_with_a_silent_robot(
    monkeypatch: pytest.MonkeyPatch, check: Callable[[], None] = lambda: None
) -> Iterator[Swarm]:
    """A swarm after its first tick, with a remote robot that is gone since then."""
    monkeypatch.setattr(remote_robot, "ANSWER_TIMEOUT", 0.1)
    settings = small_swarm()
    with Swarm(settings, bus_for_each(1)) as driven_swarm, own_bus(1) as bus:
        with remote_robot_in_a_thread(RobotNode(settings.robot_setups()[1]), bus):
            driven_swarm.wait_until_up(10, check)
            driven_swarm.tick()
        yield driven_swarm


def test_a_remote_robot_that_falls_silent_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    with swarm_with_a_silent_robot(monkeypatch) as driven_swarm:
        run = run_swarm(driven_swarm)

    assert run.failure is not None
    assert "tick 2: robot 1 did not broadcast its estimate within" in run.failure
    assert run.results["steps"] == 1


def test_a_wait_for_a_silent_robot_can_be_ended_by_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its function ``check`` is called meanwhile, and may raise an error."""
    calls: list[bool] = []
    with swarm_with_a_silent_robot(monkeypatch, check=lambda: calls.append(True)) as driven_swarm:
        calls.clear()
        run_swarm(driven_swarm)

    assert calls


SMALL = ["swarm", "--robots", "3", "--steps", "25", "--filter-period", "10", "--seed", "5", "--json"]


@pytest.mark.parametrize("swarm_filter", ["robust", *slow(["asdf-plus"])])
def test_robots_in_processes_report_and_log_what_robots_in_this_process_do(
    swarm_filter: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Also with faults between them, which both runs have."""
    multicast(251)
    log, local_log = tmp_path / "run.log", tmp_path / "local.log"
    bus = ["--interface", "udp_multicast", "--channel", "239.74.163.{robot}"]
    bus += ["--bus-kwargs", f"port={UDP_PORT}", "--processes", "--log", str(log)]
    faults = ("--fault", "loss=0.2", "--fault", "corrupt=0.1", "--filter", swarm_filter, "--allow", "0+2")
    assert main([*SMALL, *bus, *faults]) == 0
    report = json.loads(capsys.readouterr().out)
    assert main([*SMALL, *faults, "--log", str(local_log)]) == 0
    local_report = json.loads(capsys.readouterr().out)
    for robot, local_robot in enumerate(local_report["results"]["robots"]):
        process_report = report["processes"][str(robot)]["results"]
        assert process_report["steps"] == 25
        assert process_report["robot"]["b_hat"] == local_robot["b_hat"]
        assert process_report["robot"]["x"] == local_robot["x"] == report["results"]["robots"][robot]["x"]
        assert process_report["robot"]["counters"]["tests"] == local_robot["tests"]
        # Robot 1 is the only one that is not allowed.
        unknown_senders = [
            event["sender"] for event in process_report["frames"]["events"] if event["event"] == "unknown"
        ]
        assert unknown_senders == ([] if robot == 1 else [1])
    assert main(["replay", str(log)]) == 0
    with EventsReader(events_path(log)) as reader, EventsReader(events_path(local_log)) as local_reader:
        assert list(reader.entries()) == list(local_reader.entries())


def test_a_robot_on_a_device_that_does_not_answer_is_named(
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
