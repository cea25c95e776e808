"""Pictures of the scores of trials: boxes of H by cell, and h_e against h_K."""

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


def group_into_series(
    experiments: Sequence[Trials], series_name: SeriesName | None = None
) -> dict[str, list[Trials]]:
    """Return experiments by the name of their series, in the order of their filters.

    By default a series is named by its filter and by all other parameters that vary.
    """
    varying_names = varying_parameters(experiments, CELL_PARAMETERS)
    series: dict[str, list[Trials]] = {}
    for trials in sorted(experiments, key=lambda trials: sort_key("filter", trials.experiment.filter)):
        if series_name is None:
            name = name_series(trials.experiment, varying_names)
        else:
            name = series_name(trials.experiment)
        series.setdefault(name, []).append(trials)
    return series


def _colours_of_series(series: dict[str, list[Trials]]) -> list[str]:
    """Return a colour for each series: its filter's, if all its experiments have the same."""
    filter_names = []
    for experiments in series.values():
        different_names = {trials.experiment.filter for trials in experiments}
        filter_names.append(different_names.pop() if len(different_names) == 1 else "")
    return colours_of_filters(filter_names)


def _sorted_attributes(experiments: Sequence[Trials], name: str) -> list[float]:
    """Return the different values of an attribute of the experiments, in order."""
    return sorted({getattr(trials.experiment, name) for trials in experiments})


def _accuracy_offset(experiment: Experiment) -> float:
    """Return b_hat less b of flawed robots; 0 where there are none."""
    if not experiment.flawed:
        return 0.0
    return round(experiment.flawed_accuracy - experiment.true_accuracy, 9)


# --- Boxes -----------------------------------------------------------------------------------------------


def plot_boxes(
    experiments: Sequence[Trials], limits: Limits = PAPERS, series_name: SeriesName | None = None
) -> Figure:
    """Plot boxes of H by the share P of flawed robots and their accuracy, as in the paper's figures 3 and 5.

    There is a panel for each f and b, and a colour for each series. A point for each trial shows what a box
    hides: cells whose trials fall into two groups. Raises UsageError if there is more than fits a picture.
    """
    series = group_into_series(experiments, series_name)
    colours = _colours_of_series(series)
    fill_ratios = _sorted_attributes(experiments, "fill_ratio")
    accuracies = _sorted_attributes(experiments, "true_accuracy")
    figure, grid = create_panel_grid(len(fill_ratios), len(accuracies), 2.6, len(series), sharex=False)
    for (row, column), axes in np.ndenumerate(grid):
        f, b = fill_ratios[row], accuracies[column]
        series_of_panel = [
            [
                trials
                for trials in experiments_of_series
                if (trials.experiment.fill_ratio, trials.experiment.true_accuracy) == (f, b)
            ]
            for experiments_of_series in series.values()
        ]
        _draw_box_panel(axes, series_of_panel, colours, limits)
        axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
    x_label = r"$\hat{b} - b$ of flawed robots, and their proportion $P$"
    caption = make_caption(experiments, _BOX_MARKS, limits)
    handles = [legend_handle(name, colour, "s") for name, colour in zip(series, colours, strict=True)]
    return label_figure(figure, x_label, "score $H$", caption, handles)


def _draw_box_panel(
    axes: Axes, series: Sequence[Sequence[Trials]], colours: Sequence[str], limits: Limits
) -> None:
    """Draw a box for each experiment of a panel.

    There is a slot for each P and offset of b_hat, in which the boxes of the series stand side by side.
    """
    slots = sorted({_slot_of(trials.experiment) for experiments in series for trials in experiments})
    box_width = _SLOT_WIDTH / len(series)
    for series_index, (experiments, colour) in enumerate(zip(series, colours, strict=True)):
        for trials in experiments:
            slot_index = slots.index(_slot_of(trials.experiment))
            middle = slot_index + (series_index + 0.5) * box_width - 0.43
            _draw_box(axes, trials.scores(limits)["H"], middle, 0.85 * box_width, colour)
    axes.set(ylim=(0, 103), xlim=(-0.5, len(slots) - 0.5))
    axes.set_xticks(range(len(slots)), [f"{offset:+.2g}\n{share:.0%}" for share, offset in slots])
    clean(axes)


def _slot_of(experiment: Experiment) -> tuple[float, float]:
    """Return P and the offset of the flawed robots' accuracy."""
    return flawed_share(experiment), _accuracy_offset(experiment)


def _draw_box(axes: Axes, scores: NDArray[np.float64], middle: float, width: float, colour: str) -> None:
    """Draw a box, and a point for each trial, spread evenly over the box's width."""
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
    distances = (np.arange(len(scores)) * _GOLDEN_RATIO % 1 - 0.5) * width
    axes.plot(middle + distances, scores, ".", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)


# --- Scatter ---------------------------------------------------------------------------------------------


def plot_scatter(experiments: Sequence[Trials], limits: Limits = PAPERS) -> Figure:
    """Plot h_e against h_K with a point for each trial, as in the paper's figure 4.

    There is a row for each series and f, and a column for each P. Overconfident swarms are blue,
    underconfident ones red; each b has a marker. Raises UsageError if there is more than fits a picture.
    """
    series = group_into_series(experiments)
    fill_ratios = _sorted_attributes(experiments, "fill_ratio")
    accuracies = _sorted_attributes(experiments, "true_accuracy")
    shares = sorted({flawed_share(trials.experiment) for trials in experiments})
    rows = [(name, f) for name in series for f in fill_ratios]
    figure, grid = create_panel_grid(len(rows), len(shares), 1.7, len(series))
    handles: dict[tuple[float, float], Line2D] = {}  # by b and the offset of b_hat
    for (row, column), axes in np.ndenumerate(grid):
        name, f = rows[row]
        for trials in series[name]:
            experiment = trials.experiment
            if (experiment.fill_ratio, flawed_share(experiment)) != (f, shares[column]):
                continue
            b, offset = experiment.true_accuracy, _accuracy_offset(experiment)
            colour, marker = _colour_of_offset(offset), _MARKERS[accuracies.index(b) % len(_MARKERS)]
            scores = trials.scores(limits)
            axes.plot(scores["h_K"], scores["h_e"], marker, color=colour, markersize=3, alpha=0.6)
            handles[b, offset] = legend_handle(_describe_accuracy(b, offset), colour, marker)
        axes.set_title(f"{name}\n$f = {f:g}$, $P$ = {shares[column]:.0%}", fontsize=SMALL)
        axes.set(xlim=(-4, 104), ylim=(-4, 104))
        clean(axes)
    caption = make_caption(experiments, _SCATTER_MARKS, limits)
    ordered_handles = [handles[key] for key in sorted(handles)]
    return label_figure(figure, "convergence score $h_K$", "accuracy score $h_e$", caption, ordered_handles)


def _describe_accuracy(b: float, offset: float) -> str:
    """Return b and the flawed robots' b_hat for a legend."""
    return rf"$b$ = {b:g}, $\hat{{b}}$ = {b + offset:g}" if offset else f"$b$ = {b:g}, none flawed"


def _colour_of_offset(offset: float) -> str:
    """Return a blue for an offset above 0, a red below, darker the farther off; -0.5 and 0.5 are the ends."""
    return to_hex(colormaps["RdBu"](0.5 + offset)) if offset else INK
