"""Tools around the firmware ``mcp_asdf``: experiments, swarms on a CAN bus, scores and plots.

docs/library.md has an example of each name. A name is imported when it is first used, so that the command
line, whose modules stand in this package, too, loads only what a command needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.common.extras import naming_extras

if TYPE_CHECKING:
    from mcp_asdf_tools.common.errors import UsageError
    from mcp_asdf_tools.experiments.experiment import Experiment, grid
    from mcp_asdf_tools.experiments.experiment_files import read_experiments
    from mcp_asdf_tools.experiments.result_files import read_table
    from mcp_asdf_tools.experiments.result_tables import experiments_in
    from mcp_asdf_tools.library import (
        emulate,
        plot_bands,
        plot_boxes,
        plot_curve,
        plot_scatter,
        plot_series,
        score,
        simulate,
        start_swarm,
    )
    from mcp_asdf_tools.swarm.settings import SwarmSettings
    from mcp_asdf_tools.view.inline import show

_HOMES = {
    "common.errors": ["UsageError"],
    "experiments.experiment": ["Experiment", "grid"],
    "experiments.experiment_files": ["read_experiments"],
    "experiments.result_files": ["read_table"],
    "experiments.result_tables": ["experiments_in"],
    "library": [
        "emulate",
        "plot_bands",
        "plot_boxes",
        "plot_curve",
        "plot_scatter",
        "plot_series",
        "score",
        "simulate",
        "start_swarm",
    ],
    "swarm.settings": ["SwarmSettings"],
    "view.inline": ["show"],
}
__all__ = [
    "Experiment",
    "SwarmSettings",
    "UsageError",
    "emulate",
    "experiments_in",
    "grid",
    "plot_bands",
    "plot_boxes",
    "plot_curve",
    "plot_scatter",
    "plot_series",
    "read_experiments",
    "read_table",
    "score",
    "show",
    "simulate",
    "start_swarm",
]


def __getattr__(name: str) -> Any:
    """Import a name when it is first used. Raises UsageError, with the fix, if a library is missing."""
    for module, names in _HOMES.items():
        if name in names:
            with naming_extras():
                return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")
