"""Scores of accuracy against scores of convergence, with a point for each trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle, product
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcp_asdf_tools.common.figures import INK, SMALL
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import make_caption, shown_values
from mcp_asdf_tools.experiments.plot_panels import (
    Results,
    accuracy_offset,
    create_panels,
    experiments_to_plot,
    group_into_series,
    label_figure,
    legend_handle,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, Limits

_MEANING_OF_MARKS = (
    "a point is a trial: blue where flawed robots are overconfident, red where they are underconfident, "
    "darker the farther off"
)
_MARKERS = "osD^v"


def plot_scatter(
    results: Results, *, where: Mapping[str, Any] | None = None, limits: Limits = PAPER_LIMITS
) -> Figure:
    """Plot the score h_e of trials against their h_K. Each f has a row of panels, and each P a column.

    h_e is the score for a small error, and h_K the score for fast convergence; f is the share of black tiles,
    and P the share of flawed robots. As in the paper's figure 4, every series has rows of its own. Swarms are
    blue if their flawed robots assume a better accuracy than the true one, b, and red if they assume a worse
    one; b decides the marker. ``where`` chooses experiments by their parameters. Raises UsageError if no
    experiment is left, or there are more panels or series than fit a picture.
    """
    experiments = experiments_to_plot(results, where)
    all_series = group_into_series(experiments)
    fill_ratios = shown_values(experiments, "fill_ratio")
    shares = shown_values(experiments, "flawed")
    # The order is that of the panels: a row has a series and an f, and its panels have rising P.
    panel_keys = list(product(all_series, fill_ratios, shares))
    figure, panels = create_panels(len(panel_keys), 1.7, len(all_series), max_columns=len(shares))
    legend = _legend_by_accuracies(experiments)
    for axes, (series, f, share) in zip(panels, panel_keys, strict=True):
        experiments_of_panel = series.select(fill_ratio=f, flawed=share).experiments
        _draw_points(axes, experiments_of_panel, limits, legend)
        axes.set_title(f"{series.label}\n$f = {f:g}$, $P$ = {share:.0%}", fontsize=SMALL)
    caption = make_caption(experiments, _MEANING_OF_MARKS, limits)
    x_label, y_label = "convergence score $h_K$", "accuracy score $h_e$"
    return label_figure(figure, x_label, y_label, caption, list(legend.values()))


def _accuracies_of(experiment: Experiment) -> tuple[float, float]:
    """Return b, the true accuracy of sensors, and the offset of the flawed robots' b_hat from b."""
    return experiment.true_accuracy, accuracy_offset(experiment)


def _legend_by_accuracies(experiments: Sequence[Trials]) -> dict[tuple[float, float], Line2D]:
    """Return the entries of the legend, by b and the offset of b_hat from b, in ascending order.

    Experiments of the same b and offset share an entry. Its marker shows b, and its colour the offset. With
    more than five b, markers are used again.
    """
    marker_of_accuracy = dict(zip(shown_values(experiments, "true_accuracy"), cycle(_MARKERS), strict=False))
    legend = {}
    for b, offset in sorted({_accuracies_of(trials.experiment) for trials in experiments}):
        label = _describe_accuracy(b, offset)
        legend[b, offset] = legend_handle(label, _colour_of_offset(offset), marker_of_accuracy[b])
    return legend


def _draw_points(
    axes: Axes,
    experiments: Sequence[Trials],
    limits: Limits,
    legend: Mapping[tuple[float, float], Line2D],
) -> None:
    """Draw the trials of some experiments as points, with h_K along x and h_e along y.

    ``legend`` has an entry for the accuracies of every experiment. The points of an experiment have the
    marker and the colour of that entry.
    """
    for trials in experiments:
        entry = legend[_accuracies_of(trials.experiment)]
        scores = trials.scores(limits)
        marker, colour = str(entry.get_marker()), entry.get_color()
        axes.plot(scores["h_K"], scores["h_e"], marker, color=colour, markersize=3, alpha=0.6)
    # Scores are 0 to 100; the margin keeps markers at the ends from being cut.
    axes.set(xlim=(-4, 104), ylim=(-4, 104))


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
