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
from itertools import product
from types import FrameType
from typing import Any

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import Closed, MirrorRobot
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, MIN_MEMORY, Config, Filter, Observation
from mcp_asdf.table import MAX_Q, MIN_Q, Table
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

_OWN, _HEARD, _FRESH, _ALPHA_ONE = 127, 0, 126, 0x80000001
_CENTRES = 0, (1 << 29) - (1 << 24)
"""Of the robust filter: one that a count of half of the tiles contradicts, and one that it does not."""

AXES = ("t", "m", "q")
CALLS: dict[str, Callable[[MirrorRobot], object]] = {
    "observe": lambda robot: robot.observe(Observation.BLACK),
    "receive": lambda robot: robot.receive_raw(_FRESH, ONE // 3, _ALPHA_ONE),
    "receive again": lambda robot: robot.receive_raw(_HEARD, ONE // 3, _ALPHA_ONE),
    "receive own": lambda robot: robot.receive_raw(_OWN, ONE // 3, _ALPHA_ONE),
    "settle": lambda robot: robot.settle(),
    "step": lambda robot: robot.step(Observation.WHITE),
    "x": lambda robot: robot.x_raw,
}

Counts = dict[str, dict[str, dict[int, int]]]
"""Largest number of instructions by call, with the robust filter apart, by t, m or q, and by its value. The
robust filter has no q."""

_TOO_MANY = 4000
"""A call is cut short there: a loop over t would not end."""


class _CutShortError(Exception):
    """Ends a call that has executed too many instructions."""


def instructions(act: Callable[[], object]) -> int:
    """The number of bytecode instructions that ``act`` executes, cut short at 4000.

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
    """A robot before an observation, and before the end of a round at which the filter runs.

    Attributes:
        t, n: Observations, the next one included, and the black ones among them.
        b_hat: Assumed accuracy (raw).
        m: Messages in its open round, and in the last closed one.
        alpha: Confidence of these messages and its own, about.
        q: Entries of its table.
        halves: Whether the memory halves t and n at the next observation.
        agrees: Whether its x_hat is that of the messages, so that the hypothesis test does not reject.
        robust: Whether it has the robust filter, and has had 128 votes for each of the m messages; then
            ``agrees`` is about its count of black tiles.
    """

    t: int = 1000
    n: int = 400
    b_hat: int = 3 << 30
    m: int = 20
    alpha: int = _ALPHA_ONE
    q: int = MAX_Q
    halves: bool = False
    agrees: bool = False
    robust: bool = False

    def robot(self, firmware: type[MirrorRobot]) -> MirrorRobot:
        """The robot."""
        memory = self.t if self.halves else DEFAULT_MEMORY
        mode = Filter.ROBUST if self.robust else Filter.ADAPTIVE
        robot = firmware(
            Config(_table(self.q), mode, filter_period=1, memory=memory), _OWN, self.b_hat / 2**32
        )
        s = robot.s
        s.t, s.n = self.t - 1, min(self.n, self.t - 1)
        for sender in range(self.m):
            robot.receive_raw(sender, ONE // 3 + 1000 * sender, self.alpha ^ sender << 8)
        s.x_hat = s.open.x // s.open.count if self.agrees and s.open.count else ONE
        s.alpha = self.alpha
        s.closed = Closed(s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high)
        if self.robust:
            s.crowd.votes, s.crowd.centre = self.m << 7, _CENTRES[self.agrees]
        return robot


def _situations() -> Iterator[tuple[str, int, Situation]]:
    """An axis, a value of it, and a situation there."""
    values = sorted({t for k in range(32) for t in ((1 << k) - 1, 1 << k) if t})
    for t, robust in product(values, (False, True)):
        for b_hat in (B_HAT_MIN, 1 << 31, 4080218931, B_HAT_MAX):
            for n in sorted({0, 2 * t // 5, t}):
                yield "t", t, Situation(t=t, n=n, b_hat=b_hat, robust=robust)
        if t >= MIN_MEMORY and t % 4 == 0:
            yield "t", t, Situation(t=t, n=t // 2, halves=True, robust=robust)
    for m in range(MAX_ID + 1):
        yield "m", m, Situation(m=m)
        yield "m", m, Situation(m=m, agrees=True)
        yield "m", m, Situation(m=m, alpha=ALPHA_MAX)
        for agrees in (False, True):
            yield "m", m, Situation(m=m, n=500, agrees=agrees, robust=True)
    for q in range(MIN_Q, MAX_Q + 1):
        for m in (2, q, min(q + 1, MAX_ID)):
            yield "q", q, Situation(q=q, m=m)


@cache
def _table(q: int) -> Table:
    """A table with q entries of the paper's omega; only their number matters here."""
    whole = generate(parse_omega("0.05"), MAX_Q)
    return replace(whole, entries=whole.entries[:q])


def count_operations(firmware: type[MirrorRobot] = MirrorRobot, axes: Collection[str] = AXES) -> Counts:
    """Count the instructions of every call, over some of AXES. Takes a few seconds for all."""
    counts: Counts = {name + kind: {axis: {} for axis in axes} for kind in ("", ", robust") for name in CALLS}
    for axis, value, situation in _situations():
        if axis not in axes:
            continue
        plain, kind = situation.robot(firmware), ", robust" if situation.robust else ""
        for name, act in CALLS.items():
            robot = firmware.__new__(firmware)
            robot.config, robot.s = plain.config, deepcopy(plain.s)
            most = counts[name + kind][axis]
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


def measure_storage(firmware: type[MirrorRobot] = MirrorRobot) -> dict[str, dict[int, int]]:
    """Bytes of a table by q, and of the image that a robot saves by the messages m in its rounds."""
    return {
        "tables": {q: 4 * len(_table(q).words()) for q in range(MIN_Q, MAX_Q + 1)},
        "images": {m: len(Situation(m=m).robot(firmware).save()) for m in range(MAX_ID + 1)},
    }
