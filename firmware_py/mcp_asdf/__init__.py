"""The robot's firmware in Python, three ways behind one interface.

``ReferenceRobot`` follows the paper's equations in float64, ``MirrorRobot`` is the C in plain integers, bit
for bit, and ``NativeRobot`` is the C itself. See ``mcp_asdf.robot`` for the interface.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mcp_asdf.mirror import MirrorRobot
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
    from mcp_asdf.reference import AUTHORS, PAPER, Conventions, ReferenceRobot

_MODULES = {
    "NativeRobot": "native",
    "AUTHORS": "reference",
    "PAPER": "reference",
    "Conventions": "reference",
    "ReferenceRobot": "reference",
}

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
    """Load the compiled firmware and SciPy's functions on demand: the rest works without them."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"mcp_asdf.{_MODULES[name]}"), name)
