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

    x is a robot's informed estimate and f the true share of black tiles, so this is the mean over the robots
    of a trial; the line is the median over the trials. Trials of one panel and filter are taken together. All
    must have been recorded, with the same interval. Raises UsageError if there are too many panels.
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
            experiments_of_filter = [trials for trials in experiments if trials.experiment.filter == name]
            _draw_errors(axes, experiments_of_filter, colour)
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
    """Draw the median over all trials of a swarm's mean error, in its interval; nothing without trials.

    The time axis is that of the first experiment: all must have been recorded with the same interval.
    """
    if not experiments:
        return
    robot_axis = 2
    errors = [
        abs(trials.records["x"] - trials.experiment.fill_ratio).mean(axis=robot_axis)
        for trials in experiments
    ]
    error_by_trial_and_sample = np.concatenate(errors)
    # A median over the trials is wanted for each sample, so samples come first.
    band = median_intervals(error_by_trial_and_sample.T)
    sample_count = error_by_trial_and_sample.shape[1]
    steps = np.arange(sample_count) * experiments[0].sampling_interval
    draw_band(axes, steps, band, colour)


# --- Assumed accuracies of all robots --------------------------------------------------------------------

ACCURACY_TOLERANCE = 0.05
"""Change of b_hat from its first value above which a healthy robot counts as misled by its filter."""

_MEDIAN_AND_BAND_PERCENTILES = (50, 5, 95)
"""Percentiles of the line, the lower and the upper edge of a band."""

_BAND_MARKS = "lines are medians over robots and trials, bands the middle 90 %"

_TITLE_WIDTH = 56
"""Characters in a line of a title. Those of formulas, which are drawn shorter, count in full."""


def plot_accuracy_bands(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """Plot b_hat of all robots of all trials after each filter step: the median and the middle 90 %.

    b_hat is the accuracy that a robot assumes of its sensor. There is a panel for each experiment, in the
    order of their filters; its title ends with the share of healthy robots that their filter has misled:
    whose b_hat ends more than ACCURACY_TOLERANCE from its first value. Raises UsageError if there are too
    many experiments, or no filter step.
    """
    if any(_filter_step_count(trials) == 0 for trials in experiments):
        raise UsageError("these trials have no filter step; run more steps, or a shorter filter_period")
    max_columns = 2 if len(experiments) == 4 else 3  # four make a square
    figure, panels = create_panels(len(experiments), panel_height=2.1, max_columns=max_columns)
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
    """Return a title for each experiment: what makes it differ from the others, and its f, b, b_hat and P.

    These letters are the paper's: f is the share of black tiles, b the true accuracy of a sensor, b_hat the
    accuracy that flawed robots assume at first, and P the share of flawed robots. A first line names the
    filter if the experiments have several.
    """
    # f, b, b_hat, P and the filter are in every title, so they are not looked for among the differences.
    varying_names = varying_parameters(experiments, excluded=CELL_PARAMETERS)
    has_several_filters = len({trials.experiment.filter for trials in experiments}) > 1
    titles = []
    for trials in experiments:
        lines = _title_lines(trials.experiment, varying_names)
        if has_several_filters:
            lines.insert(0, filter_name(trials.experiment))
        titles.append("\n".join(lines))
    return titles


def _title_lines(experiment: Experiment, varying_names: Sequence[str]) -> list[str]:
    """Return the varying parameters that have an effect in the experiment, then f, b, b_hat and P.

    The text is wrapped into lines of up to _TITLE_WIDTH characters.
    """
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
    """Draw b_hat of flawed and of healthy robots over time, and the true accuracy as a dashed line.

    Robots of either kind are left out if there are none.
    """
    experiment = trials.experiment
    steps = experiment.filter_period * np.arange(1, _filter_step_count(trials) + 1)
    flawed, healthy = _flawed_and_healthy(trials)
    for colour, b_hat in ((FLAWED, flawed), (OTHER, healthy)):
        if b_hat.size:
            trial_axis, robot_axis = 0, 2
            band = np.percentile(b_hat, _MEDIAN_AND_BAND_PERCENTILES, axis=(trial_axis, robot_axis))
            draw_band(axes, steps, band, colour)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1.2, linestyle="--")
    clean(axes)


def _flawed_and_healthy(trials: Trials) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return b_hat of the flawed robots, which come first, and of the others.

    Both have the shape (trials, filter steps, robots of that kind).
    """
    flawed_count = trials.experiment.flawed
    return trials.b_hat[:, :, :flawed_count], trials.b_hat[:, :, flawed_count:]


def _describe_misled(trials: Trials) -> str:
    """Return a line for a title such as "more than 0.05 off: 12% of healthy robots".

    That is the share of the healthy robots of all trials whose b_hat after the last filter step differs by
    more than ACCURACY_TOLERANCE from the one they started with. It is "-" if there are no healthy robots.
    """
    _, healthy = _flawed_and_healthy(trials)
    share = "-"
    if healthy.size:
        experiment = trials.experiment
        # An unflawed accuracy of 0 means that healthy robots start with the true one.
        has_unflawed_accuracy = experiment.unflawed_accuracy != 0
        initial_b_hat = experiment.unflawed_accuracy if has_unflawed_accuracy else experiment.true_accuracy
        last_filter_step = -1
        final_b_hat = healthy[:, last_filter_step, :]
        is_misled = abs(final_b_hat - initial_b_hat) > ACCURACY_TOLERANCE
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


def plot_series(runs: Sequence[Trials], trial_number: int) -> Figure:
    """Plot b_hat, x_hat and x of every robot over time in one trial of each run, as in the paper's figure 6.

    These are the accuracy that a robot assumes, its local estimate and its informed estimate. Runs stand side
    by side, quantities below each other. Raises UsageError if a run has no such trial, or was not recorded
    over time.
    """
    for trials in runs:
        _check_recorded_trial(trials, trial_number)
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
    for trials, column in zip(runs, grid.T, strict=True):
        top_axes, bottom_axes = column[0], column[-1]
        top_axes.set_title(_series_title(trials.experiment, trial_number), fontsize=SMALL, loc="left")
        bottom_axes.set_xlabel("step", fontsize=MEDIUM)
    line_by_label = {line.get_label(): line for axes in grid.flat for line in axes.lines}
    labels = [label for label in (_FLAWED_LABEL, _HEALTHY_LABEL, _TRUE_LABEL) if label in line_by_label]
    add_legend(figure, [line_by_label[label] for label in labels])
    return figure


def _check_recorded_trial(trials: Trials, trial_number: int) -> None:
    """Raise UsageError if there is no trial of that number, or no record over time."""
    if trial_number not in trials.numbers:
        existing_numbers = f"{trials.numbers[0]} .. {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {trial_number}; choose one of {existing_numbers}")
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")


def _values_of(trials: Trials, trial_number: int, quantity: _Quantity) -> NDArray[np.float64]:
    """Return the recorded values of a quantity in one trial, shape (samples, robots)."""
    trial_index = trials.numbers.index(trial_number)
    values: NDArray[np.float64] = trials.records[quantity.name][trial_index]
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
        first_moments = len(values) // 50
        settled_values = np.append(values[first_moments:], _true_value(trials.experiment, quantity))
        lows.append(float(settled_values.min()))
        highs.append(float(settled_values.max()))
    low, high = min(lows), max(highs)
    margin = max(0.06 * (high - low), 0.01)
    return low - margin, high + margin


def _true_value(experiment: Experiment, quantity: _Quantity) -> float:
    """Return the value that a quantity estimates."""
    return float(getattr(experiment, quantity.true_parameter))


def _series_title(experiment: Experiment, trial_number: int) -> str:
    """Return filter, number of robots, topology, seed and trial of a run, in two lines."""
    title = filter_name(experiment)
    if experiment.swarm_filter.is_on:
        title += rf", $\tau$ = {experiment.filter_period}"
    robots = f"{experiment.robots} robots, {experiment.flawed} flawed"
    topology = experiment.parameters()["topology"]
    return f"{title}: {robots},\n{topology}, seed {experiment.seed}, trial {trial_number}"


def _draw_quantity(axes: Axes, trials: Trials, trial_number: int, quantity: _Quantity) -> None:
    """Draw a line for each robot, the flawed ones on top, and a dashed line with a text at the true value."""
    experiment = trials.experiment
    values = _values_of(trials, trial_number, quantity)
    steps = np.arange(len(values)) * trials.sampling_interval
    draw_style = "steps-post" if quantity.name == "b_hat" else "default"  # b_hat is constant between updates
    # Flawed robots have the lowest ids, and what is drawn last lies on top.
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
    true_value = _true_value(experiment, quantity)
    axes.axhline(true_value, color=INK, label=_TRUE_LABEL, linewidth=1.2, linestyle="--")
    text = f" {quantity.true_symbol} = {true_value:g}"
    right_edge = 1  # in this transform x is a share of the panel's width
    axes.text(right_edge, true_value, text, transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL)
    clean(axes)
