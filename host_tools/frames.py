"""The frames a robot puts on the bus: estimates (x_hat, alpha) and heartbeats, as python-can frames.

Each is one classic CAN frame with a 29-bit identifier and 8 bytes, and at the same time one OpenCyphal
v1 single-frame message; ``docs/frame.md`` gives every bit. Values are the firmware's own integers:
x_hat in units of 2**-23, alpha as IEEE binary32 bits. Nothing here raises on what comes from a bus: a
frame that is not a legal message decodes to the :class:`Rejection` that says why. All in O(1).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

import can

ONE = 1 << 23
"""x_hat = 1."""

INFINITE_ALPHA = 0x7F80_0000
"""Smallest binary32 bits that are no finite number >= 0: infinity, then NaN, then every sign bit."""

MAX_NODE = 127
MAX_SUBJECT = 6143
"""Largest subject identifier that Cyphal leaves to applications; the 8191 of the field are the others."""
MAX_PRIORITY = 7
HEARTBEAT_SUBJECT = 7509
FRAME_BYTES = 8

_NODE_BITS = 0x7F
_SERVICE, _ANONYMOUS, _RESERVED = 1 << 25, 1 << 24, 1 << 23 | 1 << 7
# Priority says nothing to a receiver, and the specification has it ignore the two bits sent as 1.
_IGNORED = MAX_PRIORITY << 26 | 3 << 21 | _NODE_BITS
_SINGLE_FRAME, _TRANSFER_BITS = 0xE0, 0x1F


class Rejection(Enum):
    """Why a frame is not the message looked for; the value is for people."""

    ERROR_FRAME = "error frame"
    REMOTE_FRAME = "remote frame"
    FD_FRAME = "CAN FD frame"
    STANDARD_ID = "11-bit identifier"
    SERVICE = "service transfer"
    ANONYMOUS = "anonymous sender"
    RESERVED_BITS = "reserved identifier bit set"
    SUBJECT = "another subject"
    LENGTH = "not 8 bytes"
    MULTI_FRAME = "not a single-frame transfer"
    X_HAT = "x_hat above 1"
    ALPHA = "alpha negative, infinite or NaN"
    MODE = "unknown node mode"


@dataclass(frozen=True)
class FrameFormat:
    """Where estimates are on the bus. Raises ValueError if a field is out of range.

    Attributes:
        subject: Cyphal subject identifier, 0 .. 6143.
        priority: 0 (wins arbitration) .. 7; receivers ignore it.
    """

    subject: int = 3000
    priority: int = 4

    def __post_init__(self) -> None:
        _check("subject", self.subject, MAX_SUBJECT)
        _check("priority", self.priority, MAX_PRIORITY)

    def identifier(self, node: int) -> int:
        """29-bit identifier of the estimates of ``node``, 0 .. 127."""
        return _identifier(self.priority, self.subject, node)


@dataclass(frozen=True, slots=True)
class Message:
    """One robot's broadcast.

    Attributes:
        sender: Robot id, 0 .. 127.
        x_hat: Local estimate in units of 2**-23, 0 .. 2**23.
        alpha: Local confidence as IEEE binary32 bits, 0 .. 0x7F7FFFFF (finite, no sign bit).
        transfer_id: Number of the sender's broadcast modulo 32.
    """

    sender: int
    x_hat: int
    alpha: int
    transfer_id: int


class Health(Enum):
    """How a node feels (Cyphal's ``uavcan.node.Health``)."""

    NOMINAL = 0
    ADVISORY = 1
    CAUTION = 2
    WARNING = 3


class Mode(Enum):
    """What a node does (Cyphal's ``uavcan.node.Mode``)."""

    OPERATIONAL = 0
    INITIALIZATION = 1
    MAINTENANCE = 2
    SOFTWARE_UPDATE = 3


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A node's sign of life (Cyphal's ``uavcan.node.Heartbeat``), due once a second.

    Attributes:
        sender: Node id, 0 .. 127.
        uptime: Whole seconds since start, 0 .. 2**32 - 1.
        transfer_id: Number of the sender's heartbeat modulo 32.
        health: How the node feels.
        mode: What the node does.
        vendor_status: The application's own code, 0 .. 255.
    """

    sender: int
    uptime: int
    transfer_id: int
    health: Health = Health.NOMINAL
    mode: Mode = Mode.OPERATIONAL
    vendor_status: int = 0


def encode(message: Message, frame_format: FrameFormat, timestamp: float = 0.0) -> can.Message:
    """Return ``message`` as a frame stamped ``timestamp`` (seconds).

    Raises ValueError if a field is out of range: what a decoder would refuse is never sent.
    """
    _check("x_hat", message.x_hat, ONE)
    _check("alpha", message.alpha, INFINITE_ALPHA - 1)
    payload = message.x_hat | message.alpha << 24
    return _frame(frame_format.identifier(message.sender), payload, message.transfer_id, timestamp)


def decode(frame: can.Message, frame_format: FrameFormat) -> Message | Rejection:
    """Read an estimate from a frame, or say why it is none; any frame whatever may be given."""
    reason = _why_no_transfer(frame, frame_format.subject)
    if reason is not None:
        return reason
    content = int.from_bytes(frame.data, "little")
    x_hat, alpha = content & 0xFF_FFFF, content >> 24 & 0xFFFF_FFFF
    if x_hat > ONE:
        return Rejection.X_HAT
    if alpha >= INFINITE_ALPHA:
        return Rejection.ALPHA
    return Message(frame.arbitration_id & _NODE_BITS, x_hat, alpha, content >> 56 & _TRANSFER_BITS)


def encode_heartbeat(heartbeat: Heartbeat, priority: int = 4, timestamp: float = 0.0) -> can.Message:
    """Return ``heartbeat`` as a frame stamped ``timestamp`` (seconds).

    Raises ValueError if a field is out of range.
    """
    _check("priority", priority, MAX_PRIORITY)
    _check("uptime", heartbeat.uptime, 0xFFFF_FFFF)
    _check("vendor_status", heartbeat.vendor_status, 0xFF)
    payload = heartbeat.uptime | heartbeat.health.value << 32 | heartbeat.mode.value << 40
    payload |= heartbeat.vendor_status << 48
    identifier = _identifier(priority, HEARTBEAT_SUBJECT, heartbeat.sender)
    return _frame(identifier, payload, heartbeat.transfer_id, timestamp)


def decode_heartbeat(frame: can.Message) -> Heartbeat | Rejection:
    """Read a heartbeat from a frame, or say why it is none; any frame whatever may be given.

    Health takes 2 bits and mode 3; the spare bits beside them are ignored, as the specification asks.
    """
    reason = _why_no_transfer(frame, HEARTBEAT_SUBJECT)
    if reason is not None:
        return reason
    uptime, health, mode, vendor_status, tail = struct.unpack("<IBBBB", frame.data)
    if mode & 7 > max(known.value for known in Mode):
        return Rejection.MODE
    sender, transfer_id = frame.arbitration_id & _NODE_BITS, tail & _TRANSFER_BITS
    return Heartbeat(sender, uptime, transfer_id, Health(health & 3), Mode(mode & 7), vendor_status)


def float_of(alpha: int) -> float:
    """Confidence of binary32 bits ``alpha``, 0 .. 0x7F7FFFFF; exact."""
    value: float = struct.unpack("<f", struct.pack("<I", alpha))[0]
    return value


def bits_of(alpha: float) -> int:
    """Binary32 bits nearest to a confidence. Raises OverflowError if none is near, at 2**128 and above."""
    bits: int = struct.unpack("<I", struct.pack("<f", alpha))[0]
    return bits


def _why_no_transfer(frame: can.Message, subject: int) -> Rejection | None:
    """Why the frame is no single-frame message of the subject; None if it is one."""
    special = frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id
    if special or frame.arbitration_id & ~_IGNORED != subject << 8:
        return _what_is_special(frame)
    if len(frame.data) != FRAME_BYTES:
        return Rejection.LENGTH
    if frame.data[-1] & ~_TRANSFER_BITS != _SINGLE_FRAME:
        return Rejection.MULTI_FRAME
    return None


def _what_is_special(frame: can.Message) -> Rejection:
    identifier = frame.arbitration_id
    findings = (
        (frame.is_error_frame, Rejection.ERROR_FRAME),
        (frame.is_remote_frame, Rejection.REMOTE_FRAME),
        (frame.is_fd, Rejection.FD_FRAME),
        (not frame.is_extended_id, Rejection.STANDARD_ID),
        (identifier & _SERVICE, Rejection.SERVICE),
        (identifier & _ANONYMOUS, Rejection.ANONYMOUS),
        (identifier & _RESERVED, Rejection.RESERVED_BITS),
    )
    return next((reason for found, reason in findings if found), Rejection.SUBJECT)


def _identifier(priority: int, subject: int, node: int) -> int:
    _check("sender", node, MAX_NODE)
    return priority << 26 | 3 << 21 | subject << 8 | node


def _frame(identifier: int, payload: int, transfer_id: int, timestamp: float) -> can.Message:
    _check("transfer_id", transfer_id, _TRANSFER_BITS)
    tail = (_SINGLE_FRAME | transfer_id) << 56
    data = (payload | tail).to_bytes(FRAME_BYTES, "little")
    return can.Message(timestamp=timestamp, arbitration_id=identifier, data=data, is_rx=False)


def _check(name: str, value: int, most: int) -> None:
    if not 0 <= value <= most:
        raise ValueError(f"{name} is {value}; it must be 0 to {most}")
