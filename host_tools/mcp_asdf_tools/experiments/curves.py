"""A score or measure over any parameter that was varied, as curves with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mcp_asdf_tools.common import (
    COLOURS,
    INK,
    MEDIUM,
    WIDTH,
    WITHOUT,
    UsageError,
    add_caption,
    add_legend,
    are_distinct,
    clean,
    empty_figure,
    number_in_words,
    ordered_colours,
    period_colour,
    share_colour,
)
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits
from mcp_asdf_tools.experiments.series_names import caption_of

LETTERS = {
    "f": "fill_ratio",
    "b": "true_accuracy",
    "b_hat": "flawed_accuracy",
    "P": "flawed",
    "N": "robots",
    "D": "density",
    "tau": "filter_period",
}
"""The paper's letters of parameters."""

_LABELS = {
    "fill_ratio": "fill ratio $f$",
    "true_accuracy": "true accuracy $b$",
    "flawed_accuracy": r"flawed assumed accuracy $\hat{b}$",
    "flawed": "flawed robots $P$",
    "robots": "robots $N$",
    "density": "swarm density $D$",
    "filter_period": r"filtering period $\tau$, steps",
    "omega": r"type II error probability $\omega$",
}

MEASURES: dict[str, Callable[[Trials, LimitsOf], NDArray[np.float64]]] = {
    "H": lambda trials, limits: trials.scores(limits).h,
    "h_K": lambda trials, limits: trials.scores(limits).h_k,
    "h_e": lambda trials, limits: trials.scores(limits).h_e,
    "K": lambda trials, limits: trials.convergence_steps.mean(axis=1),
    "e": lambda trials, limits: trials.errors.mean(axis=1),
}
"""A value for each trial; K and e are means over the robots."""

_PANELS = ("fill_ratio", "true_accuracy")
_WIDE = 30
"""Ratio of an axis' ends from which it is logarithmic."""
_MOST_PANELS = 16
_CONFIDENCE = 0.95
MARKS = "points are medians over the trials, bands their 95 % intervals"
_MEASURE_LABELS = {
    "H": "score $H$",
    "h_K": "convergence score $h_K$",
    "h_e": "accuracy score $h_e$",
    "K": "convergence step $K$",
    "e": "absolute error $e$",
}


def curve(
    experiments: Sequence[Trials], x: str, hue: str = "", y: str = "H", limits: LimitsOf = paper_limits
) -> Figure:
    """The median of ``y`` over the parameter ``x`` with its 95 % interval: a curve for each value of the
    parameter ``hue``, a panel for each f and b.

    Parameters have their names or the paper's letters; P is a share. Raises UsageError for unknown ones, and
    if the experiments differ in any other.
    """
    x, hue = (LETTERS.get(name, name) for name in (x, hue))
    _check(experiments, x, hue, y)
    panels = sorted({_panel(trials, x, hue) for trials in experiments})
    if len(panels) > _MOST_PANELS:
        raise UsageError(
            f"{len(panels)} values of f and b do not fit a picture; choose at most {_MOST_PANELS}"
        )
    hues = sorted({value_of(trials.experiment, hue) for trials in experiments}) if hue else [None]
    if len(hues) > len(COLOURS):
        raise UsageError(f"{len(hues)} values of {hue} do not fit a picture; choose at most {len(COLOURS)}")
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure = empty_figure(WIDTH if columns > 1 else 0.7 * WIDTH, 1.4 + 2.8 * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    colours = _colours_of(hue, hues)
    for axes, panel in zip(grid.flat, panels, strict=False):
        own = [trials for trials in experiments if _panel(trials, x, hue) == panel]
        for colour, chosen in zip(colours, hues, strict=True):
            shown = [each for each in own if hue == "" or value_of(each.experiment, hue) == chosen]
            points = {value_of(each.experiment, x): MEASURES[y](each, limits) for each in shown}
            _draw(axes, points, colour)
        axes.set_title(
            ", ".join(f"${LETTER_OF[name]} = {value:g}$" for name, value in panel), fontsize=MEDIUM
        )
        clean(axes)
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    _scale(grid.flat[0], x, [value_of(trials.experiment, x) for trials in experiments])
    figure.supylabel(_MEASURE_LABELS[y], fontsize=MEDIUM)
    add_caption(figure, _label(x), caption_of(experiments, MARKS, limits=limits))
    if hue:
        labels = [f"{_label(hue).removesuffix(', steps')} = {_word(hue, chosen)}" for chosen in hues]
        lines = zip(colours, labels, strict=True)
        add_legend(figure, [Line2D([], [], color=colour, marker="o", label=label) for colour, label in lines])
    return figure


def _colours_of(hue: str, hues: Sequence[Any]) -> list[str]:
    """Those of their meaning where they have one, from dark to light where they have an order."""
    if not hue:
        return [INK]
    if hue == "filter_period" and are_distinct(periods := [period_colour(each) for each in hues]):
        return periods
    if hue == "flawed":
        return [share_colour(each) for each in hues]
    if hue == "filter":
        return [_FILTER_COLOURS[each] for each in hues]
    if any(isinstance(each, str) for each in hues):
        return list(COLOURS[: len(hues)])
    return ordered_colours(len(hues))


_FILTER_COLOURS = {"none": WITHOUT, "asdf-minus": period_colour(2000), "asdf-plus": period_colour(500)}

LETTER_OF = {name: letter for letter, name in LETTERS.items()}

Panel = tuple[tuple[str, float], ...]


def _panel(trials: Trials, x: str, hue: str) -> Panel:
    return tuple((name, getattr(trials.experiment, name)) for name in _PANELS if name not in (x, hue))


def value_of(experiment: Experiment, name: str) -> Any:
    """A parameter's value for an axis: P as a share, words for choices."""
    if name == "flawed":
        return experiment.flawed / experiment.robots
    return experiment.parameters()[name]


def _check(experiments: Sequence[Trials], x: str, hue: str, y: str) -> None:
    known = experiments[0].experiment.parameters()
    for option, name in (("--x", x), ("--hue", hue)):
        if name not in known and (option, name) != ("--hue", ""):
            raise UsageError(f"{option} is {name!r}; choose a parameter, such as {', '.join(_LABELS)}")
    if y not in MEASURES:
        raise UsageError(f"--y is {y!r}; choose one of {', '.join(MEASURES)}")
    meant = {x, hue, *_PANELS, "trials"} | ({"flawed"} if "robots" in (x, hue) else set())
    others = [
        name
        for name in known
        if name not in meant and len({value_of(trials.experiment, name) for trials in experiments}) > 1
    ]
    if others:
        message = f"the results differ in {', '.join(others)} too"
        raise UsageError(
            f"{message}; draw those of a file in which they do not, or name one with --x or --hue"
        )


def _draw(axes: Axes, points: dict[Any, NDArray[np.float64]], colour: str) -> None:
    values = sorted(points)
    summaries = np.array([median_interval(points[value]) for value in values]).reshape(-1, 3).T
    places = values if all(isinstance(value, int | float) for value in values) else [str(v) for v in values]
    axes.fill_between(places, summaries[1], summaries[2], color=colour, alpha=0.2, linewidth=0)
    axes.plot(places, summaries[0], "o-", color=colour, markersize=3.5, linewidth=1.4)


def median_interval(sample: NDArray[np.float64]) -> tuple[float, float, float]:
    """The median and its 95 % interval from order statistics, exact for any distribution; of fewer than six
    trials, their extremes."""
    from scipy.stats import binom  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

    ordered = np.sort(sample)
    beyond = max(1, int(binom.ppf((1 - _CONFIDENCE) / 2, len(sample), 0.5)))
    return float(np.median(sample)), float(ordered[beyond - 1]), float(ordered[-beyond])


def _label(name: str) -> str:
    return _LABELS.get(name, name.replace("_", " "))


def _word(name: str, value: Any) -> str:
    if name == "flawed":
        return f"{value:.0%}"
    return number_in_words(value)


def _scale(axes: Axes, x: str, values: Sequence[Any]) -> None:
    """Logarithmic if the values are far apart, percent for P."""
    numbers = [value for value in values if isinstance(value, int | float)]
    if numbers and min(numbers) > 0 and max(numbers) / min(numbers) >= _WIDE:
        axes.set_xscale("log")
    if x == "flawed":
        axes.xaxis.set_major_formatter(lambda value, place: f"{value:.0%}")
