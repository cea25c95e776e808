"""Remote robots, which run in other programs, against the same robots in this process."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest
from can.interfaces import virtual

from host_tools.swarm.swarms import (
    MIXED_FAULTS,
    ON_OWN_BUSES,
    identifiers_and_data,
    own_bus,
    run_and_record,
    saved_robots,
    small_swarm,
)
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate
from mcp_asdf_tools.cli import swarm
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.recording.events import EventsReader, events_path
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import BusLink, RobotNode, run_node
from mcp_asdf_tools.swarm import remote_robot
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from multicast import multicast
from support import slow
from wire import running_in_thread, setup_of_robot

pytestmark = pytest.mark.usefixtures("no_bus_is_left")

UDP_PORT = 10_030 + os.getpid() % 500 * 40
"""The first of the ports of this process. Tests that run in other processes at the same time have others."""
FAULTS = tuple(fault for fault in MIXED_FAULTS if not fault.startswith("crash"))


class OrderlyBus(virtual.VirtualBus):
    """Virtual bus that delivers one frame to all before the next, as real ones do and lockstep needs."""

    one_at_a_time = threading.Lock()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        with OrderlyBus.one_at_a_time:
            super().send(msg, timeout)


ONE_BUS = Wiring(
    lambda robot: OrderlyBus("one", preserve_timestamps=True), is_shared=True, remote=frozenset(range(4))
)


def wiring_with_remote_robots(*remote_robots: int) -> Wiring:
    """Return a wiring in which each robot has its own bus, and these robots are remote."""
    return Wiring(own_bus, is_shared=False, remote=frozenset(remote_robots))


@contextmanager
def remote_robot_in_a_thread(node: RobotNode, bus: can.BusABC) -> Iterator[None]:
    """Run a robot that knows nothing but its bus, as one in another program, until the block ends."""
    is_over = threading.Event()
    with running_in_thread(lambda: run_node(node, BusLink(bus, is_over.is_set))):
        try:
            yield
        finally:
            is_over.set()


@dataclass(frozen=True)
class Comparison:
    """A run with remote robots, and the same swarm with all robots in this process.

    Attributes:
        remote_run: The run with remote robots, as the program that drives them knows it.
        remote_frames: The frames of that run.
        remote_nodes: The remote robots themselves, which are in threads, by id.
        local_run: The run with all robots in this process.
        local_frames: Its frames.
    """

    remote_run: SwarmRun
    remote_frames: list[can.Message]
    remote_nodes: dict[int, RobotNode]
    local_run: SwarmRun
    local_frames: list[can.Message]

    @property
    def remote_robot_ids(self) -> list[int]:
        return list(self.remote_nodes)

    @property
    def saved_remote_robots(self) -> dict[int, bytes]:
        """The saved state of each remote robot itself, by id."""
        nodes = list(self.remote_nodes.values())
        return dict(zip(self.remote_nodes, saved_robots(nodes), strict=True))

    @property
    def saved_local_robots(self) -> dict[int, bytes]:
        """The saved state of the robots with the same ids in the run without remote ones."""
        nodes = [self.local_run.nodes[robot] for robot in self.remote_nodes]
        return dict(zip(self.remote_nodes, saved_robots(nodes), strict=True))


def compare_runs(settings: SwarmSettings, wiring: Wiring) -> Comparison:
    """Run a swarm with the remote robots of a wiring, and without any."""
    setups = settings.robot_setups()
    remote_nodes = {robot: RobotNode(setups[robot]) for robot in sorted(wiring.remote)}
    run, frames = run_with_remote_nodes(settings, wiring, remote_nodes)
    local_run, local_frames = run_and_record(settings, ON_OWN_BUSES)
    return Comparison(run, frames, remote_nodes, local_run, local_frames)


def run_with_remote_nodes(
    settings: SwarmSettings, wiring: Wiring, remote_nodes: dict[int, RobotNode]
) -> tuple[SwarmRun, list[can.Message]]:
    """Run a swarm, and each of its remote robots in a thread of its own; return the run and all frames."""
    assert wiring.open_bus is not None
    frames: list[can.Message] = []
    with ExitStack() as stack:
        driven_swarm = stack.enter_context(Swarm(settings, wiring, frames.append))
        for robot, node in remote_nodes.items():
            bus = stack.enter_context(wiring.open_bus(robot))
            stack.enter_context(remote_robot_in_a_thread(node, bus))
        driven_swarm.wait_until_up(10)
        run = run_swarm(driven_swarm)
    assert run.failure is None
    return run, frames


FAULTS_AND_CRASHES = (*FAULTS, "crash=0.05,ticks=4,robots=0+2-3")
SWARMS_WITHOUT_FAULTS: dict[str, tuple[Wiring, int, str]] = {
    "one bus": (ONE_BUS, 4, "asdf-plus"),
    "one bus, robust": (ONE_BUS, 1, "robust"),
    "all remote": (wiring_with_remote_robots(*range(4)), 1, "asdf-plus"),
    "one remote": (wiring_with_remote_robots(1), 4, "robust"),
}
"""Wirings of four robots, with their comms_period and their filter."""


@pytest.fixture(scope="module", params=list(SWARMS_WITHOUT_FAULTS.values()), ids=list(SWARMS_WITHOUT_FAULTS))
def comparison(request: pytest.FixtureRequest) -> Comparison:
    """Runs of four robots, one or all remote, and of the same robots in this process, without faults."""
    wiring, comms_period, swarm_filter = request.param
    return compare_runs(small_swarm(robots=4, comms_period=comms_period, filter=swarm_filter), wiring)


def test_robots_in_other_programs_end_in_the_same_bits_as_robots_in_this_one(comparison: Comparison) -> None:
    """The saved state, which is all that a firmware holds, is the same in the end.

    ``comparison`` has a run with remote robots, and a run of the same robots in this process.
    """
    assert comparison.saved_remote_robots == comparison.saved_local_robots


def estimates_among(frames: list[can.Message]) -> list[can.Message]:
    """Return the frames that carry estimates, in their order."""
    return [frame for frame in frames if isinstance(decode_estimate(frame, FrameFormat()), Estimate)]


def test_remote_robots_broadcast_the_same_estimates_as_robots_in_this_process(comparison: Comparison) -> None:
    """Their order may differ, as any robot may be the first in a tick. So both lists are sorted."""
    remote_estimates = identifiers_and_data(estimates_among(comparison.remote_frames))
    local_estimates = identifiers_and_data(estimates_among(comparison.local_frames))
    assert sorted(remote_estimates) == sorted(local_estimates)


def test_the_frames_of_remote_robots_are_counted_like_those_of_robots_in_this_process(
    comparison: Comparison,
) -> None:
    """Estimates sent and delivered, and heartbeats, are counted as in the run without remote robots.

    How often filters made their test is unknown, as no frame of a robot has this number.
    """
    counts = comparison.remote_run.results["frames"]
    local_counts = comparison.local_run.results["frames"]
    for name in ("sent", "heartbeats_sent", "delivered"):
        assert counts[name] == local_counts[name], name
    assert comparison.remote_run.results["tests"] is None


def test_what_is_reported_of_a_remote_robot_comes_from_its_telemetry(comparison: Comparison) -> None:
    """x and the number of updates are exact, and b_hat is rounded down to units of 2**-24.

    Its x_hat is that of its last broadcast, which it makes in the last tick of the run here. The number of
    observations, t, is counted by the program that drives the robot.
    """
    for robot_id in comparison.remote_robot_ids:
        reported_robot = comparison.remote_run.nodes[robot_id].robot
        local_robot = comparison.local_run.nodes[robot_id].robot
        assert reported_robot.t == local_robot.t
        assert reported_robot.x == local_robot.x
        assert reported_robot.x_hat == local_robot.x_hat
        assert reported_robot.counters.updates == local_robot.counters.updates
        units_of_b_hat = int(local_robot.b_hat * 2**24)
        b_hat_rounded_down = units_of_b_hat / 2**24
        assert reported_robot.b_hat == b_hat_rounded_down


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wiring", "faults", "comms_period", "swarm_filter"),
    [
        (wiring_with_remote_robots(*range(4)), FAULTS, 4, "robust"),
        (wiring_with_remote_robots(1), FAULTS_AND_CRASHES, 1, "asdf-plus"),
    ],
    ids=["all remote", "one remote, others crash"],
)
def test_remote_robots_end_in_the_same_state_among_faults(
    wiring: Wiring, faults: tuple[str, ...], comms_period: int, swarm_filter: str
) -> None:
    """A run without remote robots ends with the same saved states and the same estimates x of all robots."""
    settings = small_swarm(*faults, robots=4, comms_period=comms_period, filter=swarm_filter)
    comparison = compare_runs(settings, wiring)
    x_with_remote_robots = [node.robot.x for node in comparison.remote_run.nodes]
    x_of_local_robots = [node.robot.x for node in comparison.local_run.nodes]

    assert comparison.saved_remote_robots == comparison.saved_local_robots
    assert x_with_remote_robots == x_of_local_robots


def test_126_robots_with_one_in_another_program_are_accepted() -> None:
    """No error is raised. They have ids 0 to 125, which leaves 126 for the program that drives them."""
    wiring_of_remote_robot_1 = wiring_with_remote_robots(1)
    remote_robot.check_remote(small_swarm(robots=126), wiring_of_remote_robot_1)


@contextmanager
def swarm_without_robot_1_after_tick_1(
    monkeypatch: pytest.MonkeyPatch, check: Callable[[], None] = lambda: None
) -> Iterator[Swarm]:
    """A swarm after its first tick, with the remote robot 1, which is gone since then.

    The swarm waits for robots for 0.1 s, and calls ``check`` meanwhile.
    """
    monkeypatch.setattr(remote_robot, "ANSWER_TIMEOUT", 0.1)
    settings = small_swarm()
    with Swarm(settings, wiring_with_remote_robots(1)) as driven_swarm, own_bus(1) as bus:
        with remote_robot_in_a_thread(RobotNode(settings.robot_setups()[1]), bus):
            driven_swarm.wait_until_up(10, check)
            driven_swarm.tick()
        yield driven_swarm


def test_a_remote_robot_that_falls_silent_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Robot 1 is gone after tick 1. The run's failure names tick 2 and robot 1. No error is raised."""
    with swarm_without_robot_1_after_tick_1(monkeypatch) as driven_swarm:
        run = run_swarm(driven_swarm)

    assert run.failure is not None
    assert "tick 2: robot 1 did not broadcast its estimate within" in run.failure
    assert run.results["steps"] == 1


def test_a_wait_for_a_silent_robot_can_be_ended_by_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The caller's function ``check`` is called while a tick waits for robot 1. Its error ends the tick."""
    check = Mock()
    with swarm_without_robot_1_after_tick_1(monkeypatch, check) as driven_swarm:
        check.side_effect = KeyboardInterrupt
        with pytest.raises(KeyboardInterrupt):
            driven_swarm.tick()


THREE_ROBOTS = ["swarm", "--robots", "3", "--steps", "25", "--filter-period", "10", "--seed", "5", "--json"]


@dataclass(frozen=True)
class ProcessesAndThisProcess:
    """The reports and logs of three robots in processes of their own, and of the same robots in this process.

    Both runs lose and damage some frames, and allow estimates under the ids 0 and 2 alone.
    """

    report: dict[str, Any]
    log: Path
    local_report: dict[str, Any]
    local_log: Path

    @property
    def reports_of_processes(self) -> list[dict[str, Any]]:
        """Report of each process on its robot, by id."""
        return [self.report["processes"][str(robot)]["results"] for robot in range(3)]

    @property
    def local_robots(self) -> list[dict[str, Any]]:
        """Report on each robot in this process, by id."""
        robots: list[dict[str, Any]] = self.local_report["results"]["robots"]
        return robots


@pytest.fixture(scope="module", params=["robust", *slow(["asdf-plus"])])
def two_runs(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> ProcessesAndThisProcess:
    """Run three robots with this filter in processes, on multicast groups, and in this process."""
    multicast(251)
    folder = tmp_path_factory.mktemp("runs")
    log, local_log = folder / "run.log", folder / "local.log"
    options = [*THREE_ROBOTS, "--fault", "loss=0.2", "--fault", "corrupt=0.1", "--allow", "0+2"]
    options += ["--filter", request.param]
    groups = ["--interface", "udp_multicast", "--channel", "239.74.163.{robot}"]
    groups += ["--bus-kwargs", f"port={UDP_PORT}"]
    report = json_report([*options, *groups, "--processes", "--log", str(log)])
    local_report = json_report([*options, "--log", str(local_log)])
    return ProcessesAndThisProcess(report, log, local_report, local_log)


def json_report(command: list[str]) -> dict[str, Any]:
    """Run a command, which has to succeed, and return what it prints."""
    with redirect_stdout(StringIO()) as output:
        assert main(command) == 0
    report: dict[str, Any] = json.loads(output.getvalue())
    return report


def test_robots_in_processes_report_what_robots_in_this_process_do(two_runs: ProcessesAndThisProcess) -> None:
    """After 25 steps they have the same accuracy b_hat, the same estimate x and the same number of tests.

    ``two_runs`` has the reports of three robots in processes, and of the same robots in this process.
    """
    for process_report, local_robot in zip(two_runs.reports_of_processes, two_runs.local_robots, strict=True):
        robot = process_report["robot"]
        assert process_report["steps"] == 25
        assert robot["b_hat"] == local_robot["b_hat"]
        assert robot["x"] == local_robot["x"]
        assert robot["counters"]["tests"] == local_robot["tests"]


def test_the_program_that_drives_robots_in_processes_reports_their_estimates(
    two_runs: ProcessesAndThisProcess,
) -> None:
    """Each robot has the same x as in a run in this process."""
    x_of_robots_in_processes = [robot["x"] for robot in two_runs.report["results"]["robots"]]
    x_of_local_robots = [robot["x"] for robot in two_runs.local_robots]
    assert x_of_robots_in_processes == x_of_local_robots


def test_robots_in_processes_report_the_sender_that_is_not_allowed(two_runs: ProcessesAndThisProcess) -> None:
    """Robot 1 is not allowed. Robots 0 and 2 report an event "unknown" with this sender, and robot 1 none."""
    unknown_senders_by_robot = []
    for process_report in two_runs.reports_of_processes:
        events = process_report["frames"]["events"]
        unknown_senders = [event["sender"] for event in events if event["event"] == "unknown"]
        unknown_senders_by_robot.append(unknown_senders)
    assert unknown_senders_by_robot == [[1], [], [1]]


def test_the_log_of_robots_in_processes_can_be_replayed(two_runs: ProcessesAndThisProcess) -> None:
    """The replay computes each broadcast again, and ends with exit code 0, as none differs."""
    log_of_processes = str(two_runs.log)
    assert main(["replay", log_of_processes]) == 0


def test_the_events_of_robots_in_processes_are_those_of_robots_in_this_process(
    two_runs: ProcessesAndThisProcess,
) -> None:
    """The files of events beside both logs have the same entries, such as observations."""
    with EventsReader(events_path(two_runs.log)) as reader:
        entries = list(reader.entries())
    with EventsReader(events_path(two_runs.local_log)) as local_reader:
        local_entries = list(local_reader.entries())
    assert entries == local_entries


def test_a_robot_on_a_device_that_sends_no_heartbeat_fails_the_run_with_its_id_and_the_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is on the bus of robot 1, v1. The exit code is 1, and the error is printed in JSON."""
    monkeypatch.setattr(swarm, "_STARTING_TIMEOUT", 0.05)
    options = "--robots 3 --channel v{robot} --device 1=virtual:v1 --json"
    assert main(["swarm", *options.split()]) == 1
    failure = json.loads(capsys.readouterr().err)
    assert failure["error"].startswith("robot 1 did not send a heartbeat within 0.05 s")


def test_an_error_frame_is_counted_and_is_no_frame_of_a_robot() -> None:
    """The 8 in an error frame is a kind of error, and no sender.

    So the program that drives the remote robot 8 keeps no frame for the next tick, and the robot counts the
    error.
    """
    robot_8 = BusRobot(setup_of_robot(8), FrameFormat())
    driver = remote_robot.Driver(Mock(), [robot_8], FrameFormat())
    # A bus has no error frames unless its hardware reports some, so one is handed to the driver.
    driver._handle_frame(can.Message(arbitration_id=8, is_error_frame=True))

    assert driver._frames_for_next_tick == []
    assert robot_8.reception.errors == 1
