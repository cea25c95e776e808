"""The codec for single frames: estimates (x_hat, alpha), heartbeats, telemetry and commands, for python-can.

Each is one classic CAN frame with a 29-bit identifier and 8 bytes, and at the same time one OpenCyphal v1
single-frame message; ``frame_layout`` has every field. Values are the firmware's own integers: x_hat in
units of 2**-23, alpha as a word (``mcp_asdf.fixed_point``), which a frame carries as IEEE binary32.

Decoders never raise: a frame that is not a legal message decodes to the `Rejection` that gives the reason.
Encoders raise UsageError for a value out of range, so that no frame is sent that a decoder would refuse.
All run in O(1). ``c_ref/src/mcp_asdf_frame.h`` is the same codec in C, with the same verdict on every frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mcp_asdf_tools.bus import frame_layout as layout
from mcp_asdf_tools.bus.alpha_words import alpha_word_from_float32_bits, float32_bits_from_alpha_word
from mcp_asdf_tools.bus.frame_layout import (
    FRAME_BYTES,
    MAX_NODE_ID,
    START_END_TOGGLE,
    TRANSFER_ID,
    Action,
    Health,
    Mode,
    Rejection,
    check_range,
)

if TYPE_CHECKING:
    import can

MAX_SUBJECT = 6143
"""Largest subject identifier that Cyphal leaves to applications; the bits reach 8191."""
MAX_PRIORITY = 7
HEARTBEAT_SUBJECT = 7509
HEARTBEAT_PRIORITY = 4

# A Cyphal message's 29-bit identifier, from its highest bit: 3 bits of priority; the service and the
# anonymous bit, which are 0; a reserved bit, 0; 2 bits that are 1; 13 bits of subject; a reserved bit, 0; and
# 7 bits of the sender's node id.
NODE_ID_MASK = 0x7F
SUBJECT_SHIFT, PRIORITY_SHIFT = 8, 26
_SENT_AS_ONE = 3 << 21
"""Two bits that Cyphal sends as 1 and asks receivers to ignore."""
IGNORED_IDENTIFIER_BITS = (MAX_PRIORITY << PRIORITY_SHIFT) | _SENT_AS_ONE | NODE_ID_MASK
"""Bits of an identifier that do not decide whether a frame is of a subject."""

_SERVICE_BIT = 1 << 25
_ANONYMOUS_BIT = 1 << 24
_RESERVED_BITS = (1 << 23) | (1 << 7)
_BITS_THAT_MUST_BE_ZERO = _SERVICE_BIT | _ANONYMOUS_BIT | _RESERVED_BITS


@dataclass(frozen=True)
class FrameFormat:
    """Subject and priority of one kind of frame; the default is the format of estimates.

    Raises UsageError for a value out of range.

    Attributes:
        subject: Cyphal subject identifier, 0 .. 6143.
        priority: 0 (wins arbitration) .. 7; receivers ignore it.
    """

    subject: int = 3000
    priority: int = 4

    def __post_init__(self) -> None:
        """Raise UsageError if the subject or the priority is out of range."""
        check_range("subject", self.subject, 0, MAX_SUBJECT)
        check_range("priority", self.priority, 0, MAX_PRIORITY)

    def identifier(self, node_id: int) -> int:
        """Return the 29-bit identifier of frames that node ``node_id``, 0 .. 127, sends."""
        return _identifier(self.priority, self.subject, node_id)


TELEMETRY_FORMAT = FrameFormat(subject=3001, priority=6)
"""Default format of telemetry, which can wait."""
COMMAND_FORMAT = FrameFormat(subject=3002, priority=3)
"""Default format of commands, which go ahead of the estimates that they trigger."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Broadcast of a robot's local estimate, as its neighbours receive it.

    Attributes:
        sender: Robot id, 0 .. 127.
        x_hat: Local estimate in units of 2**-23, 0 .. 2**23.
        alpha: Local confidence as an alpha word (``alpha_words``), any 32 bits; decoded with the smallest
            shift, as the firmware forms its own.
        transfer_id: Number of the sender's broadcast modulo 32.
    """

    sender: int
    x_hat: int
    alpha: int
    transfer_id: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Heartbeat of a node (Cyphal's ``uavcan.node.Heartbeat``), sent once per second.

    Attributes:
        sender: Node id, 0 .. 127.
        uptime: Complete seconds since start, 0 .. 2**32 - 1.
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


@dataclass(frozen=True, slots=True)
class Command:
    """An order of a simulator that drives robots in lockstep.

    Attributes:
        sender: The simulator's node id, 0 .. 127.
        tick: Number of the control tick, 0 .. 2**32 - 1.
        target: Id of the robot addressed, 0 .. 127, or EVERY_ROBOT.
        action: What the robot is to do.
        transfer_id: Number of the sender's command modulo 32.
    """

    sender: int
    tick: int
    target: int
    action: Action
    transfer_id: int


_MAX_ALPHA_WORD = 0xFFFF_FFFF
"""Alpha in a robot's own form may be any 32 bits."""

FrameContent = Estimate | Heartbeat | Telemetry | Rejection
"""What a frame on the bus holds, or the reason why it holds no message."""


def encode_estimate(estimate: Estimate, frame_format: FrameFormat, timestamp: float = 0.0) -> can.Message:
    """Return the frame of an estimate, which carries alpha as binary32 bits. ``timestamp`` is in seconds.

    Raises UsageError for a value outside the range that `Estimate` names.
    """
    check_range("alpha", estimate.alpha, 0, _MAX_ALPHA_WORD)
    alpha_bits = float32_bits_from_alpha_word(estimate.alpha)
    payload = layout.ESTIMATE.pack(estimate.transfer_id, {"x_hat": estimate.x_hat, "alpha": alpha_bits})
    return make_frame(frame_format.identifier(estimate.sender), payload, timestamp)


def decode_estimate(frame: can.Message, frame_format: FrameFormat) -> Estimate | Rejection:
    """Return the estimate in any frame, or the reason why it holds none.

    Only the subject of ``frame_format`` is compared, as receivers ignore a frame's priority.
    """
    values = _decode_fields(frame, frame_format.subject, layout.ESTIMATE)
    if isinstance(values, Rejection):
        return values
    # The frame carries alpha as binary32, the firmware has its own form of the number.
    alpha_word = alpha_word_from_float32_bits(values["alpha"])
    return Estimate(sender_of(frame), values["x_hat"], alpha_word, values["transfer_id"])


def encode_heartbeat(heartbeat: Heartbeat, timestamp: float = 0.0) -> can.Message:
    """Return the frame of a heartbeat. ``timestamp`` is in seconds.

    Raises UsageError for a value outside the range that `Heartbeat` names.
    """
    payload = layout.HEARTBEAT.pack(
        heartbeat.transfer_id,
        {
            "uptime": heartbeat.uptime,
            "health": heartbeat.health.value,
            "mode": heartbeat.mode.value,
            "vendor_status": heartbeat.vendor_status,
        },
    )
    identifier = _identifier(HEARTBEAT_PRIORITY, HEARTBEAT_SUBJECT, heartbeat.sender)
    return make_frame(identifier, payload, timestamp)


def decode_heartbeat(frame: can.Message) -> Heartbeat | Rejection:
    """Return the heartbeat in any frame, or the reason why it holds none."""
    values = _decode_fields(frame, HEARTBEAT_SUBJECT, layout.HEARTBEAT)
    if isinstance(values, Rejection):
        return values
    # Neither enumeration can raise: all values of 2 bits are a Health, and `_decode_fields` has returned a
    # Rejection for a mode above the largest that the layout allows.
    return Heartbeat(
        sender_of(frame),
        values["uptime"],
        values["transfer_id"],
        Health(values["health"]),
        Mode(values["mode"]),
        values["vendor_status"],
    )


def encode_telemetry(
    telemetry: Telemetry, frame_format: FrameFormat = TELEMETRY_FORMAT, timestamp: float = 0.0
) -> can.Message:
    """Return the frame of a robot's telemetry. ``timestamp`` is in seconds.

    Raises UsageError for a value outside the range that `Telemetry` names.
    """
    payload = layout.TELEMETRY.pack(
        telemetry.transfer_id, {"x": telemetry.x, "b_hat": telemetry.b_hat, "updates": telemetry.updates}
    )
    return make_frame(frame_format.identifier(telemetry.sender), payload, timestamp)


def decode_telemetry(
    frame: can.Message, frame_format: FrameFormat = TELEMETRY_FORMAT
) -> Telemetry | Rejection:
    """Return the telemetry in any frame, or the reason why it holds none."""
    values = _decode_fields(frame, frame_format.subject, layout.TELEMETRY)
    if isinstance(values, Rejection):
        return values
    # The fields have the names of the attributes.
    return Telemetry(sender_of(frame), **values)


def encode_command(
    command: Command, frame_format: FrameFormat = COMMAND_FORMAT, timestamp: float = 0.0
) -> can.Message:
    """Return the frame of a simulator's command. ``timestamp`` is in seconds.

    Raises UsageError for a value outside the range that `Command` names.
    """
    payload = layout.COMMAND.pack(
        command.transfer_id,
        {"tick": command.tick, "target": command.target, "action": command.action.value},
    )
    return make_frame(frame_format.identifier(command.sender), payload, timestamp)


def decode_command(frame: can.Message, frame_format: FrameFormat = COMMAND_FORMAT) -> Command | Rejection:
    """Return the command in any frame, or the reason why it holds none."""
    values = _decode_fields(frame, frame_format.subject, layout.COMMAND)
    if isinstance(values, Rejection):
        return values
    # Unpacking has refused every value that is no Action.
    action = Action(values["action"])
    return Command(sender_of(frame), values["tick"], values["target"], action, values["transfer_id"])


def decode_frame(frame: can.Message, estimate_format: FrameFormat) -> FrameContent:
    """Return the estimate, heartbeat or telemetry in any frame, or the reason why it is no estimate.

    The result is ``Rejection.SUBJECT`` for a frame of another subject, and also for a heartbeat or telemetry
    with a value out of range.
    """
    estimate = decode_estimate(frame, estimate_format)
    if estimate is not Rejection.SUBJECT:  # an estimate, or a frame that can hold nothing else
        return estimate
    heartbeat = decode_heartbeat(frame)
    if isinstance(heartbeat, Heartbeat):
        return heartbeat
    telemetry = decode_telemetry(frame)
    if isinstance(telemetry, Telemetry):
        return telemetry
    return Rejection.SUBJECT


def sender_of(frame: can.Message) -> int:
    """Return the node id in a frame's identifier; a frame that is not of Cyphal's form has one by chance."""
    return frame.arbitration_id & NODE_ID_MASK


def alpha_float32_bits(frame: can.Message) -> int:
    """Return the binary32 bits of alpha in the frame of an estimate, exactly as they were sent.

    ``decode_estimate`` rounds them to the firmware's form of alpha, in which different bits may be the same.
    """
    return layout.ESTIMATE.field("alpha").extract(payload_of(frame))


def payload_of(frame: can.Message) -> int:
    """Return a frame's data as one integer, whose lowest byte is the first byte of the data."""
    return int.from_bytes(frame.data, "little")


def format_frame(frame: can.Message) -> str:
    """Return identifier and data as candump writes them, such as ``106BB82A#0000400000803FE0``.

    A remote frame has an R in place of its data, and an error frame an E before its identifier.
    """
    if frame.is_remote_frame:
        return f"{frame.arbitration_id:08X}#R"
    error_mark = "E" if frame.is_error_frame else ""
    # candump tells 29-bit identifiers from those of 11 bits by the number of digits.
    digits = 8 if frame.is_extended_id or frame.is_error_frame else 3
    return f"{error_mark}{frame.arbitration_id:0{digits}X}#{frame.data.hex().upper()}"


def _decode_fields(frame: can.Message, subject: int, kind: layout.FrameKind) -> dict[str, int] | Rejection:
    """Return the integers in any frame by field name, ``transfer_id`` included, or why it is not of ``kind``.

    ``subject`` is that of the kind's messages.
    """
    payload = _payload_of_subject(frame, subject)
    if isinstance(payload, Rejection):
        return payload
    values = kind.unpack(payload)
    if isinstance(values, Rejection):
        return values
    # The transfer_id is in the tail byte, which no kind of frame has among its own fields.
    values["transfer_id"] = TRANSFER_ID.extract(payload)
    return values


def _payload_of_subject(frame: can.Message, subject: int) -> int | Rejection:
    """Return the data of a single-frame message of this subject, or the reason why the frame is none."""
    is_special = frame.is_error_frame or frame.is_remote_frame or frame.is_fd or not frame.is_extended_id
    # The usual frame passes one test. For any other frame a second function finds the reason to refuse it.
    if is_special or frame.arbitration_id & _BITS_THAT_MUST_BE_ZERO:
        return _rejection_of_special_frame(frame)
    # Priority and sender may be any, and two more bits are ignored, as Cyphal asks.
    subject_bits = frame.arbitration_id & ~IGNORED_IDENTIFIER_BITS
    if subject_bits != subject << SUBJECT_SHIFT:
        return Rejection.SUBJECT
    if len(frame.data) != FRAME_BYTES:
        return Rejection.LENGTH
    payload = payload_of(frame)
    # Each frame of a longer transfer has another tail byte.
    if not START_END_TOGGLE.is_legal(START_END_TOGGLE.extract(payload)):
        return Rejection.MULTI_FRAME
    return payload


def _rejection_of_special_frame(frame: can.Message) -> Rejection:
    """Return the reason why a frame, which is known to be no Cyphal message, is none.

    The order of the checks is the C codec's, as a frame may have several reasons.
    """
    if frame.is_error_frame:
        return Rejection.ERROR_FRAME
    if frame.is_remote_frame:
        return Rejection.REMOTE_FRAME
    if frame.is_fd:
        return Rejection.FD_FRAME
    if not frame.is_extended_id:
        return Rejection.STANDARD_ID
    if frame.arbitration_id & _SERVICE_BIT:
        return Rejection.SERVICE
    if frame.arbitration_id & _ANONYMOUS_BIT:
        return Rejection.ANONYMOUS
    return Rejection.RESERVED_BITS


# Cached, as a robot sends many frames under the same few identifiers.
@cache
def _identifier(priority: int, subject: int, node_id: int) -> int:
    """Return the 29-bit identifier of a message, in which two bits are 1 that receivers ignore.

    Raises UsageError if ``node_id`` is not 0 .. 127.
    """
    check_range("sender", node_id, 0, MAX_NODE_ID)
    return (priority << PRIORITY_SHIFT) | _SENT_AS_ONE | (subject << SUBJECT_SHIFT) | node_id


def make_frame(identifier: int, payload: int, timestamp: float) -> can.Message:
    """Return a classic frame with a 29-bit identifier that this program is about to send.

    The payload is the frame's 8 bytes of data as a number whose lowest byte is the first.
    """
    import can  # noqa: PLC0415 (it loads slowly, and not all who import this module make frames)

    data = payload.to_bytes(FRAME_BYTES, "little")
    return can.Message(timestamp=timestamp, arbitration_id=identifier, data=data, is_rx=False)
