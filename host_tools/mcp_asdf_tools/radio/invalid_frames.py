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


def malformed(draw: Draw, subjects: Subjects, sender: int) -> dict[str, can.Message]:
    """A frame for every way not to be an estimate, from ``sender`` where the identifier allows."""
    frames = {}
    for name, spoil in _WAYS.items():
        message = Message(sender, draw.randint(0, ONE), draw.randrange(1 << 32), draw.randrange(32))
        frame = encode(message, subjects.estimates)
        spoil(frame, draw)
        frames[name] = frame
    telemetry = Telemetry(sender, draw.randint(0, ONE), draw.randint(16, 1 << 23), draw.randrange(256), 0)
    return frames | {
        _TELEMETRY: encode_telemetry(telemetry, subjects.telemetry),
        _HEARTBEAT: encode_heartbeat(Heartbeat(sender, draw.randrange(1 << 32), 0)),
    }


def stray_commands(
    draw: Draw, frames: FrameFormat, robot: int, other: int, tick: int
) -> dict[str, can.Message]:
    """Commands that ``robot`` must not obey between its *observe* and its *settle* of ``tick``."""
    targets = {"robot": robot, "other": other, "all": EVERY_ROBOT}
    ticks = {
        "open": tick,
        "later": (tick + 1 + draw.randrange(1000)) % (1 << 32),
        "last": (tick - 1) % (1 << 32),
    }
    return {
        name: encode_command(Command(other, ticks[when], targets[target], action, draw.randrange(32)), frames)
        for name, (target, when, action) in STRAY.items()
    }


STRAY = {
    "an observe of the open tick": ("robot", "open", Action.OBSERVE_WHITE),
    "an observe of the open tick, for all": ("all", "open", Action.OBSERVE_BLACK),
    "a settle of a later tick": ("robot", "later", Action.SETTLE),
    "a settle of the last tick, for all": ("all", "last", Action.SETTLE),
    "a settle for another robot": ("other", "open", Action.SETTLE),
    "an observe for another robot": ("other", "later", Action.OBSERVE_WHITE),
}
"""Commands not to be obeyed: target, tick and action."""


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


def _short(longest: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.dlc = draw.randint(0, longest) if longest < _LONGEST else longest
        frame.data = frame.data[: frame.dlc]

    return spoil


def _tail(frame: can.Message, draw: Draw) -> None:
    frame.data[7] = draw.randrange(0xE0)


def _without(bit: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.data[7] &= ~bit

    return spoil


def _x_hat(low: int, high: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.data[:3] = draw.randint(low, high).to_bytes(3, "little")

    return spoil


def _alpha(low: int, high: int) -> Breaker:
    def spoil(frame: can.Message, draw: Draw) -> None:
        frame.data[3:7] = draw.randint(low, high).to_bytes(4, "little")

    return spoil


_LONGEST = 7
"""Bytes of the longest frame that is too short."""

_WAYS: dict[str, Breaker] = {
    "an 11-bit identifier": _standard,
    "a remote frame": _remote,
    "7 bytes": _short(_LONGEST),
    "fewer than 7 bytes": _short(_LONGEST - 1),
    "no single-frame tail byte": _tail,
    "a tail byte without the start bit": _without(1 << 7),
    "a tail byte without the end bit": _without(1 << 6),
    "a tail byte without the toggle bit": _without(1 << 5),
    "x_hat above 1": _x_hat(ONE + 2, 0xFF_FFFF),
    "x_hat one unit above 1": _x_hat(ONE + 1, ONE + 1),
    "alpha infinite": _alpha(0x7F80_0000, 0x7F80_0000),
    "alpha not a number": _alpha(0x7F80_0001, 0x7FFF_FFFF),
    "alpha -0": _alpha(0x8000_0000, 0x8000_0000),
    "alpha negative": _alpha(0x8000_0001, 0xFFFF_FFFF),
    "a service transfer": _set_id(1 << 25),
    "an anonymous sender": _set_id(1 << 24),
    "reserved bit 23 set": _set_id(1 << 23),
    "reserved bit 7 set": _set_id(1 << 7),
    "another subject": _set_id(1 << 20),
    "another subject of the same upper bits": _set_id(1 << 12),
    "another subject of the same lower bits": _set_id(1 << 16),
}
_TELEMETRY, _HEARTBEAT = "telemetry of another robot", "a heartbeat of another robot"
INVALID = (*_WAYS, _TELEMETRY, _HEARTBEAT)
"""Ways not to be an estimate."""
