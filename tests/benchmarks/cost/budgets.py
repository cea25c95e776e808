"""Upper limits of the firmware's cost."""

from __future__ import annotations

from dataclasses import dataclass

from .measurement import TICK_CALLS, Figures
from .robots import UPDATED, is_quiet_step


@dataclass(frozen=True)
class Budget:
    """A limit on one figure.

    Attributes:
        target: Where.
        what: "step" (the filter is not due), "receive", "step with test and update" and "x": most
            instructions at -O2, or at -Os with " at -Os" behind the name; "code" and "flash": bytes at -Os
            without and with a table of 127 entries; "RAM" of a robot and "stack" of a tick: bytes at -O2.
        limit: That of the design; on an AVR a tenth above the first core, whose code was 9407 bytes.
    """

    target: str
    what: str
    limit: int


BUDGETS = (
    Budget("Cortex-M4", "step", 130),
    Budget("Cortex-M4", "step at -Os", 150),
    Budget("Cortex-M4", "receive", 52),
    Budget("Cortex-M4", UPDATED, 385),
    Budget("Cortex-M4", "x", 88),
    Budget("Cortex-M4", "code", 1600),
    Budget("Cortex-M4", "flash", 2150),
    Budget("Cortex-M4", "RAM", 152),
    Budget("Cortex-M4", "stack", 96),
    Budget("Cortex-M0+", "step", 400),
    Budget("Cortex-M0+", "receive", 195),
    Budget("Cortex-M0+", UPDATED, 1150),
    Budget("Cortex-M0+", "x", 300),
    Budget("Cortex-M0+", "code", 2350),
    Budget("Cortex-M0+", "RAM", 152),
    Budget("Cortex-M0+", "stack", 160),
    Budget("RV32IMC", "step", 222),
    Budget("RV32IMC", "receive", 72),
    Budget("RV32IMC", UPDATED, 620),
    Budget("RV32IMC", "x", 140),
    Budget("RV32IMC", "code", 2300),
    Budget("RV32IMC", "RAM", 152),
    Budget("RV32IMC", "stack", 112),
    Budget("ATmega328P", "step", 2945),
    Budget("ATmega328P", "receive", 1064),
    Budget("ATmega328P", UPDATED, 10673),
    Budget("ATmega328P", "x", 2367),
    Budget("ATmega328P", "code", 9406),
    Budget("ATmega328P", "stack", 180),
)


def measured(budget: Budget, figures: Figures) -> int:
    """The figure that a budget limits."""
    levels = figures["targets"][budget.target]
    name = budget.what.removesuffix(" at -Os")
    firmware = levels["-O2" if name == budget.what else "-Os"]["firmware"]
    fixed, per_entry = figures["table"]
    code = int(levels["-Os"]["flash"]["least"])
    match name:
        case "code":
            return code
        case "flash":
            return code + int(fixed + 127 * per_entry)
        case "RAM":
            return int(firmware["ram"])
        case "stack":
            return stack_of_tick(firmware)
    return most(firmware["calls"], name)


def most(calls: Figures, name: str, unit: str = "instructions") -> int:
    """Most instructions or cycles of a call; of "step": with any number of messages, the filter not due."""
    names = filter(is_quiet_step, calls) if name == "step" else [name]
    return max(int(calls[each][unit][2]) for each in names)


def stack_of_tick(firmware: Figures) -> int:
    """Bytes of stack that a tick needs: the deepest of its calls."""
    return max(int(firmware["stack"][name][0]) for name in TICK_CALLS)


def grows(points: list[list[int]], slack: float) -> bool:
    """True if the maximum over all t or m exceeds that of the first half by more than a share of it.

    ``points`` are [t or m, least, most] in order.
    """
    most_of_all = [high for _, _, high in points]
    return max(most_of_all) > (1 + slack) * max(most_of_all[: len(points) // 2])


# ---- An AVR against version 0.1.0 ----

AVR = "ATmega328P"
AVR_SLACK = 0.1
"""Share by which a call may cost more than in version 0.1.0."""
_CONVERTING = {"encode": "step, m = 10", "decode": "receive"}
"""Calls that took the conversion of a confidence over from another one: both together are compared."""
AVR_FLASH_BEFORE = {
    "-Os": {"least": 9407, "whole": 14147},
    "-O2": {"least": 10881, "whole": 20311},
}
"""Bytes of flash of version 0.1.0."""

AVR_CYCLES_BEFORE: dict[str, dict[str, list[float]]] = {
    "-Os": {
        "step, m = 0": [1689, 3042.7, 3658],
        "observe": [1032, 2510.4, 3054],
        "settle": [591, 591.0, 591],
        "x": [494, 3471.4, 3575],
        "step, filter due, m < 2": [1726, 3113.2, 3740],
        "settle, filter due": [640, 2219.3, 10790],
        "receive": [563, 1877.6, 1906],
        "step, m = 1": [1748, 2839.4, 3658],
        "step, m = 10": [1737, 3322.9, 3658],
        "step with test and update": [8940, 12199.3, 13832],
        "step with test": [3908, 5444.8, 8276],
        "step, m = 127": [1721, 3240.0, 3658],
        "encode": [349, 349, 349],
        "decode": [327, 327, 327],
    },
    "-O2": {
        "step, m = 0": [1510, 2876.1, 3538],
        "observe": [1013, 2479.9, 3060],
        "settle": [573, 573.0, 573],
        "x": [384, 2865.5, 2959],
        "step, filter due, m < 2": [1784, 3086.0, 3730],
        "settle, filter due": [714, 2281.6, 9900],
        "receive": [362, 1486.6, 1515],
        "step, m = 1": [1526, 2684.7, 3538],
        "step, m = 10": [1570, 3157.0, 3538],
        "step with test and update": [8246, 11256.7, 12789],
        "step with test": [3713, 5401.8, 7651],
        "step, m = 127": [1550, 3081.5, 3538],
        "encode": [350, 350, 350],
        "decode": [176, 176, 176],
    },
}
"""Minimum, mean and maximum of cycles in version 0.1.0, measured as today's are."""


def dearer_on_avr(figures: Figures) -> list[str]:
    """Calls whose minimum, mean or maximum exceeds that of version 0.1.0 by more than AVR_SLACK."""
    found = []
    for level, before in AVR_CYCLES_BEFORE.items():
        calls = figures["targets"][AVR][level]["firmware"]["calls"]
        now = {name: call["cycles"] for name, call in calls.items()}
        for name in before:
            pairs = zip(_converted(now, name), _converted(before, name), strict=True)
            if any(new > (1 + AVR_SLACK) * old for new, old in pairs):
                found.append(f"{name} at {level}: {now[name]} cycles, {before[name]} before")
    return found


def _converted(cycles: dict[str, list[float]], name: str) -> list[float]:
    """A call's cycles, with those of the call that it took work over from."""
    other = cycles[_CONVERTING[name]] if name in _CONVERTING else [0.0] * 3
    return [sum(pair) for pair in zip(cycles[name], other, strict=True)]
