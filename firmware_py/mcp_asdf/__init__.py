"""The robot's firmware in Python, three ways behind one interface.

``ReferenceRobot`` follows the paper's equations in float64, ``MirrorRobot`` is the C in plain integers, bit
for bit, and ``NativeRobot`` is the C itself. See ``mcp_asdf.robot`` for the interface.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.reference import AUTHORS, PAPER, Conventions, ReferenceRobot
from mcp_asdf.robot import (
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
from mcp_asdf.table import Table, TableError

if TYPE_CHECKING:
    from mcp_asdf.native import NativeRobot

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


def __getattr__(name: str) -> Any:
    """Load the compiled firmware on demand: the rest works where it has not been built."""
    if name == "NativeRobot":
        from mcp_asdf.native import NativeRobot  # noqa: PLC0415

        return NativeRobot
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
