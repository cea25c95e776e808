"""One picture for trials over time: b_hat, x_hat and x of every robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
_LABELS = ("flawed robots", "healthy robots", "true value")


@dataclass(frozen=True)
class TimeSeries:
    """A trial over time.

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
    grid[0, 0].set_xlim(0, max(1.0, *(float(run.steps[-1]) for run in runs)))
    lines = {line.get_label(): line for axes in grid[0] for line in axes.lines}
    add_legend(figure, [lines[label] for label in _LABELS if label in lines])
    return figure


def _draw_panel(axes: Axes, run: TimeSeries, name: str, truth: float, letter: str) -> None:
    """A line for each robot, the flawed ones on top, and the true value."""
    values = run.values[name]
    style = "steps-post" if name == "b_hat" else "default"  # b_hat stands still between its jumps
    for robot in range(values.shape[1] - 1, -1, -1):
        color, label = (FLAWED, _LABELS[0]) if robot < run.flawed else (OTHER, _LABELS[1])
        axes.plot(
            run.steps,
            values[:, robot],
            color=color,
            label=label,
            linewidth=1.1,
            alpha=0.75,
            drawstyle=style,
        )
    axes.axhline(truth, color=INK, label=_LABELS[2], linewidth=1.2, linestyle=(0, (5, 3)))
    place, offset = (1, truth), (3, 0)
    words = f"{letter} = {truth:g}"
    axes.annotate(
        words, place, offset, ("axes fraction", "data"), "offset points", va="center", fontsize=SMALL
    )
    clean(axes)


def _limits(shown: Sequence[tuple[NDArray[np.float64], float]]) -> tuple[float, float]:
    """Room for all but the first moments, when estimates still jump between 0 and 1."""
    settled = [values[len(values) // 50 :] for values, _ in shown]
    low = min(*(float(each.min()) for each in settled), *(truth for _, truth in shown))
    high = max(*(float(each.max()) for each in settled), *(truth for _, truth in shown))
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin
