"""The emulated neighbours of a real controller, in lockstep and in real time.

In lockstep a tick ends when the controller has done its part. In real time each tick has its time.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.bus.frames import (
    Estimate,
    FrameFormat,
    encode_estimate,
    sender_of,
)
from mcp_asdf_tools.cli import radio as radio_command
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.radio.bench import Bench
from mcp_asdf_tools.radio.neighbourhood import RadioSettings, choose_ids, create_neighbours
from mcp_asdf_tools.radio.real_time import RadioRun
from mcp_asdf_tools.robots.node import BusLink, RobotNode, Subjects
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.parsing import parse_fault
from mcp_asdf_tools.swarm.run import run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from wire import Wire, join_virtual_bus, radio
from wrong_robots import ID, settings_with_four_neighbours

pytestmark = pytest.mark.usefixtures("private_setup")

# --- Neighbours in lockstep ---


def crashes_of(*, robot_that_becomes_new: int, robot_that_is_restored: int) -> str:
    """Return the faults by which two robots crash and come back."""
    first_crash = f"crash,robots={robot_that_becomes_new},from=30,to=35"
    second_crash = f"crash,robots={robot_that_is_restored},from=40,to=60,rejoin=restored"
    return f"{first_crash} {second_crash}"


FIVE_ROBOTS_IN_RANGE = SwarmSettings(
    robots=5, flawed=0.6, fill_ratio=0.9, filter_period=20, steps=120, seed=4
)
FIVE_MOVING_ROBOTS = replace(FIVE_ROBOTS_IN_RANGE, topology="dynamic", density=4)
"""Robots that move, and receive from those in range alone."""
IDS = (3, 10, 11, 40, 90)
"""Ids of a controller and its neighbours, in place of the ids 0 to 4 of a swarm."""


def state_of(robot: object) -> dict[str, int]:
    """Return the state and the counters of a robot, but not its id."""
    assert isinstance(robot, FixedPointRobot)
    return robot.state() | vars(robot.counters) | {"id": 0}


def last_states_in_a_swarm(world: SwarmSettings) -> list[dict[str, int]]:
    """Return the states in which the robots of an emulated swarm end."""
    with Swarm(world, Wiring()) as swarm:
        return [state_of(node.robot) for node in run_swarm(swarm).nodes]


def last_states_around_a_controller(world: SwarmSettings, faults: str) -> list[dict[str, int]]:
    """Run 120 ticks of a controller and its neighbours, and return their last states in the order of IDS."""
    controller_setup, *neighbour_setups = (replace(setup, id=IDS[setup.id]) for setup in world.robot_setups())
    parsed_faults = tuple(map(parse_fault, faults.split()))
    settings = RadioSettings(controller_setup, tuple(neighbour_setups), world, Subjects(), parsed_faults)
    neighbours = create_neighbours(settings)
    controller = RobotNode(controller_setup)
    for _ in range(120):
        observation = neighbours.begin_tick()[controller.id]
        for frame in neighbours.finish_tick(controller.begin_tick(observation)):
            controller.receive_frame(frame)
        controller.end_tick()
    robots = (controller, *neighbours.nodes)
    return [state_of(node.robot) for node in robots]


@pytest.mark.parametrize("world", [FIVE_ROBOTS_IN_RANGE, FIVE_MOVING_ROBOTS], ids=["all in range", "moving"])
def test_a_controller_and_its_neighbours_compute_what_an_emulated_swarm_of_as_many_robots_computes(
    world: SwarmSettings,
) -> None:
    """All five end in the same states, but for their ids, and after the same crashes of two of them.

    The robots of the swarm are 0 to 4. The controller is robot 3, and its neighbours are 10, 11, 40 and 90.
    """
    faults_in_swarm = crashes_of(robot_that_becomes_new=1, robot_that_is_restored=2)
    faults_around_controller = crashes_of(robot_that_becomes_new=10, robot_that_is_restored=11)

    states_in_swarm = last_states_in_a_swarm(replace(world, faults=faults_in_swarm.split()))
    states_around_controller = last_states_around_a_controller(world, faults_around_controller)

    assert states_around_controller == states_in_swarm
    number_of_updates = sum(state["updates"] for state in states_in_swarm)
    assert number_of_updates > 0, "no robot has re-estimated its accuracy"


@pytest.mark.parametrize(
    ("controller", "count", "first", "expected_ids"),
    [
        (3, 1, 0, (0,)),
        (3, 5, 0, (0, 1, 2, 4, 5)),
        (3, 5, 3, (4, 5, 6, 7, 8)),
        (127, 126, 0, tuple(range(126))),
    ],
)
def test_emulated_neighbours_have_the_lowest_allowed_ids_except_the_id_of_the_controller(
    controller: int, count: int, first: int, expected_ids: tuple[int, ...]
) -> None:
    """``controller`` is its id, ``first`` the first allowed id, and ``count`` the number of neighbours."""
    assert choose_ids(controller=controller, count=count, first=first) == expected_ids


@pytest.mark.parametrize(
    ("count", "first", "expected_message"),
    [
        (0, 0, "robots is 1; from id 0"),
        (126, 0, "room for 2 to 126"),
        (3, 124, "room for 2 to 3"),
        (1, 126, "first-id is 126; it must be 0 to 125"),
        (1, -1, "first-id is -1"),
    ],
)
def test_more_neighbours_than_there_are_ids_are_refused(
    count: int, first: int, expected_message: str
) -> None:
    """The error says how many there is room for from the first allowed id on, the controller counted in.

    Ids 126 and 127 are for tools, and 3 is the controller.
    """
    with pytest.raises(UsageError, match=expected_message):
        choose_ids(controller=3, count=count, first=first)


# --- Neighbours in real time ---


def run_four_neighbours(
    link: BusLink, *, ticks: int, steps_per_second: int = 1000, faults: str = ""
) -> RadioRun:
    """Run four neighbours of robot 3 in real time, and return the run when it has ended."""
    settings = settings_with_four_neighbours(faults=faults, steps_per_second=steps_per_second)
    run = RadioRun(settings, link, ticks)
    run.run()
    return run


def test_neighbours_in_real_time_go_on_when_the_bus_fails_and_count_the_frames_that_were_lost() -> None:
    """The bus refuses every other frame. All 20 ticks are done, and half of the frames count as failures."""
    bus = Mock()
    bus.send.side_effect = cycle([can.CanOperationError("cable pulled"), None])
    bus.recv.return_value = None
    figures = run_four_neighbours(BusLink(bus, tolerates_failures=True), ticks=20).figures()

    assert figures["steps"] == 20
    assert figures["ending"] == "all ticks done"
    frames = 4 * (20 + 1)  # 4 robots send 20 estimates and 1 heartbeat each
    assert figures["frames_sent"] == frames / 2
    assert figures["bus_failures"] == frames / 2


@pytest.fixture(
    params=[BusLink.handle_waiting_frames, lambda link, take: None], ids=["at ticks", "between ticks"]
)
def run_beside_others(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> RadioRun:
    """A run of 5 ticks in which estimates of robots 1, 5, 6 and 100 and of the controller arrive.

    They are read at the beginning of a tick, or else, where nothing is read then, between two ticks.
    """
    monkeypatch.setattr(BusLink, "handle_waiting_frames", request.param)
    # The first frame is of another subject, and so no estimate.
    frames = [encode_estimate(Estimate(ID, x_hat=9, alpha=0, transfer_id=0), FrameFormat(subject=17))]
    for sender in (ID, 1, 1, 100, 5, 6):
        estimate = Estimate(sender, x_hat=9, alpha=0, transfer_id=0)
        frames.append(encode_estimate(estimate, FrameFormat()))
    wire = Wire()
    for frame in frames:
        frame.is_rx = True
        wire.frames_for_tool.append(frame)
    # On a busy machine, too, one of the pauses between ticks is long enough to read all frames.
    return run_four_neighbours(BusLink(wire), ticks=5, steps_per_second=20)


def test_estimates_on_the_bus_are_counted_as_those_of_the_controller_of_strangers_or_of_a_conflict(
    run_beside_others: RadioRun,
) -> None:
    """An estimate of robot 3, the controller, comes, two of robot 1, and three of robots 5, 6 and 100.

    Robots 0, 1, 2 and 4 are emulated here. So those of robot 1 are conflicts, and 5, 6 and 100 are strangers.
    The frames wait on the bus when a run of 5 ticks begins.
    """
    figures = run_beside_others.figures()
    assert figures["estimates_heard"] == 1, "estimates of the controller, robot 3"
    assert figures["strangers"] == 3, "estimates of robots 5, 6 and 100"
    assert figures["id_conflicts"] == {"1": 2}
    assert figures["bus_failures"] == 0


def test_error_frames_on_the_bus_are_counted() -> None:
    """A CAN adapter reports disturbances of the bus, say of a loose cable, by such frames."""
    wire = Wire()
    wire.frames_for_tool.extend([can.Message(is_error_frame=True), can.Message(is_error_frame=True)])

    run = run_four_neighbours(BusLink(wire), ticks=1, steps_per_second=20)

    assert run.figures()["error_frames"] == 2


def test_each_neighbour_receives_the_estimates_of_the_controller_and_of_the_other_neighbours(
    run_beside_others: RadioRun,
) -> None:
    """In 5 ticks each of 4 neighbours accepts 5 estimates of each other one, and one of the controller."""
    nodes = run_beside_others.neighbours.nodes
    accepted_counts = [node.counters.accepted for node in nodes]
    of_three_others, of_controller = 3 * 5, 1
    assert accepted_counts == [of_three_others + of_controller] * 4


def test_the_figures_of_a_run_have_the_mean_and_the_range_of_the_neighbours_x() -> None:
    """``spread_x`` is the largest x less the smallest. It is above 0, as half of the messages are lost.

    There are four neighbours.
    """
    quiet_bus = Wire()
    run = run_four_neighbours(BusLink(quiet_bus), ticks=5, faults="loss=0.5")
    x_of_neighbours = [node.robot.x for node in run.neighbours.nodes]

    figures = run.figures()
    assert figures["mean_x"] == sum(x_of_neighbours) / 4
    assert figures["spread_x"] == max(x_of_neighbours) - min(x_of_neighbours)
    assert figures["spread_x"] > 0


@pytest.mark.parametrize(("ticks", "is_interrupted"), [(None, False), (1000, True)])
def test_neighbours_in_real_time_that_are_asked_to_stop_end_in_that_tick(
    ticks: int | None, is_interrupted: bool
) -> None:
    """They are asked in tick 3. A run of 1000 ticks counts as interrupted then.

    An endless run (None) does not, as it has no other end.
    """
    settings = settings_with_four_neighbours(steps_per_second=1000)

    def is_tick_3_reached() -> bool:
        return run.neighbours.ticks >= 3

    quiet_bus = Wire()
    run = RadioRun(settings, BusLink(quiet_bus, should_stop=is_tick_3_reached), ticks=ticks)
    run.run()

    assert run.neighbours.ticks == 3
    assert run.outcome.ending == "stopped"
    assert run.outcome.is_interrupted == is_interrupted


# --- The command ---


def receive_waiting_frames(bus: can.BusABC) -> list[can.Message]:
    """Return the frames that have arrived on a bus."""
    return list(iter(lambda: bus.recv(0), None))


@dataclass(frozen=True)
class RealTimeRun:
    """A run of 20 ticks of four neighbours of robot 3, which loses half of the frames to the controller.

    Attributes:
        frames: The frames that the neighbours have sent.
        report: The report in JSON that the command has printed.
        report_in_file: The report beside the log.
    """

    frames: list[can.Message]
    report: dict[str, Any]
    report_in_file: dict[str, Any]


@pytest.fixture
def real_time_run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> RealTimeRun:
    options = "--id 3 --robots 5 --steps 20 --steps-per-second 1000 --fault loss=0.5,receivers=3 --json"
    with join_virtual_bus() as bus:
        assert radio(f"{options} --log '{tmp_path}/run.log'") == 0
        frames = receive_waiting_frames(bus)
    report_in_file = (tmp_path / "run.log.json").read_text()
    return RealTimeRun(frames, json.loads(capsys.readouterr().out), json.loads(report_in_file))


def test_neighbours_in_real_time_send_the_frames_that_a_fault_spares(real_time_run: RealTimeRun) -> None:
    """4 neighbours of robot 3 would send 20 estimates and 1 heartbeat each.

    The fault, a loss of half of the frames, removes some of them, and counts them as injected. All that are
    left are sent.
    """
    results = real_time_run.report["results"]
    (loss,) = results["faults"]

    sent_frames = real_time_run.frames
    assert results["frames_sent"] == len(sent_frames)
    assert len(sent_frames) + loss["injected"] == 4 * (20 + 1)
    assert {sender_of(frame) for frame in sent_frames} == {0, 1, 2, 4}


def test_the_report_of_neighbours_in_real_time_is_printed_and_is_beside_the_log(
    real_time_run: RealTimeRun,
) -> None:
    """``mcp-asdf radio --json`` has done 20 ticks, and has printed what is in the file beside its log.

    ``real_time_run`` has both, parsed.
    """
    assert real_time_run.report["results"]["steps"] == 20
    assert real_time_run.report_in_file == real_time_run.report


def test_neighbours_with_perfect_sensors_assume_the_largest_accuracy_that_the_firmware_can_have(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Emulated sensors may have an accuracy of 1, but the firmware refuses 1. So b_hat is 1 - 2**-20.

    There are two neighbours of the controller.
    """
    options = "--id 3 --robots 3 --steps 1 --steps-per-second 1000 --true-accuracy 1 --json"
    assert radio(options) == 0
    parameters = json.loads(capsys.readouterr().out)["parameters"]

    largest_b_hat = 1 - 2**-20
    first_neighbour, second_neighbour = parameters["neighbours"]
    assert first_neighbour["b_hat"] == largest_b_hat
    assert second_neighbour["b_hat"] == largest_b_hat


def test_the_text_of_a_run_in_real_time_has_its_frames_faults_and_conflicts_of_ids() -> None:
    """The figures are those of a run's report. The last two lines are about a fault and a conflict of ids."""
    results = {
        "steps": 20,
        "ending": "all ticks done",
        "frames_sent": 40,
        "estimates_heard": 19,
        "strangers": 3,
        "error_frames": 1,
        "bus_failures": 2,
        "mean_x": 0.5788,
        "spread_x": 0.125,
        "faults": [{"fault": "loss=0.5,receivers=3", "injected": 42}],
        "id_conflicts": {"1": 2},
    }
    lines = radio_command._format_results(results, "no filter: no robot recalibrates").splitlines()

    assert lines == [
        "run         20 steps; all ticks done",
        "filter      no filter: no robot recalibrates",
        "frames      40 sent to it, 19 estimates heard of it, 3 from strangers; 1 error frames, "
        "the bus failed 2 times",
        "neighbours  mean x 0.57880, spread 0.12500",
        "fault       loss=0.5,receivers=3: struck 42 times",
        "node-id conflict: another node sent 2 messages as robot 1; see --first-id",
    ]


MESSAGES_BY_WRONG_ARGUMENTS = {
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


@pytest.mark.parametrize(("arguments", "expected_message"), MESSAGES_BY_WRONG_ARGUMENTS.items())
def test_wrong_arguments_of_radio_are_refused_before_the_first_tick(
    arguments: str,
    expected_message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """The exit code is 2, and the error is printed. There is no tick and no file."""
    make_tick = Mock()  # of a run in real time, or of a verification
    monkeypatch.setattr(RadioRun, "_run_tick", make_tick)
    monkeypatch.setattr(Bench, "settle_and_compare", make_tick)
    monkeypatch.chdir(tmp_path)

    assert radio(arguments) == 2
    assert expected_message in capsys.readouterr().err
    assert make_tick.call_count == 0
    assert list(tmp_path.iterdir()) == []
