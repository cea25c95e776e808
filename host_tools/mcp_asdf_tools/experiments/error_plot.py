"""Errors of swarms over time, for the studies: a panel for each title, and a line for each filter or peer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcp_asdf_tools.common.figures import SMALL, style_panel
from mcp_asdf_tools.experiments.plot_labels import make_caption
from mcp_asdf_tools.experiments.plot_panels import (
    SeriesName,
    create_panels,
    describe_intervals,
    draw_band,
    group_into_series,
    label_figure,
    legend_handle,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS


def plot_errors_over_time(panels: Mapping[str, Sequence[Trials]], series_name: SeriesName) -> Figure:
    """Plot the mean error |x - f| of a swarm over time: a panel for each title, in it a line for each name.

    x is a robot's informed estimate and f the true share of black tiles, so this is the mean over the robots
    of a trial; the line is the median over the trials. Trials of one panel to which ``series_name`` gives the
    same name are taken together. All must have been recorded, with the same interval. Raises UsageError if
    there are too many panels.
    """
    all_experiments = [trials for experiments in panels.values() for trials in experiments]
    all_series = group_into_series(all_experiments, series_name)
    figure, grid = create_panels(len(panels), panel_height=1.9, series_count=len(all_series))
    for axes, (title, experiments) in zip(grid, panels.items(), strict=True):
        axes.set_title(title, fontsize=SMALL, loc="left")
        for series in all_series:
            experiments_of_line = [
                trials for trials in experiments if series_name(trials.experiment) == series.label
            ]
            _draw_errors(axes, experiments_of_line, series.colour)
        # The errors of the filters differ by more than a factor of ten.
        axes.set_yscale("log")
        style_panel(axes)
    handles = [legend_handle(series.label, series.colour, marker="", line="-") for series in all_series]
    intervals = describe_intervals(all_experiments)
    marks = f"lines are medians over the trials of a swarm's mean error, {intervals}"
    caption = make_caption(all_experiments, marks, PAPER_LIMITS)
    return label_figure(figure, "step", "error |x \u2212 f|", caption, handles)


def _draw_errors(axes: Axes, experiments: Sequence[Trials], colour: str) -> None:
    """Draw the median over all trials of a swarm's mean error, in its interval; nothing without trials.

    The time axis is that of the first experiment: all must have been recorded with the same interval.
    """
    if not experiments:
        return
    robot_axis = 2  # of the shape (trials, samples, N)
    errors = [
        abs(trials.records["x"] - trials.experiment.fill_ratio).mean(axis=robot_axis)
        for trials in experiments
    ]
    error_by_trial_and_sample = np.concatenate(errors)
    # A median over the trials is wanted for each sample, so samples come first: shape (samples, trials).
    error_by_sample_and_trial = error_by_trial_and_sample.T
    band = median_intervals(error_by_sample_and_trial)
    sample_count = error_by_trial_and_sample.shape[1]
    steps = np.arange(sample_count) * experiments[0].sampling_interval
    draw_band(axes, steps, band, colour)
