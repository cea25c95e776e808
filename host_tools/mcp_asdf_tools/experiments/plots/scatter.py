"""Scores of accuracy against scores of convergence, with a point for each trial."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcp_asdf_tools.common.figures import INK, SMALL, style_panel
from mcp_asdf_tools.experiments.plot_labels import flawed_share, make_caption
from mcp_asdf_tools.experiments.plot_panels import (
    Results,
    accuracy_offset,
    create_panel_grid,
    experiments_to_plot,
    group_into_series,
    label_figure,
    legend_handle,
    sorted_attributes,
)
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, Limits

_MEANING_OF_MARKS = (
    "a point is a trial: blue where flawed robots are overconfident, red where they are underconfident, "
    "darker the farther off"
)
_MARKERS = "osD^v"


def plot_scatter(
    results: Results, *, where: Mapping[str, Any] | None = None, limits: Limits = PAPER_LIMITS
) -> Figure:
    """Plot the score h_e against h_K with a point for each trial, a row for each f, a column for each P.

    h_e is the score for a small error, and h_K the score for fast convergence; f is the share of black tiles,
    and P the share of flawed robots. As in the paper's figure 4, every series has rows of its own. Swarms are
    blue if their flawed robots assume a better accuracy than the true one, b, and red if they assume a worse
    one; b decides the marker. ``where`` chooses experiments by their parameters. Raises UsageError if no
    experiment is left, or there are more panels or series than fit a picture.
    """
    experiments = experiments_to_plot(results, where)
    all_series = group_into_series(experiments)
    fill_ratios = sorted_attributes(experiments, "fill_ratio")
    accuracies = sorted_attributes(experiments, "true_accuracy")
    shares = sorted({flawed_share(trials.experiment) for trials in experiments})
    # With more than five b, markers are used again.
    marker_of_accuracy = dict(zip(accuracies, cycle(_MARKERS), strict=False))
    # A row of panels for each series and f, a column for each P.
    rows = [(series, f) for series in all_series for f in fill_ratios]
    figure, grid = create_panel_grid(len(rows), len(shares), panel_height=1.7, series_count=len(all_series))
    # An entry of the legend for each b and offset of b_hat that occurs.
    handles: dict[tuple[float, float], Line2D] = {}
    for (row, column), axes in np.ndenumerate(grid):
        series, f = rows[row]
        share = shares[column]
        experiments_of_panel = [
            trials
            for trials in series.experiments
            if trials.experiment.fill_ratio == f and flawed_share(trials.experiment) == share
        ]
        for trials in experiments_of_panel:
            b = trials.experiment.true_accuracy
            offset = accuracy_offset(trials.experiment)  # of the flawed robots' b_hat from b
            colour = _colour_of_offset(offset)
            marker = marker_of_accuracy[b]
            scores = trials.scores(limits)
            axes.plot(scores["h_K"], scores["h_e"], marker, color=colour, markersize=3, alpha=0.6)
            # Experiments of the same b and offset have equal entries, which replace each other.
            handles[b, offset] = legend_handle(_describe_accuracy(b, offset), colour, marker)
        axes.set_title(f"{series.label}\n$f = {f:g}$, $P$ = {share:.0%}", fontsize=SMALL)
        # Scores are 0 to 100; the margin keeps markers at the ends from being cut.
        axes.set(xlim=(-4, 104), ylim=(-4, 104))
        style_panel(axes)
    caption = make_caption(experiments, _MEANING_OF_MARKS, limits)
    ordered_handles = [handles[key] for key in sorted(handles)]
    return label_figure(figure, "convergence score $h_K$", "accuracy score $h_e$", caption, ordered_handles)


def _describe_accuracy(b: float, offset: float) -> str:
    """Return b and the flawed robots' b_hat for a legend; an offset of 0 stands for no flawed robots."""
    if not offset:
        return f"$b$ = {b:g}, none flawed"
    return rf"$b$ = {b:g}, $\hat{{b}}$ = {b + offset:g}"


def _colour_of_offset(offset: float) -> str:
    """Return a blue for an offset above 0 and a red below, darker the farther off, or INK for 0."""
    if not offset:
        return INK
    # The scale goes from red at 0 to blue at 1, and offsets from -0.5 to 0.5.
    return to_hex(colormaps["RdBu"](0.5 + offset))
