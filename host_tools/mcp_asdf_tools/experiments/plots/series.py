"""Single trials over time: what each robot assumes and estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import (
    INK,
    MEDIUM,
    SMALL,
    WIDTH,
    add_legend,
    empty_figure,
    style_panel,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import filter_name
from mcp_asdf_tools.experiments.plot_panels import (
    COLOUR_OF_FLAWED_ROBOTS,
    COLOUR_OF_HEALTHY_ROBOTS,
    Results,
    experiments_to_plot,
)
from mcp_asdf_tools.experiments.results import Trials, single_experiment


@dataclass(frozen=True)
class _Quantity:
    """A quantity that is drawn over time.

    Attributes:
        name: Its name in the records.
        label: Its name on the axis.
        true_symbol: Letter of its true value.
        true_parameter: Parameter with its true value.
    """

    name: str
    label: str
    true_symbol: str
    true_parameter: str


_QUANTITIES = (
    _Quantity("b_hat", r"assumed accuracy $\hat{b}$", "b", "true_accuracy"),
    _Quantity("x_hat", r"local estimate $\hat{x}$", "f", "fill_ratio"),
    _Quantity("x", r"informed estimate $x$", "f", "fill_ratio"),
)
_FLAWED_LABEL, _HEALTHY_LABEL, _TRUE_LABEL = "flawed robots", "healthy robots", "true value"
_FLAWED_LINE: dict[str, Any] = {"color": COLOUR_OF_FLAWED_ROBOTS, "label": _FLAWED_LABEL}
_HEALTHY_LINE: dict[str, Any] = {"color": COLOUR_OF_HEALTHY_ROBOTS, "label": _HEALTHY_LABEL}
"""Arguments of ``Axes.plot`` for the lines of robots; a line's label is its text in the legend."""


def plot_series(results: Results, *, trial: int = 0, where: Mapping[str, Any] | None = None) -> Figure:
    """Plot b_hat, x_hat and x of every robot over time in one recorded trial of one experiment.

    Raises UsageError if several experiments are left, there is no such trial, or it was not recorded.
    """
    experiment = single_experiment(experiments_to_plot(results, where))
    return plot_runs([experiment], trial)


def plot_runs(runs: Sequence[Trials], trial_number: int) -> Figure:
    """Plot b_hat, x_hat and x of every robot over time in one trial of each run, as in the paper's figure 6.

    These are the accuracy that a robot assumes, its local estimate and its informed estimate. Runs stand side
    by side, quantities below each other. Raises UsageError if a run has no such trial, or was not recorded
    over time.
    """
    if not all(trials.records for trials in runs):
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    figure = empty_figure(WIDTH, 7.5)
    grid = figure.subplots(len(_QUANTITIES), len(runs), sharex=True, sharey="row", squeeze=False)
    for row, quantity in zip(grid, _QUANTITIES, strict=True):
        _draw_row(row, runs, trial_number, quantity)
    top_row, bottom_row = grid[0], grid[-1]
    top_row[0].set_xlim(0, max(trials.experiment.steps for trials in runs))  # all panels share it
    for axes, trials in zip(top_row, runs, strict=True):
        axes.set_title(_series_title(trials.experiment, trial_number), fontsize=SMALL, loc="left")
    for axes in bottom_row:
        axes.set_xlabel("step", fontsize=MEDIUM)
    add_legend(figure, _lines_for_legend(figure))
    return figure


def _draw_row(row: NDArray[Any], runs: Sequence[Trials], trial_number: int, quantity: _Quantity) -> None:
    """Draw a quantity into a row of panels, one for each run, and set the label and limits of the y axis."""
    for axes, trials in zip(row, runs, strict=True):
        _draw_quantity(axes, trials, trial_number, quantity)
    # The panels of a row share their y axis, so what is set for the leftmost one holds for all.
    row[0].set_ylim(_limits_of_quantity(runs, trial_number, quantity))
    row[0].set_ylabel(quantity.label, fontsize=MEDIUM)


def _lines_for_legend(figure: Figure) -> list[Line2D]:
    """Return a line of each kind that some panel has: of flawed robots, of healthy ones, and the truth.

    The kind of a line is its label. A kind may have no lines: the healthy robots, if all are flawed.
    """
    # Of the many lines with one label, the last one stays in the dictionary.
    line_by_label = {line.get_label(): line for axes in figure.axes for line in axes.lines}
    labels = (_FLAWED_LABEL, _HEALTHY_LABEL, _TRUE_LABEL)
    return [line_by_label[label] for label in labels if label in line_by_label]


def _values_of(trials: Trials, trial_number: int, quantity: _Quantity) -> NDArray[np.float64]:
    """Return the recorded values of a quantity in one trial, shape (samples, robots).

    Raises UsageError if there is no such trial.
    """
    values: NDArray[np.float64] = trials.records[quantity.name][trials.index_of(trial_number)]
    return values


def _limits_of_quantity(
    runs: Sequence[Trials], trial_number: int, quantity: _Quantity
) -> tuple[float, float]:
    """Return the limits of a quantity's axis, with a margin of 6 % of the values' range, 0.01 at least.

    The true value lies within them, and so do all values but those of the first moments, a fiftieth of the
    samples, when estimates still jump between 0 and 1.
    """
    visible_values: list[float] = []
    for trials in runs:
        values = _values_of(trials, trial_number, quantity)
        unsettled_samples = len(values) // 50
        settled_values = values[unsettled_samples:]
        true_value = _true_value(trials.experiment, quantity)
        visible_values += [settled_values.min(), settled_values.max(), true_value]
    low, high = min(visible_values), max(visible_values)
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin


def _true_value(experiment: Experiment, quantity: _Quantity) -> float:
    """Return the value that a quantity estimates."""
    return float(getattr(experiment, quantity.true_parameter))


def _series_title(experiment: Experiment, trial_number: int) -> str:
    """Return a title of two lines for the plot of a trial.

    The first line has the firmware unless it is the usual one, the filter, with its period tau in steps if it
    is on, and the numbers of robots and of flawed robots; the second has topology, seed and trial.
    """
    title = filter_name(experiment)
    if experiment.firmware != "native":
        title = f"{experiment.firmware}, {title}"
    if experiment.swarm_filter.is_on:
        title += rf", $\tau$ = {experiment.filter_period}"
    robot_counts = f"{experiment.robots} robots, {experiment.flawed} flawed"
    topology = experiment.parameters()["topology"]
    return f"{title}: {robot_counts},\n{topology}, seed {experiment.seed}, trial {trial_number}"


def _draw_quantity(axes: Axes, trials: Trials, trial_number: int, quantity: _Quantity) -> None:
    """Draw a line for each robot, the flawed ones on top, and a dashed line with a text at the true value."""
    experiment = trials.experiment
    values = _values_of(trials, trial_number, quantity)
    steps = np.arange(len(values)) * trials.sampling_interval
    draw_style = "steps-post" if quantity.name == "b_hat" else "default"  # b_hat is constant between updates
    # Flawed robots have the lowest ids, and what is drawn last lies on top.
    for robot in reversed(range(experiment.robots)):
        kind = _FLAWED_LINE if experiment.is_flawed(robot) else _HEALTHY_LINE
        axes.plot(steps, values[:, robot], drawstyle=draw_style, linewidth=1.1, alpha=0.75, **kind)
    _draw_true_value(axes, _true_value(experiment, quantity), quantity.true_symbol)
    style_panel(axes)


def _draw_true_value(axes: Axes, true_value: float, symbol: str) -> None:
    """Draw a dashed line at the true value of a quantity, and its symbol and value at the right."""
    axes.axhline(true_value, color=INK, label=_TRUE_LABEL, linewidth=1.2, linestyle="--")
    right_edge = 1  # in this transform x is a share of the panel's width
    transform = axes.get_yaxis_transform()
    text = f" {symbol} = {true_value:g}"
    axes.text(right_edge, true_value, text, transform=transform, va="center", fontsize=SMALL)
