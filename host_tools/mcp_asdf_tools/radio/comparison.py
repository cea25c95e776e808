"""Comparison of a controller's frames with its model's: bit for bit, kind by kind, whole frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest

import can

from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import FRAME_BYTES, MAX_NODE_ID, Q23_ONE, Health
from mcp_asdf_tools.bus.frames import HEARTBEAT_SUBJECT, format_frame
from mcp_asdf_tools.robots.node import Subjects

ESTIMATE, TELEMETRY, HEARTBEAT = "estimate", "telemetry", "heartbeat"
Frames = dict[str, list[can.Message]]
"""Frames by kind."""

FIELDS: dict[str, tuple[tuple[str, int, int], ...]] = {
    ESTIMATE: (("transfer_id", 56, 5), ("x_hat", 0, 24), ("alpha", 24, 32)),
    TELEMETRY: (("transfer_id", 56, 5), ("updates", 48, 8), ("b_hat", 24, 24), ("x", 0, 24)),
    HEARTBEAT: (("transfer_id", 56, 5), ("uptime", 0, 32), ("mode", 40, 3), ("health", 32, 2)),
}
"""Fields of each kind, with first bit and length, in the order in which a difference is told."""

_PRIORITY = 7 << 26
_SHOWN = 3
"""Frames shown of a kind."""


@dataclass(frozen=True)
class Symptom:
    """First difference between controller and model.

    Attributes:
        kind: Kind of frame: estimate, telemetry or heartbeat.
        field: The part that differs: a field of ``FIELDS``, "missing", "extra", "twice", or what is wrong
            with the frame itself.
        got: What the controller sent.
        expected: What the model sends.
        relation: How the two values belong together, where that is no accident.
    """

    kind: str
    field: str
    got: str
    expected: str
    relation: str = ""

    def __str__(self) -> str:
        relation = f"; {self.relation}" if self.relation else ""
        return f"{self.kind}, {self.field}: expected {self.expected}, got {self.got}{relation}"


class Comparison:
    """Comparison of what the controller says with what the model says.

    Attributes:
        equal: Frames that were equal, by kind.
        may_advise: Whether its health may be "advisory": it may say so once a settle was withheld from it.
    """

    def __init__(self, subjects: Subjects, greeting: can.Message) -> None:
        """Prepare; ``greeting`` is the heartbeat with which the model has started. The controller's may have
        come before this run, or several times if it was reset."""
        self.equal = Counter[str]()
        self.may_advise = False
        self._greeting = greeting
        self._kinds = {
            subjects.estimates.subject: ESTIMATE,
            subjects.telemetry.subject: TELEMETRY,
            HEARTBEAT_SUBJECT: HEARTBEAT,
        }

    def check(self, said: Sequence[can.Message], expected: Sequence[can.Message]) -> Symptom | None:
        """The first difference among the frames of some ticks; None if they are equal."""
        own, models = self._by_kind(said), self._by_kind(expected)
        if not self.equal[TELEMETRY]:
            self._greet(own, models)
        is_first = not self.equal[TELEMETRY]
        symptoms = (self._check_kind(kind, own[kind], models[kind]) for kind in FIELDS)
        found = next((symptom for symptom in symptoms if symptom is not None), None)
        return found if found is not None or is_first else self._check_order(said, expected)

    def _check_order(self, said: Sequence[can.Message], expected: Sequence[can.Message]) -> Symptom | None:
        """The first frame of another kind, where all are equal kind by kind."""
        ways = [[kind for each in frames if (kind := self._kind(each))] for frames in (said, expected)]
        for own, model in zip(*ways, strict=True):
            if own != model:
                return Symptom(own, "order", f"it before the {model}", f"the {model} first")
        return None

    def _kind(self, frame: can.Message) -> str | None:
        return self._kinds.get(frame.arbitration_id >> 8 & 0x1FFF)

    def _greet(self, own: Frames, models: Frames) -> None:
        """Leave out heartbeats that are the greeting; one more than expected must be it."""
        greeting = self._greeting.arbitration_id, self._greeting.data
        own[HEARTBEAT] = [each for each in own[HEARTBEAT] if (each.arbitration_id, each.data) != greeting]
        if len(own[HEARTBEAT]) > len(models[HEARTBEAT]):
            models[HEARTBEAT] = [self._greeting, *models[HEARTBEAT]]

    def _by_kind(self, frames: Sequence[can.Message]) -> Frames:
        sorted_: Frames = {kind: [] for kind in FIELDS}
        for frame in frames:
            kind = self._kind(frame)
            if kind is not None:
                sorted_[kind].append(frame)
        return sorted_

    def _check_kind(
        self, kind: str, own: Sequence[can.Message], models: Sequence[can.Message]
    ) -> Symptom | None:
        field = _first_difference(kind, own, models)
        if field == "health" and self.may_advise:
            most_severe = max(frame.data[4] & 3 for frame in own)
            field = None if most_severe <= Health.ADVISORY.value else field
        if field is None:
            self.equal[kind] += len(own)
            return None
        return Symptom(
            kind, field, _texts(kind, own), _texts(kind, models), _relation(kind, field, own, models)
        )


def _first_difference(kind: str, own: Sequence[can.Message], models: Sequence[can.Message]) -> str | None:
    """The field in which two lists of frames differ first."""
    for left, right in zip_longest(own, models):
        if left is None:
            return "missing"
        odd = _what_is_odd(left)
        if odd is not None:
            return odd
        if right is None:
            return "twice" if any(a.data == b.data for a, b in pairwise(own)) else "extra"
        field = _field_of(kind, left, right)
        if field is not None:
            return field
    return None


def _relation(kind: str, field: str, own: Sequence[can.Message], models: Sequence[can.Message]) -> str:
    """What the first wrong value is of the right one: its bytes in reverse order, or a power of two times it.

    Long values are so by accident in one case of 10,000 at most; others get no word.
    """
    place = next((place for name, *place in FIELDS[kind] if name == field and place[1] >= _MANY_BITS), None)
    if place is None:
        return ""
    pairs = [(_bits(left, *place), _bits(right, *place)) for left, right in zip(own, models, strict=False)]
    got, expected = next(pair for pair in pairs if pair[0] != pair[1])
    size = place[1] // 8
    if got.to_bytes(size, "little") == expected.to_bytes(size, "big"):
        return f"its {size} bytes are in reverse order"
    digits = _significant(field, got)
    if digits != _significant(field, expected) or digits < _MANY_DIGITS:
        return ""
    of = float32_value if field == "alpha" else float
    return f"it is {of(got) / of(expected):g} times what it should be"


def _significant(field: str, value: int) -> int:
    """The digits of a value without the power of two in it; 0 if there are none."""
    if field == "alpha":
        return (value & 0x7F_FFFF | 0x80_0000) if 0 < value >> 23 < 0xFF else 0
    return value // (value & -value) if value else 0


_MANY_BITS, _MANY_DIGITS = 24, 1 << 14
"""Of a field, and of the digits of a value."""


def _what_is_odd(frame: can.Message) -> str | None:
    """The reason why a frame is no classic single-frame message of 8 bytes."""
    if frame.is_remote_frame or frame.is_fd:
        return "frame"
    if len(frame.data) != FRAME_BYTES:
        return "length"
    return None if frame.data[-1] & 0xE0 == 0xE0 else "tail"


def _field_of(kind: str, own: can.Message, models: can.Message) -> str | None:
    """The first field in which two frames differ."""
    bits = own.arbitration_id ^ models.arbitration_id
    if bits:
        return "priority" if bits & _PRIORITY else "identifier"
    return next((name for name, *place in FIELDS[kind] if _bits(own, *place) != _bits(models, *place)), None)


def _bits(frame: can.Message, first: int, length: int) -> int:
    return int.from_bytes(frame.data, "little") >> first & (1 << length) - 1


def _texts(kind: str, frames: Sequence[can.Message]) -> str:
    shown = " and ".join(_text(kind, frame) for frame in frames[:_SHOWN]) or "nothing"
    return shown + f" and {len(frames) - _SHOWN} more" * (len(frames) > _SHOWN)


def _text(kind: str, frame: can.Message) -> str:
    """The content of a frame, with its identifier."""
    if _what_is_odd(frame) is not None:
        return format_frame(frame)
    values = {name: _bits(frame, *place) for name, *place in FIELDS[kind]}
    content = ", ".join(f"{name} {_value(name, value)}" for name, value in values.items())
    return f"{frame.arbitration_id:08X} {content}"


def _value(name: str, value: int) -> str:
    if name in ("x_hat", "x"):
        return f"{value:#08x} ({value / Q23_ONE:.7f})"
    if name == "b_hat":
        return f"{value:#08x} ({value / 2**24:.7f})"
    return f"{value:#010x} ({float32_value(value):g})" if name == "alpha" else str(value)


def is_from(frame: can.Message, robot: int) -> bool:
    """True if a frame names ``robot`` as its sender."""
    return frame.is_extended_id and not frame.is_error_frame and frame.arbitration_id & MAX_NODE_ID == robot
