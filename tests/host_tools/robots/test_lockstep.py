"""Robots driven in lockstep: what the driver makes of their answers, and robots in processes of their own.

What a robot makes of commands is that of the C node (tests/targets), of which tests/c_ref has the rules.
"""

from __future__ import annotations

import os
import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import can
import pytest

from mcp_asdf.fixed_point import alpha_from_word, alpha_word_from_float
from mcp_asdf.robot import Filter, Observation
from mcp_asdf_tools.bus.frame_layout import Action
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    Command,
    FrameFormat,
    Telemetry,
    decode_command,
    decode_telemetry,
)
from mcp_asdf_tools.bus.interfaces import BusChoice
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.cli.options import bus_of, robot_of, subjects_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots import processes
from mcp_asdf_tools.robots.lockstep import Lockstep, LockstepError
from mcp_asdf_tools.robots.node import RobotNode, Subjects
from mcp_asdf_tools.robots.processes import NodeProcesses
from mcp_asdf_tools.robots.robot_setup import RobotSetup, parse_ids
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from multicast import multicast
from support import PATIENCE, wait_until
from wire import CLOCK, EndlessWire, Wire, node, record, still

COLOURS = (*Observation, None)
"""The possible observations of a tick."""


# Driving


def decoded(frame: can.Message) -> Command:
    order = decode_command(frame, COMMAND_FORMAT)
    assert isinstance(order, Command)
    return order


def is_telemetry(frame: can.Message) -> bool:
    return isinstance(decode_telemetry(frame), Telemetry)


class Lossy(Wire):
    """A wire on which commands of the tool get lost, and answers of the nodes."""

    def __init__(self, *nodes: RobotNode, loses: Callable[[Command, int], bool], mute: int = -1) -> None:
        """``loses`` is asked of each command, with how often it has been sent; telemetry ``mute`` is lost."""
        self._loses, self._mute = loses, mute
        self._times, self.looks = Counter[tuple[int, int, Action]](), 0
        super().__init__(*nodes)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        order = decoded(msg)
        self._times[key := (order.tick, order.target, order.action)] += 1
        if self._loses(order, self._times[key]):
            self.sent.append(msg)
        else:
            super().send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.looks += 1
        return super().recv(timeout)

    def say(self, node: RobotNode, frames: Sequence[can.Message]) -> None:
        is_mute = node.sent.telemetry == self._mute and any(map(is_telemetry, frames))
        super().say(node, [] if is_mute else frames)


OBSERVES = {(5, 1, "o"), (5, 2, "o"), (5, 3, "o"), (9, 1, "o"), (20, 1, "o")}
LOST = OBSERVES | {(9, 1, "s"), (20, 2, "s"), (20, 3, "s")}
"""Commands that are lost once: tick, robot, observe or settle."""


@pytest.mark.parametrize("firmware", ["native", "reference"])
@still()
def test_a_driven_swarm_does_what_a_loop_of_calls_does(firmware: str) -> None:
    """A command that is lost is said again, to those alone who have not answered."""

    def is_lost(order: Command, times: int) -> bool:
        return times == 1 and (order.tick, order.target, order.action.name[0].lower()) in LOST

    robots, ids = [node(i, firmware, 0.55 + 0.1 * i) for i in range(4)], range(4)
    twins = [node(i, firmware, 0.55 + 0.1 * i).robot for i in ids]
    wire, draw, seen = Lossy(*robots, loses=is_lost), random.Random(5), list[can.Message]()
    lockstep = Lockstep(wire, timeout=0.02, on_frame=seen.append)
    for _ in range(120):
        z = {robot: draw.choice(COLOURS) for robot in ids}
        lockstep.observe(z)
        estimates = lockstep.estimates((0, 1)) | lockstep.estimates((2, 3))
        answers = lockstep.settle(ids)
        for robot, twin in enumerate(twins):
            if (colour := z[robot]) is not None:
                twin.observe(colour)
            said = estimates[robot]
            assert (said.sender, said.x_hat) == (robot, round(twin.x_hat * 2**23))
            assert said.alpha == alpha_word_from_float(twin.alpha)
        for robot, twin in enumerate(twins):
            for other in ids:
                if other != robot:
                    twin.receive(
                        other, estimates[other].x_hat / 2**23, alpha_from_word(estimates[other].alpha)
                    )
        for robot, twin in enumerate(twins):
            twin.settle()
            told = answers[robot]
            assert (told.x, told.b_hat) == (int(twin.x * 2**23), int(twin.b_hat * 2**24))
            assert told.updates == twin.counters.updates % 256
    assert sum(twin.counters.updates for twin in twins) > 0
    assert (lockstep.tick, lockstep.repeated) == (120, len(LOST))
    assert [frame for frame in seen if frame.is_rx] == wire.told
    assert [frame for frame in seen if not frame.is_rx] == wire.sent
    assert [decoded(frame).transfer_id for frame in wire.sent] == [n % 32 for n in range(120 * 8 + len(LOST))]
    assert all(robot.unsettled == robot.disobeyed == 0 for robot in robots)


def step(lockstep: Lockstep, *robots: int) -> None:
    """A tick in which no broadcast is waited for."""
    lockstep.observe(dict.fromkeys(robots, Observation.WHITE))
    assert set(lockstep.settle(robots)) == {*robots}


@still()
def test_late_robots_are_named_and_what_came_before_it_was_waited_for_counts() -> None:
    wire = Wire(*(node(i) for i in range(3)))
    wire.nodes.pop(1)
    lockstep = Lockstep(wire, timeout=0.02)
    with pytest.raises(LockstepError, match=r"robot 4, 5 did not send a heartbeat within 0.01 s on wire"):
        lockstep.wait_until_up({0, 2, 4, 5}, 0.01)
    many = range(10, 20)
    with pytest.raises(LockstepError, match=r"robot 10, 11, 12, 13, 14, 15, 16, 17, ... did not send"):
        lockstep.wait_until_up(many, 0.01)
    lockstep.observe(dict.fromkeys(range(3), Observation.WHITE))
    assert set(lockstep.estimates({2})) == {2}
    assert set(lockstep.estimates({0})) == {0}
    with pytest.raises(LockstepError, match=r"robot 1 did not broadcast its estimate within 0.02 s"):
        lockstep.estimates(range(3))
    with pytest.raises(LockstepError, match=r"robot 1 did not settle within 0.02 s"):
        lockstep.settle(range(3))
    lockstep = Lockstep(Wire(node(1, comms_period=2)), timeout=0.02)
    step(lockstep, 1)
    step(lockstep, 1)
    lockstep.observe({1: Observation.WHITE})
    with pytest.raises(LockstepError, match="robot 1 did not broadcast"):  # the last tick's does not count
        lockstep.estimates({1})


@still()
def test_a_robot_that_restarts_is_noticed_but_one_that_has_run_before_may_be_joined() -> None:
    robot = node(1)
    for _ in range(2):
        wire = Wire(robot)
        lockstep = Lockstep(wire, timeout=0.02)
        for _ in range(3):
            step(lockstep, 1)
    assert robot.ticks == 6
    wire.nodes[0] = node(1)
    told = r"robot 1 answered in tick 3 with transfer_id 0, not 6 .*restarted"
    with pytest.raises(LockstepError, match=told):
        step(lockstep, 1)


@pytest.mark.parametrize("kind_of_wire", [Wire, EndlessWire])
@still()
def test_the_driver_asks_whether_to_wait_on_also_on_a_bus_that_is_never_quiet(
    kind_of_wire: type[Wire],
) -> None:
    def give_up() -> None:
        raise ZeroDivisionError

    lockstep = Lockstep(kind_of_wire(node(1)), timeout=1e9, check=give_up)
    lockstep.observe(dict.fromkeys((1, 2), Observation.WHITE))
    for wait in (lambda: lockstep.wait_until_up({3}, 1e9), lambda: lockstep.settle({2})):
        with pytest.raises(ZeroDivisionError):
            wait()


@still()
def test_a_bus_that_is_never_quiet_is_listened_to_for_twice_the_time() -> None:
    wire, before = EndlessWire(node(1)), CLOCK.now
    with pytest.raises(LockstepError, match="robot 3 did not send a heartbeat within 1 s"):
        Lockstep(wire).wait_until_up({3}, 1.0)
    assert 2 <= CLOCK.now - before < 2.1


@pytest.mark.parametrize(
    ("lost", "mute", "told"),
    [
        ("OBSERVE", -1, "robot 2 did not broadcast its estimate within"),
        ("SETTLE", -1, "robot 2 did not settle within"),
        ("none", 8, "robot 1, 2, 3 did not settle within"),
    ],
)
@still()
def test_a_command_that_is_lost_twice_ends_the_run_and_so_does_an_answer(
    lost: str, mute: int, told: str
) -> None:
    """A repeated command must not make a robot settle twice, though its answer is lost."""

    def is_lost(order: Command, times: int) -> bool:
        return order.tick == 7 and order.target == 2 and order.action.name.startswith(lost)

    wire, robots = Lossy(*map(node, (1, 2, 3)), loses=is_lost, mute=mute), (1, 2, 3)
    lockstep, before = Lockstep(wire, timeout=0.02), CLOCK.now
    with pytest.raises(LockstepError, match=told):
        for tick in range(10):
            lockstep.observe(dict.fromkeys(robots, COLOURS[tick % 3]))
            lockstep.estimates(robots)
            lockstep.settle(robots)
    assert wire.looks < 1000, "it waits instead of looking again and again"
    assert 0.02 <= CLOCK.now - before < 0.021
    orders = [each.action.name for each in map(decoded, wire.sent) if (each.tick, each.target) == (7, 2)]
    assert sum(name.startswith(lost) for name in orders) == 2 * (lost != "none")
    if lost == "none":
        assert [robot.ticks for robot in wire.nodes] == [8] * 3
        assert [robot.sent.telemetry for robot in wire.nodes] == [8] * 3
        assert [robot.disobeyed for robot in wire.nodes] == [1] * 3


@still()
def test_a_tick_may_be_left_open() -> None:
    """As if every settle had been lost: the robot ends it when it observes again."""
    wire = Wire(node(1, comms_period=2))
    lockstep = Lockstep(wire)
    for distance in (1, 7):
        lockstep.observe({1: Observation.WHITE})
        lockstep.leave_open(distance)
    step(lockstep, 1)
    assert [decoded(frame).tick for frame in wire.sent] == [0, 1, 8, 8]
    assert (lockstep.tick, wire.nodes[0].unsettled, wire.nodes[0].robot.t) == (9, 2, 3)
    assert wire.nodes[0].sent.estimates == 1


@still()
def test_ids_and_subjects_that_clash_are_refused() -> None:
    with pytest.raises(UsageError, match="robot 126 has the id of the simulator"):
        Lockstep(Wire()).observe({126: Observation.WHITE})
    with pytest.raises(UsageError, match=r"subjects \[3001, 3001, 3002\]; choose three different"):
        Subjects(estimates=FrameFormat(3001))


# Processes


SUBJECTS = Subjects(FrameFormat(7, 1), FrameFormat(8, 6), FrameFormat(9, 3))
RECORDS = (
    record(0, b_hat=0.1 + 0.2, table=generate(parse_omega("0.3"), 3)),
    record(7, "mirror", filter=Filter.ALWAYS, table=None, comms_period=2, memory=64),
    record(8, filter=Filter.ROBUST, table=None),
    replace(record(9, "reference", b_hat=2**-20, filter=Filter.OFF, table=None), allow=frozenset((0, 2, 3))),
)


@pytest.mark.parametrize("own", RECORDS)
def test_a_process_is_told_all_of_its_robot(own: RobotSetup) -> None:
    choice = BusChoice("udp_multicast", {"channel": "239.1.1.1"})
    *_, (_, _, _, name, *words) = NodeProcesses([own], lambda robot: choice, SUBJECTS, 3)._commands.values()
    read = cli._parser_for(name, cli._load(name)).parse_args(words)
    record = replace(robot_of(read), allow=read.allow and parse_ids(read.allow, "--allow"))
    assert (record, subjects_of(read), read.steps_per_second) == (own, SUBJECTS, 3)
    assert (read.until_eof, read.json, str(bus_of(read))) == (True, True, str(choice))


def test_a_process_that_ends_is_named_with_what_it_said() -> None:
    choice = multicast(2)
    with (
        choice.open() as bus,
        NodeProcesses([record(3, memory=63)], lambda robot: choice, Subjects(), 10) as nodes,
    ):
        lockstep = Lockstep(bus, check=nodes.check)
        with pytest.raises(LockstepError, match=r"robot 3 ended with exit code 2: {.*memory is 63"):
            lockstep.wait_until_up({3}, PATIENCE)
    assert nodes.reports == {}


def test_a_process_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(processes, "_EXIT_TIMEOUT", 0.1)
    nodes = NodeProcesses([record(3)], lambda robot: BusChoice("udp_multicast", {}), Subjects(), 10)
    stubborn = f"trap '' TERM; echo '{{}}'; touch {tmp_path}/up; exec sleep 1000"
    nodes._commands = {3: ["sh", "-c", stubborn], 4: ["echo", '{"steps": 1}']}
    with nodes:
        assert os.getsid(nodes._processes[3].pid) != os.getsid(0), "Ctrl-C is not for it"
        wait_until((tmp_path / "up").exists)
        nodes._processes[4].wait()
    assert nodes.reports == {3: {}, 4: {"steps": 1}}


@pytest.mark.parametrize(("interface", "processors"), [("socketcan", [{2}]), ("udp_multicast", [])])
def test_only_processes_on_socketcan_keep_to_one_processor(
    interface: str, processors: list[set[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    choice, other, kept = BusChoice(interface, {}), BusChoice("udp_multicast", {}), list[set[int]]()
    monkeypatch.setattr("os.sched_getaffinity", {0: {3, 2, 4}}.__getitem__)
    monkeypatch.setattr("os.sched_setaffinity", lambda process, some: kept.append(some | {process} - {0}))
    NodeProcesses([record(3), record(4)], {3: choice, 4: other}.__getitem__, Subjects(), 10)
    assert kept == processors
