"""Pictures of results: a module for each kind, whose function has its name, such as ``boxes.plot_boxes``.

``mcp-asdf plot`` and the library offer all modules of this folder. The first parameter of a function is the
results, a table or experiments from ``experiments_in``; the command has options for the others.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.extras import naming_extras

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = tuple(sorted(module.name for module in iter_modules(__path__)))
"""The kinds of pictures, which are the names of the modules."""


@naming_extras()
def load_plot(kind: str) -> Callable[..., Figure]:
    """Import and return the function that draws pictures of a kind, one of KINDS.

    Raises UsageError, with the fix, if matplotlib is not installed.
    """
    module_name = f"{__name__}.{kind}"
    # The decorator turns the ImportError of a missing matplotlib into that UsageError.
    module = import_module(module_name)
    plot: Callable[..., Figure] = getattr(module, f"plot_{kind}")
    return plot
