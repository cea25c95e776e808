"""One picture for runs over time: b_hat, x_hat and x of every robot, of a swarm on a bus or of a trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.figures import (
    FLAWED,
    INK,
    MEDIUM,
    OTHER,
    SMALL,
    WIDTH,
    add_legend,
    clean,
    empty_figure,
)

_PANELS = (
    ("b_hat", r"assumed accuracy $\hat{b}$", "b"),
    ("x_hat", r"local estimate $\hat{x}$", "f"),
    ("x", r"informed estimate $x$", "f"),
)
_BEYOND = 0.02
"""Share of the time axis behind the last step, which shows what the last filter step changed."""


@dataclass(frozen=True)
class TimeSeries:
    """A run over time.

    Attributes:
        title: What is run.
        steps: Of the samples.
        values: ``b_hat``, ``x_hat`` and ``x``, each of shape (samples, robots).
        flawed: How many of the first robots are flawed.
        truths: True values ``b`` and ``f``.
    """

    title: str
    steps: NDArray[np.float64]
    values: Mapping[str, NDArray[np.float64]]
    flawed: int
    truths: Mapping[str, float]


def draw_time_series(runs: Sequence[TimeSeries]) -> Figure:
    """Runs side by side, at least one: three panels each, with the same axes."""
    figure = empty_figure(WIDTH, 7.5)
    grid = figure.subplots(len(_PANELS), len(runs), sharex=True, sharey="row", squeeze=False)
    for column, run in zip(grid.T, runs, strict=True):
        for axes, (name, _, truth) in zip(column, _PANELS, strict=True):
            _draw_panel(axes, run, name, run.truths[truth], truth)
        column[0].set_title(run.title, fontsize=SMALL if len(runs) > 1 else MEDIUM, loc="left")
        column[-1].set_xlabel("step", fontsize=MEDIUM)
    for row, (name, label, truth) in zip(grid, _PANELS, strict=True):
        row[0].set_ylabel(label, fontsize=MEDIUM)
        row[0].set_ylim(*_limits([(run.values[name], run.truths[truth]) for run in runs]))
    last = max(1.0, *(float(run.steps[-1]) for run in runs))
    grid[0, 0].set_xlim(0, (1 + _BEYOND) * last)
    add_legend(figure, _legend_of(runs))
    return figure


def _draw_panel(axes: Axes, run: TimeSeries, name: str, truth: float, letter: str) -> None:
    """A line for each robot, the flawed ones on top, and the true value."""
    values = run.values[name]
    for robot in range(values.shape[1] - 1, -1, -1):
        axes.plot(
            *_line(run.steps, values[:, robot], name),
            color=FLAWED if robot < run.flawed else OTHER,
            linewidth=1.1,
            alpha=0.75,
            drawstyle="steps-post" if name == "b_hat" else "default",
        )
    axes.axhline(truth, color=INK, linewidth=1.2, linestyle=(0, (5, 3)))
    place, offset = (1, truth), (3, 0)
    words = f"{letter} = {truth:g}"
    axes.annotate(
        words, place, offset, ("axes fraction", "data"), "offset points", va="center", fontsize=SMALL
    )
    clean(axes)


def _line(
    steps: NDArray[np.float64], values: NDArray[np.float64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """b_hat stands still between its jumps, so that the last one is followed by what it led to."""
    if name != "b_hat":
        return steps, values
    return np.append(steps, (1 + _BEYOND) * steps[-1]), np.append(values, values[-1])


def _limits(shown: Sequence[tuple[NDArray[np.float64], float]]) -> tuple[float, float]:
    """Room for all but the first moments, when estimates still jump between 0 and 1."""
    settled = [values[len(values) // 50 :] for values, _ in shown]
    low = min(*(float(each.min()) for each in settled), *(truth for _, truth in shown))
    high = max(*(float(each.max()) for each in settled), *(truth for _, truth in shown))
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin


def _legend_of(runs: Sequence[TimeSeries]) -> list[Line2D]:
    robots = {run.values["x"].shape[1] - run.flawed > 0 for run in runs}
    lines = []
    if any(run.flawed for run in runs):
        lines.append(Line2D([], [], color=FLAWED, label="flawed robots"))
    if True in robots:
        lines.append(Line2D([], [], color=OTHER, label="healthy robots"))
    return [*lines, Line2D([], [], color=INK, linestyle="--", label="true value")]
