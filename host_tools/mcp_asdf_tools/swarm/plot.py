"""Plot of a swarm's run: b_hat, x_hat and x of every robot over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common import plain_value
from mcp_asdf_tools.robots import Filtering
from mcp_asdf_tools.swarm.run import SwarmRun
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.world import Graph

# Colours that stay apart for the colour-blind.
_FLAWED, _OTHER, _ALL, _TRUTH = "#d55e00", "#0072b2", "#8a4f7d", "#222222"

_PANELS = (
    ("b_hat", r"assumed accuracy $\hat{b}$", "b"),
    ("x_hat", r"local estimate $\hat{x}$", "f"),
    ("x", r"informed estimate $x$", "f"),
)


def draw(run: SwarmRun) -> Figure:
    """Return a figure of three panels that share the time axis."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (quantity, label, name) in zip(figure.subplots(3, 1, sharex=True), _PANELS, strict=True):
        truth = run.settings.fill_ratio if name == "f" else run.settings.true_accuracy
        _draw_lines(axes, run, quantity)
        _finish(axes, label, name, truth, run.history.values(quantity))
    top, *_, bottom = figure.axes
    bottom.set_xlabel("step")
    bottom.set_xlim(0, max(1, int(run.history.ticks[-1])))
    top.set_title(_title(run), loc="left", fontsize=11)
    figure.legend(handles=_legend(run), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_lines(axes: Axes, run: SwarmRun, quantity: str) -> None:
    """Draw one line per robot, the flawed ones on top, in a colour of its own if all are equal."""
    ticks, values = run.history.ticks, run.history.values(quantity)
    are_equal = _are_equal(values)
    for node in sorted(run.nodes, key=lambda each: run.settings.is_flawed(each.id)):
        own_color = _FLAWED if run.settings.is_flawed(node.id) else _OTHER
        axes.plot(
            ticks,
            values[:, node.id],
            color=_ALL if are_equal else own_color,
            linewidth=1.2,
            alpha=0.75,
            # b_hat jumps at updates and stands still between them.
            drawstyle="steps-post" if quantity == "b_hat" else "default",
        )


def _finish(axes: Axes, label: str, name: str, truth: float, values: NDArray[np.float64]) -> None:
    """Mark the true value and set the axes up."""
    axes.axhline(truth, color=_TRUTH, linewidth=1.2, linestyle=(0, (5, 3)))
    axes.annotate(
        f"{name} = {truth:g}",
        (1, truth),
        xycoords=("axes fraction", "data"),
        xytext=(5, 0),
        textcoords="offset points",
        va="center",
    )
    axes.set_ylabel(label)
    axes.set_ylim(*_limits(values, truth))
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _are_equal(values: NDArray[np.float64]) -> bool:
    """True if there are several robots and their lines are one and the same."""
    return values.shape[1] > 1 and bool((values == values[:, :1]).all())


def _limits(values: NDArray[np.float64], truth: float) -> tuple[float, float]:
    """Room for all but the first moments, when estimates still jump between 0 and 1."""
    settled = values[len(values) // 50 :]
    low, high = min(truth, settled.min()), max(truth, settled.max())
    margin = max(0.05 * (high - low), 0.01)
    return low - margin, high + margin


def _title(run: SwarmRun) -> str:
    settings = run.settings
    deployment = {Filtering.ASDF_PLUS: "ASDF+", Filtering.ASDF_MINUS: "ASDF-", Filtering.NONE: "no filter"}
    return (
        f"{settings.robots} robots, {settings.flawed} flawed, {deployment[settings.filter]}, "
        rf"$\tau$ = {settings.filter_period}, {_topology(settings)}, seed {settings.seed}"
    )


def _topology(settings: SwarmSettings) -> str:
    if isinstance(settings.graph, Graph):
        return Path(settings.graph.source).name
    if settings.is_dynamic:
        return f"moving, D = {settings.density:g}"
    return str(plain_value(settings.topology)).replace("-", " ")


def _legend(run: SwarmRun) -> list[Line2D]:
    flawed = {run.settings.is_flawed(node.id) for node in run.nodes}
    lines = [Line2D([], [], color=_TRUTH, linestyle="--", label="true value")]
    if False in flawed:
        lines.insert(0, Line2D([], [], color=_OTHER, label="other robots"))
    if True in flawed:
        lines.insert(0, Line2D([], [], color=_FLAWED, label="flawed robots"))
    if any(_are_equal(run.history.values(quantity)) for quantity, _, _ in _PANELS):
        lines.insert(-1, Line2D([], [], color=_ALL, label="all robots, the same"))
    return lines
