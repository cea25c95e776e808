"""Count the instructions of every call in Python's interpreter, to check that time is O(1) and memory O(q).

The mirror's own code runs, and every bytecode instruction is counted, so every loop shows. Calls are counted
over t, over the number m of messages in a round and over the table's q, with both outcomes of every decision.
Each instruction takes a bounded time, as the mirror's integers are those of the C. The robust filter has
loops, but over its 32 slots at most: its cost must not grow beyond 32 messages.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Collection, Iterator
from copy import copy
from functools import partial
from itertools import product
from types import FrameType
from typing import Any

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, ONE
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import MAX_ROUND_SIZE, MIN_MEMORY, Observation
from mcp_asdf.table import MAX_Q, MIN_Q
from mcp_asdf_tools.crosscheck.checked_filters import CHECKED_FILTERS, checked_filter_of
from mcp_asdf_tools.crosscheck.crafted_rounds import ALPHA_ONE
from mcp_asdf_tools.crosscheck.workloads import OWN_ID, Workload, table_of_size

_ID_IN_ROUND = 0
_ID_NOT_IN_ROUND = 126

AXES = ("t", "m", "q")
CALLS: dict[str, Callable[[MirrorRobot], object]] = {
    "observe": lambda robot: robot.observe(Observation.BLACK),
    "receive": lambda robot: robot.receive_raw(_ID_NOT_IN_ROUND, ONE // 3, ALPHA_ONE),
    "receive again": lambda robot: robot.receive_raw(_ID_IN_ROUND, ONE // 3, ALPHA_ONE),
    "receive own": lambda robot: robot.receive_raw(OWN_ID, ONE // 3, ALPHA_ONE),
    "settle": lambda robot: robot.settle(),
    "step": lambda robot: robot.step(Observation.WHITE),
    "x": lambda robot: robot.x_raw,
}

Counts = dict[str, dict[str, dict[int, int]]]
"""Largest number of instructions by call, axis and value on the axis. Calls of robots with another filter
than the paper's are apart, as "settle, robust"; they have no values for q."""

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
        if event == "opcode":
            count += 1
            if count > _MAX_INSTRUCTIONS:
                raise _CutShortError
        elif event == "call":
            # Python 3.13 sends events of instructions only if the frame has its trace function when it asks.
            frame.f_trace = trace
            frame.f_trace_opcodes = True  # asks for an event at every instruction of this function
            frame.f_trace_lines = False  # asks for no events at its lines
            if count == 0:
                # Python 3.12 sends them only after settrace is called while a frame already asks for them.
                sys.settrace(trace)
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


def workloads_along(axis: str) -> Iterator[Workload]:
    """Yield the workloads of one of AXES: t next to powers of two, every m, or every q.

    The attribute of this name is the workload's value on the axis. The other attributes take the values that
    lead to all branches of a call.
    """
    workloads_by_axis = {"t": _workloads_along_t, "m": _workloads_along_m, "q": _workloads_along_q}
    return workloads_by_axis[axis]()


def _workloads_along_t() -> Iterator[Workload]:
    """Yield workloads of every number of observations that is a power of two, or one less, up to 2**31.

    There are workloads of each filter. They have several b_hat and numbers of black observations. Where a
    robot's memory may have the size of t, one more workload has that memory, which then halves t and n.
    """
    powers_of_two = {1 << exponent for exponent in range(32)}
    numbers_below = {power - 1 for power in powers_of_two}
    t_values = sorted((powers_of_two | numbers_below) - {0})
    for t, checked_filter in product(t_values, CHECKED_FILTERS):
        # Both limits, 1/2, which carries no information, and 0.95
        for b_hat in (B_HAT_MIN, 1 << 31, round(0.95 * 2**32), B_HAT_MAX):
            # No, some and all observations are black. Where t is small, two of these numbers may be equal.
            for n in sorted({0, 2 * t // 5, t}):
                yield checked_filter.workload(t=t, n=n, b_hat=b_hat)
        is_legal_memory = t >= MIN_MEMORY and t % 4 == 0
        if is_legal_memory:
            yield checked_filter.workload(t=t, n=t // 2, halves=True)


def _workloads_along_m() -> Iterator[Workload]:
    """Yield workloads of each filter, in each of its situations, with every number of messages in a round.

    A situation is a dictionary of the other attributes of a workload.
    """
    for m in range(MAX_ROUND_SIZE + 1):
        for checked_filter in CHECKED_FILTERS:
            for other_attributes in checked_filter.workload.situations:
                yield checked_filter.workload(m=m, **other_attributes)


def _workloads_along_q() -> Iterator[Workload]:
    """Yield workloads with t-tables of every size q, and rounds of m messages for three entries of each.

    A table has an entry for each m from 2 to q, and one for all larger m. The rounds use the entry for 2, the
    entry for q, and the entry for all larger m.
    """
    for q in range(MIN_Q, MAX_Q + 1):
        m_above_q = min(q + 1, MAX_ROUND_SIZE)  # No round has more messages than the largest q.
        for m in (2, q, m_above_q):
            yield Workload(q=q, m=m)


def count_operations(firmware: type[MirrorRobot] = MirrorRobot, axes: Collection[str] = AXES) -> Counts:
    """Count the instructions of every call of a robot while t, m or q grows: those that are in ``axes``.

    Returns the largest number by call, axis and value on the axis. It takes a few seconds for all axes.
    """
    counts: Counts = {}
    for checked_filter in CHECKED_FILTERS:
        for call_name in CALLS:
            counts[checked_filter.label(call_name)] = {axis: {} for axis in axes}
    for axis in axes:
        for workload in workloads_along(axis):
            value_on_axis: int = getattr(workload, axis)
            for label, count in _count_calls(workload, firmware).items():
                count_by_value = counts[label][axis]
                # Of several workloads with the same value the costliest counts.
                count_by_value[value_on_axis] = max(count, count_by_value.get(value_on_axis, 0))
    return counts


def _count_calls(workload: Workload, firmware: type[MirrorRobot]) -> dict[str, int]:
    """Return how many instructions each of CALLS takes on the workload's robot, by the label of the call.

    Labels, such as "settle", are those of `CheckedFilter.label`. All calls begin in the same state.
    """
    checked_filter = checked_filter_of(workload.filter)
    robot = workload.make_robot(firmware)
    counts = {}
    for call_name, call in CALLS.items():
        action = partial(call, _copy_robot(robot))
        counts[checked_filter.label(call_name)] = count_instructions(action)
    return counts


def _copy_robot(robot: MirrorRobot) -> MirrorRobot:
    """Return a robot of the same configuration with a copy of the state, so that a call may change it."""
    robot_copy = copy(robot)
    # Members of the state are numbers or hold nothing but numbers, so that each is copied by itself: a deep
    # copy takes most of the time of the whole count.
    robot_copy.s = copy(robot.s)
    for name, member in vars(robot.s).items():
        setattr(robot_copy.s, name, copy(member))
    return robot_copy


def find_growth(counts: Counts) -> list[str]:
    """Find the calls that take more instructions in an axis's upper half than in its lower half.

    Returns one line per such call and axis. A call that was cut short in the upper half is among them. An
    axis without counts is left out.
    """
    problems = []
    for call_name, count_by_axis in counts.items():
        for axis, count_by_value in count_by_axis.items():
            if count_by_value:
                problems += [f"{call_name}: {growth}" for growth in _growth_along(axis, count_by_value)]
    return problems


def _growth_along(axis: str, count_by_value: dict[int, int]) -> list[str]:
    """Return a list of one text if the counts of a call are larger in the axis's upper half.

    If they are not, the list is empty. ``count_by_value`` must have at least one count.
    """
    # Paths through a call differ in length, wherever on the axis they are taken. So the maxima of both halves
    # of the axis are compared, not single counts.
    values = sorted(count_by_value)
    middle = len(values) // 2
    lower_maximum = max((count_by_value[value] for value in values[:middle]), default=0)
    upper_maximum = max(count_by_value[value] for value in values[middle:])
    # A call that was cut short has a count above the limit, even if lower ones were cut short, too.
    if upper_maximum <= min(lower_maximum, _MAX_INSTRUCTIONS):
        return []
    upper_half = f"where {axis} is {values[middle]} to {values[-1]}"
    return [f"{upper_maximum} instructions {upper_half}, but {lower_maximum} below"]


def measure_storage(firmware: type[MirrorRobot] = MirrorRobot) -> dict[str, dict[int, int]]:
    """Return the bytes of tables by number of entries, and of saved robots by number of messages.

    The sizes of tables are under "tables", those of robots with one of the paper's filters under "images",
    and those of robots with the robust filter under "robust_images". The open round has that many messages,
    and so has the last closed round.
    """
    table_sizes = {}
    for q in range(MIN_Q, MAX_Q + 1):
        table_sizes[q] = 4 * len(table_of_size(q).words())  # words of 4 bytes
    storage = {"tables": table_sizes}
    for checked_filter in CHECKED_FILTERS:
        storage[checked_filter.images_key] = _image_sizes(checked_filter.workload, firmware)
    return storage


def _image_sizes(workload_class: type[Workload], firmware: type[MirrorRobot]) -> dict[int, int]:
    """Return how many bytes a saved robot of these workloads has, by its number of messages (0 to 127)."""
    image_sizes = {}
    for m in range(MAX_ROUND_SIZE + 1):
        robot = workload_class(m=m).make_robot(firmware)
        image_sizes[m] = len(robot.save())
    return image_sizes
