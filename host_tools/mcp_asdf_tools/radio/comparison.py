"""Comparison of the controller's frames with the model's: bit for bit, kind by kind, whole frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import can

from mcp_asdf_tools.bus import (
    FRAME_BYTES,
    HEARTBEAT_SUBJECT,
    MAX_NODE_ID,
    ONE,
    Health,
    float_of,
    frame_as_text,
)
from mcp_asdf_tools.robots import Subjects

ESTIMATE, TELEMETRY, HEARTBEAT, BUS = "estimate", "telemetry", "heartbeat", "bus"
Frames = dict[str, list[can.Message]]
"""Frames by kind."""

_PRIORITY = 7 << 26
_RANKS = (
    *(
        "frame",
        "length",
        "tail",
        "priority",
        "identifier",
        "never",
        "missing",
        "twice",
        "extra",
        "more updates",
    ),
    *("fewer updates", "transfer_id", "b_hat", "x_hat", "alpha", "x", "uptime", "mode", "health"),
)
"""Parts that may differ; the first tells most, as others follow from it."""
_SHOWN = 3
"""Frames shown of a kind."""


@dataclass(frozen=True)
class Symptom:
    """First difference between controller and model.

    Attributes:
        kind: Kind of frame: estimate, telemetry or heartbeat; "bus" if it is none of a frame.
        field: The part that differs, see ``comparison`` and ``causes``.
        text: Both values.
    """

    kind: str
    field: str
    text: str


FIELDS: dict[str, tuple[tuple[str, int, int], ...]] = {
    ESTIMATE: (("transfer_id", 56, 5), ("x_hat", 0, 24), ("alpha", 24, 32)),
    TELEMETRY: (("transfer_id", 56, 5), ("updates", 48, 8), ("b_hat", 24, 24), ("x", 0, 24)),
    HEARTBEAT: (("transfer_id", 56, 5), ("uptime", 0, 32), ("mode", 40, 3), ("health", 32, 2)),
}
"""Fields of each kind, with first bit and length, in the order in which a difference is told."""


class Comparison:
    """Comparison of what the controller says with what the model says.

    Attributes:
        equal: Frames that were equal, by kind.
        others: Frames of the controller of other subjects, which are not judged.
        may_advise: Whether its health may be "advisory": it may say so once a settle was withheld from it.
    """

    def __init__(self, subjects: Subjects, greeting: can.Message, equal: Counter[str]) -> None:
        """Count equal frames into ``equal``. ``greeting`` is the heartbeat with which the model has started;
        the controller's may have come too early for us, or several times if it was reset."""
        self.equal = equal
        self.others = 0
        self.may_advise = False
        self._greeting = greeting
        self._kinds = {
            subjects.estimates.subject: ESTIMATE,
            subjects.telemetry.subject: TELEMETRY,
            HEARTBEAT_SUBJECT: HEARTBEAT,
        }

    def check(self, said: Sequence[can.Message], expected: Sequence[can.Message]) -> Symptom | None:
        """Compare the frames of some ticks; returns the symptom that tells most."""
        own, models = self._by_kind(said), self._by_kind(expected)
        self.others += len(said) - sum(map(len, own.values()))
        if not self.equal[TELEMETRY]:
            self._greet(own, models)
        symptoms = [self._check_kind(kind, own[kind], models[kind]) for kind in FIELDS]
        found = [symptom for symptom in symptoms if symptom is not None]
        return min(found, key=lambda symptom: _RANKS.index(symptom.field), default=None)

    def _greet(self, own: Frames, models: Frames) -> None:
        """Leave out heartbeats that are the greeting; one more than expected must be it."""
        greeting = self._greeting.arbitration_id, self._greeting.data
        own[HEARTBEAT] = [each for each in own[HEARTBEAT] if (each.arbitration_id, each.data) != greeting]
        if len(own[HEARTBEAT]) > len(models[HEARTBEAT]):
            models[HEARTBEAT].insert(0, self._greeting)

    def _by_kind(self, frames: Sequence[can.Message]) -> Frames:
        sorted_: Frames = {kind: [] for kind in FIELDS}
        for frame in frames:
            kind = self._kinds.get(frame.arbitration_id >> 8 & 0x1FFF)
            if kind is not None:
                sorted_[kind].append(frame)
        return sorted_

    def _check_kind(
        self, kind: str, own: Sequence[can.Message], models: Sequence[can.Message]
    ) -> Symptom | None:
        field = _first_difference(kind, own, models)
        if field == "health" and self.may_advise and _most_severe(own) <= Health.ADVISORY.value:
            field = None
        if field is None:
            self.equal[kind] += len(own)
            return None
        if field == "missing" and not self.equal[kind] and not own:
            field = "never"
        texts = f"the controller sent {_texts(kind, own)}, the model {_texts(kind, models)}"
        return Symptom(kind, field, f"{kind}: {texts}")


def _first_difference(kind: str, own: Sequence[can.Message], models: Sequence[can.Message]) -> str | None:
    odd = next((field for frame in own if (field := _what_is_odd(frame)) is not None), None)
    if odd is not None:
        return odd
    if len(own) > len(models):
        return "twice" if any(a.data == b.data for a, b in pairwise(own)) else "extra"
    differences = (_field_of(kind, *pair) for pair in zip(own, models, strict=False))
    field = next((each for each in differences if each is not None), None)
    is_short = len(own) < len(models)
    return "missing" if is_short and field in (None, "transfer_id") else field


def _most_severe(heartbeats: Sequence[can.Message]) -> int:
    """The most severe health among heartbeats."""
    return max(frame.data[4] & 3 for frame in heartbeats)


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
    for name, *place in FIELDS[kind]:
        left, right = _bits(own, *place), _bits(models, *place)
        if name == "updates" and left != right:
            return "more updates" if (left - right) % 256 < 128 else "fewer updates"
        if left != right:
            return name
    return None


def _bits(frame: can.Message, first: int, length: int) -> int:
    return int.from_bytes(frame.data, "little") >> first & (1 << length) - 1


def _texts(kind: str, frames: Sequence[can.Message]) -> str:
    shown = " and ".join(_text(kind, frame) for frame in frames[:_SHOWN]) or "nothing"
    return shown + f" and {len(frames) - _SHOWN} more" * (len(frames) > _SHOWN)


def _text(kind: str, frame: can.Message) -> str:
    """The content of a frame, with its identifier."""
    if _what_is_odd(frame) is not None:
        return frame_as_text(frame)
    values = {name: _bits(frame, *place) for name, *place in FIELDS[kind]}
    content = ", ".join(f"{name} {_value(name, value)}" for name, value in values.items())
    return f"{frame.arbitration_id:08X} {content}"


def _value(name: str, value: int) -> str:
    if name in ("x_hat", "x"):
        return f"{value:#08x} ({value / ONE:.7f})"
    if name == "b_hat":
        return f"{value:#08x} ({value / 2**24:.7f})"
    return f"{value:#010x} ({float_of(value):g})" if name == "alpha" else str(value)


def is_from(frame: can.Message, robot: int) -> bool:
    """True if a frame names ``robot`` as its sender."""
    return frame.is_extended_id and not frame.is_error_frame and frame.arbitration_id & MAX_NODE_ID == robot
