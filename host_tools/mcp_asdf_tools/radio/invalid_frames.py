"""Invalid frames that a robot must ignore: malformed ones, and commands that it must not obey."""

from __future__ import annotations

import random
from collections.abc import Callable

import can

from mcp_asdf_tools.bus import (
    EVERY_ROBOT,
    ONE,
    Action,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Telemetry,
    encode,
    encode_command,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.robots import Subjects

Draw = random.Random
Breaker = Callable[[can.Message, Draw], None]


def malformed(draw: Draw, subjects: Subjects, sender: int) -> list[can.Message]:
    """A frame for every way not to be an estimate, from ``sender`` where the identifier allows."""
    frames = []
    for spoil in _WAYS:
        message = Message(sender, draw.randint(0, ONE), draw.randrange(1 << 32), draw.randrange(32))
        frame = encode(message, subjects.estimates)
        spoil(frame, draw)
        frames.append(frame)
    telemetry = Telemetry(sender, draw.randint(0, ONE), draw.randint(16, 1 << 23), draw.randrange(256), 0)
    return [
        *frames,
        encode_telemetry(telemetry, subjects.telemetry),
        encode_heartbeat(Heartbeat(sender, draw.randrange(1 << 32), 0)),
    ]


def stray_commands(draw: Draw, frames: FrameFormat, robot: int, other: int, tick: int) -> list[can.Message]:
    """Commands that ``robot`` must not obey between its *observe* and its *settle* of ``tick``."""
    orders = [
        (robot, tick, Action(draw.randrange(3))),
        (EVERY_ROBOT, tick, Action.OBSERVE_BLACK),
        (robot, (tick + 1 + draw.randrange(1000)) % (1 << 32), Action.SETTLE),
        (EVERY_ROBOT, (tick - 1) % (1 << 32), Action.SETTLE),
        (other, tick, Action.SETTLE),
        (other, tick, Action.OBSERVE_WHITE),
    ]
    return [
        encode_command(Command(other, number, target, action, draw.randrange(32)), frames)
        for target, number, action in orders
    ]


def _set_id(flip: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.arbitration_id ^= flip

    return spoil


def _standard(frame: can.Message, draw: Draw) -> None:
    frame.is_extended_id = False
    frame.arbitration_id &= 0x7FF


def _remote(frame: can.Message, draw: Draw) -> None:
    frame.is_remote_frame = True
    frame.data = bytearray()


def _short(frame: can.Message, draw: Draw) -> None:
    frame.dlc = draw.randrange(8)
    frame.data = frame.data[: frame.dlc]


def _tail(frame: can.Message, draw: Draw) -> None:
    frame.data[7] = draw.randrange(0xE0)


def _x_hat(frame: can.Message, draw: Draw) -> None:
    frame.data[:3] = draw.randint(ONE + 1, 0xFF_FFFF).to_bytes(3, "little")


def _alpha(low: int, high: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.data[3:7] = draw.randint(low, high).to_bytes(4, "little")

    return spoil


_WAYS: tuple[Breaker, ...] = (
    _standard,
    _remote,
    _short,
    _tail,
    _x_hat,
    _alpha(0x7F80_0000, 0x7F80_0000),  # infinite
    _alpha(0x7F80_0001, 0x7FFF_FFFF),  # no number
    _alpha(0x8000_0000, 0x8000_0000),  # -0
    _alpha(0x8000_0001, 0xFFFF_FFFF),  # negative
    _set_id(1 << 25),  # a service
    _set_id(1 << 24),  # anonymous
    _set_id(1 << 23),  # reserved
    _set_id(1 << 7),  # reserved
    _set_id(1 << 20),  # another subject
)
