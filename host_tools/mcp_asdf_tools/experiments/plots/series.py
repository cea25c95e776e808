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
    COLOUR_OF_FLAWED_ROBOTS,
    COLOUR_OF_HEALTHY_ROBOTS,
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
from mcp_asdf_tools.experiments.plot_panels import Results, experiments_to_plot
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
    last_step = max(trials.experiment.steps for trials in runs)
    for row, quantity in zip(grid, _QUANTITIES, strict=True):
        for axes, trials in zip(row, runs, strict=True):
            _draw_quantity(axes, trials, trial_number, quantity)
        # The panels of a row share their axes, so what is set for the leftmost one holds for all.
        leftmost_axes = row[0]
        leftmost_axes.set(xlim=(0, last_step), ylim=_limits_of_quantity(runs, trial_number, quantity))
        leftmost_axes.set_ylabel(quantity.label, fontsize=MEDIUM)
    columns_of_panels = grid.T  # shape (runs, quantities)
    for trials, column in zip(runs, columns_of_panels, strict=True):
        top_axes, bottom_axes = column[0], column[-1]
        top_axes.set_title(_series_title(trials.experiment, trial_number), fontsize=SMALL, loc="left")
        bottom_axes.set_xlabel("step", fontsize=MEDIUM)
    # Every robot has drawn a line: the legend needs one of each kind.
    add_legend(figure, _lines_for_legend(grid))
    return figure


def _lines_for_legend(panels: NDArray[Any]) -> list[Line2D]:
    """Return a line of each kind that some panel has: of flawed robots, of healthy ones, and the truth.

    The kind of a line is its label.
    """
    lines = [line for axes in panels.flat for line in axes.lines]
    lines_for_legend = []
    for label in (_FLAWED_LABEL, _HEALTHY_LABEL, _TRUE_LABEL):
        lines_of_kind = [line for line in lines if line.get_label() == label]
        # A kind may have no lines: the healthy robots, for example, if all are flawed.
        if lines_of_kind:
            lines_for_legend.append(lines_of_kind[-1])
    return lines_for_legend


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
    lows: list[float] = []
    highs: list[float] = []
    for trials in runs:
        values = _values_of(trials, trial_number, quantity)
        unsettled_samples = len(values) // 50
        settled_values = values[unsettled_samples:]
        true_value = _true_value(trials.experiment, quantity)
        lows.append(min(float(settled_values.min()), true_value))
        highs.append(max(float(settled_values.max()), true_value))
    low, high = min(lows), max(highs)
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
        if experiment.is_flawed(robot):
            colour, label = COLOUR_OF_FLAWED_ROBOTS, _FLAWED_LABEL
        else:
            colour, label = COLOUR_OF_HEALTHY_ROBOTS, _HEALTHY_LABEL
        axes.plot(
            steps,
            values[:, robot],
            color=colour,
            label=label,
            linewidth=1.1,
            alpha=0.75,
            drawstyle=draw_style,
        )
    true_value = _true_value(experiment, quantity)
    axes.axhline(true_value, color=INK, label=_TRUE_LABEL, linewidth=1.2, linestyle="--")
    true_value_text = f" {quantity.true_symbol} = {true_value:g}"
    right_edge = 1  # in this transform x is a share of the panel's width
    axes.text(
        right_edge,
        true_value,
        true_value_text,
        transform=axes.get_yaxis_transform(),
        va="center",
        fontsize=SMALL,
    )
    style_panel(axes)
