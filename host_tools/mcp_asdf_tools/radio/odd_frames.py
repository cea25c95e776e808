"""Frames that a robot must ignore, and frames that look unusual and that it must take like any others."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import can

from mcp_asdf_tools.bus.frames import (
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
from mcp_asdf_tools.robots.node import Subjects

Change = Callable[[can.Message], object]
"""Change of a frame in place."""

# --- Ignored: what is no estimate ---


def malformed(draw: random.Random, subjects: Subjects, sender: int) -> dict[str, can.Message]:
    """A frame for every way not to be an estimate, from ``sender`` where the identifier allows."""
    frames = {}
    for name, spoil in _ways(draw).items():
        message = Message(sender, draw.randint(0, ONE), draw.randrange(1 << 32), draw.randrange(32))
        frame = encode(message, subjects.estimates)
        spoil(frame)
        frames[name] = frame
    telemetry = Telemetry(sender, draw.randint(0, ONE), draw.randint(16, 1 << 23), draw.randrange(256), 0)
    return frames | {
        "telemetry of another robot": encode_telemetry(telemetry, subjects.telemetry),
        "a heartbeat of another robot": encode_heartbeat(Heartbeat(sender, draw.randrange(1 << 32), 0)),
    }


def _ways(draw: random.Random) -> dict[str, Change]:
    """Ways to spoil an estimate."""

    def x_hat(low: int, high: int) -> Change:
        return lambda frame: _put(frame, 0, draw.randint(low, high).to_bytes(3, "little"))

    def alpha(low: int, high: int) -> Change:
        return lambda frame: _put(frame, 3, draw.randint(low, high).to_bytes(4, "little"))

    def tail(clear: int) -> Change:
        return lambda frame: _put(frame, 7, bytes([frame.data[7] & ~clear]))

    return {
        "an 11-bit identifier": _standard,
        "a remote frame": _remote,
        "7 bytes": lambda frame: _shorten(frame, 7),
        "fewer than 7 bytes": lambda frame: _shorten(frame, draw.randint(0, 6)),
        "no single-frame tail byte": lambda frame: _put(frame, 7, bytes([draw.randrange(0xE0)])),
        "a tail byte without the start bit": tail(1 << 7),
        "a tail byte without the end bit": tail(1 << 6),
        "a tail byte without the toggle bit": tail(1 << 5),
        "x_hat above 1": x_hat(ONE + 2, 0xFF_FFFF),
        "x_hat one unit above 1": x_hat(ONE + 1, ONE + 1),
        "alpha infinite": alpha(0x7F80_0000, 0x7F80_0000),
        "alpha not a number": alpha(0x7F80_0001, 0x7FFF_FFFF),
        "alpha -0": alpha(0x8000_0000, 0x8000_0000),
        "alpha negative": alpha(0x8000_0001, 0xFFFF_FFFF),
        "a service transfer": _flip(1 << 25),
        "an anonymous sender": _flip(1 << 24),
        "reserved bit 23 set": _flip(1 << 23),
        "reserved bit 7 set": _flip(1 << 7),
        "another subject": _flip(1 << 20),
        "another subject of the same upper bits": _flip(1 << 12),
        "another subject of the same lower bits": _flip(1 << 16),
    }


def _put(frame: can.Message, place: int, content: bytes) -> None:
    frame.data[place : place + len(content)] = content


def _flip(bits: int) -> Change:
    def change(frame: can.Message) -> None:
        frame.arbitration_id ^= bits

    return change


def _standard(frame: can.Message) -> None:
    frame.is_extended_id = False
    frame.arbitration_id &= 0x7FF


def _remote(frame: can.Message) -> None:
    frame.is_remote_frame = True
    frame.data = bytearray()


def _shorten(frame: can.Message, length: int) -> None:
    frame.dlc = length
    frame.data = frame.data[:length]


# --- Ignored: commands that must not be obeyed ---

STRAY = {
    "an observe of the open tick": ("robot", "open", Action.OBSERVE_WHITE),
    "an observe of the open tick, for all": ("all", "open", Action.OBSERVE_BLACK),
    "a settle of a later tick": ("robot", "later", Action.SETTLE),
    "a settle of the last tick, for all": ("all", "last", Action.SETTLE),
    "a settle for another robot": ("other", "open", Action.SETTLE),
    "an observe for another robot": ("other", "later", Action.OBSERVE_WHITE),
}
"""Commands not to be obeyed between *observe* and *settle* of a tick: target, tick and action."""


def stray_command(
    name: str, draw: random.Random, usual: Command, other: int, frames: FrameFormat
) -> can.Message:
    """The command of ``STRAY`` with this name; the ``usual`` one is for the robot, in its open tick."""
    target, when, action = STRAY[name]
    targets = {"robot": usual.target, "other": other, "all": EVERY_ROBOT}
    ticks = {"open": usual.tick, "later": usual.tick + 1 + draw.randrange(1000), "last": usual.tick - 1}
    stray = replace(usual, sender=other, tick=ticks[when] % 2**32, target=targets[target], action=action)
    return encode_command(stray, frames)


# --- Taken: what a receiver ignores, or its sender is free to choose ---


def _with_priority(priority: int) -> Change:
    def change(frame: can.Message) -> None:
        frame.arbitration_id = frame.arbitration_id & ~(7 << 26) | priority << 26

    return change


def _without_ignored_bits(frame: can.Message) -> None:
    frame.arbitration_id &= ~(3 << 21)


UNUSUAL_IDENTIFIERS: dict[str, Change] = {
    **{f"with priority {priority}": _with_priority(priority) for priority in range(8)},
    "with identifier bits 22 and 21 clear": _without_ignored_bits,
}
"""Changes of an identifier that make no difference."""

UNUSUAL_COMMANDS: dict[str, Change] = {
    "for every robot": lambda frame: None,
    "of another node": lambda frame: None,
    "whose spare byte is not 0": lambda frame: _put(frame, 6, b"\xff"),
    **UNUSUAL_IDENTIFIERS,
}
"""Differences of a command that make none to the robot; ``unusual_command`` makes the first two."""

DISTANT_NUMBERS = {
    f"an observe whose number differs from that of the open tick in bit {bit} alone": 1 << bit
    for bit in (8, 16, 24, 31)
}
"""Distances between the numbers of two ticks."""


def unusual_command(name: str, usual: Command, other: int, frames: FrameFormat) -> can.Message:
    """The ``usual`` command with the difference of this name; ``other`` is the id of another node."""
    if name == "for every robot":
        usual = replace(usual, target=EVERY_ROBOT)
    if name == "of another node":
        usual = replace(usual, sender=other)
    frame = encode_command(usual, frames)
    UNUSUAL_COMMANDS[name](frame)
    return frame
