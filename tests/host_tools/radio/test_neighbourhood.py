"""The emulated neighbours of a real controller, in lockstep and in real time."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest

from host_tools.swarm.test_swarm_faults import REJOINING
from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Heartbeat, decode_heartbeat, encode_estimate
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings, choose_ids
from mcp_asdf_tools.radio.real_time import RadioRun
from mcp_asdf_tools.robots.node import BusLink, RobotNode, Subjects
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from wire import Wire, join
from wrong_robots import ID, surroundings

pytestmark = pytest.mark.usefixtures("private_setup")

# --- Neighbours in lockstep ---


CRASHES = "crash,robots={},from=30,to=35 crash,robots={},from=40,to=60,rejoin=restored"
POPULATION: dict[str, Any] = {"robots": 5, "flawed": 0.6, "filter_period": 20, "steps": 120}
IDS = (3, 10, 11, 40, 90)
"""Ids of the controller, and of its neighbours in place of 1 to 4."""


def state_of(robot: object) -> dict[str, int]:
    """Return the state and the counters of a robot, but not its id."""
    assert isinstance(robot, FixedPointRobot)
    return robot.state() | vars(robot.counters) | {"id": 0}


@pytest.mark.parametrize(
    ("changes", "estimates_received"), [({}, 480 - 25), ({"topology": "dynamic", "density": 4}, 192)]
)
def test_a_controller_among_its_neighbours_is_a_robot_in_a_swarm(
    changes: dict[str, Any], estimates_received: int
) -> None:
    """All five end with the same bits as an emulated swarm of other ids, in which some crash."""
    world = SwarmSettings(
        **POPULATION | {"seed": 4, "fill_ratio": 0.9} | changes, faults=CRASHES.format(1, 2).split()
    )
    with Swarm(world, Wiring()) as swarm:
        swarm_states = [state_of(node.robot) for node in run_swarm(swarm).nodes]

    setup, *neighbour_setups = (replace(setup, id=IDS[setup.id]) for setup in world.robot_setups())
    faults = tuple(map(parse_fault, CRASHES.format(10, 11).split()))
    neighbourhood = Neighbourhood(RadioSettings(setup, tuple(neighbour_setups), world, Subjects(), faults))
    controller = RobotNode(setup)
    for _ in range(120):
        for frame in neighbourhood.finish(controller.observe(neighbourhood.begin())):
            controller.receive_frame(frame)
        controller.settle()
    robots = (controller.bus_robot, *neighbourhood.nodes.values())
    states = [state_of(node.robot) for node in robots]

    assert states == swarm_states
    assert any(state["updates"] for state in states)
    assert states[0]["accepted"] == estimates_received
    # Those that crash miss observations.
    assert states[1]["t"] < states[2]["t"] < states[0]["t"]


def test_frames_of_neighbours_are_stamped_with_the_time_of_their_tick() -> None:
    neighbourhood = Neighbourhood(surroundings())
    for tick in range(20):
        neighbourhood.begin()
        assert {frame.timestamp for frame in neighbourhood.finish([])} == {tick / 10}


@pytest.mark.parametrize(("rejoin", "expected_heartbeats"), REJOINING.items())
def test_a_neighbour_that_rejoins_sends_heartbeats_as_a_robot_of_a_swarm_does(
    rejoin: str, expected_heartbeats: list[tuple[int, int]]
) -> None:
    crash = parse_fault(f"crash,robots=1,from=45,to=47,rejoin={rejoin}")
    neighbourhood = Neighbourhood(replace(surroundings(), faults=(crash,)))
    heartbeats = []
    for tick in range(60):
        neighbourhood.begin()
        for frame in neighbourhood.finish([]):
            heartbeat = decode_heartbeat(frame)
            if isinstance(heartbeat, Heartbeat) and heartbeat.sender == 1:
                heartbeats.append((tick, heartbeat.uptime))

    assert heartbeats == expected_heartbeats


@pytest.mark.parametrize(
    ("controller", "count", "first", "ids"),
    [
        (3, 1, 0, (0,)),
        (3, 5, 0, (0, 1, 2, 4, 5)),
        (3, 5, 3, (4, 5, 6, 7, 8)),
        (127, 126, 0, tuple(range(126))),
    ],
)
def test_neighbours_have_the_lowest_ids_but_the_controllers(
    controller: int, count: int, first: int, ids: tuple[int, ...]
) -> None:
    """Emulated robots around a real controller have ids from ``first`` on, and not that of the controller."""
    assert choose_ids(controller, count, first) == ids


@pytest.mark.parametrize(
    ("count", "first", "complaint"),
    [
        (0, 0, "robots is 1; from id 0"),
        (126, 0, "room for 2 to 126"),
        (3, 124, "room for 2 to 3"),
        (1, 126, "first-id is 126; it must be 0 to 125"),
        (1, -1, "first-id is -1"),
    ],
)
def test_too_few_ids_for_neighbours_are_refused(count: int, first: int, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        choose_ids(3, count, first)


# --- Neighbours in real time ---


def test_emulated_neighbours_go_on_when_the_bus_fails_and_count_what_was_lost() -> None:
    bus = Mock()
    bus.send.side_effect = cycle([can.CanOperationError("cable pulled"), None])
    bus.recv.return_value = None
    settings = surroundings(steps_per_second=1000)
    run = RadioRun(Neighbourhood(settings), BusLink(bus, endures=True), ticks=20)
    run.run()
    figures = run.figures()

    assert figures["steps"] == 20
    assert figures["ending"] == "all ticks done"
    # Every other frame fails: 4 robots send an estimate in each of 20 ticks, and a heartbeat.
    assert figures["bus_failures"] == figures["frames_sent"] == 4 * (20 + 1) // 2
    assert all(node.robot.t == 20 for node in run.neighbours.nodes.values())


@pytest.fixture(params=[BusLink.catch_up, lambda link, take: None], ids=["at ticks", "between ticks"])
def run_beside_others(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> RadioRun:
    """A run of 5 ticks in which estimates of robots 1, 5, 6 and 100 and of the controller arrive."""
    monkeypatch.setattr(BusLink, "catch_up", request.param)
    frames = [encode_estimate(Estimate(ID, 9, 0, 0), FrameFormat(17))]  # of another subject
    frames += [encode_estimate(Estimate(sender, 9, 0, 0), FrameFormat()) for sender in (ID, 1, 1, 100, 5, 6)]
    for frame in frames:
        frame.is_rx = True
    wire = Wire()
    wire._waiting.extend(frames)
    # On a busy machine, too, one of the pauses between ticks is long enough to read all frames.
    run = RadioRun(Neighbourhood(surroundings(steps_per_second=20)), BusLink(wire), ticks=5)
    run.run()
    return run


def test_estimates_are_counted_as_the_controllers_a_strangers_or_a_conflict(
    run_beside_others: RadioRun,
) -> None:
    """Robot 1 is one of the emulated neighbours, so two estimates of another robot 1 are a conflict."""
    figures = run_beside_others.figures()
    assert figures["estimates_heard"] == 1  # of the controller, robot 3
    assert figures["strangers"] == 3  # robots 5, 6 and 100
    assert figures["id_conflicts"] == {"1": 2}
    assert figures["bus_failures"] == 0


def test_neighbours_receive_the_controllers_estimate_and_their_own(run_beside_others: RadioRun) -> None:
    """Each of 4 neighbours takes an estimate of 3 others in each of 5 ticks, and one of the controller."""
    nodes = run_beside_others.neighbours.nodes.values()
    assert [node.counters.accepted for node in nodes] == [3 * 5 + 1] * 4


def test_the_figures_have_the_mean_and_the_range_of_x(run_beside_others: RadioRun) -> None:
    x = [node.robot.x for node in run_beside_others.neighbours.nodes.values()]
    figures = run_beside_others.figures()
    assert (figures["mean_x"], figures["spread_x"]) == (sum(x) / 4, max(x) - min(x))


@pytest.mark.parametrize(("ticks", "is_interrupted"), [(None, False), (1000, True)])
def test_neighbours_stop_when_asked_to(ticks: int | None, is_interrupted: bool) -> None:
    """In tick 3. It is an interruption if more ticks were asked for, and else the end of an endless run."""
    link = BusLink(Wire(), lambda: run.neighbours.tick >= 3)
    run = RadioRun(Neighbourhood(surroundings(steps_per_second=1000)), link, ticks)
    run.run()

    assert run.neighbours.tick == 3
    assert (run.outcome.ending, run.outcome.is_interrupted) == ("stopped", is_interrupted)
    assert run.outcome.lateness is not None


# --- The command ---


def radio(options: str) -> int:
    return main(["radio", "--interface", "virtual", *shlex.split(options)])


def test_neighbours_in_real_time_send_frames_and_leave_a_report(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log_path, options = tmp_path / "run.log", "--steps 20 --steps-per-second 100 --fault loss=0.5,receivers=3"
    with join() as bus:
        assert radio(f"--id 3 --robots 5 {options} --json --log '{log_path}'") == 0
        frames = list(iter(lambda: bus.recv(0), None))
    report = json.loads(capsys.readouterr().out)
    assert json.loads(Path(f"{log_path}.json").read_text()) == report
    results = report["results"]

    assert (results["steps"], results["frames_sent"]) == (20, len(frames))
    assert len(frames) + results["faults"][0]["injected"] == 4 * (20 + 1)  # with a heartbeat each
    assert {frame.arbitration_id & 0x7F for frame in frames} == {0, 1, 2, 4}


COMPLAINTS = {
    "": "--id",
    "--id 3 --robots 1": "robots is 1; from id 0 on there is room for 2 to 126",
    "--id 3 --steps 0": "steps is 0",
    "--id 3 --fault gremlin": "no kind is called 'gremlin'",
    "--id 3 --verify --fault collide": "fault collide needs the id",
    "--id 3 --report x.md": "--report is for a verification",
    "--id 3 --timeout 2": "--timeout is for a verification",
    "--id 3 --verify --timeout 0": "timeout is 0.0",
    "--id 3 --verify --wait nan": "wait is nan",
    "--id 3 --verify --comms-period 2000 --filter-period 2000": "comms-period is 2000; a verification has",
    "--id 3 --verify --report .": "cannot write .: it is not a regular file",
    "--id 3 --log .": "cannot write .: it is not a regular file",
    "--id 126 --verify": "robot 126 has the id of the simulator",
}


@pytest.mark.parametrize("arguments", COMPLAINTS)
def test_wrong_arguments_are_refused_before_the_first_tick(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(RadioRun, "_take_tick", lambda self: pytest.fail("it ran"))
    monkeypatch.setattr(Bench, "settle", lambda self: pytest.fail("it ran"))
    monkeypatch.chdir(tmp_path)

    assert radio(arguments) == 2
    assert COMPLAINTS[arguments] in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
