"""Control ticks and rounds: a ticked robot, and each node that has one, equals plain firmware calls."""

from __future__ import annotations

import random
from dataclasses import astuple, replace
from typing import Any

import can
import numpy as np
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, Observation, Status
from mcp_asdf_tools.bus.frames import FrameFormat, Message, decode, encode
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import NodeSettings, RobotNode
from mcp_asdf_tools.robots.rounds import TickConfig, TickedRobot
from robots import ALPHA_ONE
from wire import TABLE, record

SEEN = (*Observation, None)
PERIODS = [(1, 10), (2, 10), (5, 20), (7, 7)]
"""comms_period and filter_period in ticks."""


@pytest.mark.parametrize(("comms", "tau", "rounds"), [(1, 1000, 1000), (5, 1000, 200), (1000, 1000, 1)])
def test_the_firmware_is_given_its_filter_period_in_rounds(comms: int, tau: int, rounds: int) -> None:
    config = TickConfig(TABLE, Filter.ALWAYS, comms, tau, memory=64)
    assert config.in_rounds() == Config(TABLE, Filter.ALWAYS, rounds, 64)


@pytest.mark.parametrize(
    ("periods", "complaint"),
    [
        ({"comms_period": 0}, "comms_period is 0; choose 1 .. 4294967295"),
        ({"comms_period": 2**32}, "comms_period is 4294967296"),
        ({"filter_period": 0}, "filter_period is 0; choose a multiple of comms_period 1"),
        ({"filter_period": 2**32}, "filter_period is 4294967296"),
        ({"comms_period": 3}, "filter_period is 1000; choose a multiple of comms_period 3"),
    ],
)
def test_periods_that_do_not_fit_are_refused(periods: dict[str, Any], complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        TickConfig(**periods)


@pytest.mark.parametrize("name", ["comms_period", "filter_period"])
def test_a_period_that_is_no_integer_is_refused(name: str) -> None:
    wrong: Any = {name: 10.5}
    with pytest.raises(UsageError, match=f"{name} is 10.5; give a whole number"):
        TickConfig(**wrong)


def test_a_broadcast_that_did_not_end_its_tick_stays_due() -> None:
    ticked = TickedRobot(Counting(), 3)
    assert [ticked.observe(None) for _ in range(5)] == [False, False, True, True, True]
    ticked.settle()
    assert [ticked.observe(None) for _ in range(3)] == [False, False, True]


class Plain:
    """The firmware called as docs/design.md says, without any of the tools."""

    def __init__(self, comms: int, tau: int) -> None:
        self.robot = MirrorRobot(Config(TABLE, filter_period=tau // comms), 5, 0.55)
        self._comms = comms
        self._ticks = 0

    def begin(self, z: Observation | None) -> list[tuple[int, int]]:
        """Its broadcast, if one is due."""
        if z is not None:
            assert self.robot.observe(z) == Status.OK
        self._ticks += 1
        return [(self.robot.x_hat_raw, self.robot.alpha_raw)] if self._ticks % self._comms == 0 else []

    def end(self) -> None:
        if self._ticks % self._comms == 0:
            self.robot.settle()


def said(frames: list[can.Message]) -> list[tuple[int, int]]:
    decoded = [decode(frame, FrameFormat()) for frame in frames]
    return [(message.x_hat, message.alpha) for message in decoded if isinstance(message, Message)]


@pytest.mark.parametrize(("comms", "tau"), PERIODS)
def test_nodes_do_what_the_plain_firmware_does(comms: int, tau: int) -> None:
    """The node on a bus and the robot of a swarm; the same state after every tick, also after ticks that are
    not due, without an observation, or with a message that is repeated."""
    own = record(5, "mirror", 0.55, comms_period=comms, filter_period=tau)
    plain, node, member = (
        Plain(comms, tau),
        RobotNode(own.make(), NodeSettings(5)),
        BusRobot(own.id, own.make, FrameFormat()),
    )
    draw = random.Random(comms)
    for tick in range(300):
        z, replay = draw.choice(SEEN), f"random.Random({comms}), tick {tick}"
        expected = plain.begin(z)
        assert said(node.observe(z)) == expected, replay
        assert said(member.broadcast(z, 0)) == expected, replay
        for sender in draw.sample(range(6, 20), 5):
            message = Message(sender, draw.randint(0, 1 << 20), ALPHA_ONE, 0)
            plain.robot.receive_raw(sender, message.x_hat, message.alpha)
            frame = encode(message, FrameFormat())
            member.listen([frame])
            node.hear(frame)
        plain.end()
        node.settle()
        member.end()
        assert state(node) == state(member) == plain.robot.state(), replay
        assert node.robot.x == plain.robot.x
    assert plain.robot.counters.updates > 0
    assert comms == 1 or plain.robot.counters.repeated > 0
    assert node.counters == member.counters == plain.robot.counters


def state(node: RobotNode | BusRobot) -> dict[str, int]:
    assert isinstance(node.robot, MirrorRobot)
    return node.robot.state()


class Counting(MirrorRobot):
    """A robot whose counters are close to where they wrap."""

    def __init__(self, **counters: int) -> None:
        super().__init__(Config(filter=Filter.OFF), 5, 0.75)
        for name, value in counters.items():
            setattr(self.s, name, value)


def receive(ticked: TickedRobot, sender: int, x_hat: int, alpha: int) -> None:
    ticked.receive_all(np.array([[sender, x_hat, alpha]], np.uint32))


def test_counters_go_on_where_those_of_the_firmware_wrap() -> None:
    ticked = TickedRobot(Counting(accepted=65_000, updates=65_535, tests=65_534, rejected=1, repeated=65_533))
    before = ticked.counters
    assert before == Counters(65_000, 65_533, 1, 65_534, 65_535)
    for _ in range(1000):
        ticked.observe(Observation.BLACK)
        for sender in (6, 6, 6, 7, 5):
            receive(ticked, sender, 0, ALPHA_ONE)
        ticked.settle()
    assert ticked.robot.counters.accepted == (65_000 + 2000) % 2**16
    assert ticked.counters == replace(before, accepted=67_000, repeated=67_533, rejected=1001)


def test_counters_go_on_in_a_long_round_of_many_messages() -> None:
    ticked = TickedRobot(Counting(), comms_period=10**6)
    for _ in range(300):
        ticked.observe(None)
        for _ in range(1000):
            receive(ticked, 5, 0, ALPHA_ONE)
        ticked.settle()
    assert ticked.counters == Counters(rejected=300_000)


def test_counters_are_complete_between_rounds() -> None:
    ticked = TickedRobot(Counting(), comms_period=10)
    ticked.observe(None)
    receive(ticked, 6, 0, ALPHA_ONE)
    assert astuple(ticked.counters) == (1, 0, 0, 0, 0)
    ticked.settle()
    assert astuple(ticked.counters) == (1, 0, 0, 0, 0)


def test_a_tick_without_an_observation_does_not_call_the_firmware() -> None:
    class Watched(MirrorRobot):
        calls = 0

        def observe(self, z: Observation) -> Status:
            self.calls += 1
            return super().observe(z)

    robot = Watched(Config(filter=Filter.OFF), 5, 0.75)
    ticked = TickedRobot(robot)
    assert ticked.observe(None) and robot.calls == 0
    ticked.settle()
    assert ticked.observe(Observation.BLACK) and robot.calls == 1
