"""What the firmware may cost at most: what the design asks for, and what was agreed where that is not met."""

from __future__ import annotations

from dataclasses import dataclass

from .measurement import TICK_CALLS, Figures
from .robots import SHORT, UPDATED, is_quiet_step

STEP_AND_X = "step and x"
"""A quiet step after which x is read."""


@dataclass(frozen=True)
class Budget:
    """A limit on one figure.

    Attributes:
        target: Where.
        what: Of "step" (the filter is not due), "step and x", "receive", the steps with the filter
            due (most instructions at -O2), "flash" (bytes at -Os with a table of 127 entries), "RAM" of a
            robot and "stack" of a tick (bytes at -O2).
        asked: The design's limit. Its step tests only where an update is named, and always forms x.
        agreed: The limit that is tested; docs/decisions.md says why it is another one.
    """

    target: str
    what: str
    asked: int
    agreed: int


BUDGETS = (
    Budget("Cortex-M4", "step", 150, 150),
    Budget("Cortex-M4", STEP_AND_X, 150, 250),
    Budget("Cortex-M4", SHORT, 150, 180),
    Budget("Cortex-M4", "receive", 60, 60),
    Budget("Cortex-M4", UPDATED, 450, 450),
    Budget("Cortex-M0+", "step", 360, 360),
    Budget("Cortex-M0+", STEP_AND_X, 360, 650),
    Budget("Cortex-M0+", SHORT, 360, 400),
    Budget("Cortex-M0+", "receive", 180, 180),
    Budget("Cortex-M0+", UPDATED, 1200, 1200),
    Budget("RV32IMC", "step", 224, 224),
    Budget("RV32IMC", STEP_AND_X, 224, 400),
    Budget("RV32IMC", SHORT, 224, 280),
    Budget("RV32IMC", "receive", 75, 75),
    Budget("RV32IMC", UPDATED, 700, 700),
    Budget("Cortex-M4", "flash", 1843, 2700),
    Budget("Cortex-M4", "RAM", 176, 176),
    Budget("Cortex-M4", "stack", 100, 100),
)


def measured(budget: Budget, figures: Figures) -> int:
    """The figure that a budget limits."""
    levels = figures["targets"][budget.target]
    if budget.what == "flash":
        fixed, per_entry = figures["table"]
        return int(levels["-Os"]["flash"]["least"] + fixed + 127 * per_entry)
    firmware = levels["-O2"]["firmware"]
    if budget.what == "RAM":
        return int(firmware["ram"])
    if budget.what == "stack":
        return stack_of_tick(firmware)
    return most(firmware["calls"], budget.what)


def most(calls: Figures, name: str, unit: str = "instructions") -> int:
    """Most instructions or cycles of a call; of "step": with any number of messages, the filter not due."""
    if name == STEP_AND_X:
        return most(calls, "step", unit) + most(calls, "x", unit)
    names = filter(is_quiet_step, calls) if name == "step" else [name]
    return max(int(calls[each][unit][2]) for each in names)


def stack_of_tick(firmware: Figures) -> int:
    """Bytes of stack that a tick needs: the deepest of its calls."""
    return max(int(firmware["stack"][name][0]) for name in TICK_CALLS)


def grows(points: list[list[int]], slack: float) -> bool:
    """Whether the most at any t or m is above the most of the first half by more than a share of it.

    ``points`` are [t or m, least, most] in order.
    """
    most_of_all = [high for _, _, high in points]
    return max(most_of_all) > (1 + slack) * max(most_of_all[: len(points) // 2])
