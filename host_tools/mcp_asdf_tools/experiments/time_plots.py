"""Pictures of trials over time: errors of swarms, assumed accuracies of all robots, one trial's values."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from mcp_asdf_tools.experiments.plot_labels import (
    CELL_PARAMETERS,
    filter_name,
    flawed_share,
    has_effect,
    make_caption,
    parameter_with_value,
    sort_key,
    varying_parameters,
)
from mcp_asdf_tools.experiments.plot_panels import (
    colours_of_filters,
    create_panels,
    describe_intervals,
    draw_band,
    label_figure,
    legend_handle,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPERS, Limits
from mcp_asdf_tools.robots.filters import FILTERS

# --- Errors of swarms ------------------------------------------------------------------------------------


def plot_errors_over_time(panels: Mapping[str, Sequence[Trials]], limits: Limits = PAPERS) -> Figure:
    """Plot the mean error |x - f| of a swarm over time: a panel for each title, in it a line for each filter.

    Trials of one panel and filter are taken together. All need records of x.
    """
    all_experiments = [trials for experiments in panels.values() for trials in experiments]
    used_filters = {trials.experiment.filter for trials in all_experiments}
    colour_by_filter = {
        name: colour
        for name, colour in zip(FILTERS, colours_of_filters([*FILTERS]), strict=True)
        if name in used_filters
    }
    figure, grid = create_panels(len(panels), 1.9, len(colour_by_filter))
    for axes, (title, experiments) in zip(grid, panels.items(), strict=True):
        axes.set_title(title, fontsize=SMALL, loc="left")
        for name, colour in colour_by_filter.items():
            _draw_errors(axes, [each for each in experiments if each.experiment.filter == name], colour)
        axes.set_yscale("log")
        clean(axes)
    handles = [
        legend_handle(FILTERS[name].typeset_term, colour, marker="", line="-")
        for name, colour in colour_by_filter.items()
    ]
    intervals = describe_intervals(all_experiments)
    marks = f"lines are medians over the trials of a swarm's mean error, {intervals}"
    caption = make_caption(all_experiments, marks, limits)
    return label_figure(figure, "step", "error |x \u2212 f|", caption, handles)


def _draw_errors(axes: Axes, experiments: Sequence[Trials], colour: str) -> None:
    """Draw the median over all trials of a swarm's mean error, in its interval; nothing without trials."""
    if not experiments:
        return
    # Shape (trials, samples) for each experiment.
    errors = [abs(trials.records["x"] - trials.experiment.fill_ratio).mean(axis=2) for trials in experiments]
    band = median_intervals(np.concatenate(errors).T)
    steps = np.arange(band.shape[1]) * experiments[0].sampling_interval
    draw_band(axes, steps, band, colour)


# --- Assumed accuracies of all robots --------------------------------------------------------------------

ACCURACY_TOLERANCE = 0.05
"""Change of b_hat from which on a healthy robot counts as misled by its filter."""

_BAND_MARKS = "lines are medians over robots and trials, bands the middle 90 %"

_TITLE_WIDTH = 56
"""Characters in a line of a title. Those of formulas, which are drawn shorter, count in full."""


def plot_accuracy_bands(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """Plot b_hat of all robots of all trials after each filter step: the median and the middle 90 %.

    There is a panel for each experiment; its title ends with the share of healthy robots that their filter
    has misled. Raises UsageError if there are too many experiments, or no filter step.
    """
    if any(_filter_step_count(trials) == 0 for trials in experiments):
        raise UsageError("these trials have no filter step; run more steps, or a shorter filter_period")
    max_columns = 2 if len(experiments) == 4 else 3  # four make a square
    figure, panels = create_panels(len(experiments), 2.1, max_columns=max_columns)
    ordered_experiments = sorted(experiments, key=lambda trials: sort_key("filter", trials.experiment.filter))
    titles = _panel_titles(ordered_experiments)
    for axes, trials, title in zip(panels, ordered_experiments, titles, strict=True):
        _draw_accuracy_bands(axes, trials)
        axes.set_title(f"{title}\n{_describe_misled(trials)}", fontsize=SMALL)
    handles = [
        legend_handle(label, colour, marker="", line="-")
        for label, colour in (("flawed", FLAWED), ("healthy", OTHER), ("true", INK))
    ]
    caption = make_caption(experiments, _BAND_MARKS, limits)
    return label_figure(figure, "step", r"assumed accuracy $\hat{b}$", caption, handles)


def _filter_step_count(trials: Trials) -> int:
    """Return how many filter steps each trial has."""
    return int(trials.b_hat.shape[1])


def _panel_titles(experiments: Sequence[Trials]) -> list[str]:
    """Return f, b, b_hat and P of each experiment, and every other parameter in which they differ."""
    varying_names = varying_parameters(experiments, CELL_PARAMETERS)
    has_several_filters = len({trials.experiment.filter for trials in experiments}) > 1
    titles = []
    for trials in experiments:
        lines = _title_lines(trials.experiment, varying_names)
        if has_several_filters:
            lines.insert(0, filter_name(trials.experiment))
        titles.append("\n".join(lines))
    return titles


def _title_lines(experiment: Experiment, varying_names: Sequence[str]) -> list[str]:
    """Return the varying parameters that have an effect, and f, b, b_hat and P, wrapped into lines."""
    values = [
        parameter_with_value(name, experiment.parameters()[name])
        for name in varying_names
        if has_effect(experiment, name)
    ]
    values.append(f"$f$ = {experiment.fill_ratio:g}")
    values.append(f"$b$ = {experiment.true_accuracy:g}")
    values.append(rf"$\hat{{b}}$ = {experiment.flawed_accuracy:g}")
    values.append(f"$P$ = {flawed_share(experiment):.0%}")
    # A symbol and its value stay on one line.
    text = ", ".join(values).replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    return textwrap.wrap(text, _TITLE_WIDTH)


def _draw_accuracy_bands(axes: Axes, trials: Trials) -> None:
    """Draw b_hat of flawed and of healthy robots over time, and the true accuracy."""
    experiment = trials.experiment
    steps = experiment.filter_period * np.arange(1, _filter_step_count(trials) + 1)
    flawed, healthy = _flawed_and_healthy(trials)
    for colour, b_hat in ((FLAWED, flawed), (OTHER, healthy)):
        if b_hat.size:
            draw_band(axes, steps, np.percentile(b_hat, [50, 5, 95], axis=(0, 2)), colour)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1.2, linestyle="--")
    clean(axes)


def _flawed_and_healthy(trials: Trials) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return b_hat of the flawed robots, which come first, and of the others.

    Both have the shape (trials, filter steps, robots of that kind).
    """
    flawed_count = trials.experiment.flawed
    return trials.b_hat[:, :, :flawed_count], trials.b_hat[:, :, flawed_count:]


def _describe_misled(trials: Trials) -> str:
    """Return which share of the healthy robots ends with a b_hat far from the one they started with."""
    _, healthy = _flawed_and_healthy(trials)
    share = "-"
    if healthy.size:
        # An unflawed accuracy of 0 stands for the true one.
        initial_b_hat = trials.experiment.unflawed_accuracy or trials.experiment.true_accuracy
        is_misled = abs(healthy[:, -1] - initial_b_hat) > ACCURACY_TOLERANCE
        share = f"{np.mean(is_misled):.0%} of healthy robots"
    return f"more than {ACCURACY_TOLERANCE} off: {share}"


# --- One trial -------------------------------------------------------------------------------------------


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


def plot_series(runs: Sequence[Trials], number: int) -> Figure:
    """Plot b_hat, x_hat and x of every robot in trial ``number`` of each run, as in the paper's figure 6.

    Runs stand side by side, quantities below each other. Raises UsageError if a run has no such trial, or was
    not recorded over time.
    """
    for trials in runs:
        _check_recorded_trial(trials, number)
    figure = empty_figure(WIDTH, 7.5)
    grid = figure.subplots(len(_QUANTITIES), len(runs), sharex=True, sharey="row", squeeze=False)
    last_step = max(trials.experiment.steps for trials in runs)
    for row, quantity in zip(grid, _QUANTITIES, strict=True):
        drawn_values = [
            _draw_quantity(axes, trials, number, quantity) for axes, trials in zip(row, runs, strict=True)
        ]
        row[0].set(xlim=(0, last_step), ylim=_limits_around(drawn_values))
        row[0].set_ylabel(quantity.label, fontsize=MEDIUM)
    for trials, column in zip(runs, grid.T, strict=True):
        column[0].set_title(_series_title(trials.experiment, number), fontsize=SMALL, loc="left")
        column[-1].set_xlabel("step", fontsize=MEDIUM)
    line_by_label = {line.get_label(): line for axes in grid.flat for line in axes.lines}
    labels = [label for label in (_FLAWED_LABEL, _HEALTHY_LABEL, _TRUE_LABEL) if label in line_by_label]
    add_legend(figure, [line_by_label[label] for label in labels])
    return figure


def _check_recorded_trial(trials: Trials, number: int) -> None:
    """Raise UsageError if there is no trial of that number, or no record over time."""
    if number not in trials.numbers:
        existing_numbers = f"{trials.numbers[0]} .. {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {number}; choose one of {existing_numbers}")
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")


def _limits_around(arrays: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """Return limits of an axis that leave a margin around all values."""
    low = min(array.min() for array in arrays)
    high = max(array.max() for array in arrays)
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin


def _series_title(experiment: Experiment, number: int) -> str:
    """Return filter, number of robots, topology, seed and trial of a run, in two lines."""
    title = filter_name(experiment)
    if experiment.swarm_filter.is_on:
        title += rf", $\tau$ = {experiment.filter_period}"
    robots = f"{experiment.robots} robots, {experiment.flawed} flawed"
    topology = experiment.parameters()["topology"]
    return f"{title}: {robots},\n{topology}, seed {experiment.seed}, trial {number}"


def _draw_quantity(axes: Axes, trials: Trials, number: int, quantity: _Quantity) -> NDArray[np.float64]:
    """Draw a line for each robot, the flawed ones on top, and the true value.

    Returns all values but those of the first moments, when estimates still jump between 0 and 1.
    """
    experiment = trials.experiment
    values = trials.records[quantity.name][trials.numbers.index(number)]  # shape (samples, robots)
    steps = np.arange(len(values)) * trials.sampling_interval
    draw_style = "steps-post" if quantity.name == "b_hat" else "default"  # b_hat is constant between updates
    for robot in reversed(range(experiment.robots)):
        is_flawed = robot < experiment.flawed
        axes.plot(
            steps,
            values[:, robot],
            color=FLAWED if is_flawed else OTHER,
            label=_FLAWED_LABEL if is_flawed else _HEALTHY_LABEL,
            linewidth=1.1,
            alpha=0.75,
            drawstyle=draw_style,
        )
    true_value = getattr(experiment, quantity.true_parameter)
    axes.axhline(true_value, color=INK, label=_TRUE_LABEL, linewidth=1.2, linestyle="--")
    text = f" {quantity.true_symbol} = {true_value:g}"
    axes.text(1, true_value, text, transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL)
    clean(axes)
    first_moments = len(values) // 50
    return np.append(values[first_moments:], true_value)
