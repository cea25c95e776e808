"""Pictures of results, by the name of their kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.experiments.results import Trials, experiments_in, matching, only
from mcp_asdf_tools.experiments.scores import PAPERS, Limits

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mcp_asdf_tools.experiments.plots import Measure

PLOTS = ("boxes", "scatter", "curve", "bands", "series")
"""The last is of one experiment."""


@naming_extras()
def plot(  # noqa: PLR0913 (each is given by name, and most pictures need none)
    results: pa.Table | list[Trials],
    kind: str = PLOTS[0],
    *,
    trial: int = 0,
    x: str = "",
    hue: str = "",
    y: str | Measure = "H",
    facet: str = "",
    where: Mapping[str, Any] | None = None,
    ax: Axes | None = None,
    limits: Limits = PAPERS,
) -> Figure:
    """A picture of results; its method ``savefig`` writes a file.

    Kinds: ``boxes`` and ``scatter`` show scores relative to ``limits``; ``curve`` the measure ``y`` (H, h_K,
    h_e, K, e, or a function of ``Trials`` with a number for each trial) over a parameter ``x``, with a curve
    for each value of a parameter ``hue`` and a panel for each of ``facet``, or into the axes ``ax``;
    ``bands`` b_hat of all trials over time; ``series`` a ``trial`` over time, which needs ``record``.
    ``where`` chooses experiments by their parameters. Raises UsageError if the results do not have what it
    shows.
    """
    from mcp_asdf_tools.experiments import plots, series_plot  # noqa: PLC0415 (matplotlib loads slowly)

    experiments = matching(results if isinstance(results, list) else experiments_in(results), where or {})
    if not experiments:
        raise UsageError("there is no experiment to draw; give results of one or more")
    if kind != "curve" and (facet or ax is not None):
        raise UsageError(f"facet and ax are for curve, and {kind} has panels of its own; leave them out")
    pictures = {
        "boxes": lambda: plots.boxes(experiments, limits),
        "scatter": lambda: plots.scatter(experiments, limits),
        "curve": lambda: plots.curve(experiments, x, hue, y, limits, facet=facet, ax=ax),
        "bands": lambda: plots.bands(experiments, limits),
        "series": lambda: series_plot.series_beside([only(experiments)], trial),
    }
    if kind not in pictures:
        raise UsageError(f"kind is {kind!r}; choose one of {', '.join(PLOTS)}")
    return pictures[kind]()
