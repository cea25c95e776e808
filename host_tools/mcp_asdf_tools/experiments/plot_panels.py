"""What pictures of results share: grids of panels, legends, series in their colours, and lines in a band."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import (
    COLOURS,
    MEDIUM,
    WIDTH,
    add_caption,
    add_legend,
    empty_figure,
    style_panel,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import (
    ALWAYS_SHOWN_PARAMETERS,
    name_series,
    shown_value,
    sorted_by_filter,
    varying_parameters,
)
from mcp_asdf_tools.experiments.result_files import stream_experiments
from mcp_asdf_tools.experiments.results import Trials, select_experiments
from mcp_asdf_tools.robots.filters import FILTERS

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]

MIN_TRIALS_OF_INTERVAL = 6
"""Trials from which on a median has a 95 % interval."""

Results: TypeAlias = "pa.Table | Sequence[Trials]"
"""Pictures are drawn of a table of trials, or of experiments from ``experiments_in``."""

COLOUR_OF_HEALTHY_ROBOTS = COLOURS[0]
"""Colour of robots that are not flawed."""
COLOUR_OF_FLAWED_ROBOTS = COLOURS[1]
"""Colour of flawed robots, whose assumed accuracy is wrong at the start."""

_MAX_SERIES = 8
_MAX_PANELS = 32
_LEGEND_AND_CAPTION_HEIGHT = 1.4  # inches


def experiments_to_plot(results: Results, where: Mapping[str, Any] | None) -> list[Trials]:
    """Return the experiments of results whose parameters have the values in ``where``; None selects all.

    ``results`` are a list of experiments with their trials, or a table whose rows are trials. Raises
    UsageError if no experiment is left.
    """
    experiments = results if isinstance(results, Sequence) else list(stream_experiments(results))
    selected = select_experiments(experiments, where or {})
    if not selected:
        raise UsageError("there is no experiment to draw; give results of one or more")
    return selected


def create_panels(
    count: int, panel_height: float, series_count: int = 1, max_columns: int = 3, sharex: bool = True
) -> tuple[Figure, list[Axes]]:
    """Create a figure with ``count`` empty panels in rows, of which the last may be shorter.

    Returns the figure and its panels, row by row. A panel is ``panel_height`` inches high, and a row has up
    to ``max_columns`` of them. They have the same y axis, and unless ``sharex`` is false the same x axis.
    ``series_count`` is the number of series in the whole picture. Raises UsageError for more than 32 panels
    or 8 series, which do not fit a picture.
    """
    _check_fits_picture(count, series_count)
    column_count = min(count, max_columns)
    row_count = math.ceil(count / column_count)
    # A single panel across the page would be too wide for its height.
    width = WIDTH if column_count > 1 else 0.7 * WIDTH
    figure = empty_figure(width, _LEGEND_AND_CAPTION_HEIGHT + panel_height * row_count)
    # Without squeeze=False a single row would have another shape.
    grid = figure.subplots(row_count, column_count, sharex=sharex, sharey=True, squeeze=False)
    panels = [*grid.flat[:count]]
    for axes in panels:
        style_panel(axes)
    for unused_axes in grid.flat[count:]:
        unused_axes.set_axis_off()
    return figure, panels


def _check_fits_picture(panel_count: int, series_count: int) -> None:
    """Raise UsageError, with the limits, for more panels or series than fit a picture."""
    if panel_count > _MAX_PANELS or series_count > _MAX_SERIES:
        raise UsageError(
            f"{panel_count} panels with {series_count} series do not fit a picture; plot at most "
            f"{_MAX_PANELS} with {_MAX_SERIES}, or a parameter along an axis: --kind curve --x NAME"
        )


def label_figure(
    figure: Figure, x_label: str, y_label: str, caption: str, legend_handles: Sequence[Line2D]
) -> Figure:
    """Add labels of the axes, a caption and a legend to a figure, and return it."""
    figure.supylabel(y_label, fontsize=MEDIUM)
    # Below the panels a figure has room for one text: the caption with the x label above it.
    add_caption(figure, x_label, caption)
    add_legend(figure, legend_handles)
    return figure


def legend_handle(label: str, colour: str, marker: str = "o", line: Literal["", "-"] = "") -> Line2D:
    """Return an entry of a legend: a marker, a line or both."""
    return Line2D([], [], linestyle=line, marker=marker, color=colour, label=label)


# --- Series ----------------------------------------------------------------------------------------------

SeriesName = Callable[[Experiment], str]
"""Returns the name of the series that an experiment belongs to."""


@dataclass(frozen=True)
class Series:
    """Experiments that a picture shows in one colour, with one entry of its legend.

    Attributes:
        label: Text of the legend.
        colour: Colour of all that is drawn of the series.
        experiments: What is drawn, all panels together.
    """

    label: str
    colour: str
    experiments: list[Trials]

    def select(self, **values: Any) -> Series:
        """Return this series with those of its experiments in which the named parameters have these values.

        The values are those of ``shown_value``, so ``flawed`` is a share of the robots.
        """
        selected = self.experiments
        for name, value in values.items():
            selected = [trials for trials in selected if shown_value(trials.experiment, name) == value]
        return replace(self, experiments=selected)


def legend_of_series(
    all_series: Sequence[Series], marker: str = "o", line: Literal["", "-"] = ""
) -> list[Line2D]:
    """Return the entries of a legend. Each series has one: a marker, a line or both in its colour."""
    return [legend_handle(series.label, series.colour, marker, line) for series in all_series]


def colours_of_filters(filter_names: Sequence[str]) -> list[str]:
    """Return a colour for each series, by the name of its filter.

    The first series of a filter has the filter's colour, if it has one; every other series has the next free
    colour of the palette, which begins again after its last one. A name that is no filter's, such as "", is
    allowed.
    """
    remaining_colours = {
        name: swarm_filter.colour for name, swarm_filter in FILTERS.items() if swarm_filter.colour is not None
    }
    # After the last colour the first one comes again: ``create_panels`` refuses too many series.
    free_colours = cycle([colour for colour in COLOURS if colour not in remaining_colours.values()])
    colours: list[str] = []
    for name in filter_names:
        # The colour is removed, so that the next series of this filter gets another one.
        colour = remaining_colours.pop(name, None)
        if colour is None:
            colour = next(free_colours)
        colours.append(colour)
    return colours


def group_into_series(experiments: Sequence[Trials], series_name: SeriesName | None = None) -> list[Series]:
    """Return the experiments of equal names as series, in the colour of their filter if they have only one.

    Both series and the experiments in them are in the order of FILTERS, and otherwise as they are passed. By
    default a series is named by its filter and by the parameters in which the experiments differ, but for
    those that pictures show otherwise (ALWAYS_SHOWN_PARAMETERS).
    """
    varying_names = varying_parameters(experiments, excluded=ALWAYS_SHOWN_PARAMETERS)
    experiments_by_name: dict[str, list[Trials]] = {}
    for trials in sorted_by_filter(experiments):
        if series_name is None:
            series_label = name_series(trials.experiment, varying_names)
        else:
            series_label = series_name(trials.experiment)
        experiments_by_name.setdefault(series_label, []).append(trials)
    colours = colours_of_filters([_common_filter(group) for group in experiments_by_name.values()])
    return [
        Series(label, colour, group)
        for (label, group), colour in zip(experiments_by_name.items(), colours, strict=True)
    ]


def _common_filter(experiments: Sequence[Trials]) -> str:
    """Return the name of the filter that all experiments have, or an empty name if they have several."""
    different_names = {trials.experiment.filter for trials in experiments}
    return different_names.pop() if len(different_names) == 1 else ""


def accuracy_offset(experiment: Experiment) -> float:
    """Return the accuracy that flawed robots assume minus the true one, b; 0 if no robot is flawed."""
    if not experiment.flawed:
        return 0.0
    # Rounding makes differences equal that differ by the error of floats alone, such as 0.9 - 0.8 and 0.1.
    return round(experiment.flawed_accuracy - experiment.true_accuracy, ndigits=9)


# --- Medians in their intervals --------------------------------------------------------------------------


def median_interval(sample: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the median of a sample with its 95 % interval from order statistics, exact for any distribution.

    The interval of fewer than MIN_TRIALS_OF_INTERVAL values is their range.
    """
    from scipy.stats import quantile_test  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

    # The ends are two values of the sample, which the binomial distribution of ranks chooses.
    low, high = quantile_test(sample, p=0.5).confidence_interval(0.95)
    has_interval = low <= high  # both are NaN where there is none
    if not has_interval:
        low, high = sample.min(), sample.max()
    return float(np.median(sample)), float(low), float(high)


def median_intervals(samples: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the medians of samples, and the lower and upper ends of their intervals, shape (3, samples).

    The intervals are those of ``median_interval``.
    """
    intervals = np.array([median_interval(sample) for sample in samples])  # shape (samples, 3)
    return intervals.T


def describe_intervals(experiments: Sequence[Trials]) -> str:
    """Return what the band around a median covers, for a caption: all trials where they are few, or 95 %."""
    if min(len(trials.numbers) for trials in experiments) < MIN_TRIALS_OF_INTERVAL:
        condition = f"where there are fewer than {MIN_TRIALS_OF_INTERVAL}"
        return f"bands all trials {condition}, else 95 % intervals of the medians"
    return "bands their 95 % intervals"


def draw_band(axes: Axes, x: Any, band: NDArray[np.float64], colour: str, style: str = "-") -> None:
    """Draw a line in a translucent band over the positions ``x``.

    ``band`` has the line, its lower edge and its upper edge, shape (3, points). ``style`` is matplotlib's
    format of the line, such as "o-".
    """
    line, lower_edge, upper_edge = band
    axes.fill_between(x, lower_edge, upper_edge, facecolor=colour, alpha=0.2)
    axes.plot(x, line, style, color=colour, markersize=3.5, linewidth=1.4)
