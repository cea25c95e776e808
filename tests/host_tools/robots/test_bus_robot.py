"""The one robot that swarms, nodes, neighbours and replays drive: its numbers, its ears, its crashes."""

from __future__ import annotations

import random

import can
import pytest

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frames import (
    FrameFormat,
    Heartbeat,
    Message,
    Telemetry,
    decode,
    decode_heartbeat,
    decode_telemetry,
    encode,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.robots.bus_robot import BusRobot, Reception
from mcp_asdf_tools.robots.events import Recorder
from robots import ALPHA_ONE
from wire import record

ESTIMATES = FrameFormat()


def robot(recorder: Recorder | None = None) -> BusRobot:
    return BusRobot(5, record(5).make, ESTIMATES, recorder)


def transfer_ids(one: BusRobot) -> list[int]:
    """Those of the next estimate, heartbeat and telemetry frame, in a tick of its own."""
    (estimate,) = one.broadcast(Observation.BLACK, 0)
    heartbeat, telemetry = one.heartbeat(0), one.telemetry(0)
    one.end()
    found = decode(estimate, ESTIMATES), decode_heartbeat(heartbeat), decode_telemetry(telemetry)
    assert [type(each) for each in found] == [Message, Heartbeat, Telemetry]
    return [each.transfer_id for each in found if isinstance(each, Message | Heartbeat | Telemetry)]


@pytest.mark.parametrize("loses_state", [False, True])
def test_each_kind_is_numbered_anew_only_when_a_crash_loses_the_state(loses_state: bool) -> None:
    one = robot()
    assert [transfer_ids(one) for _ in range(40)] == [[tick % 32] * 3 for tick in range(40)]
    one.die(loses_state)
    one.wake()
    before = 0 if loses_state else 40
    assert (one.robot.t, one.ticks) == (before, before)
    assert transfer_ids(one) == [before % 32] * 3


def test_a_dead_robot_hears_nothing_and_counts_nothing() -> None:
    one = robot()
    one.die(loses_state=False)
    for frame in frames_of_all_kinds(random.Random(1)):
        one.listen([frame])
        one.hear_stranger(frame)
    assert one.reception == Reception()
    assert one.robot.counters.accepted == one.robot.counters.rejected == 0


def frames_of_all_kinds(source: random.Random) -> list[can.Message]:
    """An estimate, one under the own id, one cut short, a heartbeat, telemetry, and an error frame."""
    own, other, cut = (
        encode(Message(sender, source.randrange(1 << 23), ALPHA_ONE, 0), ESTIMATES) for sender in (5, 6, 7)
    )
    cut.data, cut.dlc = cut.data[:7], 7
    heartbeat = encode_heartbeat(Heartbeat(8, source.randrange(1000), 0))
    telemetry = encode_telemetry(Telemetry(9, source.randrange(1 << 23), 1 << 20, 3, 0))
    return [other, own, cut, heartbeat, telemetry, can.Message(arbitration_id=8, is_error_frame=True)]


def test_every_frame_is_counted_once_by_what_it_is() -> None:
    source, one = random.Random(2), robot()
    for _ in range(50):
        one.broadcast(None, 0)
        frames = frames_of_all_kinds(source)
        source.shuffle(frames)
        half = source.randrange(len(frames))
        one.listen(frames[:half])
        one.listen(frames[half:])
        one.end()
    heard = one.reception
    assert (heard.delivered, heard.refused, heard.id_conflicts, one.heard) == (100, 50, 50, 1)
    assert (heard.heartbeats, heard.telemetry, heard.errors, heard.rejected.total()) == (50, 50, 50, 50)
    assert heard.strays == 0 and list(heard.last_telemetry) == [9]


def test_a_stranger_is_counted_but_does_not_reach_the_firmware() -> None:
    one = robot()
    for frame in frames_of_all_kinds(random.Random(3)):
        one.hear_stranger(frame)
    heard = one.reception
    assert (heard.strays, heard.id_conflicts, heard.delivered, heard.refused) == (2, 1, 0, 0)
    assert one.robot.counters.accepted == one.robot.counters.rejected == 0


def test_a_crash_that_loses_the_state_is_in_the_events_and_one_that_keeps_it_is_not() -> None:
    lines: list[str] = []
    one = robot(recorder=Recorder(5, lines.append))
    for loses_state in (False, True):
        one.die(loses_state)
        one.wake()
        one.broadcast(Observation.WHITE, 0)
        one.end()
    assert lines == ["[5,0,3]\n", '[5,"restart",0,3]\n']
