"""The protocol of docs/frame.md: what a robot in lockstep does, and what its driver makes of the answers."""

from __future__ import annotations

import argparse
import random
from collections import Counter
from collections.abc import Callable, Sequence

import can
import pytest

from mcp_asdf.fixed_point import word_to_alpha
from mcp_asdf.robot import Filter, FixedPointRobot, Observation, Robot
from mcp_asdf_tools.bus.frames import (
    COMMANDS,
    EVERY_ROBOT,
    Action,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    decode,
    decode_command,
    decode_heartbeat,
    decode_telemetry,
    encode,
    encode_command,
)
from mcp_asdf_tools.bus.interfaces import add_arguments, choose_bus
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.lockstep import Lockstep, LockstepError
from mcp_asdf_tools.robots.node import RobotNode, Subjects, state_of
from mcp_asdf_tools.robots.processes import node_processes
from multicast import multicast
from robots import ALPHA_ONE
from support import PATIENCE
from wire import EndlessWire, Wire, node, record, still

COLOURS = (*Observation, None)
"""The possible observations of a tick."""


def command(tick: int, target: int, action: Action) -> can.Message:
    return encode_command(Command(126, tick, target, action, 0))


def see(robot: Robot, z: Observation | None) -> None:
    """Let the firmware observe, if there is something to see."""
    if z is not None:
        robot.observe(z)


def kind(frame: can.Message) -> str:
    """Kinds of the frames: heartbeat, estimate or telemetry."""
    decoded = {"h": decode_heartbeat(frame), "e": decode(frame, FrameFormat()), "t": decode_telemetry(frame)}
    return "".join(letter for letter, what in decoded.items() if not isinstance(what, Rejection))


def kinds(frames: list[can.Message]) -> str:
    return "".join(map(kind, frames))


# The robot's half


def test_the_rules_one_by_one() -> None:
    robot = node(5, comms_period=2)
    assert kinds(robot.start()) == "h"
    observe, settle = Action.OBSERVE_BLACK, Action.SETTLE
    steps = [
        (command(0, 5, settle), ""),  # nothing to settle
        (command(0, 6, observe), ""),  # for another
        (command(0, 5, observe), ""),  # no broadcast due
        (command(0, 5, observe), ""),  # repeated
        (command(1, 5, settle), ""),  # another tick's
        (command(0, 6, settle), ""),  # for another
        (command(0, 5, settle), "t"),
        (command(0, 5, settle), ""),  # repeated
        (command(7, EVERY_ROBOT, observe), "e"),  # any tick is accepted
        (command(7, EVERY_ROBOT, settle), "t"),
        (command(7, 5, Action.OBSERVE_NONE), ""),  # the number may come again
        (command(7, 5, settle), "t"),
    ]
    assert [kinds(robot.hear(frame)) for frame, _ in steps] == [answer for _, answer in steps]
    assert (robot.robot.t, robot.robot.n, robot.ticks) == (2, 2, 3)
    assert (robot.obeyed, robot.disobeyed) == (6, 4)


def test_a_tick_whose_settle_is_lost_ends_with_the_next_observe() -> None:
    """With any commands lost, each observe counts, each round is closed once and each settle answered."""
    draw, robot, twin = random.Random(12), node(5), node(5).robot
    ticks, unsettled, is_open = 0, 0, False
    for number in range(400):
        z, replay = draw.choice(COLOURS), f"replay: random.Random(12), tick {number}"
        if draw.random() < 0.8:
            if is_open:
                twin.settle()
            see(twin, z)
            beat = "h" if ticks and ticks % 10 == 0 else ""
            assert kinds(robot.hear(command(number, 5, Action.observing(z)))) == beat + "e", replay
            ticks, unsettled, is_open = ticks + 1, unsettled + is_open, True
            told = number
        for sender in draw.sample(range(6, 20), 5):
            twin.receive(sender, (x_hat := draw.randint(0, 1 << 23)) / 2**23, 1.0)
            robot.hear(encode(Message(sender, x_hat, ALPHA_ONE, 0), FrameFormat()))
        if draw.random() < 0.8:
            is_obeyed = is_open and told == number
            assert kinds(robot.hear(command(number, 5, Action.SETTLE))) == "t" * is_obeyed, replay
            if is_obeyed:
                twin.settle()
                is_open = False
    assert isinstance(twin, FixedPointRobot) and isinstance(robot.robot, FixedPointRobot)
    assert robot.robot.state() == twin.state()
    assert twin.counters.updates > 0
    assert (robot.ticks, robot.unsettled) == (ticks, unsettled)
    assert robot.sent.telemetry > 100 and unsettled > 50


def test_heartbeats_come_every_second_of_ticks_before_the_estimate() -> None:
    robot = RobotNode(record(5), steps_per_second=3)
    said = [robot.start()]
    for tick in range(7):
        said += [
            robot.hear(command(tick, 5, Action.OBSERVE_WHITE)),
            robot.hear(command(tick, 5, Action.SETTLE)),
        ]
    assert [kinds(frames) for frames in said] == [
        "h",
        *["e", "t"] * 3,
        *["he", "t", "e", "t", "e", "t"],
        "he",
        "t",
    ]
    beats = [beat for frames in said for f in frames if isinstance(beat := decode_heartbeat(f), Heartbeat)]
    assert [(beat.uptime, beat.transfer_id) for beat in beats] == [(0, 0), (1, 1), (2, 2)]


@pytest.mark.parametrize("when", ["before observe", "in a tick", "between ticks"])
def test_estimates_count_whenever_they_come(when: str) -> None:
    robot = node(5)
    estimate = encode(Message(6, 1 << 22, ALPHA_ONE, 0), FrameFormat())
    orders = [command(0, 5, Action.OBSERVE_BLACK), command(0, 5, Action.SETTLE)]
    orders += [command(1, 5, Action.OBSERVE_BLACK), command(1, 5, Action.SETTLE)]
    orders.insert({"before observe": 0, "in a tick": 1, "between ticks": 2}[when], estimate)
    for frame in orders:
        robot.hear(frame)
    assert robot.robot.counters.accepted == 1
    assert (robot.robot.beta > 0) == (when == "between ticks")  # of the last round


# The driver's half


@pytest.mark.parametrize("firmware", ["native", "reference"])
@still()
def test_a_driven_swarm_does_what_a_loop_of_calls_does(firmware: str) -> None:
    robots, ids = [node(i, firmware, 0.55 + 0.1 * i) for i in range(4)], range(4)
    twins = [node(i, firmware, 0.55 + 0.1 * i).robot for i in ids]
    lockstep, draw = Lockstep(Wire(*robots)), random.Random(5)
    for _ in range(120):
        z = {robot: draw.choice(COLOURS) for robot in ids}
        lockstep.observe(z)
        estimates = lockstep.estimates(ids)
        answers = lockstep.settle(ids)
        for robot, twin in enumerate(twins):
            see(twin, z[robot])
            said = estimates[robot]
            assert (said.sender, said.x_hat) == (robot, round(twin.x_hat * 2**23))
        for robot, twin in enumerate(twins):
            for other in ids:
                if other != robot:
                    twin.receive(other, estimates[other].x_hat / 2**23, word_to_alpha(estimates[other].alpha))
        for robot, twin in enumerate(twins):
            twin.settle()
            told = answers[robot]
            assert (told.x, told.b_hat) == (int(twin.x * 2**23), int(twin.b_hat * 2**24))
            assert told.updates == twin.counters.updates % 256
    assert sum(twin.counters.updates for twin in twins) > 0
    assert lockstep.tick == 120


@still()
def test_late_robots_are_named() -> None:
    robots = [node(i) for i in range(3)]
    wire = Wire(*robots)
    wire.nodes.pop(1)
    lockstep = Lockstep(wire, timeout=0.02)
    with pytest.raises(LockstepError, match=r"robot 4, 5 did not send a heartbeat within 0.01 s on wire"):
        lockstep.wait_until_up({0, 2, 4, 5}, 0.01)
    lockstep.observe(dict.fromkeys(range(3), Observation.WHITE))
    with pytest.raises(LockstepError, match=r"robot 1 did not broadcast its estimate within 0.02 s"):
        lockstep.estimates(range(3))
    with pytest.raises(LockstepError, match=r"robot 1 did not settle within 0.02 s"):
        lockstep.settle(range(3))


@still()
def test_what_came_before_it_was_waited_for_counts() -> None:
    lockstep = Lockstep(Wire(node(1), node(2)), timeout=0.02)
    lockstep.wait_until_up({1, 2}, 0.01)
    lockstep.observe({1: Observation.WHITE, 2: Observation.BLACK})
    assert set(lockstep.estimates({2})) == {2}
    assert set(lockstep.estimates({1})) == {1}
    with pytest.raises(LockstepError):
        lockstep.estimates({3})


@still()
def test_estimates_of_an_earlier_tick_do_not_count() -> None:
    lockstep = Lockstep(Wire(node(1, comms_period=2)), timeout=0.02)
    for _ in range(2):
        lockstep.observe({1: Observation.WHITE})
        lockstep.settle({1})
    lockstep.observe({1: Observation.WHITE})
    with pytest.raises(LockstepError, match="robot 1 did not broadcast"):
        lockstep.estimates({1})


@still()
def test_a_robot_that_restarts_is_noticed() -> None:
    wire = Wire(node(1))
    lockstep = Lockstep(wire, timeout=0.02)
    for _ in range(3):
        lockstep.observe({1: Observation.WHITE})
        lockstep.settle({1})
    wire.nodes[0] = node(1)
    lockstep.observe({1: Observation.WHITE})
    with pytest.raises(
        LockstepError, match=r"robot 1 answered in tick 3 with transfer_id 0, not 3 .*restarted"
    ):
        lockstep.settle({1})


@still()
def test_a_driver_may_join_robots_that_have_run_before() -> None:
    robot = node(1)
    for lockstep in (Lockstep(Wire(robot)), Lockstep(Wire(robot))):
        for _ in range(5):
            lockstep.observe({1: Observation.WHITE})
            assert set(lockstep.settle({1})) == {1}
    assert robot.ticks == 10


@still()
def test_the_driver_shows_all_frames_and_asks_whether_to_wait_on() -> None:
    wire, seen = Wire(node(1), node(2)), list[can.Message]()

    def give_up() -> None:
        raise ZeroDivisionError

    lockstep = Lockstep(wire, watch=seen.append, check=give_up)
    lockstep.observe({1: Observation.WHITE, 2: Observation.WHITE})
    lockstep.estimates({1, 2})
    lockstep.settle({1, 2})
    assert [frame for frame in seen if frame.is_rx] == wire.told
    assert [frame for frame in seen if not frame.is_rx] == wire.sent
    assert [frame.is_rx for frame in seen] == [False, False, *[True] * 4, False, False, True, True]
    with pytest.raises(ZeroDivisionError):
        lockstep.wait_until_up({3}, PATIENCE)


@still()
def test_a_bus_that_is_never_quiet_does_not_keep_the_driver_from_asking() -> None:
    def give_up() -> None:
        raise ZeroDivisionError

    wire = EndlessWire(node(1))
    lockstep = Lockstep(wire, timeout=1e9, check=give_up)
    lockstep.observe({1: Observation.WHITE})
    for wait in (lambda: lockstep.wait_until_up({3}, 1e9), lambda: lockstep.settle({1})):
        before = wire.frames
        with pytest.raises(ZeroDivisionError):
            wait()
        assert wire.frames - before < 20


def decoded(frame: can.Message) -> Command:
    order = decode_command(frame, COMMANDS)
    assert isinstance(order, Command)
    return order


class Lossy(Wire):
    """A wire on which commands of the tool get lost, and answers of the nodes."""

    def __init__(self, *nodes: RobotNode, loses: Callable[[Command, int], bool], mute: int = -1) -> None:
        """``loses`` is asked of each command, with how often it has been sent; telemetry ``mute`` is lost."""
        self._loses, self._mute = loses, mute
        self._times = Counter[tuple[int, int, Action]]()
        super().__init__(*nodes)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        order = decoded(msg)
        self._times[key := (order.tick, order.target, order.action)] += 1
        if self._loses(order, self._times[key]):
            self.sent.append(msg)
        else:
            super().send(msg, timeout)

    def say(self, node: RobotNode, frames: Sequence[can.Message]) -> None:
        is_mute = node.sent.telemetry == self._mute and kinds(list(frames)) == "t"
        super().say(node, [] if is_mute else frames)


def play(wire: Wire, ticks: int = 40) -> Lockstep:
    """Drive robots 1, 2 and 3 with what a seeded generator draws."""
    lockstep, draw, robots = Lockstep(wire, timeout=0.02), random.Random(8), (1, 2, 3)
    for _ in range(ticks):
        lockstep.observe({robot: draw.choice(COLOURS) for robot in robots})
        lockstep.estimates(robots)
        lockstep.settle(robots)
    return lockstep


@still()
def test_a_command_that_is_lost_once_is_said_again() -> None:
    """To those alone who have not answered; the run ends in the same bits."""
    observes = {(5, 2), (5, 3), (9, 1), (20, 1)}
    settles = {(9, 1), (20, 2), (20, 3)}

    def is_lost(order: Command, times: int) -> bool:
        lost = settles if order.action is Action.SETTLE else observes
        return times == 1 and (order.tick, order.target) in lost

    wire, twins = Lossy(*map(node, (1, 2, 3)), loses=is_lost), Wire(*map(node, (1, 2, 3)))
    lockstep = play(wire)
    assert (lockstep.repeated, play(twins).repeated) == (7, 0)
    assert contents(wire.told) == contents(twins.told)
    assert len(wire.sent) == 40 * 6 + 7
    assert [decoded(frame).transfer_id for frame in wire.sent] == [n % 32 for n in range(247)]
    assert all(robot.unsettled == robot.disobeyed == 0 for robot in wire.nodes)


def contents(frames: list[can.Message]) -> list[tuple[int, bytes]]:
    """Apart from their order, which shows the robots that got a command twice."""
    return sorted((frame.arbitration_id, bytes(frame.data)) for frame in frames)


@pytest.mark.parametrize(("action", "what"), [("OBSERVE", "broadcast its estimate"), ("SETTLE", "settle")])
@still()
def test_a_command_that_is_lost_twice_ends_the_run(action: str, what: str) -> None:
    def is_lost(order: Command, times: int) -> bool:
        return order.tick == 7 and order.target == 2 and order.action.name.startswith(action)

    wire = Lossy(*map(node, (1, 2, 3)), loses=is_lost)
    with pytest.raises(LockstepError, match=f"robot 2 did not {what} within"):
        play(wire)
    names = [each.action.name for each in map(decoded, wire.sent) if (each.tick, each.target) == (7, 2)]
    assert sum(name.startswith(action) for name in names) == 2


@still()
def test_an_answer_that_is_lost_is_not_taken_for_a_lost_command() -> None:
    """The robot has settled: a repeated command must not make it settle twice."""
    wire = Lossy(*map(node, (1, 2, 3)), loses=lambda order, times: False, mute=8)
    with pytest.raises(LockstepError, match="robot 1, 2, 3 did not settle within"):
        play(wire)
    assert [robot.ticks for robot in wire.nodes] == [8] * 3
    assert [robot.sent.telemetry for robot in wire.nodes] == [8] * 3
    assert [robot.disobeyed for robot in wire.nodes] == [1] * 3


@still()
def test_a_tick_may_be_left_open() -> None:
    """As if every settle had been lost: the robots have ended it when they observe again."""
    wire, twins = Wire(node(1)), Wire(node(1))
    lockstep, model = Lockstep(wire), Lockstep(twins)
    for tick in range(60):
        for each in (lockstep, model):
            each.observe({1: COLOURS[tick * tick % 3]})
        assert lockstep.estimates({1})[1].x_hat == model.estimates({1})[1].x_hat
        told = model.settle({1})[1]
        if tick % 3:
            assert lockstep.settle({1})[1].x == told.x
        else:
            lockstep.leave_open()
    assert lockstep.tick == 60
    assert wire.nodes[0].unsettled == 20


@still()
def test_ids_and_subjects_that_clash_are_refused() -> None:
    with pytest.raises(UsageError, match="robot 126 has the id of the simulator"):
        Lockstep(Wire()).observe({126: Observation.WHITE})
    with pytest.raises(UsageError, match=r"subjects \[3001, 3001, 3002\]; choose three different"):
        Subjects(estimates=FrameFormat(3001))


# Processes


def test_processes_do_what_robots_in_this_process_do() -> None:
    choice = multicast(1)
    records = [record(0, "native", b_hat=0.55), record(7, "mirror", filter=Filter.ALWAYS, comms_period=2)]
    twins = Wire(*(RobotNode(each) for each in records))
    draw, ids = random.Random(3), (0, 7)
    with choice.open() as bus, node_processes(records, lambda robot: choice, Subjects(), 10) as nodes:
        lockstep, model = Lockstep(bus, timeout=PATIENCE, check=nodes.check), Lockstep(twins)
        lockstep.wait_until_up(ids, PATIENCE)
        for tick in range(60):
            z = {robot: draw.choice(COLOURS) for robot in ids}
            due = ids if tick % 2 else (0,)
            for each in (lockstep, model):
                each.observe(z)
            assert lockstep.estimates(due) == model.estimates(due)
            assert lockstep.settle(ids) == model.settle(ids)
    for twin in twins.nodes:
        results = nodes.reports[twin.id]["results"]
        assert results["robot"] == state_of(twin)
        # Filters keep heartbeats and telemetry away from a process.
        assert results["frames"] == twin.figures() | {"rejected": {}}
        assert (results["steps"], results["ending"]) == (60, "stopped")


def test_a_process_that_ends_is_named_with_what_it_said() -> None:
    choice = multicast(2)
    with (
        choice.open() as bus,
        node_processes([record(3, memory=63)], lambda robot: choice, Subjects(), 10) as nodes,
    ):
        lockstep = Lockstep(bus, check=nodes.check)
        with pytest.raises(LockstepError, match=r"robot 3 ended with exit code 2: .*memory is 63"):
            lockstep.wait_until_up({3}, PATIENCE)
    assert nodes.reports == {}


def test_a_bus_inside_this_process_is_no_place_for_others() -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    choice = choose_bus(parser.parse_args([]))
    with pytest.raises(UsageError, match="inside this process, so no other can join it"):
        node_processes([record(3)], lambda robot: choice, Subjects(), 10)
    with pytest.raises(UsageError, match=r"two robots have one id among \[3, 3\]"):
        node_processes([record(3), record(3)], lambda robot: choice, Subjects(), 10)


@pytest.mark.parametrize(("interface", "processors"), [("socketcan", [{1}]), ("udp_multicast", [])])
def test_only_processes_on_socketcan_keep_to_one_processor(
    interface: str, processors: list[set[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    choice = choose_bus(parser.parse_args([f"--interface={interface}", "--channel=vcan0"]))
    kept: list[set[int]] = []
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {3, 1, 2})
    monkeypatch.setattr("os.sched_setaffinity", lambda process, some: kept.append(some))
    node_processes([record(3)], lambda robot: choice, Subjects(), 10)
    assert kept == processors
