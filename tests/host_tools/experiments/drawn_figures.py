"""What tests of pictures read from a figure: its panels, legend, caption, lines and bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_panels import median_interval
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials

SHORT_EXPERIMENT = Experiment(robots=4, flawed=0, steps=300, filter_period=100, trials=5, filter="none")

GREY, GREEN = "#999999", "#009e73"
"""Colours of swarms without a filter, and with the robust one."""


def results_of(experiment: Experiment, sampling_interval: int = 0) -> Trials:
    """Run all trials of an experiment, recorded every ``sampling_interval`` steps; 0 means never."""
    return run_trials(experiment, first=0, trials=experiment.trials, sampling_interval=sampling_interval)


def visible_axes(figure: Figure) -> list[Axes]:
    """Return the panels of a figure, without the empty ones at the end of its last row."""
    return [axes for axes in figure.axes if axes.axison]


def titles_of(figure: Figure) -> list[str]:
    """Return the titles of the panels, in the middle or on the left, with plain spaces."""
    titles = [axes.get_title() or axes.get_title("left") for axes in visible_axes(figure)]
    return [title.replace("\N{NO-BREAK SPACE}", " ") for title in titles]


def legend_of(figure: Figure) -> list[str]:
    """Return the entries of a figure's only legend."""
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def caption_of(figure: Figure) -> str:
    """Return label and caption below a figure, in one line."""
    text: str = figure._supxlabel.get_text()  # type: ignore[attr-defined]
    return " ".join(text.split())


def x_values_of(line: Line2D) -> list[float]:
    """Return where the points of a line stand along the x axis."""
    values: list[float] = np.asarray(line.get_xdata()).tolist()
    return values


def y_values_of(line: Line2D) -> list[float]:
    """Return the heights of a line's points."""
    values: list[float] = np.asarray(line.get_ydata()).tolist()
    return values


@dataclass(frozen=True)
class Layout:
    """How many panels a figure has, its width in inches, and the height that it gives a row of them."""

    rows: int
    columns: int
    width: float
    panel_height: float


def layout_of(figure: Figure) -> Layout:
    """Return the layout of a figure; 1.4 inches of its height are for title, legend and caption."""
    subplot: Any = figure.axes[0].get_subplotspec()
    rows, columns, *_ = subplot.get_geometry()
    width, height = figure.get_size_inches()
    return Layout(rows, columns, round(width, 6), round((height - 1.4) / rows, 6))


def band_edges(band: Any, x: float) -> tuple[float, float]:
    """Return the lower and the upper edge of a band at one of its x values."""
    corners = np.asarray(band.get_paths()[0].vertices)  # a row for each corner, with its x and its height
    heights = corners[corners[:, 0] == x, 1]
    return float(heights.min()), float(heights.max())


def assert_line_has_medians_in_band(line: Any, band: Any, samples_by_x: Mapping[float, NDArray[Any]]) -> None:
    """Fail unless a line goes through the median of each sample, and its band over the 95 % interval."""
    assert line.get_xdata().tolist() == list(samples_by_x)
    for height, (x, sample) in zip(line.get_ydata(), samples_by_x.items(), strict=True):
        median, lower_end, upper_end = median_interval(sample)
        assert height == median
        assert band_edges(band, x) == (lower_end, upper_end)
