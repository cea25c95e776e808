"""The robot's firmware in Python, three ways behind one interface.

``ReferenceRobot`` follows the paper's equations in float64, ``MirrorRobot`` is the C in plain integers, bit
for bit, and ``NativeRobot`` is the C itself. See ``firmware_py.robot`` for the interface.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from firmware_py.mirror import MirrorRobot
from firmware_py.reference import AUTHORS, PAPER, Conventions, ReferenceRobot
from firmware_py.robot import (
    Config,
    Counters,
    Filter,
    FirmwareError,
    FixedPointRobot,
    Observation,
    Robot,
    Status,
    Sums,
)
from firmware_py.table import Table, TableError

if TYPE_CHECKING:
    from firmware_py.native import NativeRobot

__all__ = [
    "AUTHORS",
    "PAPER",
    "Config",
    "Conventions",
    "Counters",
    "Filter",
    "FirmwareError",
    "FixedPointRobot",
    "MirrorRobot",
    "NativeRobot",
    "Observation",
    "ReferenceRobot",
    "Robot",
    "Status",
    "Sums",
    "Table",
    "TableError",
]


def __getattr__(name: str) -> type[NativeRobot]:
    """Load the compiled firmware when it is asked for: the other two also work where it is not built."""
    if name != "NativeRobot":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from firmware_py.native import NativeRobot  # noqa: PLC0415

    return NativeRobot
