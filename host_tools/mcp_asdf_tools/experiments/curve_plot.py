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

from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.figures import MEDIUM, SMALL, clean, ordered_colours
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
    colours_of_filters,
    create_panels,
    describe_intervals,
    draw_band,
    label_figure,
    legend_handle,
    median_intervals,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import PAPERS, SCORES, Limits

MEASURES = (*SCORES, "K", "e")

Measure = Callable[[Trials], NDArray[np.float64]]
"""Returns a value for each trial of an experiment."""


@dataclass(frozen=True)
class _Curves:
    """What a picture of curves shows.

    Attributes:
        x: Parameter along the axis.
        x_values: Its values in all panels.
        hue: Parameter with a curve for each value; empty for one curve.
        colours: Colour of each curve, by the value of ``hue``.
        y: What is shown over ``x``.
        limits: Limits of the scores.
    """

    x: str
    x_values: list[Any]
    hue: str
    colours: dict[Any, str]
    y: str | Measure
    limits: Limits

    @property
    def y_label(self) -> str:
        """Return the name of the measure."""
        return self.y if isinstance(self.y, str) else getattr(self.y, "__name__", "y")

    def legend_handles(self) -> list[Line2D]:
        """Return an entry for each value of ``hue``."""
        if not self.hue:
            return []
        return [
            legend_handle(parameter_with_value(self.hue, value), colour, line="-")
            for value, colour in self.colours.items()
        ]

    def draw(self, axes: Axes, experiments: Sequence[Trials]) -> None:
        """Draw the curves of some experiments into a panel, one for each value of ``hue``."""
        for hue_value, colour in self.colours.items():
            values_by_x = {
                _value(trials.experiment, self.x): _measure(trials, self.y, self.limits)
                for trials in experiments
                if not self.hue or _value(trials.experiment, self.hue) == hue_value
            }
            _draw_curve(axes, values_by_x, self.x_values, colour)


def plot_curve(  # noqa: PLR0913 (each is given by name)
    experiments: Sequence[Trials],
    x: str,
    hue: str = "",
    y: str | Measure = "H",
    limits: Limits = PAPERS,
    *,
    facet: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Plot the median of ``y``, one of MEASURES or a function, over a parameter ``x``, in its 95 % interval.

    There is a curve for each value of the parameter ``hue``, and a panel for each value of ``facet``; or the
    curves are drawn into ``ax``, whose figure is returned. Flawed robots are a share. Raises UsageError for
    unknown parameters, and if the experiments differ in any other.
    """
    _check_axes(experiments, x, hue, y, facet)
    hue_values: list[Any] = _sorted_values(experiments, hue) if hue else [None]
    colours = colours_of_filters(hue_values) if hue == "filter" else ordered_colours(len(hue_values))
    curves = _Curves(
        x, _sorted_values(experiments, x), hue, dict(zip(hue_values, colours, strict=True)), y, limits
    )
    if ax is not None:
        if facet:
            raise UsageError("facet makes panels and ax is one; give one of them")
        return _draw_into(ax, curves, experiments)
    if not facet:
        figure, (axes,) = create_panels(1, 3.8, len(hue_values))
        curves.draw(axes, experiments)
    else:
        facet_values = _sorted_values(experiments, facet)
        panel_height = 3.8 if len(facet_values) == 1 else 2.6
        figure, panels = create_panels(len(facet_values), panel_height, len(hue_values))
        for axes, facet_value in zip(panels, facet_values, strict=True):
            experiments_of_panel = [
                trials for trials in experiments if _value(trials.experiment, facet) == facet_value
            ]
            curves.draw(axes, experiments_of_panel)
            axes.set_title(parameter_with_value(facet, facet_value), fontsize=MEDIUM)
    marks = f"points are medians over the trials, {describe_intervals(experiments)}"
    caption = make_caption(experiments, marks, limits)
    return label_figure(figure, parameter_in_words(x), curves.y_label, caption, curves.legend_handles())


def _draw_into(axes: Axes, curves: _Curves, experiments: Sequence[Trials]) -> Figure:
    """Draw curves, labels and a legend into axes of the user's, and return their figure."""
    curves.draw(axes, experiments)
    axes.set(xlabel=parameter_in_words(curves.x), ylabel=curves.y_label)
    if curves.hue:
        axes.legend(handles=curves.legend_handles(), frameon=False, fontsize=SMALL)
    return cast(Figure, axes.get_figure(root=True))


def _draw_curve(
    axes: Axes, values_by_x: Mapping[Any, NDArray[np.float64]], x_values: Sequence[Any], colour: str
) -> None:
    """Draw a curve through the medians of the values at those ``x_values`` that have some.

    Where an x value is a long text, such as a graph, values stand side by side with shortened labels.
    """
    measured_x = [x for x in x_values if x in values_by_x]
    has_long_texts = any(isinstance(x, str) and len(x) > MAX_LABEL_LENGTH for x in x_values)
    if measured_x:
        positions = [x_values.index(x) for x in measured_x] if has_long_texts else measured_x
        draw_band(axes, positions, median_intervals(values_by_x[x] for x in measured_x), colour, "o-")
    if has_long_texts:
        axes.set_xticks(range(len(x_values)), [shorten(x) for x in x_values])
    clean(axes)


def _measure(trials: Trials, y: str | Measure, limits: Limits) -> NDArray[np.float64]:
    """Return ``y`` of each trial. Raises UsageError if a function does not give one number for each."""
    if isinstance(y, str):
        return np.asarray(trials.measures(limits)[y], dtype=np.float64)  # updates are counted in integers
    values = np.asarray(y(trials), dtype=np.float64)
    if values.shape != (len(trials.numbers),):
        raise UsageError(
            f"y gives shape {values.shape}; return a number for each of {len(trials.numbers)} trials"
        )
    return values


def _value(experiment: Experiment, name: str) -> Any:
    """Return the value of a parameter for an axis: flawed robots as a share, choices as words."""
    return flawed_share(experiment) if name == "flawed" else experiment.parameters()[name]


def _sorted_values(experiments: Sequence[Trials], name: str) -> list[Any]:
    """Return the different values of a parameter for an axis, in order."""
    values = {_value(trials.experiment, name) for trials in experiments}
    return sorted(values, key=lambda value: sort_key(name, value))


def _check_axes(experiments: Sequence[Trials], x: str, hue: str, y: str | Measure, facet: str) -> None:
    """Raise UsageError for unknown names, or if the experiments differ in a parameter that is not shown.

    ``x``, ``hue`` and ``facet`` must be parameters, the last two may be empty; ``y`` must be one of MEASURES
    or a function. The number of trials may differ.
    """
    known_names = parameters_of(Experiment)
    for option, name in (("x", x), ("hue", hue), ("facet", facet)):
        is_left_out = name == "" and option != "x"
        if name not in known_names and not is_left_out:
            fix = offer(name, known_names) or f"; choose a parameter: {', '.join(known_names)}"
            raise UsageError(f"{option} is {name!r}{fix}")
    if not callable(y) and y not in MEASURES:
        raise UsageError(f"y is {y!r}; choose one of {', '.join(MEASURES)}")
    hidden_names = varying_parameters(experiments, (x, hue, facet, "trials", "flawed"))
    # Equal shares of swarms of different sizes are no difference.
    if "flawed" not in (x, hue, facet) and len({flawed_share(each.experiment) for each in experiments}) > 1:
        hidden_names.append("flawed")
    if hidden_names:
        raise UsageError(
            f"the results differ in {', '.join(hidden_names)} too; choose with where NAME=VALUE, or name one "
            "with x, hue or facet"
        )
