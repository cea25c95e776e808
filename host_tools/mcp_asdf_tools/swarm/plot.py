"""Plot of a swarm's run: b_hat, x_hat and x of every robot over time."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mcp_asdf_tools.robots.population import FILTER_NAMES
from mcp_asdf_tools.robots.series_plot import TimeSeries, draw_time_series
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import QUANTITIES, SwarmRun
from mcp_asdf_tools.world.topology import Graph

_LETTERS = 100
"""Of a title's line."""


def draw(run: SwarmRun) -> Figure:
    """Return a figure of three panels that share the time axis."""
    settings = run.settings
    series = TimeSeries(
        title=_title(settings),
        steps=np.asarray(run.history.ticks, np.float64),
        values={name: run.history.values(name) for name in QUANTITIES},
        flawed=settings.flawed,
        truths={"b": settings.true_accuracy, "f": settings.fill_ratio},
    )
    return draw_time_series([series])


def _title(settings: SwarmSettings) -> str:
    """Parameters and faults in words."""
    flawed = f"{settings.flawed} flawed"
    if settings.flawed:
        flawed += rf" with $\hat{{b}}$ = {settings.flawed_accuracy:g}"
    words = f"{settings.robots} robots, {flawed}, {FILTER_NAMES[settings.filter]}"
    if settings.filter != "none":
        words += rf", $\tau$ = {settings.filter_period}"
    words += f", {_topology(settings)}, seed {settings.seed}"
    if settings.faults:
        words += "\n" + textwrap.fill(f"faults: {'; '.join(map(str, settings.faults))}", _LETTERS)
    return words


def _topology(settings: SwarmSettings) -> str:
    if isinstance(settings.graph, Graph):
        return Path(settings.graph.source).name
    if settings.is_dynamic:
        return f"moving, D = {settings.density:g}"
    return str(settings.topology).replace("-", " ")
