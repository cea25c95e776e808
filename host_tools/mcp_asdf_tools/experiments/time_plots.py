"""Pictures over time: one trial's robots, b_hat of all trials, and the paths of robots that move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

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
from mcp_asdf_tools.experiments.plots import caption_of, finish, handle, panels_of, share_of
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.robots.population import TYPESET_FILTER_NAMES
from mcp_asdf_tools.robots.series_plot import TimeSeries, draw_time_series
from mcp_asdf_tools.world.arena import Arena

BANDS = (
    "lines are medians over robots and trials, bands the middle 50 and 90 %; titles say how many robots that "
    "began with the right accuracy end more than 0.05 off"
)


def series_beside(runs: Sequence[Trials], number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial of each run, side by side, as in
    the paper's figure 6.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    return draw_time_series([_series_of(trials, number) for trials in runs])


def _series_of(trials: Trials, number: int) -> TimeSeries:
    experiment = trials.experiment
    if number not in trials.numbers:
        raise UsageError(
            f"there is no trial {number}; choose one of {trials.numbers[0]} .. {trials.numbers[-1]}"
        )
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    index = trials.numbers.index(number)
    values = {name: trials.records[name][index] for name in ("b_hat", "x_hat", "x")}
    intervals = len(values["x"]) - 1
    steps = np.arange(intervals + 1.0) * (experiment.steps // intervals)
    truths = {"b": experiment.true_accuracy, "f": experiment.fill_ratio}
    return TimeSeries(_title(experiment, number), steps, values, experiment.flawed, truths)


def _title(experiment: Experiment, trial: int) -> str:
    """Parameters of a trial in words."""
    words = TYPESET_FILTER_NAMES[experiment.filter]
    if experiment.filter != "none":
        words += rf", $\tau$ = {experiment.filter_period}"
    return (
        f"{words}: {experiment.robots} robots, {experiment.flawed} flawed,\n"
        f"{experiment.parameters()['topology']}, seed {experiment.seed}, trial {trial}"
    )


_OFF = 0.05
"""Error above which b_hat is counted as wrong."""


def bands(experiments: Sequence[Trials]) -> Figure:
    """b_hat of all robots over all trials: the median, the middle half and the middle 90 % after each filter
    step, a panel for each experiment; its title says how many unflawed robots end more than 0.05 off.

    Raises UsageError if there are too many, or no filter step.
    """
    if any(not trials.b_hat.shape[1] for trials in experiments):
        raise UsageError(
            "there is no filter step in these trials; run more steps, or a shorter filter_period"
        )
    columns = min(len(experiments), 4)
    figure, grid = panels_of(-(-len(experiments) // columns), columns, 1.8)
    for axes, trials in zip(grid.flat, experiments, strict=False):
        _draw_bands(axes, trials)
    for axes in grid.flat[len(experiments) :]:
        axes.set_axis_off()
    handles = [
        handle("flawed at the start", FLAWED, "", "-"),
        handle("healthy", OTHER, "", "-"),
        handle("true accuracy", INK, "", "--"),
    ]
    labels = ("step", r"assumed accuracy $\hat{b}$")
    return finish(figure, labels, caption_of(experiments, BANDS), handles)


def _draw_bands(axes: Axes, trials: Trials) -> None:
    experiment = trials.experiment
    flawed, healthy = trials.b_hat[..., : experiment.flawed], trials.b_hat[..., experiment.flawed :]
    steps = experiment.filter_period * np.arange(1, trials.b_hat.shape[1] + 1)
    for colour, values in ((FLAWED, flawed), (OTHER, healthy)):
        if values.size:
            low, lower, middle, upper, high = np.percentile(values, [5, 25, 50, 75, 95], axis=(0, 2))
            axes.fill_between(steps, low, high, color=colour, alpha=0.15, linewidth=0)
            axes.fill_between(steps, lower, upper, color=colour, alpha=0.3, linewidth=0)
            axes.plot(steps, middle, color=colour, linewidth=1.4)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1, linestyle=(0, (5, 3)))
    words = f"$f = {experiment.fill_ratio:g}$, $b = {experiment.true_accuracy:g}$"
    if flawed.size:
        words += rf", $\hat{{b}} = {experiment.flawed_accuracy:g}$, $P$ = {share_of(experiment):.0%}"
    right = experiment.unflawed_accuracy or experiment.true_accuracy
    off = f"{np.mean(abs(healthy[:, -1] - right) > _OFF):.0%} of healthy robots" if healthy.size else "-"
    axes.set_title(f"{words}\nmore than {_OFF} off: {off}", fontsize=SMALL - 1.5)
    clean(axes)


# --- The moving world ------------------------------------------------------------------------------------

BODY_RADIUS = 0.0704
_MOST_POINTS = 2000
"""Points of a path: more could not be distinguished."""


def trajectories(experiment: Experiment, trial: int, step: int) -> Figure:
    """The paths of all robots of a dynamic experiment up to a step, and where they are then.

    Raises UsageError if robots do not move or the step is none of the trial's.
    """
    if not experiment.is_dynamic:
        raise UsageError("the robots of this experiment do not move; run one with topology dynamic")
    if not (0 <= trial < experiment.trials and 1 <= step <= experiment.steps):
        raise UsageError(
            f"there is no step {step} of trial {trial}; choose steps of 1 .. {experiment.steps}, trials of "
            f"0 .. {experiment.trials - 1}"
        )
    arena = Arena(experiment, trial)
    paths = np.concatenate([arena.positions[np.newaxis], arena.record(step).position])
    every = np.linspace(0, step, min(step, _MOST_POINTS) + 1).astype(int)
    width, height = experiment.sides
    figure = empty_figure(0.7 * WIDTH, 0.7 * WIDTH * height / width + 0.5)
    axes = figure.subplots()
    axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, fill=False, color=INK))
    for robot in range(experiment.robots - 1, -1, -1):
        colour, path = FLAWED if robot < experiment.flawed else OTHER, paths[every, robot]
        axes.plot(*path.T, color=colour, linewidth=1, alpha=0.6)
        axes.plot(*path[0], "o", color="none", markeredgecolor=INK, markersize=4)
        axes.add_patch(Circle(tuple(path[-1]), BODY_RADIUS, facecolor=colour, edgecolor=INK, zorder=3))
    axes.set_aspect("equal")
    axes.set_title(f"{_title(experiment, trial)}, steps 0 to {step}", fontsize=MEDIUM)
    axes.set_xlabel("$x$ (m)", fontsize=MEDIUM)
    axes.set_ylabel("$y$ (m)", fontsize=MEDIUM)
    add_legend(figure, [handle("flawed", FLAWED), handle("healthy", OTHER), handle("start", INK, "$\\circ$")])
    return figure
