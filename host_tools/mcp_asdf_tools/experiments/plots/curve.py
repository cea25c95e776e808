"""Picture of a measure over any parameter: medians of the trials with their intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError, did_you_mean
from mcp_asdf_tools.common.figures import MEDIUM, SMALL, ordered_colours, style_panel
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plot_labels import (
    MAX_LABEL_LENGTH,
    flawed_share,
    make_caption,
    parameter_in_words,
    parameter_with_value,
    shorten,
    sort_key,
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
    legend_handle,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPER_LIMITS, SCORES, Limits

MEASURES = (*SCORES, "K", "e")

Measure = Callable[[Trials], NDArray[np.float64]]
"""Returns a value for each trial of an experiment."""


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
    if limits is not None and y not in SCORES:
        raise UsageError("limits would do nothing: they are for scores, and y is none; leave them out")
    limits = limits or PAPER_LIMITS
    experiments = experiments_to_plot(results, where)
    _check_axes(experiments, x, hue, y, facet)
    all_series = _series_by_hue(experiments, hue)
    x_values = _sorted_axis_values(experiments, x)
    y_label = y if isinstance(y, str) else getattr(y, "__name__", "y")
    handles = []
    if hue:  # without a hue there is a single curve, which needs no legend
        handles = [legend_handle(series.label, series.colour, line="-") for series in all_series]
    measure = partial(_measured_values, y=y, limits=limits)
    if ax is not None and facet:
        raise UsageError("facet makes panels and ax is one; give one of them")
    if ax is not None:
        # The figure is the caller's, so it gets no caption.
        _draw_curves(ax, all_series, x, x_values, measure)
        ax.set(xlabel=parameter_in_words(x), ylabel=y_label)
        if hue:
            ax.legend(handles=handles, frameon=False, fontsize=SMALL)
        return cast(Figure, ax.get_figure(root=True))
    titles_and_series = _split_into_panels(experiments, all_series, facet)
    panel_height = 2.6 if len(titles_and_series) > 1 else 3.8
    figure, panels = create_panels(len(titles_and_series), panel_height, len(all_series))
    for axes, (title, series_of_panel) in zip(panels, titles_and_series, strict=True):
        _draw_curves(axes, series_of_panel, x, x_values, measure)
        axes.set_title(title, fontsize=MEDIUM)
    marks = f"points are medians over the trials, {describe_intervals(experiments)}"
    caption = make_caption(experiments, marks, limits)
    return label_figure(figure, parameter_in_words(x), y_label, caption, handles)


def _series_by_hue(experiments: Sequence[Trials], hue: str) -> list[Series]:
    """Return a series for each value of the parameter ``hue``, or one of all experiments if it is empty."""
    if not hue:
        return [Series("", ordered_colours(1)[0], list(experiments))]
    hue_values = _sorted_axis_values(experiments, hue)
    # Values of other parameters have an order, which their colours show.
    colours = colours_of_filters(hue_values) if hue == "filter" else ordered_colours(len(hue_values))
    return [
        Series(parameter_with_value(hue, value), colour, _with_value(experiments, hue, value))
        for value, colour in zip(hue_values, colours, strict=True)
    ]


def _split_into_panels(
    experiments: Sequence[Trials], all_series: Sequence[Series], facet: str
) -> list[tuple[str, list[Series]]]:
    """Return title and series of each panel: one for each value of the parameter ``facet``.

    Without a facet there is one panel with all series, which has no title.
    """
    if not facet:
        return [("", list(all_series))]
    panels = []
    for value in _sorted_axis_values(experiments, facet):
        series_of_panel = [
            replace(series, experiments=_with_value(series.experiments, facet, value))
            for series in all_series
        ]
        panels.append((parameter_with_value(facet, value), series_of_panel))
    return panels


def _with_value(experiments: Sequence[Trials], parameter_name: str, value: Any) -> list[Trials]:
    """Return those experiments whose parameter has this value, as an axis shows it."""
    return [trials for trials in experiments if _axis_value(trials.experiment, parameter_name) == value]


def _draw_curves(
    axes: Axes, all_series: Sequence[Series], x: str, x_values: Sequence[Any], measure: Measure
) -> None:
    """Draw a curve for each series: medians of the ``measure`` of its trials over the parameter ``x``.

    ``x_values`` are the values of the parameter in all panels.
    """
    for series in all_series:
        samples = {_axis_value(trials.experiment, x): measure(trials) for trials in series.experiments}
        _draw_curve(axes, samples, x_values, series.colour)


def _draw_curve(
    axes: Axes, samples: Mapping[Any, NDArray[np.float64]], x_values: Sequence[Any], colour: str
) -> None:
    """Draw a curve through the medians of ``samples``: by x value, a measured value of each trial.

    Where one of the ``x_values``, those of all panels, is a long text, such as a graph, they stand side by
    side with shortened labels. A series need not have been measured at every x of the others.
    """
    measured_x = [x for x in x_values if x in samples]
    long_texts = [x for x in x_values if isinstance(x, str) and len(x) > MAX_LABEL_LENGTH]
    # Long texts are labels of the axis, at the positions 0, 1, 2 and so on.
    positions = [x_values.index(x) for x in measured_x] if long_texts else measured_x
    if measured_x:
        band = median_intervals(samples[x] for x in measured_x)
        draw_band(axes, positions, band, colour, "o-")
    if long_texts:
        axes.set_xticks(range(len(x_values)), [shorten(x) for x in x_values])
    style_panel(axes)


def _measured_values(trials: Trials, y: str | Measure, limits: Limits) -> NDArray[np.float64]:
    """Return ``y`` of each trial; it is the name of one of MEASURES, or a function of the trials.

    ``limits`` are those of scores. Raises UsageError if the function does not give one number for each trial.
    """
    if isinstance(y, str):
        # For the type alone: all MEASURES are floats, but measures() also returns counts.
        return np.asarray(trials.measures(limits)[y], dtype=np.float64)
    values = np.asarray(y(trials), dtype=np.float64)
    if values.shape != (len(trials.numbers),):
        raise UsageError(
            f"y gives shape {values.shape}; return a number for each of {len(trials.numbers)} trials"
        )
    return values


def _axis_value(experiment: Experiment, parameter_name: str) -> Any:
    """Return the value of a parameter for an axis: of ``flawed`` the share of the robots."""
    if parameter_name == "flawed":
        return flawed_share(experiment)
    return experiment.parameters()[parameter_name]


def _sorted_axis_values(experiments: Sequence[Trials], parameter_name: str) -> list[Any]:
    """Return the different values of a parameter for an axis, in order; filters in the order of FILTERS."""
    values = {_axis_value(trials.experiment, parameter_name) for trials in experiments}
    return sorted(values, key=lambda value: sort_key(parameter_name, value))


def _check_axes(experiments: Sequence[Trials], x: str, hue: str, y: str | Measure, facet: str) -> None:
    """Raise UsageError for unknown names, or if the experiments differ in a parameter that is not shown.

    ``x``, ``hue`` and ``facet`` must be parameters, the last two may be empty; ``y`` must be one of MEASURES
    or a function. The number of trials may differ.
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
    hidden_names = varying_parameters(experiments, (x, hue, facet, "trials", "flawed"))
    # Equal shares of swarms of different sizes are no difference.
    flawed_shares = {flawed_share(trials.experiment) for trials in experiments}
    if "flawed" not in (x, hue, facet) and len(flawed_shares) > 1:
        hidden_names.append("flawed")
    if hidden_names:
        raise UsageError(
            f"the results differ in {', '.join(hidden_names)} too; choose with where NAME=VALUE, or name one "
            "with x, hue or facet"
        )
