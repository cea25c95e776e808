"""One picture for trials over time: b_hat, x_hat and x of every robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
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
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import filter_name
from mcp_asdf_tools.experiments.results import Trials

_PANELS = (
    ("b_hat", r"assumed accuracy $\hat{b}$", "b", "true_accuracy"),
    ("x_hat", r"local estimate $\hat{x}$", "f", "fill_ratio"),
    ("x", r"informed estimate $x$", "f", "fill_ratio"),
)
"""A quantity and its label; the letter and the parameter of its true value."""
_LABELS = ("flawed robots", "healthy robots", "true value")


def series_beside(runs: Sequence[Trials], number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial of each run, side by side, as in
    the paper's figure 6.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    for trials in runs:
        if number not in trials.numbers:
            there = f"{trials.numbers[0]} .. {trials.numbers[-1]}"
            raise UsageError(f"there is no trial {number}; choose one of {there}")
        if not trials.records:
            raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    figure = empty_figure(WIDTH, 7.5)
    grid = figure.subplots(len(_PANELS), len(runs), sharex=True, sharey="row", squeeze=False)
    for row, panel in zip(grid, _PANELS, strict=True):
        shown = [_draw_panel(axes, trials, number, panel) for axes, trials in zip(row, runs, strict=True)]
        low, high = min(map(np.min, shown)), max(map(np.max, shown))
        margin = max(0.06 * (high - low), 0.01)
        row[0].set_ylim(low - margin, high + margin)
    for trials, column in zip(runs, grid.T, strict=True):
        title = _title(trials.experiment, number)
        column[0].set_title(title, fontsize=SMALL if len(runs) > 1 else MEDIUM, loc="left")
        column[-1].set_xlabel("step", fontsize=MEDIUM)
    for axes, (_, label, *_) in zip(grid[:, 0], _PANELS, strict=True):
        axes.set_ylabel(label, fontsize=MEDIUM)
    grid[0, 0].set_xlim(0, max(line.get_xdata()[-1] for axes in grid[0] for line in axes.lines[:1]))
    lines = {line.get_label(): line for axes in grid[0] for line in axes.lines}
    add_legend(figure, [lines[label] for label in _LABELS if label in lines])
    return figure


def _title(experiment: Experiment, number: int) -> str:
    words = filter_name(experiment)
    if experiment.filter != "none":
        words += rf", $\tau$ = {experiment.filter_period}"
    robots = f"{experiment.robots} robots, {experiment.flawed} flawed"
    topology = experiment.parameters()["topology"]
    return f"{words}: {robots},\n{topology}, seed {experiment.seed}, trial {number}"


def _draw_panel(
    axes: Axes, trials: Trials, number: int, panel: tuple[str, str, str, str]
) -> NDArray[np.float64]:
    """A line for each robot, the flawed ones on top, and the true value; returns all values but those of the
    first moments, when estimates still jump between 0 and 1."""
    (name, _, letter, parameter), experiment = panel, trials.experiment
    values, truth = trials.records[name][trials.numbers.index(number)], getattr(experiment, parameter)
    intervals = len(values) - 1
    steps = np.arange(intervals + 1) * (experiment.steps // intervals)
    style = "steps-post" if name == "b_hat" else "default"  # b_hat stands still between its jumps
    for robot in range(experiment.robots - 1, -1, -1):
        color, label = (FLAWED, _LABELS[0]) if robot < experiment.flawed else (OTHER, _LABELS[1])
        axes.plot(
            steps, values[:, robot], color=color, label=label, linewidth=1.1, alpha=0.75, drawstyle=style
        )
    axes.axhline(truth, color=INK, label=_LABELS[2], linewidth=1.2, linestyle=(0, (5, 3)))
    words, place, offset = f"{letter} = {truth:g}", (1, truth), (3, 0)
    axes.annotate(
        words, place, offset, ("axes fraction", "data"), "offset points", va="center", fontsize=SMALL
    )
    clean(axes)
    return np.append(values[len(values) // 50 :], truth)
