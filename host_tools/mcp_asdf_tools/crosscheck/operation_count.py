"""Counting the interpreter's instructions of every call: the claims that time is O(1) and memory O(q).

The mirror's code runs as it is and every bytecode instruction is counted, so a loop shows whatever it loops
over. The count is taken over t, over the messages m of a round and over the table's q, with both outcomes of
every decision. Each instruction takes a bounded time, for the mirror's integers are those of the C.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Collection, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, partial
from types import FrameType
from typing import Any

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import Closed, MirrorRobot
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, MIN_MEMORY, Config, Observation
from mcp_asdf.table import EXTRA_WORDS, MAX_Q, MIN_Q, Table
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

CALLS = ("observe", "receive", "settle", "step", "x")
AXES = ("t", "m", "q")

Counts = dict[str, dict[str, dict[int, int]]]
"""Largest number of instructions by call, by t, m or q, and by its value."""

_OWN, _HEARD, _FRESH = 127, 0, 126
_ALPHA_ONE, _ANY_BITS = 0x80000001, 0xFFFFFFFF
_TOO_MANY = 20_000
"""A call is cut short there: a loop over t would not end."""


class _CutShortError(Exception):
    """Ends a call that has executed too many instructions."""


def instructions(act: Callable[[], object]) -> int:
    """The number of bytecode instructions that ``act`` executes, cut short at 20,000.

    Garbage is not collected meanwhile: finalizers of whatever else the process has made would be counted.
    """
    count = 0

    def trace(frame: FrameType, event: str, _: object) -> Callable[..., Any]:
        nonlocal count
        frame.f_trace_opcodes = True
        count += event == "opcode"
        if count > _TOO_MANY:
            raise _CutShortError
        return trace

    previous, collects = sys.gettrace(), gc.isenabled()
    gc.disable()
    sys.settrace(trace)
    try:
        act()
    except _CutShortError:
        pass
    finally:
        sys.settrace(previous)
        if collects:
            gc.enable()
    return count


@dataclass(frozen=True)
class Situation:
    """A robot before a call.

    Attributes:
        t, n: Observations, the next one included, and the black ones among them.
        b_hat: Assumed accuracy (raw).
        m: Messages in its open round, at whose end the filter runs, and in the last closed round.
        alpha: Confidence of these messages and its own, about.
        q: Entries of its table.
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


def count_operations(firmware: type[MirrorRobot] = MirrorRobot, axes: Collection[str] = AXES) -> Counts:
    """Count the instructions of every call, over some of AXES. Takes a few seconds for all."""
    counts: Counts = {name: {axis: {} for axis in axes} for name in CALLS}
    for axis, value, situation in _situations():
        if axis not in axes:
            continue
        plain = _robot(firmware, situation)
        for name, act in _acts(axis):
            robot = firmware.__new__(firmware)
            robot.config, robot.s = plain.config, deepcopy(plain.s)
            most = counts[name][axis]
            most[value] = max(most.get(value, 0), instructions(partial(act, robot)))
    return counts


def growing(counts: Counts) -> list[str]:
    """Calls that take more instructions in the later half of an axis than in the earlier, or have no
    end, a line each."""
    problems = []
    for name, axes in counts.items():
        for axis, most in axes.items():
            values = sorted(most)
            early, late = values[: len(values) // 2], values[len(values) // 2 :]
            earlier, later = (max(map(most.__getitem__, half), default=0) for half in (early, late))
            if later > min(earlier, _TOO_MANY):
                where = f"where {axis} is {late[0]} to {late[-1]}"
                problems.append(f"{name}: {later} instructions {where}, but {earlier} below")
    return problems


@dataclass(frozen=True)
class Storage:
    """Bytes.

    Attributes:
        tables: Size of a table, by q.
        images: Sizes of the images that robots in all situations save: one size.
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


Act = Callable[[MirrorRobot], object]


def _acts(axis: str) -> Iterator[tuple[str, Act]]:
    """The calls to count; ``receive`` has many kinds, which are tried along its own axis only."""
    yield "step", lambda robot: robot.step(Observation.BLACK)
    yield "settle", lambda robot: robot.settle()
    yield "x", lambda robot: robot.x_raw
    for z in Observation:
        yield "observe", partial(_observe, z)
    for sender in (_FRESH, _HEARD, _OWN) if axis == "m" else (_FRESH,):
        for alpha in (0, 0xFF, 0x100, _ALPHA_ONE, ALPHA_MAX, _ANY_BITS) if axis == "m" else (_ALPHA_ONE,):
            yield "receive", partial(_receive, sender, alpha)


def _observe(z: Observation, robot: MirrorRobot) -> None:
    robot.observe(z)


def _receive(sender: int, alpha: int, robot: MirrorRobot) -> None:
    robot.receive_raw(sender, ONE // 3, alpha)


def _robot(firmware: type[MirrorRobot], situation: Situation) -> MirrorRobot:
    """A robot in a situation."""
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


@cache
def _table(q: int) -> Table:
    """A table with q entries of the paper's omega; only their number matters here."""
    whole = generate(parse_omega("0.05"), MAX_Q)
    return replace(whole, entries=whole.entries[:q])
