"""Pictures of the scores of trials: boxes of H by cell, and h_e against h_K.

The scores are the paper's, at most 100: h_K is that for fast convergence, h_e that for a small error, and H
is their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.figures import INK, MEDIUM, SMALL, clean
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import (
    CELL_PARAMETERS,
    flawed_share,
    make_caption,
    name_series,
    sort_key,
    varying_parameters,
)
from mcp_asdf_tools.experiments.plot_panels import (
    Series,
    colours_of_filters,
    create_panel_grid,
    label_figure,
    legend_handle,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPERS, Limits

SeriesName = Callable[[Experiment], str]
"""Returns the name of the series that an experiment belongs to."""

_BOX_MARKS = (
    "a point is a trial; boxes from quartile to quartile with the median, whiskers to the last trial within "
    "1.5 of their length"
)
_SCATTER_MARKS = (
    "a point is a trial: blue where flawed robots are overconfident, red where they are underconfident, "
    "darker the farther off"
)
_SLOT_WIDTH = 0.86
"""Width that the boxes of a slot share, where slots are 1 apart."""

_GOLDEN_RATIO = 0.618
"""Multiples of it, less their integers, are spread evenly, however many they are."""

_MARKERS = "osD^v"


def group_into_series(experiments: Sequence[Trials], series_name: SeriesName | None = None) -> list[Series]:
    """Return the experiments of equal names as series, in the colour of their filter if they have only one.

    Both series and the experiments in them are in the order of FILTERS, and otherwise as they are passed. By
    default a series is named by its filter and by the parameters in which the experiments differ, but for
    those that pictures show otherwise (CELL_PARAMETERS).
    """
    varying_names = varying_parameters(experiments, excluded=CELL_PARAMETERS)
    experiments_by_name: dict[str, list[Trials]] = {}
    for trials in sorted(experiments, key=lambda trials: sort_key("filter", trials.experiment.filter)):
        if series_name is None:
            name = name_series(trials.experiment, varying_names)
        else:
            name = series_name(trials.experiment)
        experiments_by_name.setdefault(name, []).append(trials)
    colours = colours_of_filters([_common_filter(group) for group in experiments_by_name.values()])
    return [
        Series(name, colour, group)
        for (name, group), colour in zip(experiments_by_name.items(), colours, strict=True)
    ]


def _common_filter(experiments: Sequence[Trials]) -> str:
    """Return the name of the filter that all experiments have, or an empty name if they have several."""
    different_names = {trials.experiment.filter for trials in experiments}
    return different_names.pop() if len(different_names) == 1 else ""


def _sorted_attributes(experiments: Sequence[Trials], name: str) -> list[float]:
    """Return the different values of an attribute of the experiments, in order."""
    return sorted({getattr(trials.experiment, name) for trials in experiments})


def _accuracy_offset(experiment: Experiment) -> float:
    """Return how much better than b the accuracy is that flawed robots assume; 0 if there are none."""
    if not experiment.flawed:
        return 0.0
    # Rounding makes differences equal that differ by the error of floats alone, such as 0.9 - 0.8 and 0.1.
    return round(experiment.flawed_accuracy - experiment.true_accuracy, ndigits=9)


# --- Boxes -----------------------------------------------------------------------------------------------


def plot_boxes(
    experiments: Sequence[Trials], limits: Limits = PAPERS, series_name: SeriesName | None = None
) -> Figure:
    """Plot boxes of H by the share P of flawed robots and their accuracy, as in the paper's figures 3 and 5.

    There is a panel for each f, the share of black tiles, and b, the true accuracy, and a colour for each
    series of ``group_into_series``. A point for each trial shows what a box hides: cells whose trials fall
    into two groups. Raises UsageError if there are more panels or series than fit a picture.
    """
    all_series = group_into_series(experiments, series_name)
    fill_ratios = _sorted_attributes(experiments, "fill_ratio")
    accuracies = _sorted_attributes(experiments, "true_accuracy")
    figure, grid = create_panel_grid(len(fill_ratios), len(accuracies), 2.6, len(all_series), sharex=False)
    for (row, column), axes in np.ndenumerate(grid):
        f, b = fill_ratios[row], accuracies[column]
        _draw_box_panel(axes, [_select_panel(series, f, b) for series in all_series], limits)
        axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
    x_label = r"$\hat{b} - b$ of flawed robots, and their proportion $P$"
    caption = make_caption(experiments, _BOX_MARKS, limits)
    handles = [legend_handle(series.label, series.colour, "s") for series in all_series]
    return label_figure(figure, x_label, "score $H$", caption, handles)


def _select_panel(series: Series, f: float, b: float) -> Series:
    """Return the series with only those experiments that have this f and this b."""
    return series.select(lambda experiment: (experiment.fill_ratio, experiment.true_accuracy) == (f, b))


def _draw_box_panel(axes: Axes, series_of_panel: Sequence[Series], limits: Limits) -> None:
    """Draw a box for each experiment of a panel.

    Along the x axis there is a slot for each share P of flawed robots and offset of their b_hat from b, in
    which the boxes of the series stand side by side.
    """
    slots = sorted(
        {_slot_of(trials.experiment) for series in series_of_panel for trials in series.experiments}
    )
    box_width = _SLOT_WIDTH / len(series_of_panel)
    for series_index, series in enumerate(series_of_panel):
        # From the middle of a slot, whose position is a whole number.
        offset = (series_index + 0.5) * box_width - _SLOT_WIDTH / 2
        for trials in series.experiments:
            middle = slots.index(_slot_of(trials.experiment)) + offset
            _draw_box(axes, trials.scores(limits)["H"], middle, 0.85 * box_width, series.colour)
    axes.set(ylim=(0, 103), xlim=(-0.5, len(slots) - 0.5))
    axes.set_xticks(range(len(slots)), [f"{offset:+.2g}\n{share:.0%}" for share, offset in slots])
    clean(axes)


def _slot_of(experiment: Experiment) -> tuple[float, float]:
    """Return P, the share of flawed robots, and the offset of the accuracy that they assume."""
    return flawed_share(experiment), _accuracy_offset(experiment)


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
    shares_of_width = np.arange(len(scores)) * _GOLDEN_RATIO % 1
    distances = (shares_of_width - 0.5) * width  # from the middle of the box
    axes.plot(middle + distances, scores, ".", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)


# --- Scatter ---------------------------------------------------------------------------------------------


def plot_scatter(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """Plot h_e against h_K with a point for each trial, as in the paper's figure 4.

    There is a row for each series and f, the share of black tiles, and a column for each P, the share of
    flawed robots. Swarms whose flawed robots assume a better accuracy than the true one, b, are blue, those
    who assume a worse one red; each b has a marker. Raises UsageError if there are more panels or series
    than fit a picture.
    """
    all_series = group_into_series(experiments)
    fill_ratios = _sorted_attributes(experiments, "fill_ratio")
    accuracies = _sorted_attributes(experiments, "true_accuracy")
    shares = sorted({flawed_share(trials.experiment) for trials in experiments})
    rows = [(series, f) for series in all_series for f in fill_ratios]
    figure, grid = create_panel_grid(len(rows), len(shares), 1.7, len(all_series))
    # An entry of the legend for each b and offset of b_hat that occurs.
    handles: dict[tuple[float, float], Line2D] = {}
    for (row, column), axes in np.ndenumerate(grid):
        series, f = rows[row]
        for trials in series.experiments:
            experiment = trials.experiment
            is_of_panel = (experiment.fill_ratio, flawed_share(experiment)) == (f, shares[column])
            if not is_of_panel:
                continue
            b, offset = experiment.true_accuracy, _accuracy_offset(experiment)
            colour = _colour_of_offset(offset)
            marker = _MARKERS[accuracies.index(b) % len(_MARKERS)]
            scores = trials.scores(limits)
            axes.plot(scores["h_K"], scores["h_e"], marker, color=colour, markersize=3, alpha=0.6)
            handles[b, offset] = legend_handle(_describe_accuracy(b, offset), colour, marker)
        axes.set_title(f"{series.label}\n$f = {f:g}$, $P$ = {shares[column]:.0%}", fontsize=SMALL)
        axes.set(xlim=(-4, 104), ylim=(-4, 104))
        clean(axes)
    caption = make_caption(experiments, _SCATTER_MARKS, limits)
    ordered_handles = [handles[key] for key in sorted(handles)]
    return label_figure(figure, "convergence score $h_K$", "accuracy score $h_e$", caption, ordered_handles)


def _describe_accuracy(b: float, offset: float) -> str:
    """Return b and the flawed robots' b_hat for a legend; an offset of 0 stands for no flawed robots."""
    if not offset:
        return f"$b$ = {b:g}, none flawed"
    return rf"$b$ = {b:g}, $\hat{{b}}$ = {b + offset:g}"


def _colour_of_offset(offset: float) -> str:
    """Return a blue for an offset above 0 and a red below, darker the farther off, or INK for 0.

    Offsets of -0.5 and 0.5 are the ends of the scale.
    """
    if not offset:
        return INK
    return to_hex(colormaps["RdBu"](0.5 + offset))
