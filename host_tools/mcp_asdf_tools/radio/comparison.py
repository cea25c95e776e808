"""Bit-exact comparison of the frames that a controller sends with those that its model sends.

The model is the firmware's Python mirror. It gets the same input as the controller under test, so both must
send the same frames. ``Comparison`` finds the first difference and describes it in words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest

import can

from mcp_asdf_tools.bus import frame_layout as layout
from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import FRAME_BYTES, START_END_TOGGLE, TRANSFER_ID, Field, Health
from mcp_asdf_tools.bus.frames import (
    HEARTBEAT_SUBJECT,
    MAX_PRIORITY,
    PRIORITY_SHIFT,
    SUBJECT_SHIFT,
    format_frame,
    payload_of,
    sender_of,
)
from mcp_asdf_tools.robots.node import Subjects

ESTIMATE, TELEMETRY, HEARTBEAT = "estimate", "telemetry", "heartbeat"
"""The kinds of frame that are compared, in this order."""
FramesByKind = dict[str, list[can.Message]]

_HEALTH = layout.HEARTBEAT.field("health")
# A lost or repeated frame shows in the transfer_id, which counts frames, so that comes first. In telemetry
# b_hat decides x, so that a wrong b_hat is reported as such and not by the x that it leads to.
FIELDS_BY_KIND: dict[str, tuple[Field, ...]] = {
    ESTIMATE: (TRANSFER_ID, layout.ESTIMATE.field("x_hat"), layout.ESTIMATE.field("alpha")),
    TELEMETRY: (TRANSFER_ID, *(layout.TELEMETRY.field(name) for name in ("updates", "b_hat", "x"))),
    HEARTBEAT: (TRANSFER_ID, layout.HEARTBEAT.field("uptime"), layout.HEARTBEAT.field("mode"), _HEALTH),
}
"""The fields that are compared in each kind of frame, in the order in which a difference is reported."""

_PRIORITY_BITS = MAX_PRIORITY << PRIORITY_SHIFT
_SUBJECT_MASK = 0x1FFF
"""The 13 bits of a subject, at the low end of an identifier shifted right by ``SUBJECT_SHIFT``."""
_MAX_FRAMES_SHOWN = 3
"""Number of frames of one kind that a description of a difference shows."""


@dataclass(frozen=True)
class Difference:
    """The first difference between a controller's frames and its model's frames.

    Attributes:
        kind: Kind of frame: "estimate", "telemetry" or "heartbeat".
        field: What differs: the name of a data field; "priority" or "identifier"; "frame", "length" or "tail"
            for a frame of another format; "missing", "extra" or "twice" for another number of frames; or
            "order" for frames of two kinds that came in the other order.
        received: The controller's frames, as text.
        expected: The model's frames, as text.
        hint: How the wrong value may have come about, such as bytes in reverse order; "" without a guess.
    """

    kind: str
    field: str
    received: str
    expected: str
    hint: str = ""

    def __str__(self) -> str:
        """Return kind, field and both sides, and the hint if there is one: ``telemetry, x: expected ...``."""
        hint = f"; {self.hint}" if self.hint else ""
        return f"{self.kind}, {self.field}: expected {self.expected}, got {self.received}{hint}"


class Comparison:
    """Running comparison of a controller's frames with its model's.

    Attributes:
        equal_frames: Number of the controller's frames so far that equal the model's, by kind.
        is_advisory_allowed: Whether the controller may report the health "advisory" where its model does not.
            It may as soon as a settle command was withheld from it.
    """

    def __init__(self, subjects: Subjects, first_heartbeat: can.Message) -> None:
        """Start a comparison.

        Args:
            subjects: The subjects under which the controller sends.
            first_heartbeat: The heartbeat that the model sent when it started. The controller may have sent
                the same before the comparison began, or may send it several times because it was reset.
        """
        self.equal_frames = Counter[str]()
        self.is_advisory_allowed = False
        self._first_heartbeat = first_heartbeat
        self._kind_by_subject = {
            subjects.estimates.subject: ESTIMATE,
            subjects.telemetry.subject: TELEMETRY,
            HEARTBEAT_SUBJECT: HEARTBEAT,
        }

    def check(self, received: Sequence[can.Message], expected: Sequence[can.Message]) -> Difference | None:
        """Compare the frames of one or more ticks, and count those that are equal in ``equal_frames``.

        Frames are compared kind by kind; frames of other subjects are ignored. The order of frames of
        different kinds is compared last, and only if an earlier call has counted telemetry: until then the
        controller may be starting, and its first heartbeat may come at any time.

        Args:
            received: What the controller sent, in order.
            expected: What the model sent, in order.

        Returns:
            The first difference; None if all frames are equal.
        """
        has_answered_before = self.equal_frames[TELEMETRY] > 0
        received_by_kind, expected_by_kind = self._group_by_kind(received), self._group_by_kind(expected)
        if not has_answered_before:
            self._align_first_heartbeats(received_by_kind, expected_by_kind)
        for kind in FIELDS_BY_KIND:
            difference = self._compare_kind(kind, received_by_kind[kind], expected_by_kind[kind])
            if difference is not None:
                return difference
        if not has_answered_before:
            return None
        return self._compare_order(received, expected)

    def _kind_of(self, frame: can.Message) -> str | None:
        """Return a frame's kind by its subject; None if frames of this subject are not compared."""
        subject = (frame.arbitration_id >> SUBJECT_SHIFT) & _SUBJECT_MASK
        return self._kind_by_subject.get(subject)

    def _compared_kinds(self, frames: Sequence[can.Message]) -> list[str]:
        """Return the kind of each frame in order, without frames that are not compared."""
        kinds = [self._kind_of(frame) for frame in frames]
        return [kind for kind in kinds if kind is not None]

    def _group_by_kind(self, frames: Sequence[can.Message]) -> FramesByKind:
        """Return the frames of each kind in their order, without those that are not compared."""
        frames_by_kind: FramesByKind = {kind: [] for kind in FIELDS_BY_KIND}
        for frame in frames:
            kind = self._kind_of(frame)
            if kind is not None:
                frames_by_kind[kind].append(frame)
        return frames_by_kind

    def _align_first_heartbeats(self, received: FramesByKind, expected: FramesByKind) -> None:
        """Change the heartbeats of both sides so that the first ones can be compared like all others.

        Received heartbeats that equal the model's first one are removed, however many there are. If more are
        left than expected, the controller's first heartbeat must be wrong, and the model's is added to the
        expected ones.
        """
        first = self._first_heartbeat
        later_heartbeats = [
            frame
            for frame in received[HEARTBEAT]
            if frame.arbitration_id != first.arbitration_id or frame.data != first.data
        ]
        received[HEARTBEAT] = later_heartbeats
        if len(later_heartbeats) > len(expected[HEARTBEAT]):
            expected[HEARTBEAT] = [first, *expected[HEARTBEAT]]

    def _compare_kind(
        self, kind: str, received: Sequence[can.Message], expected: Sequence[can.Message]
    ) -> Difference | None:
        """Return the first difference between frames of one kind, or count them as equal and return None.

        If the first difference is in the health, they count as equal, too, if that health is allowed.
        """
        field_name = _first_difference(kind, received, expected)
        is_difference_allowed = field_name == _HEALTH.name and self._is_health_allowed(received)
        if field_name is None or is_difference_allowed:
            self.equal_frames[kind] += len(received)
            return None
        return Difference(
            kind,
            field_name,
            received=_describe_frames(kind, received),
            expected=_describe_frames(kind, expected),
            hint=_hint(kind, field_name, received, expected),
        )

    def _is_health_allowed(self, heartbeats: Sequence[can.Message]) -> bool:
        """Return whether the controller may report the health of these heartbeats though its model does not.

        It may report "advisory" if ``is_advisory_allowed``, and nothing worse.
        """
        worst_health = max(_HEALTH.extract(payload_of(frame)) for frame in heartbeats)
        return self.is_advisory_allowed and worst_health <= Health.ADVISORY.value

    def _compare_order(
        self, received: Sequence[can.Message], expected: Sequence[can.Message]
    ) -> Difference | None:
        """Return a difference if the controller's frames of different kinds came in another order; else None.

        Both sides must have been found equal kind by kind, and so have as many frames.
        """
        received_kinds, expected_kinds = self._compared_kinds(received), self._compared_kinds(expected)
        for received_kind, expected_kind in zip(received_kinds, expected_kinds, strict=True):
            if received_kind != expected_kind:
                return Difference(
                    received_kind,
                    "order",
                    received=f"it before the {expected_kind}",
                    expected=f"the {expected_kind} first",
                )
        return None


def is_from(frame: can.Message, robot: int) -> bool:
    """Return whether a frame has a 29-bit identifier that names ``robot`` as its sender."""
    return frame.is_extended_id and not frame.is_error_frame and sender_of(frame) == robot


# --- Where two lists of frames differ ---


def _first_difference(
    kind: str, received: Sequence[can.Message], expected: Sequence[can.Message]
) -> str | None:
    """Return what differs first between two lists of frames of one kind; None if they are equal.

    The result is a ``Difference.field``: "missing" if the received frames end first, "twice" if more frames
    are received than expected and two in a row have the same data, "extra" if no two have. Otherwise it names
    what is wrong with a frame, or the first data field in which it is wrong.
    """
    # The shorter list is filled up with None.
    for received_frame, expected_frame in zip_longest(received, expected):
        if received_frame is None:
            return "missing"
        format_error = _format_error(received_frame)
        if format_error is not None:
            return format_error
        if expected_frame is None:
            return "twice" if _has_repeated_frame(received) else "extra"
        field_name = _first_different_field(kind, received_frame, expected_frame)
        if field_name is not None:
            return field_name
    return None


def _has_repeated_frame(frames: Sequence[can.Message]) -> bool:
    """Return whether two frames in a row have the same data."""
    return any(frame.data == next_frame.data for frame, next_frame in pairwise(frames))


def _format_error(frame: can.Message) -> str | None:
    """Return why a frame is no Cyphal message in one classic frame of 8 bytes; None if it is one.

    The reasons are "frame" for a remote or CAN FD frame, "length" for other than 8 bytes, and "tail" for a
    last byte that belongs to a transfer of several frames.
    """
    if frame.is_remote_frame or frame.is_fd:
        return "frame"
    if len(frame.data) != FRAME_BYTES:
        return "length"
    tail_bits = START_END_TOGGLE.extract(payload_of(frame))
    is_single_frame = START_END_TOGGLE.is_legal(tail_bits)
    return None if is_single_frame else "tail"


def _first_different_field(kind: str, received: can.Message, expected: can.Message) -> str | None:
    """Return in what two frames of one kind differ first; None if they are equal.

    That is "priority", "identifier" (in other bits than those of the priority) or the name of a data field.
    """
    different_identifier_bits = received.arbitration_id ^ expected.arbitration_id
    if different_identifier_bits & _PRIORITY_BITS:
        return "priority"
    if different_identifier_bits:
        return "identifier"
    received_payload, expected_payload = payload_of(received), payload_of(expected)
    for field in FIELDS_BY_KIND[kind]:
        if field.extract(received_payload) != field.extract(expected_payload):
            return field.name
    return None


# --- Hints ---

_MIN_BITS_FOR_HINT = 24
"""Length of the shortest field whose wrong values get a hint: few get one by accident."""


def _hint(
    kind: str, field_name: str, received: Sequence[can.Message], expected: Sequence[can.Message]
) -> str:
    """Return a hint if the first wrong value of a data field has its bytes in reverse order, and else "".

    ``field_name`` is where the two lists differ. The result is "" for fields of less than 24 bits, too, and
    for a difference that is not in a data field.
    """
    field_by_name = {field.name: field for field in FIELDS_BY_KIND[kind]}
    field = field_by_name.get(field_name)
    if field is None or field.bit_count < _MIN_BITS_FOR_HINT:
        return ""
    # The lists may have different lengths; the first difference comes before the shorter one ends.
    for received_frame, expected_frame in zip(received, expected, strict=False):
        received_value = field.extract(payload_of(received_frame))
        expected_value = field.extract(payload_of(expected_frame))
        if received_value != expected_value:
            return _byte_order_hint(field.bit_count // 8, received_value, expected_value)
    return ""


def _byte_order_hint(byte_count: int, received_value: int, expected_value: int) -> str:
    """Return a hint if the received value has the bytes of the expected one in reverse order, and else ""."""
    received_bytes = received_value.to_bytes(byte_count, "little")
    reversed_bytes = expected_value.to_bytes(byte_count, "big")
    if received_bytes != reversed_bytes:
        return ""
    return f"its {byte_count} bytes are in reverse order"


# --- Frames as text ---


def _describe_frames(kind: str, frames: Sequence[can.Message]) -> str:
    """Return the first three frames as text, and how many more there are; "nothing" if there is none."""
    if not frames:
        return "nothing"
    descriptions = [_describe_frame(kind, frame) for frame in frames[:_MAX_FRAMES_SHOWN]]
    if len(frames) > _MAX_FRAMES_SHOWN:
        descriptions.append(f"{len(frames) - _MAX_FRAMES_SHOWN} more")
    return " and ".join(descriptions)


def _describe_frame(kind: str, frame: can.Message) -> str:
    """Return a frame as text: its identifier and the fields that are compared in frames of this kind.

    A frame that has no such fields, as its format is wrong, is returned as a line of candump: identifier and
    data in hexadecimal.
    """
    if _format_error(frame) is not None:
        return format_frame(frame)
    payload = payload_of(frame)
    descriptions = []
    for field in FIELDS_BY_KIND[kind]:
        value = field.extract(payload)
        descriptions.append(f"{field.name} {_describe_value(field, value)}")
    return f"{frame.arbitration_id:08X} {', '.join(descriptions)}"


def _describe_value(field: Field, value: int) -> str:
    """Return a field's value as text: a fraction or float in hexadecimal and as a number, others plain."""
    if field.is_float:
        return f"{value:#010x} ({float32_value(value):g})"
    if field.unit != 1:
        return f"{value:#08x} ({value * field.unit:.7f})"
    return str(value)
