"""Pictures over time: one trial's robots, and b_hat of all trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcp_asdf_tools.common import (
    FLAWED,
    INK,
    MEDIUM,
    OTHER,
    SMALL,
    WIDTH,
    UsageError,
    add_caption,
    add_legend,
    clean,
    empty_figure,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.series_names import FILTER_NAMES, caption_of, check_size, share_of
from mcp_asdf_tools.robots import Filtering, TimeSeries, draw_time_series

# --- One trial -------------------------------------------------------------------------------------------


def series(trials: Trials, number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    return series_beside([trials], number)


def series_beside(runs: Sequence[Trials], number: int) -> Figure:
    """As ``series``, of several runs side by side, as in the paper's figure 6."""
    return draw_time_series([_series_of(trials, number) for trials in runs])


def _series_of(trials: Trials, number: int) -> TimeSeries:
    experiment = trials.experiment
    index = _index_of(trials, number)
    values = {name: trials.records[name][index] for name in ("b_hat", "x_hat", "x")}
    samples = len(values["x"])
    last = experiment.steps // (samples - 1) * (samples - 1)
    truths = {"b": experiment.true_accuracy, "f": experiment.fill_ratio}
    steps = np.linspace(0, last, samples)
    return TimeSeries(_title(experiment, number), steps, values, experiment.flawed, truths)


def _title(experiment: Experiment, number: int) -> str:
    """What was run."""
    flawed = f"{experiment.flawed} flawed"
    if experiment.flawed:
        flawed += rf" with $\hat{{b}}$ = {experiment.flawed_accuracy:g}"
    words = FILTER_NAMES[experiment.filter]
    if experiment.filter is not Filtering.NONE:
        words += rf", $\tau$ = {experiment.filter_period}"
    topology = experiment.parameters()["topology"].replace("-", " ")
    return (
        f"{words}: {experiment.robots} robots, {flawed},\n{topology}, seed {experiment.seed}, trial {number}"
    )


def _index_of(trials: Trials, number: int) -> int:
    if number not in trials.numbers:
        raise UsageError(
            f"there is no trial {number}; choose one of {trials.numbers[0]} .. {trials.numbers[-1]}"
        )
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    return trials.numbers.index(number)


# --- All trials over time --------------------------------------------------------------------------------

_OFF = 0.05
"""From which b_hat counts as off."""
BANDS = (
    "lines are medians over robots and trials, bands the middle 50 and 90 %; titles say how many robots that "
    "began with the right accuracy end more than 0.05 off"
)


def bands(experiments: Sequence[Trials]) -> Figure:
    """b_hat of all robots over all trials: the median, the middle half and the middle 90 % after each filter
    step, a panel for each experiment; its title says how many unflawed robots end more than 0.05 off.

    Raises UsageError if there are too many, or no filter step.
    """
    check_size(len(experiments), 1)
    if any(not trials.b_hat.shape[1] for trials in experiments):
        raise UsageError(
            "there is no filter step in these trials; run more steps, or a shorter filter_period"
        )
    columns = 4 if len(experiments) > 3 else len(experiments)
    rows = -(-len(experiments) // columns)
    figure = empty_figure(WIDTH if columns > 2 else 0.7 * WIDTH, 1.4 + 1.8 * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, trials in zip(grid.flat, experiments, strict=False):
        _draw_bands(axes, trials)
    for axes in grid.flat[len(experiments) :]:
        axes.set_axis_off()
    figure.supylabel(r"assumed accuracy $\hat{b}$", fontsize=MEDIUM)
    add_caption(figure, "step", caption_of(experiments, BANDS))
    truth = Line2D([], [], color=INK, linestyle="--", label="true accuracy")
    lines = [("flawed at the start", FLAWED), ("healthy", OTHER)]
    add_legend(figure, [*(Line2D([], [], color=colour, label=name) for name, colour in lines), truth])
    return figure


def _draw_bands(axes: Axes, trials: Trials) -> None:
    experiment = trials.experiment
    flawed = experiment.flawed
    steps = experiment.filter_period * np.arange(1, trials.b_hat.shape[1] + 1)
    for colour, values in ((FLAWED, trials.b_hat[..., :flawed]), (OTHER, trials.b_hat[..., flawed:])):
        if values.size:
            low, lower, middle, upper, high = np.percentile(values, [5, 25, 50, 75, 95], axis=(0, 2))
            axes.fill_between(steps, low, high, color=colour, alpha=0.15, linewidth=0)
            axes.fill_between(steps, lower, upper, color=colour, alpha=0.3, linewidth=0)
            axes.plot(steps, middle, color=colour, linewidth=1.4)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1, linestyle=(0, (5, 3)))
    words = rf"$f = {experiment.fill_ratio:g}$, $b = {experiment.true_accuracy:g}$"
    if flawed:
        words += rf", $\hat{{b}} = {experiment.flawed_accuracy:g}$, $P$ = {share_of(trials):.0%}"
    axes.set_title(f"{words}\n{_corruption_of(trials)}", fontsize=SMALL - 1.5)
    clean(axes)


def _corruption_of(trials: Trials) -> str:
    unflawed = trials.b_hat[:, -1, trials.experiment.flawed :]
    if not unflawed.size:
        return "all robots flawed"
    right = trials.experiment.unflawed_accuracy or trials.experiment.true_accuracy
    return f"{np.mean(abs(unflawed - right) > _OFF):.0%} of healthy robots end off"
