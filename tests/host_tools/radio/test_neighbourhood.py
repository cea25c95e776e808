"""The neighbours of a real controller: a swarm with a gap, and a judge who finds every wrong controller."""

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

# Neighbours


CRASHES = "crash,robots={},from=30,to=35 crash,robots={},from=40,to=60,rejoin=restored"


@pytest.mark.parametrize(("changes", "heard"), [({}, 480 - 25), ({"topology": "dynamic", "density": 4}, 192)])
def test_a_controller_among_its_neighbours_is_a_robot_in_a_swarm(changes: dict[str, Any], heard: int) -> None:
    """Robot 3 lives outside; all five end with the same bits as in an emulated swarm of other ids, in which
    some crash, and what comes from one that does not is stamped with the time."""
    ids, population = (3, 10, 11, 40, 90), {"robots": 5, "flawed": 0.6, "filter_period": 20, "steps": 120}
    settings: dict[str, Any] = population | {"seed": 4, "fill_ratio": 0.9} | changes
    world = SwarmSettings(**settings, faults=CRASHES.format(1, 2).split())
    own, *others = (replace(each, id=ids[each.id]) for each in world.robot_setups())
    faults = tuple(map(parse_fault, CRASHES.format(10, 11).split()))
    neighbourhood = Neighbourhood(RadioSettings(own, tuple(others), world, Subjects(), faults))
    controller = RobotNode(own)
    for tick in range(120):
        for frame in neighbourhood.finish(controller.observe(neighbourhood.begin())):
            assert frame.arbitration_id & 0x7F != 40 or frame.timestamp == tick / world.steps_per_second
            controller.receive_frame(frame)
        controller.settle()
    with Swarm(world, Wiring()) as swarm:
        expected = [state(each.robot) for each in run_swarm(swarm).nodes]
    found = [state(each.robot) for each in (controller.bus_robot, *neighbourhood.nodes.values())]
    assert found == expected
    assert any(each["updates"] for each in expected)
    assert found[0]["accepted"] == heard
    assert found[1]["t"] < found[2]["t"] < found[0]["t"]


@pytest.mark.parametrize(("rejoin", "expected"), REJOINING.items())
def test_a_neighbour_that_rejoins_sends_heartbeats_as_a_robot_of_a_swarm_does(
    rejoin: str, expected: list[tuple[int, int]]
) -> None:
    crash = parse_fault(f"crash,robots=1,from=45,to=47,rejoin={rejoin}")
    neighbourhood = Neighbourhood(replace(surroundings(), faults=(crash,)))
    found = []
    for tick in range(60):
        neighbourhood.begin()
        for frame in neighbourhood.finish([]):
            heartbeat = decode_heartbeat(frame)
            if isinstance(heartbeat, Heartbeat) and heartbeat.sender == 1:
                found.append((tick, heartbeat.uptime))
    assert found == expected


def state(robot: object) -> dict[str, int]:
    assert isinstance(robot, FixedPointRobot)
    return robot.state() | vars(robot.counters) | {"id": 0}


def test_ids_are_chosen_around_the_controller() -> None:
    assert (choose_ids(3, 1), choose_ids(3, 5)) == ((0,), (0, 1, 2, 4, 5))
    assert choose_ids(3, 5, 3) == (4, 5, 6, 7, 8)
    assert choose_ids(127, 126) == tuple(range(126))
    for count, first, text in (
        (0, 0, "robots is 1; from id 0"),
        (126, 0, "room for 2 to 126"),
        (3, 124, "room for 2 to 3"),
        (1, 126, "first-id is 126; it must be 0 to 125"),
        (1, -1, "first-id is -1"),
    ):
        with pytest.raises(UsageError, match=text):
            choose_ids(3, count, first)


def test_neighbours_go_on_when_the_bus_fails() -> None:
    bus = Mock()
    bus.send.side_effect, bus.recv.return_value = cycle([can.CanOperationError("cable pulled"), None]), None
    plan = surroundings(steps_per_second=1000)
    run = RadioRun(Neighbourhood(plan), BusLink(bus, endures=True), ticks=20)
    run.run()
    figures = run.figures()
    assert (figures["steps"], figures["ending"]) == (20, "all ticks done")
    assert figures["bus_failures"] == figures["frames_sent"] == 4 * 21 // 2
    assert all(node.robot.t == 20 for node in run.neighbours.nodes.values())


@pytest.mark.parametrize("catch_up", [BusLink.catch_up, lambda link, take: None])
def test_what_neighbours_hear_is_counted_by_its_sender(
    catch_up: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether it comes at a tick or between two. And what the controller says reaches them."""
    monkeypatch.setattr(BusLink, "catch_up", catch_up)
    wire, others = Wire(), FrameFormat(17)
    heard = [encode_estimate(Estimate(ID, 9, 0, 0), others)]  # another subject's
    heard += [encode_estimate(Estimate(sender, 9, 0, 0), FrameFormat()) for sender in (ID, 1, 1, 100, 5, 6)]
    wire._waiting.extend(heard)
    for frame in heard:
        frame.is_rx = True
    # On a busy machine, too, one of the pauses between ticks is long enough to read all frames.
    run = RadioRun(Neighbourhood(surroundings(steps_per_second=20)), BusLink(wire), ticks=5)
    run.run()
    told = {"estimates_heard": 1, "strangers": 3, "id_conflicts": {"1": 2}, "bus_failures": 0}
    assert run.figures().items() >= told.items()
    assert [node.counters.accepted for node in run.neighbours.nodes.values()] == [3 * 5 + 1] * 4
    x = [node.robot.x for node in run.neighbours.nodes.values()]
    assert (run.figures()["mean_x"], run.figures()["spread_x"]) == (sum(x) / 4, max(x) - min(x))


@pytest.mark.parametrize("ticks", [None, 1000])
def test_neighbours_stop_when_asked_to(ticks: int | None) -> None:
    """With a number of ticks that is an interruption."""
    run = RadioRun(
        Neighbourhood(surroundings(steps_per_second=1000)), BusLink(Wire(), lambda: done > []), ticks
    )
    done: list[int] = []
    run.on_tick = lambda: done.append(run.neighbours.tick) if run.neighbours.tick == 3 else None
    run.run()
    assert (done, run.outcome.ending, run.outcome.is_interrupted) == ([3], "stopped", ticks is not None)
    assert run.outcome.lateness is not None


# The command


def radio(options: str) -> int:
    return main(["radio", "--interface", "virtual", *shlex.split(options)])


def test_neighbours_in_real_time_speak_and_leave_a_report(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log, options = tmp_path / "run.log", "--steps 20 --steps-per-second 100 --fault loss=0.5,receivers=3"
    with join() as bus:
        assert radio(f"--id 3 --robots 5 {options} --json --log {log}") == 0
        frames = []
        while (frame := bus.recv(0)) is not None:
            frames.append(frame)
    report = json.loads(capsys.readouterr().out)
    assert json.loads(Path(f"{log}.json").read_text()) == report
    results = report["results"]
    assert (results["steps"], results["frames_sent"]) == (20, len(frames))
    assert len(frames) + results["faults"][0]["injected"] == 4 * (20 + 1)  # with a heartbeat each
    assert {frame.arbitration_id & 0x7F for frame in frames} == {0, 1, 2, 4}


BAD = {
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


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """All of it is told before the first tick."""
    monkeypatch.setattr(RadioRun, "_take_tick", lambda self: pytest.fail("it ran"))
    monkeypatch.setattr(Bench, "settle", lambda self: pytest.fail("it ran"))
    monkeypatch.chdir(tmp_path)
    assert radio(arguments) == 2
    assert BAD[arguments] in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
