"""Faults between robots, each described in one line of text.

A fault is its kind, with a rate unless it is certain, then any options, separated by commas:
``loss=0.2,from=100,to=500,robots=3-5`` loses each frame that robots 3, 4 and 5 send from tick 100 on, until
before tick 500, with probability 0.2 on its way to each neighbour. ``FaultKind`` lists the kinds.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum
from typing import Any, Literal

from mcp_asdf_tools.bus.alpha_words import float32_value
from mcp_asdf_tools.bus.frame_layout import MAX_NODE_ID
from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.parameters import parameter, parameters_of
from mcp_asdf_tools.robots.record import ids_of, text_of_ids

_MAX_TICK = 2**32 - 1


class FaultKind(Enum):
    """Kind of fault. The value is its name in texts.

    Attributes:
        options: Options that it has besides its rate, from, to and robots.
        text: Description of one injection.
    """

    options: tuple[str, ...]
    text: str

    LOSS = "loss", ("receivers",), "a frame does not reach a neighbour"
    DELAY = "delay", ("receivers", "ticks"), "a frame reaches a neighbour ticks later"
    DUPLICATE = "duplicate", ("receivers", "ticks"), "a frame comes once more, ticks later"
    CORRUPT = "corrupt", ("receivers", "bits"), "bits of the data are flipped, unseen by the bus's checksum"
    BABBLE = "babble", ("frames",), "a node sends frames of random content besides its own, each tick"
    CRASH = "crash", ("ticks", "rejoin"), "a node is dead for ticks, then rejoins new or restored"
    FREEZE = "freeze", (), "a broadcast repeats the estimate of the robot's last regular one"
    LIAR = "liar", ("x", "alpha"), "a broadcast carries x and alpha instead of the robot's own"
    COLLIDE = "collide", ("id",), "a node sends under another's id"
    SYBIL = "sybil", ("ids", "x", "alpha"), "a node sends estimates under other ids, too, before all others"
    BUSOFF = "busoff", ("ticks",), "a node neither sends nor hears for ticks, while its robot goes on"

    def __new__(cls, name: str, options: tuple[str, ...], text: str) -> FaultKind:
        """Make a member."""
        member = object.__new__(cls)
        member._value_, member.options, member.text = name, options, text
        return member


@dataclass(frozen=True)
class Fault:
    """One fault, as ``parse_fault`` reads it. A field that its kind does not use has its default.

    The occasions are for ``babble``, ``sybil``, ``crash`` and ``busoff`` ticks; for the kinds with receivers
    frames on their way to each receiver; for the others frames. ``robots`` are the affected senders, that is
    nodes under any id they use, and ``receivers`` those affected; None for all.
    """

    kind: FaultKind
    rate: float = parameter("probability at each occasion", 0, 1, default=1.0)
    start: int = parameter("first tick", 0, _MAX_TICK, default=0)
    stop: int | None = parameter("first tick after, if it ends", 0, _MAX_TICK, default=None)
    robots: frozenset[int] | None = None
    receivers: frozenset[int] | None = None
    ticks: int = parameter("how late, or how long; 0 only for duplicates", 0, _MAX_TICK, default=1)
    bits: int = parameter("different bits of a frame that are flipped", 1, 64, default=1)
    frames: int = parameter("frames per tick", 0, 10_000, default=10)
    rejoin: Literal["new", "restored"] = parameter("new, or as it was when it crashed", default="new")
    x: float = parameter("estimate that is claimed", 0, 1, default=1.0)
    alpha: float = parameter("confidence that is claimed", 0, float32_value(0x7F7FFFFF), default=1e6)
    id: int | None = parameter("id to send under, needed for collide", 0, MAX_NODE_ID, default=None)
    ids: frozenset[int] | None = None
    """Ids to send under, needed for sybil."""

    def is_on(self, tick: int, sender: int) -> bool:
        """True if the fault may affect ``sender`` in this tick. O(1)."""
        is_time = self.start <= tick and (self.stop is None or tick < self.stop)
        return is_time and (self.robots is None or sender in self.robots)

    def __str__(self) -> str:
        """The text that ``parse_fault`` reads back."""
        spelling = {field: option for option, field in _FIELDS.items()}
        named = [
            f"{spelling.get(item.name, item.name)}={_text_of(value)}"
            for item in fields(self)[2:]
            if (value := getattr(self, item.name)) != item.default
        ]
        return ",".join([f"{self.kind.value}={self.rate!r}", *named])


_KINDS: dict[str, FaultKind] = {kind.value: kind for kind in FaultKind}
_ALWAYS = ("from", "to", "robots")
_FIELDS = {"from": "start", "to": "stop"}


def parse_fault(text: str) -> Fault:
    """Read a fault such as ``delay=0.5,ticks=3,from=100,to=500,robots=0+3-5``.

    The first item is the kind and its rate (1 if left out); ``robots``, ``receivers`` and ``ids`` take ids
    and ranges of ids, separated by +. Raises UsageError that names the error and the fix.
    """
    first, *rest = (item.strip() for item in text.split(","))
    name, _, rate = first.partition("=")
    if name not in _KINDS:
        fix = offer(name, _KINDS) or f"; choose one of {', '.join(_KINDS)}"
        raise UsageError(f"fault {text!r}: no kind is called {name!r}{fix}")
    options = (*_ALWAYS, *_KINDS[name].options)
    values = {"rate": _read(text, "rate", rate)} if "=" in first else {}
    for item in rest:
        option, _, value = item.partition("=")
        if option not in options:
            fix = offer(option, options) or f"; its options are {', '.join(options)}"
            raise UsageError(f"fault {text!r}: {name} has no option {option!r}{fix}")
        if option in values:
            raise UsageError(f"fault {text!r}: {option} is given twice; give it once")
        values[option] = _read(text, option, value)
    fault = Fault(_KINDS[name], **{_FIELDS.get(option, option): value for option, value in values.items()})
    _check(text, fault)
    return fault


def _check(text: str, fault: Fault) -> None:
    """Refuse values that contradict each other."""
    if fault.kind is FaultKind.COLLIDE and fault.id is None:
        raise UsageError(f"fault {fault.kind.value} needs the id to send under, such as id=3")
    if fault.kind is FaultKind.SYBIL and fault.ids is None:
        raise UsageError(f"fault {fault.kind.value} needs the ids to send under, such as ids=30-39")
    if fault.stop is not None and fault.stop <= fault.start:
        raise _error(text, "to", fault.stop, f"above from, {fault.start}")
    if fault.ticks == 0 and fault.kind is not FaultKind.DUPLICATE:
        raise _error(text, "ticks", 0, "at least 1")


def _read(text: str, option: str, value: str) -> Any:
    """The value of an option of the fault ``text``. Raises UsageError if it cannot be."""
    read = parameters_of(Fault).get(_FIELDS.get(option, option))
    if read is None:
        return ids_of(value, f"fault {text!r}: {option}")
    if read.choices:
        if value not in read.choices:
            raise _error(text, option, value, " or ".join(read.choices))
        return value
    kind = float if read.kind is float else int
    try:
        number = kind(value)
    except ValueError:
        number = None
    if number is None or not read.least <= number <= read.most:
        name = "a whole number" if kind is int else "a number"
        raise _error(text, option, value, f"{name}, {read.least:g} to {read.most:g}")
    return number


def _error(text: str, option: str, value: object, fix: str) -> UsageError:
    return UsageError(f"fault {text!r}: {option} is {value!r}; it must be {fix}")


def _text_of(value: object) -> str:
    if isinstance(value, frozenset):
        return text_of_ids(value)
    return value if isinstance(value, str) else repr(value)
