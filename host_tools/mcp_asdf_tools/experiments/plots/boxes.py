"""Boxes of the score H, by the share of flawed robots and their accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcp_asdf_tools.common.figures import INK, MEDIUM
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import flawed_share, make_caption, shown_values
from mcp_asdf_tools.experiments.plot_panels import (
    Results,
    Series,
    SeriesName,
    accuracy_offset,
    create_panels,
    experiments_to_plot,
    group_into_series,
    label_figure,
    legend_of_series,
)
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, Limits

_MEANING_OF_MARKS = (
    "a point is a trial; boxes from quartile to quartile with the median, whiskers to the last trial within "
    "1.5 of their length"
)
_SLOT_WIDTH = 0.86
"""Width that the boxes of a slot share; slots are 1 apart."""

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
    """Plot boxes of the score H by the share of flawed robots and their accuracy. Each f and b has a panel.

    They are as in the paper's figures 3 and 5. Experiments have a colour by their filter and other parameters
    in which they differ, or by the name that ``series_name`` returns. A point for each trial shows what a box
    hides: that trials fall into two groups. f is the share of black tiles, b the true accuracy of a sensor.

    Scores are relative to ``limits``, by default the paper's. As in all pictures, ``where`` chooses
    experiments by their parameters, and the figure's method ``savefig`` writes a file. Raises UsageError if
    no experiment is left, or there are more panels or series than fit a picture.
    """
    experiments = experiments_to_plot(results, where)
    all_series = group_into_series(experiments, series_name)
    fill_ratios = shown_values(experiments, "fill_ratio")
    accuracies = shown_values(experiments, "true_accuracy")
    panel_keys = list(product(fill_ratios, accuracies))
    # Panels have different slots along x, as not every b goes with every b_hat.
    figure, panels = create_panels(
        len(panel_keys), 2.6, len(all_series), max_columns=len(accuracies), sharex=False
    )
    for axes, (f, b) in zip(panels, panel_keys, strict=True):
        series_of_panel = [series.select(fill_ratio=f, true_accuracy=b) for series in all_series]
        _draw_box_panel(axes, series_of_panel, limits)
        axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
    x_label = r"$\hat{b} - b$ of flawed robots, and their proportion $P$"
    caption = make_caption(experiments, _MEANING_OF_MARKS, limits)
    return label_figure(figure, x_label, "score $H$", caption, legend_of_series(all_series, "s"))


def _draw_box_panel(axes: Axes, series_of_panel: Sequence[Series], limits: Limits) -> None:
    """Draw a box for each experiment of a panel, in the colour of its series.

    Along the x axis there is a slot for each share P of flawed robots and offset of their b_hat from b, in
    which the boxes of the series stand side by side.
    """
    slots = sorted(
        {_slot_of(trials.experiment) for series in series_of_panel for trials in series.experiments}
    )
    box_width = _SLOT_WIDTH / len(series_of_panel)
    for series_index, series in enumerate(series_of_panel):
        # Boxes begin at the left end of a slot, and a slot's position along x is its middle.
        middle_of_box_in_slot = (series_index + 0.5) * box_width - _SLOT_WIDTH / 2
        for trials in series.experiments:
            slot_position = slots.index(_slot_of(trials.experiment))
            scores = trials.scores(limits)["H"]
            _draw_box(axes, scores, slot_position + middle_of_box_in_slot, box_width, series.colour)
    _label_slots(axes, slots)  # after the boxes, as each call of boxplot sets limits and labels, too


def _label_slots(axes: Axes, slots: Sequence[tuple[float, float]]) -> None:
    """Set the limits of a panel's axes, and write below each slot its offset and share of flawed robots.

    ``slots`` has the share and the offset of each. They stand at 0, 1, 2 and so on along the x axis.
    """
    # H is at most 100; above it is room for the outlines of boxes and points there.
    axes.set(ylim=(0, 103), xlim=(-0.5, len(slots) - 0.5))
    slot_labels = [f"{offset:+.2g}\n{share:.0%}" for share, offset in slots]
    axes.set_xticks(range(len(slots)), slot_labels)


def _slot_of(experiment: Experiment) -> tuple[float, float]:
    """Return P, the share of flawed robots, and the offset of the accuracy that they assume from b."""
    return flawed_share(experiment), accuracy_offset(experiment)


def _draw_box(axes: Axes, scores: NDArray[np.float64], middle: float, width: float, colour: str) -> None:
    """Draw a box of the trials' scores, and the scores as points, spread evenly over the box's width.

    The box takes _DRAWN_SHARE_OF_WIDTH of ``width``, in the middle of it.
    """
    drawn_width = _DRAWN_SHARE_OF_WIDTH * width
    line = {"color": colour, "linewidth": 0.8}
    axes.boxplot(
        scores,
        positions=[middle],
        widths=drawn_width,
        showfliers=False,
        medianprops={"color": INK, "linewidth": 1.2},
        boxprops=line,
        whiskerprops=line,
        capprops=line,
    )
    # Points are moved sideways, without a pattern, since equal scores would hide each other.
    shares_of_width = (np.arange(len(scores)) * _GOLDEN_RATIO) % 1
    distances = (shares_of_width - 0.5) * drawn_width  # from the middle of the box
    axes.plot(middle + distances, scores, ".", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)
