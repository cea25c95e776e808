"""Counting the integer operations of every call: the claims that time is O(1) and memory O(q).

The mirror's code runs on integers that count their operations, so the count is that of the very code whose
bits are the firmware's. It is taken over t, over the messages m of a round and over the table's q, with both
outcomes of every decision. Integers here have no fixed size; the widest one met is recorded too, so that an
operation is a bounded number of instructions. So are the lines of code executed, for a loop need not touch
such an integer, and the builtins used, for some of them are loops themselves.
"""

from __future__ import annotations

import builtins
import dis
import gc
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from types import CodeType, FrameType
from typing import Any

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import Closed, MirrorRobot
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, MIN_MEMORY, Config, Observation
from mcp_asdf.table import EXTRA_WORDS, MAX_Q, MIN_Q, Table
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

KINDS = {
    "add": ("add", "radd", "sub", "rsub", "neg"),
    "multiply": ("mul", "rmul", "pow"),
    "divide": ("floordiv", "rfloordiv", "mod", "rmod"),
    "shift": ("lshift", "rlshift", "rshift", "rrshift"),
    "logic": ("and", "rand", "or", "ror", "xor", "rxor", "invert"),
    "compare": ("lt", "le", "gt", "ge", "eq", "ne", "bool"),
    "bit length": ("bit_length",),
}
"""Kinds of operations, and the methods of ``int`` that count as such."""

BOUNDS = {"observe": 70, "receive": 40, "settle": 110, "step": 180, "x": 15}
"""Maximum operations of a call. Written down, so that a change of the mirror's cost is a decision."""
WIDEST = 96
"""Maximum bits of any intermediate integer."""
LINE_BOUNDS = {"observe": 40, "receive": 30, "settle": 90, "step": 130, "x": 8}
"""Maximum lines of Python that a call executes."""
ELEMENTARY = frozenset({"int", "len", "max", "min", "super", "ValueError"})
"""Builtins that calls may use: given a few numbers, their time does not depend on the values."""

AXES = ("t", "m", "q")

_OWN, _HEARD, _FRESH = 127, 0, 126
_ALPHA_ONE, _ANY_BITS = 0x80000001, 0xFFFFFFFF
_TOO_MANY_LINES = 1000
"""A call is cut short there: a loop over t would not end."""


class _CutShortError(Exception):
    """Ends a call that has executed too many lines."""


class Tally:
    """The work of a call.

    Attributes:
        counts: Operations by kind.
        widest: Bits of the widest result.
        lines: Lines of Python executed.
        builtins: Names of the builtins used.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Start again."""
        self.counts: Counter[str] = Counter()
        self.widest = 0
        self.lines = 0
        self.builtins: set[str] = set()

    def note(self, kind: str, result: int) -> None:
        """Count an operation."""
        # A missing key of a Counter is looked up by lines of Python, which would count.
        self.counts[kind] = self.counts.get(kind, 0) + 1
        self.widest = max(self.widest, int.bit_length(result))

    def watch(self, act: Callable[[], object]) -> None:
        """Act, and count the lines executed and the builtins used, those of this module aside.

        Garbage is not collected meanwhile: finalizers of whatever else the process has made would be counted.
        """
        previous, collects = sys.gettrace(), gc.isenabled()
        gc.disable()
        sys.settrace(self._trace)
        try:
            act()
        except _CutShortError:
            pass
        finally:
            sys.settrace(previous)
            if collects:
                gc.enable()

    def _trace(self, frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
        if event == "call":
            if frame.f_globals is globals():
                return None
            self.builtins |= _builtins_of(frame.f_code)
        elif event == "line":
            self.lines += 1
            if self.lines > _TOO_MANY_LINES:
                raise _CutShortError
        return self._trace


@cache
def _builtins_of(code: CodeType) -> frozenset[str]:
    """Names of builtins that code loads."""
    loaded = {step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"}
    return frozenset(loaded & vars(builtins).keys())


def counting_type(tally: Tally) -> type[int]:
    """A subclass of int whose operators note themselves in ``tally`` and return its own kind."""
    methods: dict[str, Any] = {}
    for kind, names in KINDS.items():
        for name in names:
            method = name if name == "bit_length" else f"__{name}__"
            methods[method] = _counted(getattr(int, method), kind, tally)
    # Equality defined in a class takes the hash away.
    methods["__hash__"] = int.__hash__
    return type("CountingInt", (int,), methods)


def _counted(plain: Callable[..., Any], kind: str, tally: Tally) -> Callable[..., Any]:
    def operate(self: int, *others: int) -> Any:
        result = plain(self, *others)
        if result is NotImplemented:
            return result
        tally.note(kind, result)
        return result if isinstance(result, bool) else type(self)(result)

    return operate


@dataclass(frozen=True)
class Situation:
    """A robot before a call.

    Attributes:
        t, n: Observations, the next one included, and the black ones among them.
        b_hat: Assumed accuracy (raw).
        m: Messages in its open round, at whose end the filter runs, and in the last closed round.
        alpha: Of these messages and its own, about.
        q: Of its table.
        memory: Observations at which t and n are halved.
        agrees: Whether its x_hat is that of the messages, so that the hypothesis test does not reject.
    """

    t: int = 1000
    n: int = 400
    b_hat: int = 3 << 30
    m: int = 20
    alpha: int = _ALPHA_ONE
    q: int = MAX_Q
    memory: int = DEFAULT_MEMORY
    agrees: bool = False


Axis = dict[int, tuple[int, int]]
"""Minimum and maximum operations of a call, by the value of t, m or q."""


@dataclass
class CallCount:
    """Operations of one call.

    Attributes:
        least, most: Minimum and maximum over everything that was tried.
        kinds: Of the operations of the maximum.
        widest: Bits of the widest result.
        lines: Maximum lines of Python executed.
        loops: Builtins used that are not elementary, by name.
        axes: By t, by m and by q.
    """

    least: int = 2**31
    most: int = 0
    widest: int = 0
    lines: int = 0
    loops: list[str] = field(default_factory=list)
    kinds: dict[str, int] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=lambda: {axis: {} for axis in AXES})

    def add(self, axis: str, value: int, tally: Tally) -> None:
        """Count a call made at ``value`` of ``axis``."""
        total = tally.counts.total()
        if total > self.most:
            self.kinds = dict(tally.counts)
        self.least, self.most = min(self.least, total), max(self.most, total)
        self.widest, self.lines = max(self.widest, tally.widest), max(self.lines, tally.lines)
        self.loops = sorted({*self.loops, *tally.builtins - ELEMENTARY})
        least, most = self.axes[axis].get(value, (total, total))
        self.axes[axis][value] = min(least, total), max(most, total)


def count_operations(
    firmware: type[MirrorRobot] = MirrorRobot, axes: Collection[str] = AXES
) -> dict[str, CallCount]:
    """Count the operations of every call in BOUNDS, over some of AXES. Takes about three seconds for all."""
    counts = {name: CallCount() for name in BOUNDS}
    tally = Tally()
    number = counting_type(tally)
    for axis, value, situation in _situations():
        if axis not in axes:
            continue
        plain = _robot(firmware, situation)
        plain.config = _converted(plain.config, number)
        for name, act in _acts(axis):
            robot = copy(plain)
            robot.s = _converted(plain.s, number)
            tally.clear()
            tally.watch(partial(act, robot, number))
            counts[name].add(axis, value, tally)
    return counts


def exceeded(counts: dict[str, CallCount]) -> list[str]:
    """Counts above their bounds, a line each."""
    return [problem for name, count in counts.items() for problem in _exceeded(name, count)]


def _exceeded(name: str, count: CallCount) -> Iterator[str]:
    if count.most > BOUNDS[name] or count.widest > WIDEST:
        operations = f"{count.most} operations of up to {count.widest} bits"
        yield f"{name}: {operations}, bound {BOUNDS[name]} of {WIDEST}"
    if count.lines > LINE_BOUNDS[name]:
        yield f"{name}: {count.lines} lines executed, bound {LINE_BOUNDS[name]}"
    if count.loops:
        yield f"{name}: uses {', '.join(count.loops)}, whose time depends on its arguments"


@dataclass(frozen=True)
class Storage:
    """Bytes.

    Attributes:
        tables: Of a table, by q.
        images: Of the images that robots in all situations save: one size.
    """

    tables: dict[int, int]
    images: list[int]

    def problems(self) -> list[str]:
        """Exceptions from the rule that a table takes 12 + 4 q bytes, and every robot the same."""
        wrong = [
            f"a table with q = {q} takes {size} bytes"
            for q, size in self.tables.items()
            if size != 4 * (EXTRA_WORDS + q)
        ]
        return wrong + ([f"robots take {self.images} bytes"] if len(self.images) != 1 else [])


def measure_storage(firmware: type[MirrorRobot] = MirrorRobot) -> Storage:
    """Measure all tables, and images of robots in all situations."""
    tables = {q: 4 * len(_table(q).words()) for q in range(MIN_Q, MAX_Q + 1)}
    images = {len(_robot(firmware, situation).save()) for _, _, situation in _situations()}
    return Storage(tables, sorted(images))


def _situations() -> Iterator[tuple[str, int, Situation]]:
    """An axis, a value of it, and a situation there."""
    powers = [1 << k for k in range(32)]
    times = {t for power in powers for t in (power - 1, power, power + 1)}
    for t in sorted(t for t in times if 1 <= t <= DEFAULT_MEMORY):
        for b_hat in (B_HAT_MIN, 1 << 30, 1 << 31, 4080218931, B_HAT_MAX):
            for n in sorted({0, 2 * t // 5, t // 2, t}):
                yield "t", t, Situation(t=t, n=n, b_hat=b_hat)
        if t >= MIN_MEMORY and t % 4 == 0:
            yield "t", t, Situation(t=t, n=t // 2, memory=t)
    for m in range(MAX_ID + 1):
        for agrees in (False, True):
            yield "m", m, Situation(m=m, agrees=agrees)
        yield "m", m, Situation(m=m, alpha=ALPHA_MAX)
    for q in range(MIN_Q, MAX_Q + 1):
        for m in (2, q, min(q + 1, MAX_ID)):
            yield "q", q, Situation(q=q, m=m)


Act = Callable[[MirrorRobot, type[int]], object]


def _acts(axis: str) -> Iterator[tuple[str, Act]]:
    """The calls to count; ``receive`` has many kinds, which are tried along its own axis only."""
    yield "step", lambda robot, number: robot.step(Observation.BLACK)
    yield "settle", lambda robot, number: robot.settle()
    yield "x", lambda robot, number: robot.x_raw
    for z in Observation:
        yield "observe", partial(_observe, z)
    for sender in (_FRESH, _HEARD, _OWN) if axis == "m" else (_FRESH,):
        for alpha in (0, 0xFF, 0x100, _ALPHA_ONE, ALPHA_MAX, _ANY_BITS) if axis == "m" else (_ALPHA_ONE,):
            yield "receive", partial(_receive, sender, alpha)


def _observe(z: Observation, robot: MirrorRobot, number: type[int]) -> None:
    robot.observe(z)


def _receive(sender: int, alpha: int, robot: MirrorRobot, number: type[int]) -> None:
    robot.receive_raw(number(sender), number(ONE // 3), number(alpha))


def _robot(firmware: type[MirrorRobot], situation: Situation) -> MirrorRobot:
    """A robot in a situation, still of plain integers."""
    robot = firmware(
        Config(_table(situation.q), filter_period=1, memory=situation.memory), _OWN, situation.b_hat / 2**32
    )
    s = robot.s
    s.t, s.n = situation.t - 1, min(situation.n, situation.t - 1)
    for sender in range(situation.m):
        robot.receive_raw(sender, ONE // 3 + 1000 * sender, situation.alpha ^ sender << 8)
    s.x_hat = s.open.x // s.open.count if situation.agrees and s.open.count else ONE
    s.alpha = situation.alpha
    s.closed = Closed(s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high)
    return robot


def _converted(value: Any, number: type[int]) -> Any:
    """A value made of counting integers; a fresh one, so that the original does not change with it."""
    if isinstance(value, int):
        return number(value)
    if isinstance(value, list | tuple):
        return type(value)(_converted(item, number) for item in value)
    return replace(
        value, **{member.name: _converted(getattr(value, member.name), number) for member in fields(value)}
    )


@cache
def _table(q: int) -> Table:
    """A table with q entries of the paper's omega; only their number matters here."""
    whole = generate(parse_omega("0.05"), MAX_Q)
    return replace(whole, entries=whole.entries[:q])
