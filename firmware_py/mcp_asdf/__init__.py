"""The robot's firmware in Python: three implementations of one interface.

``ReferenceRobot`` computes the paper's equations in float64, ``MirrorRobot`` the same bits as the C in Python
integers, and ``NativeRobot`` runs the C itself. ``mcp_asdf.robot`` has the interface.
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
    """Import ``NativeRobot`` at its first use, so that the rest works where the C has not been compiled."""
    if name == "NativeRobot":
        from mcp_asdf.native import NativeRobot  # noqa: PLC0415

        return NativeRobot
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
