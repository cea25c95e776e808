"""Picture of a measure over any parameter: medians of the trials with their intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError, did_you_mean
from mcp_asdf_tools.common.figures import MEDIUM, SMALL, ordered_colours, style_panel
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import (
    MAX_LABEL_LENGTH,
    make_caption,
    parameter_in_words,
    parameter_with_value,
    shorten,
    shown_value,
    shown_values,
    varying_parameters,
)
from mcp_asdf_tools.experiments.plot_panels import (
    Results,
    Series,
    colours_of_filters,
    create_panels,
    describe_intervals,
    draw_band,
    experiments_to_plot,
    label_figure,
    legend_of_series,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, SCORES, Limits

MEASURES = (*SCORES, "K", "e")

Measure = Callable[[Trials], NDArray[np.float64]]
"""Measures the trials of an experiment; the result has one value per trial."""


def plot_curve(  # noqa: PLR0913 (each is given by name)
    results: Results,
    x: str = "",
    y: str | Measure = "H",
    *,
    hue: str = "",
    facet: str = "",
    ax: Axes | None = None,
    where: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
) -> Figure:
    """Plot medians of the measure ``y`` over the parameter ``x``, with their 95 % intervals.

    ``y`` is H, h_K, h_e, K, e, or a function of ``Trials`` that returns a number for each trial. There is a
    curve for each value of the parameter ``hue``, and a panel for each value of ``facet``, or the curves are
    drawn into the axes ``ax``, whose figure is then returned. The parameter ``flawed`` is shown as the share
    of the robots. Scores are relative to ``limits``, by default the paper's. Raises UsageError for a name
    that is no parameter, if the experiments differ in what is not shown, for limits where ``y`` is no score,
    for ``facet`` together with ``ax``, and for more panels or curves than fit a picture.
    """
    _check_axes(x, hue, y, facet)
    if limits is not None and y not in SCORES:
        raise UsageError("limits would do nothing: they are for scores, and y is none; leave them out")
    if ax is not None and facet:
        raise UsageError("facet makes panels and ax is one; give one of them")
    experiments = experiments_to_plot(results, where)
    _check_all_shown(experiments, shown_names=(x, hue, facet))
    plot = _CurvePlot(experiments, x, y, hue, limits or PAPER_LIMITS)
    if ax is not None:
        return plot.draw_into(ax)
    return plot.draw_panels(facet)


def _check_axes(x: str, hue: str, y: str | Measure, facet: str) -> None:
    """Raise UsageError for unknown names.

    ``x``, ``hue`` and ``facet`` must be parameters, the last two may be empty; ``y`` must be one of MEASURES
    or a function.
    """
    parameter_names = parameters_of(Experiment)
    for option, name in (("x", x), ("hue", hue), ("facet", facet)):
        is_left_out = name == "" and option != "x"
        if name not in parameter_names and not is_left_out:
            all_names = f"; choose a parameter: {', '.join(parameter_names)}"
            # Without a similar name the first one is empty.
            fix = did_you_mean(name, parameter_names) or all_names
            raise UsageError(f"{option} is {name!r}{fix}")
    if not callable(y) and y not in MEASURES:
        raise UsageError(f"y is {y!r}; choose one of {', '.join(MEASURES)}")


def _check_all_shown(experiments: Sequence[Trials], shown_names: Sequence[str]) -> None:
    """Raise UsageError if the experiments differ in a parameter that is none of ``shown_names``.

    The number of trials may differ, and so may the number of flawed robots if they are equal shares.
    """
    hidden_names = varying_parameters(experiments, excluded=(*shown_names, "trials", "flawed"))
    if "flawed" not in shown_names and len(shown_values(experiments, "flawed")) > 1:
        hidden_names.append("flawed")
    if hidden_names:
        raise UsageError(
            f"the results differ in {', '.join(hidden_names)} too; choose with where NAME=VALUE, or name one "
            "with x, hue or facet"
        )


def _series_by_hue(experiments: Sequence[Trials], hue: str) -> list[Series]:
    """Return a series for each value of the parameter ``hue``, or one of all experiments if it is empty."""
    if not hue:
        return [Series("", ordered_colours(1)[0], list(experiments))]
    hue_values = shown_values(experiments, hue)
    # Values of other parameters have an order, which their colours show.
    colours = colours_of_filters(hue_values) if hue == "filter" else ordered_colours(len(hue_values))
    return [
        Series(parameter_with_value(hue, value), colour, list(experiments)).select(**{hue: value})
        for value, colour in zip(hue_values, colours, strict=True)
    ]


@dataclass(frozen=True)
class _CurvePlot:
    """A picture of curves.

    Attributes:
        experiments: What is drawn; they differ only in ``x``, ``hue`` and the parameter of the panels.
        x: The parameter along x.
        y: The name of one of MEASURES, or a function that measures trials.
        hue: The parameter of which each value has a curve; empty for a single curve.
        limits: Limits of the scores.
    """

    experiments: Sequence[Trials]
    x: str
    y: str | Measure
    hue: str
    limits: Limits

    def draw_into(self, axes: Axes) -> Figure:
        """Draw all curves into axes of the caller, with labels and a legend, and return their figure.

        The figure is the caller's, so it gets no caption.
        """
        all_series = _series_by_hue(self.experiments, self.hue)
        self._draw_curves(axes, all_series)
        style_panel(axes)
        axes.set(xlabel=parameter_in_words(self.x), ylabel=self._y_label)
        if self.hue:
            axes.legend(handles=self._legend(all_series), frameon=False, fontsize=SMALL)
        return cast(Figure, axes.get_figure(root=True))

    def draw_panels(self, facet: str) -> Figure:
        """Draw a panel for each value of the parameter ``facet``, or a single one if it is empty."""
        all_series = _series_by_hue(self.experiments, self.hue)
        facet_values = shown_values(self.experiments, facet) if facet else [None]
        # A picture of a single panel may be higher.
        panel_height = 2.6 if len(facet_values) > 1 else 3.8
        figure, panels = create_panels(len(facet_values), panel_height, len(all_series))
        for axes, value in zip(panels, facet_values, strict=True):
            series_of_panel = all_series
            if facet:
                # All panels select from the same series, so a series has the same colour in each of them.
                series_of_panel = [series.select(**{facet: value}) for series in all_series]
                axes.set_title(parameter_with_value(facet, value), fontsize=MEDIUM)
            self._draw_curves(axes, series_of_panel)
        marks = f"points are medians over the trials, {describe_intervals(self.experiments)}"
        caption = make_caption(self.experiments, marks, self.limits)
        legend = self._legend(all_series)
        return label_figure(figure, parameter_in_words(self.x), self._y_label, caption, legend)

    @property
    def _y_label(self) -> str:
        """The name of the measure or of the function."""
        return self.y if isinstance(self.y, str) else getattr(self.y, "__name__", "y")

    def _legend(self, all_series: Sequence[Series]) -> list[Line2D]:
        """Return the entries of the legend. Each series has one, but without a hue the legend is empty."""
        return legend_of_series(all_series, line="-") if self.hue else []

    def _draw_curves(self, axes: Axes, series_of_panel: Sequence[Series]) -> None:
        """Draw a curve for each series, over the values that ``x`` has in any panel.

        Where one of these values is a long text, such as a graph, they stand side by side at 0, 1, 2 and so
        on, with shortened labels.
        """
        x_values = shown_values(self.experiments, self.x)
        position_by_x = {x: x for x in x_values}
        if any(isinstance(x, str) and len(x) > MAX_LABEL_LENGTH for x in x_values):
            # A long text stands at its index, since another one may have the same shortened label.
            position_by_x = {x: index for index, x in enumerate(x_values)}
            axes.set_xticks(range(len(x_values)), [shorten(x) for x in x_values])
        for series in series_of_panel:
            self._draw_curve(axes, series, position_by_x)

    def _draw_curve(self, axes: Axes, series: Series, position_by_x: Mapping[Any, Any]) -> None:
        """Draw a curve through the medians of a series, and a band of their confidence intervals around it.

        The series need not have trials at every x.
        """
        samples = {
            shown_value(trials.experiment, self.x): self._measure(trials) for trials in series.experiments
        }
        measured_x = [x for x in position_by_x if x in samples]  # in order
        if measured_x:
            positions = [position_by_x[x] for x in measured_x]
            band = median_intervals(samples[x] for x in measured_x)
            draw_band(axes, positions, band, series.colour, "o-")

    def _measure(self, trials: Trials) -> NDArray[np.float64]:
        """Return y of each trial, shape (trials,).

        Raises UsageError if y is a function that returns an array of another shape.
        """
        if isinstance(self.y, str):
            # For the type alone: all MEASURES are floats, but measures() also returns counts.
            return np.asarray(trials.measures(self.limits)[self.y], dtype=np.float64)
        values = np.asarray(self.y(trials), dtype=np.float64)
        if values.shape != (len(trials.numbers),):
            raise UsageError(
                f"y gives shape {values.shape}; return a number for each of {len(trials.numbers)} trials"
            )
        return values
