"""Kinds of pictures of results, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mcp_asdf_tools.experiments.plots import Measure

PLOTS = ("boxes", "scatter", "curve", "bands", "series")
"""The last is of one experiment."""


def draw(  # noqa: PLR0913 (each is given by name, and most pictures need none)
    experiments: Sequence[Trials],
    kind: str = PLOTS[0],
    *,
    trial: int = 0,
    x: str = "",
    hue: str = "",
    y: str | Measure = "H",
    facet: str = "",
    ax: Axes | None = None,
    limits: LimitsOf = paper_limits,
) -> Figure:
    """A picture of a kind, as ``mcp_asdf_tools.plot`` describes them. Raises UsageError as that does."""
    from mcp_asdf_tools.experiments import plots  # noqa: PLC0415 (matplotlib loads slowly)

    if not experiments:
        raise UsageError("there is no experiment to draw; give results of one or more")
    if kind != "curve" and (facet or ax is not None):
        raise UsageError(f"facet and ax are for curve, and {kind} has panels of its own; leave them out")
    if kind == "series" and len(experiments) != 1:
        raise UsageError(f"there are {len(experiments)} experiments; series shows one: choose it")
    pictures = {
        "boxes": lambda: plots.boxes(experiments, limits),
        "scatter": lambda: plots.scatter(experiments, limits),
        "curve": lambda: plots.curve(experiments, x, hue, y, limits, facet=facet, ax=ax),
        "bands": lambda: plots.bands(experiments, limits),
        "series": lambda: plots.series_beside(experiments, trial),
    }
    if kind not in pictures:
        raise UsageError(f"kind is {kind!r}; choose one of {', '.join(PLOTS)}")
    return pictures[kind]()
