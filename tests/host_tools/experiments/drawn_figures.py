"""What tests of pictures read from a figure: its panels, legend, caption, lines and bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_panels import median_interval
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials

SHORT_EXPERIMENT = Experiment(robots=4, flawed=0, steps=300, filter_period=100, trials=5, filter="none")

GREY, GREEN = "#999999", "#009e73"
"""Colours of swarms without a filter, and with the robust one."""


def results_of(experiment: Experiment, sampling_interval: int = 0) -> Trials:
    """Run all trials of an experiment."""
    return run_trials(experiment, 0, experiment.trials, sampling_interval)


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


def assert_panels(figure: Figure, rows: int, columns: int, panel_height: float) -> None:
    """Assert that panels have these rows and columns, share a y axis and fit a page, in inches."""
    width = 9 if columns > 1 else 6.3
    assert tuple(figure.get_size_inches()) == pytest.approx((width, 1.4 + rows * panel_height))
    first_axes, *other_axes = visible_axes(figure)
    for axes in (first_axes, *other_axes):
        assert axes.get_subplotspec().get_geometry()[:2] == (rows, columns)  # type: ignore[union-attr]
        assert not axes.spines["top"].get_visible()
    assert all(axes.get_shared_y_axes().joined(axes, first_axes) for axes in other_axes)


def band_edges(band: Any, x: float) -> tuple[float, float]:
    """Return the lower and the upper edge of a band at one of its x values."""
    corners = np.asarray(band.get_paths()[0].vertices)
    heights = corners[corners[:, 0] == x, 1]
    return float(heights.min()), float(heights.max())


def assert_medians(line: Any, band: Any, samples_by_x: Mapping[float, NDArray[Any]]) -> None:
    """Assert that a line goes through the medians of samples, in a band of their 95 % intervals."""
    assert line.get_xdata().tolist() == [*samples_by_x]
    for (x, sample), y in zip(samples_by_x.items(), line.get_ydata(), strict=True):
        assert (y, *band_edges(band, x)) == median_interval(sample)
    assert not band.get_edgecolor().size
