"""The robot that swarms, nodes, neighbours and replays drive: its ticks, ears, numbers and crashes."""

from __future__ import annotations

import random
from dataclasses import replace
from decimal import Decimal
from typing import Any
from unittest.mock import Mock

import can
import numpy as np
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation
from mcp_asdf.table import Table
from mcp_asdf_tools.bus.frames import (
    Action,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
    encode,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.robots.bus_robot import BusRobot, Reception
from mcp_asdf_tools.robots.node import RobotNode
from mcp_asdf_tools.robots.population import Activation, Filtering, Population
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.suspicion import Suspicion
from mcp_asdf_tools.tables.thresholds import generate
from messages import encoded
from robots import ALPHA_ONE
from wire import TABLE, record

ESTIMATES = FrameFormat()
SEEN = (*Observation, None)


# Ticks and rounds


def said(frames: list[can.Message]) -> list[tuple[int, int]]:
    decoded = [decode(frame, ESTIMATES) for frame in frames]
    return [(message.x_hat, message.alpha) for message in decoded if isinstance(message, Message)]


@pytest.mark.parametrize(("comms", "tau"), [(1, 10), (2, 10), (5, 20), (7, 7)])
def test_nodes_do_what_the_plain_firmware_does(comms: int, tau: int) -> None:
    """The same state at any time as by docs/design.md, with commands lost and estimates whenever they come.

    Each observe counts, each round is closed once, and each settle is answered; a tick whose settle is lost
    ends with the next observe.
    """
    own = record(5, "mirror", 0.55, comms_period=comms, filter_period=tau)
    plain = MirrorRobot(Config(own.config.table, filter_period=tau // comms), 5, 0.55)
    node, member = RobotNode(own), BusRobot(own, ESTIMATES)
    draw, ticks, unsettled, told = random.Random(comms), 0, 0, -1

    def hear() -> None:
        for sender in draw.sample(range(6, 20), 4):
            message = Message(sender, draw.randint(0, 1 << 20), ALPHA_ONE, 0)
            plain.receive_raw(sender, message.x_hat, message.alpha)
            frame = encode(message, ESTIMATES)
            member.listen([frame])
            node.hear(frame)

    def end() -> None:
        if ticks % comms == 0:
            plain.settle()
        member.end()

    for number in range(400):
        z, replay = draw.choice(SEEN), f"random.Random({comms}), tick {number}"
        hear()
        if draw.random() < 0.8:
            if told >= 0:
                end()
            unsettled, ticks, told = unsettled + (told >= 0), ticks + 1, number
            if z is not None:
                plain.observe(z)
            expected = [(plain.x_hat_raw, plain.alpha_raw)] if ticks % comms == 0 else []
            assert said(node.hear(command(number, Action.observing(z)))) == expected, replay
            assert said(member.broadcast(z, 0)) == expected, replay
        hear()
        if draw.random() < 0.8:
            answers = [decode_telemetry(frame) for frame in node.hear(command(number, Action.SETTLE))]
            assert [type(each) for each in answers] == [Telemetry] * (told == number), replay
            if told == number:
                end()
                told = -1
        for robot in (node.robot, member.robot):
            assert isinstance(robot, MirrorRobot)
            assert (robot.state(), robot.x) == (plain.state(), plain.x), replay
    assert plain.counters.updates > 0 and plain.counters.repeated > 0
    assert node.counters == member.counters == plain.counters
    assert (node.ticks, member.ticks, node.unsettled) == (ticks, ticks, unsettled)
    assert node.sent.telemetry > 100 and unsettled > 50


def command(tick: int, action: Action) -> can.Message:
    return encoded(Command(126, tick, 5, action, 0))


def counting(comms_period: int, **counters: int) -> BusRobot:
    """A robot whose counters may be close to where they wrap."""
    firmware = MirrorRobot(Config(filter=Filter.OFF), 5, 0.75)
    for name, value in counters.items():
        setattr(firmware.s, name, value)
    return BusRobot(record(5, comms_period=comms_period), ESTIMATES, make=lambda: firmware)


def test_a_broadcast_that_did_not_end_its_tick_stays_due() -> None:
    one = counting(3)
    assert [one.begin(None) for _ in range(5)] == [False, False, True, True, True]
    one.end()
    assert [one.begin(None) for _ in range(3)] == [False, False, True]


def test_counters_go_on_where_those_of_the_firmware_wrap() -> None:
    """In a long round of many messages, too."""
    one = counting(10**6, accepted=65_000, updates=65_535, tests=65_534, rejected=1, repeated=65_533)
    before = one.counters
    assert before == Counters(65_000, 65_533, 1, 65_534, 65_535)
    messages = np.array([[sender, 0, ALPHA_ONE] for sender in [5] * 998 + [6, 7]], np.uint32)
    for _ in range(300):
        one.begin(None)
        one.receive(messages)
        one.end()
    assert one.counters == replace(before, accepted=65_002, rejected=1 + 998 * 300, repeated=65_533 + 598)


# Records


def test_a_record_is_the_same_after_json_and_makes_the_same_robot() -> None:
    own = record(5, "mirror", 0.55, comms_period=2, filter_period=10, memory=64)
    ends = [record(5, comms_period=each, filter_period=each) for each in (1, 2**32 - 1)]
    for each in (own, *ends):
        assert RobotRecord.from_plain(each.plain()) == each
    table = Table(3, TABLE.entries)
    with pytest.raises(UsageError, match=r"omega is .*make one with mcp-asdf table"):
        record(5, table=table).plain()
    made = own.make()
    assert isinstance(made, MirrorRobot)
    assert made.state() == MirrorRobot(Config(own.config.table, Filter.ADAPTIVE, 5, 64), 5, 0.55).state()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"comms_period": 0}, "comms_period is 0"),
        ({"comms_period": 20}, "filter_period is 10; choose a multiple of comms_period 20"),
        ({"filter_period": 2**32}, "filter_period is 4294967296"),
        ({"comms_period": 3}, "filter_period is 10; choose a multiple of comms_period 3"),
        ({"filter_period": 10.5}, "filter_period is 10.5; give a whole number"),
        ({"filter": "some"}, "filter is 'some'; it must be one of adaptive, always, off"),
        ({"memory": 66}, "memory is 66"),
        ({"id": 128}, "robot id is 128"),
        ({"b_hat": "high"}, "b_hat is 'high'"),
        ({"firmware": "own"}, "firmware is 'own'"),
        ({"table": {"omega": "0.05", "q": 20, "checksum": 1}}, "has checksum 1"),
    ],
)
def test_what_is_no_record_is_refused_by_name(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises((UsageError, FirmwareError), match=complaint):
        RobotRecord.from_plain(record(5).plain() | changes)


def test_flawed_robots_are_a_count_or_a_share() -> None:
    ways = (6, "6", np.int64(4), "44.9%", 0, 0.0, 10, 1.0, "30%", 0.25, "45%", "0.5")
    counts = [Population(robots=10, flawed=way).flawed for way in ways]
    assert counts == [6, 6, 4, 4, 0, 0, 10, 10, 3, 3, 5, 5]
    for wrong in (11, -1, -0.01, 1.01, "150%", True, "x", "nan", None):
        with pytest.raises(UsageError, match="; give a count, 0 to 10, or a share such as"):
            Population(robots=10, flawed=wrong)


@pytest.mark.parametrize("filters", ["none", "asdf-minus", "asdf-plus"])
@pytest.mark.parametrize("activation", ["adaptive", "always"])
def test_a_population_has_a_record_of_each_robot(filters: Filtering, activation: Activation) -> None:
    periods: dict[str, Any] = {"comms_period": 2, "filter_period": 4, "memory": 64}
    accuracies: dict[str, Any] = {"robots": 4, "flawed": 2, "flawed_accuracy": 0.3, "true_accuracy": 1.0}
    some = Population(**accuracies, **periods, filter=filters, activation=activation, omega="0.1")
    off, on = Config(None, Filter.OFF, 2, 64), Config(None, Filter.ALWAYS, 2, 64)
    if activation == "adaptive":
        on = Config(generate(Decimal("0.1"), 3), Filter.ADAPTIVE, 2, 64)
    configs = [on if filters != "none" else off] * 2 + [on if filters == "asdf-plus" else off] * 2
    b_hat = [0.3, 0.3, 1 - 2**-20, 1 - 2**-20]
    expected = [RobotRecord(i, "native", b_hat[i], configs[i], 2) for i in range(4)]
    assert [some.record(robot) for robot in range(4)] == expected
    assert Population(**some.parameters()) == some
    with pytest.raises(ParameterError, match="unknown key 'activity'; did you mean activation"):
        Population(activity=1)  # type: ignore[call-arg]
    unused = {"none": {"omega", "activation"}}.get(filters, {"omega"} if activation == "always" else set())
    assert set(some.unused_parameters()) == unused


# On a bus


def transfer_ids(one: BusRobot) -> list[int]:
    """Those of the next estimate, heartbeat and telemetry frame, in a tick of its own."""
    (estimate,) = one.broadcast(SEEN[one.ticks % 2], 7.5)
    heartbeat, telemetry = one.heartbeat(1.5), one.telemetry(2.5)
    one.end()
    assert [each.timestamp for each in (estimate, heartbeat, telemetry)] == [7.5, 1.5, 2.5]
    found = decode(estimate, ESTIMATES), decode_heartbeat(heartbeat), decode_telemetry(telemetry)
    assert [type(each) for each in found] == [Message, Heartbeat, Telemetry]
    assert isinstance(told := found[2], Telemetry)
    assert (told.x, told.b_hat) == (int(one.robot.x * 2**23), int(one.robot.b_hat * 2**24))
    return [each.transfer_id for each in found if isinstance(each, Message | Heartbeat | Telemetry)]


@pytest.mark.parametrize("loses_state", [False, True])
def test_each_kind_is_numbered_anew_only_when_a_crash_loses_the_state(loses_state: bool) -> None:
    one = BusRobot(record(5), ESTIMATES)
    assert [transfer_ids(one) for _ in range(40)] == [[tick % 32] * 3 for tick in range(40)]
    one.die(loses_state)
    one.wake()
    before = 0 if loses_state else 40
    assert (one.robot.t, one.ticks) == (before, before)
    assert transfer_ids(one) == [before % 32] * 3


def frames_of_all_kinds() -> list[can.Message]:
    """An estimate, one under the own id, one cut short, a heartbeat, telemetry, and an error frame."""
    other, own, cut = (encoded(Message(sender, 9, ALPHA_ONE, 0)) for sender in (6, 5, 7))
    cut.data, cut.dlc = cut.data[:7], 7
    others = [encoded(Heartbeat(8, 1, 0)), encoded(Telemetry(9, 1, 1 << 20, 3, 0))]
    return [other, own, cut, *others, can.Message(arbitration_id=8, is_error_frame=True)]


@pytest.mark.parametrize("firmware", ["native", "reference"])
def test_every_frame_is_counted_once_by_what_it_is(firmware: str) -> None:
    """Those of strangers do not reach the firmware, and the dead hear nothing."""
    source, one, other, dead = random.Random(2), *(BusRobot(record(5, firmware), ESTIMATES) for _ in range(3))
    dead.die(loses_state=False)
    for _ in range(50):
        one.broadcast(None, 0)
        frames = frames_of_all_kinds()
        source.shuffle(frames)
        half = source.randrange(len(frames))
        for part in (frames[:half], frames[half:]):
            one.listen(part)
            dead.listen(part)
        for frame in frames:
            other.hear_stranger(frame)
            dead.hear_stranger(frame)
        one.end()
    everything = Reception(heartbeats=50, telemetry=50, errors=50)
    everything.rejected[Rejection.LENGTH] = 50
    everything.events[Suspicion.CONFLICT, 5] = 50
    assert one.reception == replace(everything, delivered=100, refused=50)
    assert other.reception == replace(everything, strays=100)
    assert dead.reception == Reception()
    assert other.counters == dead.counters == Counters()
    elsewhere = BusRobot(record(5), ESTIMATES, make=lambda: Mock(receive_all=len))
    elsewhere.listen(frames_of_all_kinds()[:2])  # what its firmware makes of them is its own affair
    assert elsewhere.reception == Reception(delivered=2)
