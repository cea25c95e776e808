"""The frames as a DBC file, from which CAN tools decode them (``docs/frame.md`` is its source)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from mcp_asdf_tools.bus.frames import (
    COMMANDS,
    EVERY_ROBOT,
    INFINITE_ALPHA,
    MAX_B_HAT,
    MAX_NODE_ID,
    MIN_B_HAT,
    ONE,
    TELEMETRY,
    Action,
    FrameFormat,
    Health,
    Heartbeat,
    Mode,
    encode_heartbeat,
    float_of,
)

ANY_NODE_MASK = 0x1FFF_FF00
"""Mask of the identifier bits to compare when one entry serves all nodes."""

_EXTENDED = 1 << 31


@dataclass(frozen=True)
class Signal:
    """A run of bits in the data, lowest first.

    Attributes:
        name: As in the frame's description.
        start: Number of its lowest bit, 0 .. 63.
        bits: How many.
        comment: Description.
        low: Smallest legal value, in units of ``unit``.
        high: Largest legal value.
        unit: Value of the lowest bit; None for IEEE 754 binary32.
        names: Names of single values.
    """

    name: str
    start: int
    bits: int
    comment: str
    low: float = 0
    high: float = 0
    unit: float | None = 1
    names: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class Entry:
    """A message of the file.

    Attributes:
        name: Of the kind, with the node's id if the entry is for one node.
        identifier: 29 bits; for any node, those of node 0.
        sender: Name of the node that sends it.
        comment: Description.
        signals: Its content.
    """

    name: str
    identifier: int
    sender: str
    comment: str
    signals: tuple[Signal, ...]


def _named(kind: type[Enum]) -> tuple[tuple[int, str], ...]:
    return tuple((member.value, member.name) for member in kind)


_TAIL = (
    Signal("transfer_id", 56, 5, "number of the sender's messages of this kind modulo 32", high=31),
    Signal("start_end_toggle", 61, 3, "7: the transfer is this one frame", 7, 7),
)
_ESTIMATE = (
    Signal("x_hat", 0, 24, "local estimate (eq. 3)", high=1, unit=1 / ONE),
    Signal("alpha", 24, 32, "local confidence (eq. 4)", high=float_of(INFINITE_ALPHA - 1), unit=None),
)
_HEARTBEAT = (
    Signal("uptime", 0, 32, "seconds since start", high=2**32 - 1),
    Signal("health", 32, 2, "health of the node", high=3, names=_named(Health)),
    Signal("mode", 40, 3, "operating mode of the node", high=3, names=_named(Mode)),
    Signal("vendor_status", 48, 8, "the application's own code", high=255),
)
_TELEMETRY = (
    Signal("x", 0, 24, "informed estimate (eq. 7)", high=1, unit=1 / ONE),
    Signal("b_hat", 24, 24, "assumed accuracy", MIN_B_HAT / 2**24, MAX_B_HAT / 2**24, 2**-24),
    Signal("updates", 48, 8, "number of re-estimates of b_hat (eq. 8) modulo 256", high=255),
)
_COMMAND = (
    Signal("tick", 0, 32, "number of the control tick", high=2**32 - 1),
    Signal("target", 32, 8, "id of the robot addressed", high=255, names=((EVERY_ROBOT, "EVERY_ROBOT"),)),
    Signal("action", 40, 8, "half of a tick to do", high=3, names=_named(Action)),
)


def dbc_entries(estimates: FrameFormat, nodes: Sequence[int] | None = None) -> list[Entry]:
    """The messages of a file: all kinds from each of ``nodes`` or, if None, one entry a kind for any node.

    Raises ValueError if a node is not 0 .. 127 or listed twice, or if the subject of ``estimates`` is that
    of telemetry or of commands.
    """
    for other in (TELEMETRY, COMMANDS):
        if estimates.subject == other.subject:
            raise ValueError(
                f"subject {other.subject} is that of telemetry or commands; choose another for estimates"
            )
    if nodes is None:
        return _kinds(estimates, 0, "", "Robot")
    for node in nodes:
        if not 0 <= node <= MAX_NODE_ID:
            raise ValueError(f"node {node} does not exist; ids are 0 to {MAX_NODE_ID}")
        if nodes.count(node) > 1:
            raise ValueError(f"node {node} is listed twice; each id belongs to one node")
    return [entry for node in nodes for entry in _kinds(estimates, node, f"_{node}", f"Robot_{node}")]


def _kinds(estimates: FrameFormat, node: int, suffix: str, sender: str) -> list[Entry]:
    heartbeat = encode_heartbeat(Heartbeat(node, 0, 0)).arbitration_id
    kinds = (
        ("Estimate", estimates.identifier(node), "A robot's broadcast", _ESTIMATE),
        ("Heartbeat", heartbeat, "A node's heartbeat, once per second", _HEARTBEAT),
        ("Telemetry", TELEMETRY.identifier(node), "A robot's state for observers of the bus", _TELEMETRY),
        ("Command", COMMANDS.identifier(node), "A simulator's order", _COMMAND),
    )
    return [Entry(name + suffix, number, sender, what, body + _TAIL) for name, number, what, body in kinds]


def dbc_text(messages: Sequence[Entry]) -> str:
    """The text of a DBC file. O(len(messages))."""
    senders = " ".join(dict.fromkeys(entry.sender for entry in messages))
    parts = [
        'VERSION ""\n',
        "NS_ :\n",
        "BS_:\n",
        f"BU_: {senders}\n",
        *(_message(entry) for entry in messages),
        *("\n".join(line for entry in messages for line in about(entry)) + "\n" for about in _ABOUT),
    ]
    return "\n".join(parts)


def _key(entry: Entry) -> int:
    return entry.identifier | _EXTENDED


def _message(entry: Entry) -> str:
    signals = (f" SG_ {_signal(signal)}\n" for signal in entry.signals)
    return f"BO_ {_key(entry)} {entry.name}: 8 {entry.sender}\n" + "".join(signals)


def _signal(signal: Signal) -> str:
    sign, factor = ("-", 1.0) if signal.unit is None else ("+", signal.unit)
    bits = f"{signal.start}|{signal.bits}@1{sign} ({_number(factor)},0)"
    return f'{signal.name} : {bits} [{_number(signal.low)}|{_number(signal.high)}] "" Vector__XXX'


def _number(value: float) -> str:
    """Shortest text that reads back as the same number."""
    return str(int(value)) if value == int(value) and value < 2**53 else repr(value).upper()


def _comments(entry: Entry) -> Iterator[str]:
    yield f'CM_ BO_ {_key(entry)} "{entry.comment}";'
    for signal in entry.signals:
        yield f'CM_ SG_ {_key(entry)} {signal.name} "{signal.comment}";'


def _value_names(entry: Entry) -> Iterator[str]:
    for signal in entry.signals:
        if signal.names:
            names = " ".join(f'{value} "{name}"' for value, name in signal.names)
            yield f"VAL_ {_key(entry)} {signal.name} {names} ;"


def _float_types(entry: Entry) -> Iterator[str]:
    for signal in entry.signals:
        if signal.unit is None:
            yield f"SIG_VALTYPE_ {_key(entry)} {signal.name} : 1;"


_ABOUT = (_comments, _value_names, _float_types)
