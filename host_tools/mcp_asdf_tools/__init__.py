"""Tools around the firmware ``mcp_asdf``: experiments, swarms on a CAN bus, scores and plots.

The names of this package are those of ``mcp_asdf_tools.library``, and ``show``; docs/api.md has an
example of each. They are imported when one is first used, so that the command line, whose modules stand in
this package, too, loads only what a command needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for type checkers and editors, which do not call ``__getattr__``
    # A picture that is not named here can be drawn, too; only its parameters are not known to editors.
    from mcp_asdf_tools.experiments.plots.bands import plot_bands as plot_bands
    from mcp_asdf_tools.experiments.plots.boxes import plot_boxes as plot_boxes
    from mcp_asdf_tools.experiments.plots.curve import plot_curve as plot_curve
    from mcp_asdf_tools.experiments.plots.scatter import plot_scatter as plot_scatter
    from mcp_asdf_tools.experiments.plots.series import plot_series as plot_series
    from mcp_asdf_tools.library import *  # noqa: F403
    from mcp_asdf_tools.view.notebook_page import show as show


def __getattr__(name: str) -> Any:
    """Return a public name of the package, or the list of them as ``__all__``."""
    library = import_module(f"{__name__}.library")
    public_names = [*library.__all__, "show"]
    if name == "__all__":
        return public_names
    if name not in public_names:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    if name == "show":  # the library may not import the package ``view``, which is built on it
        return getattr(import_module(f"{__name__}.view.notebook_page"), name)
    return getattr(library, name)
