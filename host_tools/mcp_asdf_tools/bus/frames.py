"""The frames on the bus: estimates (x_hat, alpha), heartbeats, telemetry and commands, for python-can.

Each is one classic CAN frame with a 29-bit identifier and 8 bytes, and at the same time one OpenCyphal
v1 single-frame message; ``docs/frame.md`` gives every bit. Values are the firmware's own integers:
x_hat in units of 2**-23, alpha as a word (``mcp_asdf.fixed_point``), which a frame carries as IEEE
binary32. Decoding never raises: a frame that is not a legal message decodes to the `Rejection` that
gives the reason. All in O(1). ``c_ref/src/mcp_asdf_frame.h`` is the same codec in C, with the same verdict
on every frame.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum
from functools import cache

import can

from mcp_asdf.fixed_point import ALPHA_MAX, SHIFT_MAX
from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.errors import UsageError

ONE = 1 << 23
"""x_hat = 1."""

INFINITE_ALPHA = 0x7F80_0000
"""Smallest binary32 bits that are no finite number >= 0: infinity, then NaN, then every sign bit."""

FRACTION, IMPLICIT = 0x7F_FFFF, 0x80_0000
UNIT_EXPONENT = 126
"""Biased exponent of the binary32 numbers whose last bit is worth 2**-24."""

MAX_NODE_ID = 127
MAX_SUBJECT = 6143
"""Largest subject identifier that Cyphal leaves to applications; the field reaches 8191."""
MAX_PRIORITY = 7
HEARTBEAT_SUBJECT = 7509
FRAME_BYTES = 8
TRANSFER_IDS = 32
"""Different values of a transfer_id, which counts a node's messages of one kind modulo this."""

MIN_B_HAT = 1 << 4
"""Smallest b_hat in telemetry, 2**-20 in units of 2**-24."""
MAX_B_HAT = (1 << 24) - MIN_B_HAT
EVERY_ROBOT = 255
"""Target of a command to all robots."""

NODE_BITS = 0x7F
_SERVICE, _ANONYMOUS, _RESERVED = 1 << 25, 1 << 24, 1 << 23 | 1 << 7
_ALWAYS_0 = _SERVICE | _ANONYMOUS | _RESERVED
# Receivers ignore the priority and, as the specification asks, the two bits sent as 1.
IGNORED_BITS = MAX_PRIORITY << 26 | 3 << 21 | NODE_BITS
SINGLE_FRAME, _TRANSFER_BITS = 0xE0, 0x1F


class Rejection(Enum):
    """Reason why a frame is not the expected message.

    The value is the code of the same name in C, ``MCP_ASDF_FRAME_ERR_...``; ``mcp_asdf_frame.h`` explains it.
    """

    ERROR_FRAME = -21
    REMOTE_FRAME = -22
    FD_FRAME = -23
    STANDARD_ID = -24
    SERVICE = -25
    ANONYMOUS = -26
    RESERVED_BITS = -27
    SUBJECT = -28
    LENGTH = -29
    MULTI_FRAME = -30
    X_HAT = -31
    ALPHA = -32
    MODE = -33
    X = -34
    B_HAT = -35
    TARGET = -36
    ACTION = -37


def _check(name: str, value: int, high: int, low: int = 0) -> None:
    if not low <= value <= high:
        raise UsageError(f"{name} is {value}; it must be {low} to {high}")


@dataclass(frozen=True)
class FrameFormat:
    """Subject and priority of one kind of message. Raises UsageError for a field that is wrong.

    The default is that of estimates.

    Attributes:
        subject: Cyphal subject identifier, 0 .. 6143.
        priority: 0 (wins arbitration) .. 7; receivers ignore it.
    """

    subject: int = 3000
    priority: int = 4

    def __post_init__(self) -> None:
        _check("subject", self.subject, MAX_SUBJECT)
        _check("priority", self.priority, MAX_PRIORITY)

    def identifier(self, node_id: int) -> int:
        """29-bit identifier of the messages of node ``node_id``, 0 .. 127."""
        return _identifier(self.priority, self.subject, node_id)


TELEMETRY = FrameFormat(subject=3001, priority=6)
"""Default format of telemetry, which can wait."""
COMMANDS = FrameFormat(subject=3002, priority=3)
"""Default format of commands: ahead of the estimates that they trigger."""


@dataclass(frozen=True, slots=True)
class Message:
    """One robot's broadcast.

    Attributes:
        sender: Robot id, 0 .. 127.
        x_hat: Local estimate in units of 2**-23, 0 .. 2**23.
        alpha: Local confidence as the firmware's word, any 32 bits; decoded with the smallest shift, as the
            firmware forms its own.
        transfer_id: Number of the sender's broadcast modulo 32.
    """

    sender: int
    x_hat: int
    alpha: int
    transfer_id: int


class Health(Enum):
    """Health of a node (Cyphal's ``uavcan.node.Health``)."""

    NOMINAL = 0
    ADVISORY = 1
    CAUTION = 2
    WARNING = 3


class Mode(Enum):
    """Operating mode of a node (Cyphal's ``uavcan.node.Mode``)."""

    OPERATIONAL = 0
    INITIALIZATION = 1
    MAINTENANCE = 2
    SOFTWARE_UPDATE = 3


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Heartbeat of a node (Cyphal's ``uavcan.node.Heartbeat``), due once per second.

    Attributes:
        sender: Node id, 0 .. 127.
        uptime: Whole seconds since start, 0 .. 2**32 - 1.
        transfer_id: Number of the sender's heartbeat modulo 32.
        health: Health of the node.
        mode: Operating mode of the node.
        vendor_status: The application's own code, 0 .. 255.
    """

    sender: int
    uptime: int
    transfer_id: int
    health: Health = Health.NOMINAL
    mode: Mode = Mode.OPERATIONAL
    vendor_status: int = 0


@dataclass(frozen=True, slots=True)
class Telemetry:
    """State of a robot for observers of the bus.

    Attributes:
        sender: Robot id, 0 .. 127.
        x: Informed estimate in units of 2**-23, 0 .. 2**23.
        b_hat: Assumed accuracy in units of 2**-24, MIN_B_HAT .. MAX_B_HAT: the firmware's upper 24 bits.
        updates: Number of re-estimates of b_hat modulo 256.
        transfer_id: Number of the sender's telemetry modulo 32.
    """

    sender: int
    x: int
    b_hat: int
    updates: int
    transfer_id: int


class Action(Enum):
    """Half of a control tick that a command asks for, with its observation."""

    OBSERVE_WHITE = 0
    OBSERVE_BLACK = 1
    OBSERVE_NONE = 2
    SETTLE = 3

    @classmethod
    def observing(cls, z: Observation | None) -> Action:
        """The *observe* that carries ``z``."""
        return cls.OBSERVE_NONE if z is None else cls(int(z))

    @property
    def observation(self) -> Observation | None:
        """The observation that an *observe* carries, if any. Raises ValueError for SETTLE."""
        return None if self is Action.OBSERVE_NONE else Observation(self.value)


@dataclass(frozen=True, slots=True)
class Command:
    """An order of a simulator that drives robots in lockstep.

    Attributes:
        sender: The simulator's node id, 0 .. 127.
        tick: Number of the control tick, 0 .. 2**32 - 1.
        target: Id of the robot addressed, 0 .. 127, or EVERY_ROBOT.
        action: What to do.
        transfer_id: Number of the sender's command modulo 32.
    """

    sender: int
    tick: int
    target: int
    action: Action
    transfer_id: int


def encode(message: Message, frame_format: FrameFormat, timestamp: float = 0.0) -> can.Message:
    """The frame of ``message``, stamped ``timestamp`` (seconds).

    Raises UsageError if a field is out of range, so that no frame is sent that a decoder would refuse; so do
    the other encoders.
    """
    _check("x_hat", message.x_hat, ONE)
    _check("alpha", message.alpha, 0xFFFF_FFFF)
    payload = message.x_hat | binary32_of(message.alpha) << 24
    return _frame(frame_format.identifier(message.sender), payload, message.transfer_id, timestamp)


def decode(frame: can.Message, frame_format: FrameFormat) -> Message | Rejection:
    """Estimate in any frame, or the reason why there is none."""
    content = _content(frame, frame_format.subject)
    if isinstance(content, Rejection):
        return content
    x_hat, alpha = content & 0xFF_FFFF, content >> 24 & 0xFFFF_FFFF
    if x_hat > ONE:
        return Rejection.X_HAT
    if alpha >= INFINITE_ALPHA:
        return Rejection.ALPHA
    sender, transfer_id = frame.arbitration_id & NODE_BITS, content >> 56 & _TRANSFER_BITS
    return Message(sender, x_hat, word_of(alpha), transfer_id)


def encode_heartbeat(heartbeat: Heartbeat, timestamp: float = 0.0) -> can.Message:
    """The frame of ``heartbeat``, stamped ``timestamp`` (seconds)."""
    _check("uptime", heartbeat.uptime, 0xFFFF_FFFF)
    _check("vendor_status", heartbeat.vendor_status, 0xFF)
    payload = heartbeat.uptime | heartbeat.health.value << 32 | heartbeat.mode.value << 40
    payload |= heartbeat.vendor_status << 48
    return _frame(
        _identifier(4, HEARTBEAT_SUBJECT, heartbeat.sender), payload, heartbeat.transfer_id, timestamp
    )


def decode_heartbeat(frame: can.Message) -> Heartbeat | Rejection:
    """Heartbeat in any frame, or the reason why there is none.

    Health takes 2 bits and mode 3; the spare bits next to them are ignored, as the specification asks.
    """
    content = _content(frame, HEARTBEAT_SUBJECT)
    if isinstance(content, Rejection):
        return content
    health, mode, status = content >> 32 & 3, content >> 40 & 7, content >> 48 & 0xFF
    if mode > Mode.SOFTWARE_UPDATE.value:
        return Rejection.MODE
    uptime, transfer_id = content & 0xFFFF_FFFF, content >> 56 & _TRANSFER_BITS
    sender = frame.arbitration_id & NODE_BITS
    return Heartbeat(sender, uptime, transfer_id, Health(health), Mode(mode), status)


def encode_telemetry(
    telemetry: Telemetry, frame_format: FrameFormat = TELEMETRY, timestamp: float = 0.0
) -> can.Message:
    """The frame of ``telemetry``, stamped ``timestamp`` (seconds)."""
    _check("x", telemetry.x, ONE)
    _check("b_hat", telemetry.b_hat, MAX_B_HAT, MIN_B_HAT)
    _check("updates", telemetry.updates, 0xFF)
    payload = telemetry.x | telemetry.b_hat << 24 | telemetry.updates << 48
    return _frame(frame_format.identifier(telemetry.sender), payload, telemetry.transfer_id, timestamp)


def decode_telemetry(frame: can.Message, frame_format: FrameFormat = TELEMETRY) -> Telemetry | Rejection:
    """Telemetry in any frame, or the reason why there is none."""
    content = _content(frame, frame_format.subject)
    if isinstance(content, Rejection):
        return content
    x, b_hat, updates = content & 0xFF_FFFF, content >> 24 & 0xFF_FFFF, content >> 48 & 0xFF
    if x > ONE:
        return Rejection.X
    if not MIN_B_HAT <= b_hat <= MAX_B_HAT:
        return Rejection.B_HAT
    return Telemetry(frame.arbitration_id & NODE_BITS, x, b_hat, updates, content >> 56 & _TRANSFER_BITS)


def encode_command(
    command: Command, frame_format: FrameFormat = COMMANDS, timestamp: float = 0.0
) -> can.Message:
    """The frame of ``command``, stamped ``timestamp`` (seconds)."""
    _check("tick", command.tick, 0xFFFF_FFFF)
    if command.target != EVERY_ROBOT:
        _check("target", command.target, MAX_NODE_ID)
    payload = command.tick | command.target << 32 | command.action.value << 40
    return _frame(frame_format.identifier(command.sender), payload, command.transfer_id, timestamp)


def decode_command(frame: can.Message, frame_format: FrameFormat = COMMANDS) -> Command | Rejection:
    """Command in any frame, or the reason why there is none.

    The spare byte is ignored, as the specification asks.
    """
    content = _content(frame, frame_format.subject)
    if isinstance(content, Rejection):
        return content
    tick, target, action = content & 0xFFFF_FFFF, content >> 32 & 0xFF, content >> 40 & 0xFF
    if target > MAX_NODE_ID and target != EVERY_ROBOT:
        return Rejection.TARGET
    if action > Action.SETTLE.value:
        return Rejection.ACTION
    return Command(
        frame.arbitration_id & NODE_BITS, tick, target, Action(action), content >> 56 & _TRANSFER_BITS
    )


Content = Message | Heartbeat | Telemetry | Rejection
"""Content of a frame, or the reason why it has none."""


def decode_any(frame: can.Message, estimates: FrameFormat) -> Content:
    """Estimate, heartbeat or telemetry in any frame, or the reason why it is no estimate."""
    found: Content = decode(frame, estimates)
    if found is not Rejection.SUBJECT:
        return found
    heartbeat = decode_heartbeat(frame)
    if isinstance(heartbeat, Heartbeat):
        return heartbeat
    telemetry = decode_telemetry(frame)
    return telemetry if isinstance(telemetry, Telemetry) else found


def binary32_of(alpha: int) -> int:
    """The IEEE binary32 bits of an alpha word, 0 .. 2**32 - 1: the same value, exactly."""
    mantissa, exponent = alpha >> 8, UNIT_EXPONENT + (alpha & SHIFT_MAX)
    if mantissa == 0:
        return 0
    shift = 24 - mantissa.bit_length()
    return (exponent - shift << 23) + (mantissa << shift) - IMPLICIT


def word_of(bits: int) -> int:
    """The word of the largest confidence not above the number of binary32 ``bits``, 0 .. 0x7F7FFFFF.

    The inverse of ``binary32_of``, except for the choice of the shift. Parts smaller than 2**-24 are lost;
    numbers above the largest confidence, 2**31 - 2**7, become that.
    """
    mantissa, shift = bits & FRACTION | IMPLICIT, (bits >> 23) - UNIT_EXPONENT
    if shift < 0:  # a subnormal number has no implicit bit, but loses everything
        return mantissa >> -shift << 8
    return mantissa << 8 | shift if shift <= SHIFT_MAX else ALPHA_MAX


def alpha_bits(frame: can.Message) -> int:
    """The binary32 bits of alpha in an estimate's frame, unchanged; several stand for one word."""
    return int.from_bytes(frame.data[3:7], "little")


def float_of(bits: int) -> float:
    """The number of binary32 ``bits``, 0 .. 0x7F7FFFFF; exact."""
    value: float = struct.unpack("<f", struct.pack("<I", bits))[0]
    return value


def bits_of(value: float) -> int:
    """The binary32 bits nearest to a number. Raises OverflowError if none is near, at 2**128 and above."""
    return int.from_bytes(struct.pack("<f", value), "little")


def _content(frame: can.Message, subject: int) -> int | Rejection:
    """The 64 bits of a single-frame message of the subject, or the reason why the frame is none."""
    special = frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id
    if special or frame.arbitration_id & _ALWAYS_0:
        return _what_is_special(frame)
    if frame.arbitration_id & ~IGNORED_BITS != subject << 8:
        return Rejection.SUBJECT
    if len(frame.data) != FRAME_BYTES:
        return Rejection.LENGTH
    if frame.data[-1] & ~_TRANSFER_BITS != SINGLE_FRAME:
        return Rejection.MULTI_FRAME
    return int.from_bytes(frame.data, "little")


def _what_is_special(frame: can.Message) -> Rejection:
    """Reason why a frame that has any is no message of any subject."""
    identifier = frame.arbitration_id
    found = (
        (frame.is_error_frame, Rejection.ERROR_FRAME),
        (frame.is_remote_frame, Rejection.REMOTE_FRAME),
        (frame.is_fd, Rejection.FD_FRAME),
        (not frame.is_extended_id, Rejection.STANDARD_ID),
        (identifier & _SERVICE, Rejection.SERVICE),
        (identifier & _ANONYMOUS, Rejection.ANONYMOUS),
    )
    return next((reason for is_so, reason in found if is_so), Rejection.RESERVED_BITS)


@cache
def _identifier(priority: int, subject: int, node_id: int) -> int:
    _check("sender", node_id, MAX_NODE_ID)
    return priority << 26 | 3 << 21 | subject << 8 | node_id


def _frame(identifier: int, payload: int, transfer_id: int, timestamp: float) -> can.Message:
    _check("transfer_id", transfer_id, _TRANSFER_BITS)
    tail = (SINGLE_FRAME | transfer_id) << 56
    data = (payload | tail).to_bytes(FRAME_BYTES, "little")
    return can.Message(timestamp=timestamp, arbitration_id=identifier, data=data, is_rx=False)


def frame_as_text(frame: can.Message) -> str:
    """A frame's identifier and data as candump writes them, with a mark for remote and error frames."""
    if frame.is_remote_frame:
        return f"{frame.arbitration_id:08X}#R"
    kind = "E" if frame.is_error_frame else ""
    digits = 8 if frame.is_extended_id or frame.is_error_frame else 3
    return f"{kind}{frame.arbitration_id:0{digits}X}#{frame.data.hex().upper()}"
