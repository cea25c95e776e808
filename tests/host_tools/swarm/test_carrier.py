"""Frames that the air delivers, their order, and how a connection sorts those that come."""

from __future__ import annotations

from itertools import count

import can
import numpy as np
import pytest
from can.interfaces import virtual
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import FrameFormat, Message, encode
from mcp_asdf_tools.swarm import carrier as connection
from mcp_asdf_tools.swarm.carrier import Connection, SwarmError
from mcp_asdf_tools.swarm.delivery import Delivery, SentFrame
from mcp_asdf_tools.swarm.fault_spec import parse_fault
from mcp_asdf_tools.swarm.faults import Faults


def estimate(sender: int, tick: int, x_hat: int = 0) -> SentFrame:
    return SentFrame(encode(Message(sender, x_hat, tick, tick % 32), FrameFormat()), sender, tick)


def faults_of(*texts: str) -> Faults:
    return Faults([parse_fault(text) for text in texts], 5)


def test_robots_hear_their_neighbours_only() -> None:
    class Line:
        hears = np.eye(5, k=1, dtype=np.bool_) | np.eye(5, k=-1, dtype=np.bool_)

    for faults in ((), ("loss=0",)):
        air = Delivery(Line(), faults_of(*faults), latency=0)
        heard = air.arrivals(0, [estimate(sender, 0) for sender in (0, 1, 3, 4)]).of(2)
        assert [frame.arbitration_id & 127 for frame in heard] == [1, 3]


def test_late_frames_reach_the_robots_in_range_when_they_arrive() -> None:
    class Moving:
        near = True

        @property
        def hears(self) -> NDArray[np.bool_]:
            return np.array([[False, self.near, not self.near], [False] * 3, [False] * 3])

    world = Moving()
    air = Delivery(world, faults_of(), latency=1)
    heard = []
    for tick, world.near in enumerate((True, False, False, True)):
        frames = air.arrivals(tick, [estimate(sender, tick) for sender in (1, 2)]).of(0)
        heard.append([(frame.arbitration_id & 127, frame.data[3]) for frame in frames])
    assert [[sender for sender, _ in each] for each in heard] == [[], [2], [2], [1]]
    assert air.in_range == air.arrived == 3


# Connections


@pytest.fixture
def strangers() -> list[can.Message]:
    return []


def pair(strangers: list[can.Message], returns: bool = False) -> tuple[can.BusABC, Connection]:
    """Another connection to a bus, and the one to try; the bus ``returns`` what is sent, or does not."""
    other = virtual.VirtualBus("pair")
    own = virtual.VirtualBus("pair", receive_own_messages=returns)
    return other, Connection(own, "robot 7", strangers.append)


def test_expected_frames_are_told_from_strangers(strangers: list[can.Message]) -> None:
    other, own = pair(strangers)
    with other, own.bus:
        expected = [estimate(1, 0), estimate(2, 0), estimate(2, 0)]
        for frame in (estimate(3, 0).frame, *(each.frame for each in expected[::-1])):
            other.send(frame, timeout=1)
        assert own.take(expected, None) == expected
        assert [frame.arbitration_id & 127 for frame in strangers] == [3]


def test_what_never_comes_is_named(strangers: list[can.Message], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TIMEOUT", 0.02)
    other, own = pair(strangers)
    with other, own.bus:
        other.send(estimate(1, 0).frame, timeout=1)
        with pytest.raises(SwarmError, match="robot 7 did not hear frame 106BB802, frame 106BB804 within"):
            own.take([estimate(1, 0), estimate(2, 0), estimate(4, 0)], None)


@pytest.mark.parametrize("patience", [None, 0.02])
def test_a_bus_that_is_never_quiet_does_not_keep_a_robot_listening(
    patience: float | None, strangers: list[can.Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "TIMEOUT", 0.02)
    other, own = pair(strangers)
    with other, own.bus:
        frames = count()
        babble = estimate(9, 0).frame

        def receive(timeout: float) -> can.Message:
            assert timeout > 0 or next(frames) < 10_000, "nothing ends the wait"
            return babble

        monkeypatch.setattr(own.bus, "recv", receive)
        missing = estimate(1, 0)
        if patience is None:
            with pytest.raises(SwarmError, match=r"robot 7 did not hear frame 106BB801 within 0\.02 s"):
                own.take([missing], None)
        else:
            assert own.take([missing], patience) == []
            assert own.missed == 1


def test_what_comes_late_is_had_with_the_next(strangers: list[can.Message]) -> None:
    other, own = pair(strangers)
    with other, own.bus:
        first, second, third = estimate(1, 0), estimate(2, 0), estimate(3, 0)
        other.send(second.frame, timeout=1)
        assert own.take([first, second, third], 0.01) == [second]
        assert own.missed == 2
        other.send(first.frame, timeout=1)
        assert own.take([], 0.01) == [first]
        assert own.missed == 2
        other.send(third.frame, timeout=1)
        following = estimate(1, 1)
        other.send(following.frame, timeout=1)
        assert own.take([following], 0.01) == [third, following]
        assert own.missed == 2
        assert strangers == []


@pytest.mark.parametrize("marks", [True, False])
def test_returned_frames_are_no_strangers(strangers: list[can.Message], marks: bool) -> None:
    """Marked as own, or as every frame from this computer is."""
    other, own = pair(strangers, returns=True)
    with other, own.bus:
        own.send(estimate(7, 0).frame)
        other.send(estimate(8, 0).frame, timeout=1)
        if not marks:
            queue = virtual.channels["pair"]
            for frame in list(queue[1].queue):
                frame.is_rx = False
        own.drain(5)
        assert [frame.arbitration_id & 127 for frame in strangers] == [8]
