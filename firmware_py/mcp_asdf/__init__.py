"""The robot's firmware in Python: three implementations of one interface.

``ReferenceRobot`` computes the paper's equations in float64, ``MirrorRobot`` the same bits as the C in Python
integers, and ``NativeRobot`` runs the C itself. ``mcp_asdf.robot`` has the interface.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    from mcp_asdf.mirror import MirrorRobot
    from mcp_asdf.native import NativeRobot
    from mcp_asdf.reference import AUTHORS, PAPER, Conventions, ReferenceRobot

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

_MODULE_OF_NAME = {
    "MirrorRobot": "mirror",
    "NativeRobot": "native",
    "AUTHORS": "reference",
    "PAPER": "reference",
    "Conventions": "reference",
    "ReferenceRobot": "reference",
}
"""Modules of the names that are imported at their first use."""


def __getattr__(name: str) -> Any:
    """Import an implementation, or what belongs to it, at its first use.

    So a program loads only the firmware that it runs, and the others work where the C has not been compiled.
    """
    if name in _MODULE_OF_NAME:
        return getattr(import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
