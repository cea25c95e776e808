"""How a connection sorts the frames that come, and for how long it waits."""

from __future__ import annotations

from itertools import count

import can
import pytest
from can.interfaces import virtual

from mcp_asdf_tools.bus.frames import FrameFormat, Message, encode
from mcp_asdf_tools.swarm import carrier as connection
from mcp_asdf_tools.swarm.carrier import Connection, SwarmError
from mcp_asdf_tools.swarm.delivery import SentFrame


def estimate(sender: int, tick: int, x_hat: int = 0) -> SentFrame:
    return SentFrame(encode(Message(sender, x_hat, tick, tick % 32), FrameFormat()), sender, tick)


@pytest.fixture
def strangers() -> list[can.Message]:
    return []


def pair(strangers: list[can.Message]) -> tuple[can.BusABC, Connection]:
    """Another connection to a bus, and the one to try."""
    return virtual.VirtualBus("pair"), Connection(virtual.VirtualBus("pair"), "robot 7", strangers.append)


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
