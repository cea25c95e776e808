"""Boxes of the score H, by the share of flawed robots and their accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcp_asdf_tools.common.figures import INK, MEDIUM, style_panel
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import flawed_share, make_caption
from mcp_asdf_tools.experiments.plot_panels import (
    Results,
    Series,
    SeriesName,
    accuracy_offset,
    create_panel_grid,
    experiments_to_plot,
    group_into_series,
    label_figure,
    legend_handle,
    sorted_attributes,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, Limits

_MEANING_OF_MARKS = (
    "a point is a trial; boxes from quartile to quartile with the median, whiskers to the last trial within "
    "1.5 of their length"
)
_SLOT_WIDTH = 0.86
"""Width that the boxes of a slot share, where slots are 1 apart."""

_DRAWN_SHARE_OF_WIDTH = 0.85
"""Share of a box's width that it is drawn with, so that neighbouring boxes do not touch."""

_GOLDEN_RATIO = 0.618
"""Multiples of it, less their integers, are spread evenly, however many they are."""


def plot_boxes(
    results: Results,
    *,
    where: Mapping[str, Any] | None = None,
    limits: Limits = PAPER_LIMITS,
    series_name: SeriesName | None = None,
) -> Figure:
    """Plot boxes of the score H by the share of flawed robots and their accuracy, a panel for each f and b.

    They are as in the paper's figures 3 and 5. Experiments have a colour by their filter and other parameters
    in which they differ, or by the name that ``series_name`` returns. A point for each trial shows what a box
    hides: that trials fall into two groups. f is the share of black tiles, b the true accuracy of a sensor.

    Scores are relative to ``limits``, by default the paper's. As in all pictures, ``where`` chooses
    experiments by their parameters, and the figure's method ``savefig`` writes a file. Raises UsageError if
    no experiment is left, or there are more panels or series than fit a picture.
    """
    experiments = experiments_to_plot(results, where)
    all_series = group_into_series(experiments, series_name)
    fill_ratios = sorted_attributes(experiments, "fill_ratio")
    accuracies = sorted_attributes(experiments, "true_accuracy")
    figure, grid = create_panel_grid(
        row_count=len(fill_ratios),
        column_count=len(accuracies),
        panel_height=2.6,
        series_count=len(all_series),
        sharex=False,  # panels have different slots along x, as not every b goes with every b_hat
    )
    for (row, column), axes in np.ndenumerate(grid):
        f, b = fill_ratios[row], accuracies[column]
        series_of_panel = [
            replace(series, experiments=_select_experiments(series, f, b)) for series in all_series
        ]
        _draw_box_panel(axes, series_of_panel, limits)
        axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
    x_label = r"$\hat{b} - b$ of flawed robots, and their proportion $P$"
    caption = make_caption(experiments, _MEANING_OF_MARKS, limits)
    handles = [legend_handle(series.label, series.colour, "s") for series in all_series]
    return label_figure(figure, x_label, "score $H$", caption, handles)


def _select_experiments(series: Series, fill_ratio: float, true_accuracy: float) -> list[Trials]:
    """Return the experiments of a series with this share of black tiles and this accuracy of sensors."""
    return [
        trials
        for trials in series.experiments
        if trials.experiment.fill_ratio == fill_ratio and trials.experiment.true_accuracy == true_accuracy
    ]


def _draw_box_panel(axes: Axes, series_of_panel: Sequence[Series], limits: Limits) -> None:
    """Draw a box for each experiment of a panel, in the colour of its series.

    Along the x axis there is a slot for each share P of flawed robots and offset of their b_hat from b, in
    which the boxes of the series stand side by side.
    """
    slots = sorted(
        {_slot_of(trials.experiment) for series in series_of_panel for trials in series.experiments}
    )
    box_width = _SLOT_WIDTH / len(series_of_panel)
    drawn_width = _DRAWN_SHARE_OF_WIDTH * box_width
    for series_index, series in enumerate(series_of_panel):
        # The boxes of a slot begin at its left end, and a box is drawn around its middle.
        distance_from_left_end = (series_index + 0.5) * box_width
        distance_from_middle_of_slot = distance_from_left_end - _SLOT_WIDTH / 2
        for trials in series.experiments:
            middle_of_slot = slots.index(_slot_of(trials.experiment))  # 0, 1, 2 and so on
            middle_of_box = middle_of_slot + distance_from_middle_of_slot
            scores = trials.scores(limits)["H"]
            _draw_box(axes, scores, middle_of_box, drawn_width, series.colour)
    # H is at most 100; above it is room for the outlines of boxes and points there.
    axes.set(ylim=(0, 103), xlim=(-0.5, len(slots) - 0.5))
    slot_labels = [f"{offset:+.2g}\n{share:.0%}" for share, offset in slots]
    axes.set_xticks(range(len(slots)), slot_labels)
    style_panel(axes)


def _slot_of(experiment: Experiment) -> tuple[float, float]:
    """Return P, the share of flawed robots, and the offset of the accuracy that they assume from b."""
    return flawed_share(experiment), accuracy_offset(experiment)


def _draw_box(axes: Axes, scores: NDArray[np.float64], middle: float, width: float, colour: str) -> None:
    """Draw a box of the trials' scores, and a point for each trial, spread evenly over the box's width."""
    line = {"color": colour, "linewidth": 0.8}
    axes.boxplot(
        scores,
        positions=[middle],
        widths=width,
        showfliers=False,
        medianprops={"color": INK, "linewidth": 1.2},
        boxprops=line,
        whiskerprops=line,
        capprops=line,
    )
    # Points are moved sideways, without a pattern, since equal scores would hide each other.
    shares_of_width = (np.arange(len(scores)) * _GOLDEN_RATIO) % 1
    distances = (shares_of_width - 0.5) * width  # from the middle of the box
    axes.plot(middle + distances, scores, ".", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)
