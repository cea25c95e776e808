"""The neighbours of a real controller: a swarm with a gap, and a judge who finds every wrong controller."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import can
import pytest

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.bus.frames import FrameFormat, Message, decode, encode
from mcp_asdf_tools.cli.main import main
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.radio.neighbourhood import Neighbourhood, RadioSettings, choose_ids
from mcp_asdf_tools.radio.real_time import RadioRun
from mcp_asdf_tools.radio.verification import Verification
from mcp_asdf_tools.robots.node import BusLink, RobotNode, Subjects
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.world.world import World
from node_thread import join, live_robot, meanwhile
from support import PATIENCE
from wire import Wire, record
from wrong_robots import ID, surroundings

pytestmark = pytest.mark.usefixtures("private_setup")

# Neighbours


def test_a_controller_among_its_neighbours_is_a_robot_in_a_swarm() -> None:
    """Robot 3 lives outside; all five end with the same bits as in an emulated swarm."""
    world = SwarmSettings(robots=5, flawed=0.6, steps=120, filter_period=20, seed=9, fill_ratio=0.9)
    records = world.records()
    others = tuple(each for each in records if each.id != ID)
    neighbourhood = Neighbourhood(RadioSettings(records[ID], others, world, Subjects()))
    controller = RobotNode(records[ID])
    for _ in range(120):
        for frame in neighbourhood.finish(controller.observe(neighbourhood.begin())):
            controller.hear(frame)
        controller.settle()
    with Swarm(world, Wiring(lambda robot: can.Bus("s", "virtual"))) as swarm:
        for _ in range(120):
            swarm.tick()
        expected = {each.id: state(each.robot) for each in swarm.nodes}
    alone = {robot: state(each.robot) for robot, each in (neighbourhood.nodes | {ID: controller}).items()}
    assert alone == expected
    assert any(each["updates"] for each in expected.values())


def state(robot: object) -> dict[str, int]:
    assert isinstance(robot, FixedPointRobot)
    return robot.state() | {"updates": robot.counters.updates}


def test_a_controller_hears_and_is_heard_in_range_only() -> None:
    ids = (3, 10, 11, 40, 90)
    own = record(ID)
    world = SwarmSettings(robots=5, topology="dynamic", seed=4)
    neighbourhood = Neighbourhood(
        RadioSettings(own, tuple(record(robot) for robot in ids[1:]), world, Subjects())
    )
    twin = World(world)
    seen: set[int] = set()
    for tick in range(300):
        z = neighbourhood.begin()
        assert z == twin.step()[0]
        near = {ids[place] for place in twin.neighbours(0)}
        before = {robot: node.robot.counters.accepted for robot, node in neighbourhood.nodes.items()}
        frames = neighbourhood.finish([encode(Message(ID, 1, 0, tick % 32), FrameFormat())])
        estimates = [m for f in frames if isinstance(m := decode(f, FrameFormat()), Message)]
        assert {message.sender for message in estimates} == near
        for robot, node in neighbourhood.nodes.items():
            around = {ids[place] for place in twin.neighbours(ids.index(robot))}
            assert node.robot.counters.accepted - before[robot] == len(around)
        seen.add(len(near))
    assert len(seen) > 2


def test_crashed_neighbours_are_silent_and_rejoin_new_or_as_they_were() -> None:
    for rejoin in ("new", "restored"):
        neighbourhood = Neighbourhood(
            surroundings(faults=f"crash,robots=1,from=10,to=11,ticks=5,rejoin={rejoin}")
        )
        senders = []
        for _ in range(30):
            neighbourhood.begin()
            heard = [
                m for f in neighbourhood.finish([]) if isinstance(m := decode(f, FrameFormat()), Message)
            ]
            senders.append({message.sender for message in heard})
        assert [tick for tick in range(30) if 1 not in senders[tick]] == list(range(10, 15))
        assert neighbourhood.nodes[1].robot.t == (15 if rejoin == "new" else 25)
        assert neighbourhood.nodes[0].robot.t == 30


def test_ids_are_chosen_around_the_controller() -> None:
    assert choose_ids(3, 5) == (0, 1, 2, 4, 5)
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
    class Failing(Wire):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            self.sent.append(msg)
            if len(self.sent) % 2:
                raise can.CanOperationError("cable pulled")

    plan = surroundings(steps_per_second=1000)
    run = RadioRun(Neighbourhood(plan), BusLink(Failing(), endures=True), ticks=20)
    run.run()
    figures = run.figures()
    assert (figures["steps"], figures["ending"]) == (20, "all ticks done")
    assert figures["bus_failures"] == figures["frames_sent"] == 4 * 21 // 2
    assert all(node.robot.t == 20 for node in run.neighbours.nodes.values())


# The command


def radio(options: str) -> int:
    return main(["radio", *shlex.split(options)])


def test_neighbours_in_real_time_hear_and_are_heard(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = tmp_path / "run.log"
    with live_robot(record(3), 100) as frames, meanwhile(lambda: speak_as(1, 9)):
        code = radio(
            "--id 3 --robots 5 --steps-per-second 100 --steps 100 --fault loss=0.5,receivers=3 --json "
            f"--log {log}"
        )
    assert code == 0
    report = json.loads(capsys.readouterr().out)
    assert json.loads(Path(f"{log}.json").read_text()) == report
    results = report["results"]
    assert results["steps"] == 100
    assert results["estimates_heard"] > 0
    assert results["strangers"] == 1
    assert results["id_conflicts"] == {"1": 1}
    lost = results["faults"][0]["injected"]
    assert results["frames_sent"] + lost == 4 * (100 + 1)  # with a heartbeat each
    heard = [m for f in frames if isinstance(m := decode(f, FrameFormat()), Message)]
    assert [message for message in heard if message.sender in (0, 1, 2, 4)]


def speak_as(*senders: int) -> None:
    """Let other nodes say something once the radio is at work."""
    with join() as bus:
        while (frame := bus.recv(PATIENCE)) is not None and frame.arbitration_id & 0x7F != 4:
            pass
        bus.send(can.Message(arbitration_id=FrameFormat().identifier(9), data=bytes(8)))  # no estimate
        for sender in senders:
            bus.send(encode(Message(sender, 7, 0, 0), FrameFormat()), timeout=1)


BAD = {
    "": "--id",
    "--id 128": "robot id is 128",
    "--id 3 --robots 1": "robots is 1; from id 0 on there is room for 2 to 126",
    "--id 3 --robots 5 --first-id 123": "robots is 5; from id 123 on there is room for 2 to 4",
    "--id 3 --first-id 126": "first-id is 126; it must be 0 to 125",
    "--id 3 --steps 0": "steps is 0",
    "--id 3 --fault gremlin": "no kind is called 'gremlin'",
    "--id 3 --verify --fault collide": "fault collide needs the id",
    "--id 3 --report x.md": "--report is for a verification",
    "--id 3 --timeout 2": "--timeout is for a verification",
    "--id 3 --verify --timeout 0": "timeout is 0.0",
    "--id 3 --verify --wait nan": "wait is nan",
    "--id 126 --verify": "robot 126 has the id of the simulator",
    "--id 3 --log run.db": "cannot log to run.db: choose .log",
    "--id 3 --command-subject 3000": "choose three different ones",
}


@pytest.mark.parametrize(
    ("options", "obstructed"),
    [
        ("--log run.log", "run.log"),
        ("--log run.log", "run.log.json"),
        ("--verify --log run.log", "run.log.events"),
        ("--verify --report report.md", "report.md"),
    ],
)
def test_what_cannot_be_written_is_told_before_the_first_tick(
    options: str,
    obstructed: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    for kind in (RadioRun, Verification):
        monkeypatch.setattr(kind, "run", lambda self: pytest.fail("it ran"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / obstructed).mkdir()
    assert radio(f"--id 3 {options}") == 2
    assert f"cannot write {obstructed}: it is not a regular file" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [obstructed]


@pytest.mark.parametrize("arguments", BAD)
def test_bad_usage(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert radio(arguments) == 2
    assert BAD[arguments] in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
