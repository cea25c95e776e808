"""Faults between robots, each described in one line of text.

A fault is its kind, with a rate unless it is certain, then any options, separated by commas:
``loss=0.2,from=100,to=500,robots=3-5`` loses each frame that robots 3, 4 and 5 send from tick 100 on, until
before tick 500, with probability 0.2 on its way to each neighbour. ``FaultKind`` lists the kinds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

from mcp_asdf_tools.bus.frames import MAX_NODE_ID, float_of
from mcp_asdf_tools.common.errors import UsageError

_MAX_TICK = 2**32 - 1
_MAX_ALPHA = float_of(0x7F7FFFFF)


class FaultKind(Enum):
    """Kind of fault. The value is its name in texts.

    Attributes:
        options: Fields of ``Fault`` that it uses besides rate, start, stop and robots.
        text: Description of one injection.
    """

    options: tuple[str, ...]
    text: str

    LOSS = "loss", ("receivers",), "a frame does not reach a neighbour"
    BURST = "burst", ("receivers", "length"), "the same in bursts: RATE of the time, length ticks on average"
    DELAY = "delay", ("receivers", "ticks"), "a frame reaches a neighbour ticks later"
    DUPLICATE = "duplicate", ("receivers", "ticks"), "a frame comes once more, ticks later"
    REORDER = "reorder", ("receivers",), "a frame falls behind others of its tick"
    CORRUPT = "corrupt", ("receivers", "bits"), "bits of the data are flipped, unseen by the bus's checksum"
    BABBLE = "babble", ("frames",), "a node sends frames of random content besides its own, each tick"
    CRASH = "crash", ("ticks", "rejoin"), "a node is dead for ticks, then rejoins new or restored"
    FREEZE = "freeze", (), "a broadcast repeats the estimate of the robot's last regular one"
    LIAR = "liar", ("x", "alpha"), "a broadcast carries x and alpha instead of the robot's own"
    COLLIDE = "collide", ("id",), "a node sends under another's id"
    ERROR = "error", (), "an error frame is seen by all, and the frame that it hit is sent again"
    BUSOFF = "busoff", ("ticks",), "a node neither sends nor hears for ticks, while its robot goes on"
    QUEUE = "queue", ("frames",), "a node's send queue takes frames a tick and refuses more"

    def __new__(cls, name: str, options: tuple[str, ...], text: str) -> FaultKind:
        """Make a member."""
        member = object.__new__(cls)
        member._value_, member.options, member.text = name, options, text
        return member


@dataclass(frozen=True)
class Fault:
    """One fault. Raises UsageError if a field is out of range or unused by the kind.

    Attributes:
        kind: Kind of fault.
        rate: Probability at each occasion, 0 .. 1: for ``burst`` the share of ticks in bursts, below
            length / (length + 1); for ``babble``, ``crash``, ``busoff`` and ``queue`` of each tick; for the
            kinds with receivers of each frame on its way to each receiver; for the others of each frame.
        start: First tick, from 0.
        stop: First tick after, above ``start``; None for no end.
        robots: Affected senders, None for all: the nodes themselves, under any id they use.
        receivers: Affected receivers; None for all.
        ticks: How late, or how long, 0 .. 2**32 - 1; 0 only for duplicates.
        length: Mean length of a burst in ticks, 1 or more.
        bits: Different bits of a frame that are flipped, 1 .. 64.
        frames: Frames per tick, 0 .. 10000.
        rejoin: Whether a crashed robot rejoins ``new`` or ``restored`` as it was when it crashed.
        x: Estimate that a liar claims, 0 .. 1.
        alpha: Confidence that a liar claims, 0 up to the largest binary32.
        id: Id under which a node sends, 0 .. 127; required for ``collide``.
    """

    kind: FaultKind
    rate: float = 1.0
    start: int = 0
    stop: int | None = None
    robots: frozenset[int] | None = None
    receivers: frozenset[int] | None = None
    ticks: int = 1
    length: float = 5.0
    bits: int = 1
    frames: int = 10
    rejoin: str = "new"
    x: float = 1.0
    alpha: float = 1e6
    id: int | None = None

    def __post_init__(self) -> None:
        self._check_options()
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise self._error(name, value, f"{low:g} to {high:g}")
        if self.stop is not None and self.stop <= self.start:
            raise self._error("stop", self.stop, f"above from, {self.start}")
        if self.ticks == 0 and self.kind is not FaultKind.DUPLICATE:
            raise self._error("ticks", 0, "at least 1")
        if self.rejoin not in ("new", "restored"):
            raise self._error("rejoin", self.rejoin, "new or restored")
        if self.kind is FaultKind.BURST and self.rate * (self.length + 1) > self.length:
            limit = self.length / (self.length + 1)
            raise self._error("rate", self.rate, f"at most length / (length + 1), {limit:.6g}")

    def _check_options(self) -> None:
        if self.kind is FaultKind.COLLIDE and self.id is None:
            raise UsageError(f"fault {self.kind.value} needs the id to send under, such as id=3")
        for item in fields(self)[_COMMON:]:
            if getattr(self, item.name) != item.default and item.name not in self.kind.options:
                raise UsageError(f"fault {self.kind.value} has no {item.name}; {_offer(self.kind)}")

    def _error(self, name: str, value: object, fix: str) -> UsageError:
        return UsageError(
            f"{_SPELLING.get(name, name)} of fault {self.kind.value} is {value}; it must be {fix}"
        )

    def is_on(self, tick: int, sender: int) -> bool:
        """True if the fault may affect ``sender`` in this tick. O(1)."""
        is_time = self.start <= tick and (self.stop is None or tick < self.stop)
        return is_time and (self.robots is None or sender in self.robots)

    def __str__(self) -> str:
        """The text that ``parse_fault`` reads back."""
        named = [
            f"{_SPELLING.get(item.name, item.name)}={_text_of(value)}"
            for item in fields(self)[2:]
            if (value := getattr(self, item.name)) != item.default
        ]
        return ",".join([f"{self.kind.value}={self.rate!r}", *named])


_COMMON = 5
_SPELLING = {"start": "from", "stop": "to"}
_RANGES: dict[str, tuple[float, float]] = {
    "rate": (0, 1),
    "start": (0, _MAX_TICK),
    "stop": (0, _MAX_TICK),
    "ticks": (0, _MAX_TICK),
    "length": (1, 1e9),
    "bits": (1, 64),
    "frames": (0, 10_000),
    "x": (0, 1),
    "alpha": (0, _MAX_ALPHA),
    "id": (0, MAX_NODE_ID),
}


def parse_fault(text: str) -> Fault:
    """Read a fault such as ``delay=0.5,ticks=3,from=100,to=500,robots=0+3-5``.

    The first item is the kind and its rate (1 if left out); ``robots`` and ``receivers`` take ids and
    ranges of ids, separated by +. Raises UsageError that names the error and the fix.
    """
    first, *rest = (item.strip() for item in text.split(","))
    name, _, rate = first.partition("=")
    if name not in _KINDS:
        raise UsageError(f"fault {text!r}: no kind is called {name!r}; choose one of {', '.join(_KINDS)}")
    kind = _KINDS[name]
    values: dict[str, Any] = {"rate": _read(text, "rate", rate)} if "=" in first else {}
    for item in rest:
        option, _, value = item.partition("=")
        if option not in {*_ALWAYS, *kind.options}:
            raise UsageError(f"fault {text!r}: {name} has no option {option!r}; {_offer(kind)}")
        field_name = _FIELDS.get(option, option)
        if field_name in values:
            raise UsageError(f"fault {text!r}: {option} is given twice; give it once")
        values[field_name] = _read(text, option, value)
    return Fault(kind, **values)


_KINDS: dict[str, FaultKind] = {kind.value: kind for kind in FaultKind}
_ALWAYS = ("from", "to", "robots")
_FIELDS = {spelling: name for name, spelling in _SPELLING.items()}


def _ids(text: str) -> frozenset[int]:
    """The ids of ``0+3-5``. Raises ValueError if it is no such list."""
    chosen: set[int] = set()
    for item in text.split("+"):
        first, dash, last = item.partition("-")
        low, high = int(first), int(last if dash else first)
        if not 0 <= low <= high <= MAX_NODE_ID:
            raise ValueError
        chosen.update(range(low, high + 1))
    return frozenset(chosen)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


_READERS: dict[str, tuple[Callable[[str], Any], str]] = {
    **dict.fromkeys(("rate", "length", "x", "alpha"), (_finite, "a number")),
    **dict.fromkeys(("from", "to", "ticks", "bits", "frames", "id"), (int, "a whole number")),
    **dict.fromkeys(("robots", "receivers"), (_ids, f"ids 0 to {MAX_NODE_ID} such as 0+3-5")),
    "rejoin": (str, "new or restored"),
}


def _read(text: str, option: str, value: str) -> Any:
    reader, wanted = _READERS[option]
    try:
        return reader(value)
    except ValueError as error:
        raise UsageError(f"fault {text!r}: {option} is {value!r}; it must be {wanted}") from error


def _text_of(value: object) -> str:
    if not isinstance(value, frozenset):
        return value if isinstance(value, str) else repr(value)
    firsts = sorted(robot for robot in value if robot - 1 not in value)
    lasts = sorted(robot for robot in value if robot + 1 not in value)
    return "+".join(f"{a}-{b}" if a < b else str(a) for a, b in zip(firsts, lasts, strict=True))


def _offer(kind: FaultKind) -> str:
    return f"its options are {', '.join((*_ALWAYS, *kind.options))}"
