"""Errors of swarms over time, for the studies: a panel for each title, and a line for each filter or peer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcp_asdf_tools.common.figures import SMALL
from mcp_asdf_tools.experiments.plot_labels import make_caption
from mcp_asdf_tools.experiments.plot_panels import (
    SeriesName,
    create_panels,
    describe_intervals,
    draw_band,
    group_into_series,
    label_figure,
    legend_of_series,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS


def plot_errors_over_time(panels: Mapping[str, Sequence[Trials]], series_name: SeriesName) -> Figure:
    """Plot the mean error |x - f| of a swarm over time. Each title has a panel, and each name a line in it.

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
            _draw_errors(axes, _with_name(experiments, series_name, series.label), series.colour)
        # The errors of the filters differ by more than a factor of ten.
        axes.set_yscale("log")
    intervals = describe_intervals(all_experiments)
    marks = f"lines are medians over the trials of a swarm's mean error, {intervals}"
    caption = make_caption(all_experiments, marks, PAPER_LIMITS)
    legend = legend_of_series(all_series, marker="", line="-")
    return label_figure(figure, "step", "error |x \u2212 f|", caption, legend)


def _with_name(experiments: Sequence[Trials], series_name: SeriesName, name: str) -> list[Trials]:
    """Return those of ``experiments`` to which ``series_name`` gives the name ``name``."""
    return [trials for trials in experiments if series_name(trials.experiment) == name]


def _draw_errors(axes: Axes, experiments: Sequence[Trials], colour: str) -> None:
    """Draw the median over all trials of a swarm's mean error, in its interval; nothing without trials.

    The time axis is that of the first experiment: all must have been recorded with the same interval.
    """
    if not experiments:
        return
    errors = np.concatenate([trials.mean_errors_over_time() for trials in experiments])
    errors_by_sample = errors.T  # from shape (trials, samples)
    steps = np.arange(len(errors_by_sample)) * experiments[0].sampling_interval
    draw_band(axes, steps, median_intervals(errors_by_sample), colour)
