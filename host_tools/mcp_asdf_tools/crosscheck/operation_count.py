"""Count the instructions of every call in Python's interpreter, to check that time is O(1) and memory O(q).

The mirror's own code runs, and every bytecode instruction is counted, so a loop shows whatever it loops over.
Calls are counted over t, over the number m of messages in a round and over the table's q, with both outcomes
of every decision. Each instruction takes a bounded time, as the mirror's integers are those of the C. The
robust filter has loops, but over its 32 slots at most: what it takes must not grow beyond 32 messages.
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

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE
from mcp_asdf.mirror import Closed, MirrorRobot
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ROUND_SIZE, MIN_MEMORY, Config, Filter, Observation
from mcp_asdf.robust_filter import VOTES_MAX
from mcp_asdf.table import MAX_Q, MIN_Q, Table
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE
from mcp_asdf_tools.tables.thresholds import generate, parse_omega

_OWN_ID = 127
_ID_IN_ROUND = 0
_ID_NOT_IN_ROUND = 126

_X_HAT_THAT_CONTRADICTS, _X_HAT_THAT_AGREES = 0, HALF
"""Estimates that contradict half of the observations being black, and that do not, in units of 2**-23."""

AXES = ("t", "m", "q")
CALLS: dict[str, Callable[[MirrorRobot], object]] = {
    "observe": lambda robot: robot.observe(Observation.BLACK),
    "receive": lambda robot: robot.receive_raw(_ID_NOT_IN_ROUND, ONE // 3, ALPHA_ONE),
    "receive again": lambda robot: robot.receive_raw(_ID_IN_ROUND, ONE // 3, ALPHA_ONE),
    "receive own": lambda robot: robot.receive_raw(_OWN_ID, ONE // 3, ALPHA_ONE),
    "settle": lambda robot: robot.settle(),
    "step": lambda robot: robot.step(Observation.WHITE),
    "x": lambda robot: robot.x_raw,
}

Counts = dict[str, dict[str, dict[int, int]]]
"""Largest number of instructions by call, axis and value on the axis. Calls of robots with the robust filter
are apart, as "settle, robust"; they have no values for q."""

_MAX_INSTRUCTIONS = 20_000
"""Longer calls are cut short here, as a loop over t would not end."""


class _CutShortError(Exception):
    """Ends a call that has executed too many instructions."""


def count_instructions(action: Callable[[], object]) -> int:
    """Return the number of bytecode instructions that ``action`` executes; it is cut short after 20,000.

    The garbage collector is off meanwhile: finalizers of other objects of the process would be counted.
    """
    count = 0

    def trace(frame: FrameType, event: str, _: object) -> Callable[..., Any]:
        """Count an instruction; Python calls this for each one, and at the beginning of each function."""
        nonlocal count
        frame.f_trace_opcodes = True  # asks for an event at every instruction of this function
        if event == "opcode":
            count += 1
        if count > _MAX_INSTRUCTIONS:
            raise _CutShortError
        return trace

    # A debugger or a coverage tool may have set a trace function, too.
    previous_trace, is_collecting = sys.gettrace(), gc.isenabled()
    gc.disable()
    sys.settrace(trace)
    try:
        action()
    except _CutShortError:
        pass
    finally:
        sys.settrace(previous_trace)
        if is_collecting:
            gc.enable()
    return count


@dataclass(frozen=True)
class Workload:
    """A robot whose calls are counted: before an observation, and in the last round before the filter runs.

    Attributes:
        t: Number of observations, with the next one.
        n: Number of black ones among them.
        b_hat: Assumed accuracy in units of 2**-32.
        m: Number of messages in the open round, and in the last closed one.
        alpha: Alpha word of the robot's confidence; those of the messages differ in some bits.
        q: Number of entries of the table.
        halves: Whether the memory halves t and n at the next observation.
        agrees: Whether x_hat is that of the messages, so that the hypothesis test does not reject it. With
            the robust filter: whether the messages agree with half of the observations being black.
        robust: Whether the robot has the robust filter. Then it has taken votes, if there are messages.
    """

    t: int = 1000
    n: int = 400
    b_hat: int = 3 << 30
    m: int = 20
    alpha: int = ALPHA_ONE
    q: int = MAX_Q
    halves: bool = False
    agrees: bool = False
    robust: bool = False

    def make_robot(self, firmware: type[MirrorRobot]) -> MirrorRobot:
        """Make a robot of this firmware in the described state, before its next observation."""
        memory = self.t if self.halves else DEFAULT_MEMORY
        mode = Filter.ROBUST if self.robust else Filter.ADAPTIVE
        config = Config(_table(self.q), mode, filter_period=1, memory=memory)
        robot = firmware(config, _OWN_ID, self.b_hat / 2**32)
        s = robot.s
        s.t = self.t - 1
        s.n = min(self.n, self.t - 1)
        for sender in range(self.m):
            alpha = self.alpha ^ (sender << 8)  # differs in the lower bits of the mantissa
            robot.receive_raw(sender, self._smallest_x_hat + 1000 * sender, alpha)
        has_estimates = s.open.count > 0
        mean_x_hat = s.open.x // s.open.count if has_estimates else ONE
        s.x_hat = mean_x_hat if self.agrees else ONE
        s.alpha = self.alpha
        s.closed = Closed(s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high)
        if self.robust and self.m > 0:
            s.robust.votes = VOTES_MAX
        return robot

    @property
    def _smallest_x_hat(self) -> int:
        """The smallest x_hat of the messages, in units of 2**-23; the others are little larger."""
        if not self.robust:
            return ONE // 3
        return _X_HAT_THAT_AGREES if self.agrees else _X_HAT_THAT_CONTRADICTS


def workloads_along(axis: str) -> Iterator[Workload]:
    """Yield the workloads of one of AXES: t next to powers of two, every m, or every q.

    The attribute of this name is the workload's value on the axis. The other attributes take the values that
    lead to all branches of a call.
    """
    workloads_by_axis = {"t": _workloads_along_t, "m": _workloads_along_m, "q": _workloads_along_q}
    return workloads_by_axis[axis]()


def _workloads_along_t() -> Iterator[Workload]:
    """Yield workloads of every number of observations that is a power of two, or one less, up to 2**31."""
    powers_of_two = [1 << exponent for exponent in range(32)]
    t_values = sorted({t for power in powers_of_two for t in (power - 1, power) if t > 0})
    for t, robust in product(t_values, (False, True)):
        # Both limits, 1/2, which carries no information, and 0.95
        for b_hat in (B_HAT_MIN, 1 << 31, round(0.95 * 2**32), B_HAT_MAX):
            for n in sorted({0, 2 * t // 5, t}):  # no, some and all observations are black
                yield Workload(t=t, n=n, b_hat=b_hat, robust=robust)
        is_legal_memory = t >= MIN_MEMORY and t % 4 == 0
        if is_legal_memory:
            yield Workload(t=t, n=t // 2, halves=True, robust=robust)


def _workloads_along_m() -> Iterator[Workload]:
    """Yield workloads of every number of messages in a round."""
    for m in range(MAX_ROUND_SIZE + 1):
        yield Workload(m=m)
        yield Workload(m=m, agrees=True)
        yield Workload(m=m, alpha=ALPHA_MAX)
        # Half of 1000 observations are black, which the messages may contradict.
        yield Workload(m=m, n=500, agrees=False, robust=True)
        yield Workload(m=m, n=500, agrees=True, robust=True)


def _workloads_along_q() -> Iterator[Workload]:
    """Yield workloads with t-tables of every size q, and rounds of m messages that read their ends.

    A table has an entry for each m from 2 to q, and one for all larger m.
    """
    for q in range(MIN_Q, MAX_Q + 1):
        for m in (2, q, min(q + 1, MAX_ROUND_SIZE)):
            yield Workload(q=q, m=m)


@cache
def _table(q: int) -> Table:
    """Return a table with q entries, to count what their number changes.

    It is the beginning of a larger table, so that its last entry is not that of a right one.
    """
    largest_table = generate(parse_omega("0.05"), MAX_Q)
    return replace(largest_table, entries=largest_table.entries[:q])


def count_operations(firmware: type[MirrorRobot] = MirrorRobot, axes: Collection[str] = AXES) -> Counts:
    """Count the instructions of every call of a robot while t, m or q grows, whichever ``axes`` name.

    Returns the largest number by call, axis and value on the axis. It takes a few seconds for all axes.
    """
    counts: Counts = {
        name + suffix: {axis: {} for axis in axes} for suffix in ("", ", robust") for name in CALLS
    }
    for axis in axes:
        for workload in workloads_along(axis):
            value: int = getattr(workload, axis)
            suffix = ", robust" if workload.robust else ""
            robot = workload.make_robot(firmware)
            for name, call in CALLS.items():
                # Each call is made on a copy, since calls change the robot.
                copied_robot = firmware.__new__(firmware)
                copied_robot.config = robot.config
                copied_robot.s = deepcopy(robot.s)
                count = count_instructions(partial(call, copied_robot))
                count_by_value = counts[name + suffix][axis]
                count_by_value[value] = max(count_by_value.get(value, 0), count)
    return counts


def find_growth(counts: Counts) -> list[str]:
    """Return a line for each call that takes more instructions in the later half of an axis than before.

    Calls that were cut short are among them.
    """
    problems = []
    for name, count_by_axis in counts.items():
        for axis, count_by_value in count_by_axis.items():
            values = sorted(count_by_value)
            # Paths through a call differ in length, wherever on the axis they are taken. So the maxima of
            # both halves of the axis are compared, not single counts.
            middle = len(values) // 2
            early_maximum = max((count_by_value[value] for value in values[:middle]), default=0)
            late_maximum = max((count_by_value[value] for value in values[middle:]), default=0)
            if late_maximum > min(early_maximum, _MAX_INSTRUCTIONS):
                late_range = f"where {axis} is {values[middle]} to {values[-1]}"
                problems.append(
                    f"{name}: {late_maximum} instructions {late_range}, but {early_maximum} below"
                )
    return problems


def measure_storage(firmware: type[MirrorRobot] = MirrorRobot) -> dict[str, dict[int, int]]:
    """Return the bytes of a table by q, and of a saved robot by the messages m in its rounds."""

    def image_sizes(robust: bool) -> dict[int, int]:
        """Return the bytes of saved robots by m, with the robust filter or without it."""
        workloads = (Workload(m=m, robust=robust) for m in range(MAX_ROUND_SIZE + 1))
        return {workload.m: len(workload.make_robot(firmware).save()) for workload in workloads}

    return {
        "tables": {q: 4 * len(_table(q).words()) for q in range(MIN_Q, MAX_Q + 1)},
        "images": image_sizes(robust=False),
        "robust_images": image_sizes(robust=True),
    }
