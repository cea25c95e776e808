"""Pictures of results: scores, convergence against accuracy, a trial over time; and confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from mcp_asdf.reference import local_confidence
from mcp_asdf_tools.common import COLOURS, FLAWED, GREY, INK, OTHER, UsageError, clean, empty_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits
from mcp_asdf_tools.robots import Filtering

_NO_FILTER = GREY
_MARKERS = "osD^v"

WHISKERS = "boxes from quartile to quartile, whiskers to the last trial within 1.5 of their length"

FILTER_NAMES = {
    Filtering.NONE: "no filter",
    Filtering.ASDF_MINUS: "ASDF\N{MINUS SIGN}",
    Filtering.ASDF_PLUS: "ASDF+",
}
_SERIES = (
    ("b_hat", r"assumed accuracy $\hat{b}$"),
    ("x_hat", r"local estimate $\hat{x}$"),
    ("x", r"informed estimate $x$"),
)
_MOST_SERIES = 8
_MOST_PANELS = 32

Name = Callable[[Experiment], str]
"""Names the series that an experiment belongs to."""


# --- Scores ----------------------------------------------------------------------------------------------


def boxes(experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None) -> Figure:
    """H over the proportion of flawed robots P and their accuracy b_hat: a panel for each f and b, as in the
    paper's figures 3 and 5; a colour for each ``name``, by default made of all else that varies.

    Raises UsageError if there is more than fits a picture, as ``scatter`` does.
    """
    return _in_slots(experiments, limits, name, _draw_box)


def strips(
    experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None
) -> Figure:
    """The same with a point for every trial, which shows what a box hides: cells with two modes."""
    return _in_slots(experiments, limits, name, _draw_strip)


DrawSlot = Callable[[Axes, NDArray[np.float64], float, float, str], None]
"""Draws scores around a place, with a width and a colour."""


def _in_slots(experiments: Sequence[Trials], limits: LimitsOf, name: Name | None, draw: DrawSlot) -> Figure:
    series = _by_series(experiments, name)
    fills, accuracies = _axis(experiments, "fill_ratio"), _axis(experiments, "true_accuracy")
    _check_size(len(fills) * len(accuracies), len(series))
    figure = empty_figure(1.2 + 4.4 * len(accuracies), 1.2 + 2.6 * len(fills))
    grid = figure.subplots(len(fills), len(accuracies), sharey=True, squeeze=False)
    for row, f in zip(grid, fills, strict=True):
        for axes, b in zip(row, accuracies, strict=True):
            own = [_in_panel(trials, f, b) for trials in series.values()]
            _draw_slots(axes, own, limits, list(_colours(series).values()), draw)
            axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=10)
            clean(axes)
    figure.supxlabel(r"$\hat{b} - b$ of flawed robots, and their proportion $P$", fontsize=10)
    figure.supylabel("score $H$", fontsize=10)
    handles = [Patch(facecolor=colour, edgecolor=INK, label=key) for key, colour in _colours(series).items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw_slots(
    axes: Axes,
    series: Sequence[Sequence[Trials]],
    limits: LimitsOf,
    colours: Sequence[str],
    draw: DrawSlot,
) -> None:
    """Groups side by side: P after P, within it b_hat after b_hat, within it the series."""
    slots = sorted({_slot(trials) for own in series for trials in own})
    width = 0.86 / len(series)
    for index, (own, colour) in enumerate(zip(series, colours, strict=True)):
        for trials in own:
            place = slots.index(_slot(trials)) + (index + 0.5) * width - 0.43
            draw(axes, trials.scores(limits).h, place, 0.85 * width, colour)
    axes.set_xlim(-0.5, len(slots) - 0.5)
    axes.set_xticks(range(len(slots)), [_off(slot) for slot in slots], fontsize=7)
    _mark_shares(axes, slots)


def _draw_box(axes: Axes, scores: NDArray[np.float64], place: float, width: float, colour: str) -> None:
    axes.boxplot(
        scores,
        positions=[place],
        widths=width,
        manage_ticks=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "edgecolor": INK, "linewidth": 0.5},
        medianprops={"color": INK, "linewidth": 1},
        whiskerprops={"linewidth": 0.5},
        capprops={"linewidth": 0.5},
        flierprops={"markersize": 2, "marker": ".", "markeredgecolor": colour},
    )


_GOLDEN = 0.618


def _draw_strip(axes: Axes, scores: NDArray[np.float64], place: float, width: float, colour: str) -> None:
    """Points spread evenly over the width, and a line at the median."""
    aside = (np.arange(len(scores)) * _GOLDEN % 1 - 0.5) * width
    axes.plot(place + aside, scores, ".", color=colour, markersize=3.5, alpha=0.5, markeredgewidth=0)
    middle = float(np.median(scores))
    axes.plot([place - width / 2, place + width / 2], [middle, middle], color=INK, linewidth=1.2)


Slot = tuple[float, float]
"""P, and b_hat less b."""


def _slot(trials: Trials) -> Slot:
    experiment = trials.experiment
    if not experiment.flawed:
        return 0.0, 0.0
    return _share(trials), round(experiment.flawed_accuracy - experiment.true_accuracy, 9)


def _off(slot: Slot) -> str:
    return f"{slot[1]:+.2g}".replace("-", "\N{MINUS SIGN}") if slot[0] else ""


def _mark_shares(axes: Axes, slots: Sequence[Slot]) -> None:
    """P below the slots that have it, and lines between them."""
    start = 0
    for share, group in groupby(slots, lambda slot: slot[0]):
        count = len(list(group))
        middle = start + (count - 1) / 2
        axes.annotate(
            f"{share:.0%}",
            (middle, 0),
            (0, -18),
            axes.get_xaxis_transform(),
            "offset points",
            ha="center",
            va="top",
            fontsize=9,
        )
        start += count
        axes.axvline(start - 0.5, color="#bbbbbb", linewidth=0.8)


# --- Convergence against accuracy ------------------------------------------------------------------------

_OVERCONFIDENT = ("#56b4e9", "#0072b2", "#023858", "#000000")
_UNDERCONFIDENT = ("#e69f00", "#d55e00", "#7f2704", "#3b1102")
"""From slightly to badly wrong: blue and red or orange, as in the paper."""


def scatter(
    experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None
) -> Figure:
    """h_e against h_K, a point for each trial, as the paper's figure 4: a row for each series and f, a column
    for each P; overconfident swarms blue, underconfident ones red or orange, a shape for each b."""
    series = _by_series(experiments, name)
    fills, shares = _axis(experiments, "fill_ratio"), sorted({_share(trials) for trials in experiments})
    rows = [(key, f) for key in series for f in fills]
    _check_size(len(rows) * len(shares), len(series))
    figure = empty_figure(1.2 + 2.2 * len(shares), 1.6 + 2.0 * len(rows))
    grid = figure.subplots(len(rows), len(shares), sharex=True, sharey=True, squeeze=False)
    looks = _looks_of(experiments)
    for (key, f), row in zip(rows, grid, strict=True):
        for axes, share in zip(row, shares, strict=True):
            own = [t for t in series[key] if (t.experiment.fill_ratio, _share(t)) == (f, share)]
            _draw_points(axes, own, limits, looks)
            axes.set_title(f"{key}\n$f = {f:g}$, $P$ = {share:.0%}", fontsize=8)
            clean(axes)
    figure.supxlabel("convergence score $h_K$", fontsize=10)
    figure.supylabel("accuracy score $h_e$", fontsize=10)
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, label=_look_name(*key))
        for key, (colour, marker) in looks.items()
    ]
    columns = max(1, int(figure.get_figwidth() / _LEGEND_WIDTH))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False, fontsize=8)
    return figure


_LEGEND_WIDTH = 2.6
"""Inches of an entry."""

Look = tuple[float, float]
"""b, and b_hat less b."""


def _look_of(trials: Trials) -> Look:
    return trials.experiment.true_accuracy, _slot(trials)[1]


def _looks_of(experiments: Sequence[Trials]) -> dict[Look, tuple[str, str]]:
    """Colour and shape of each kind of swarm."""
    looks = sorted({_look_of(trials) for trials in experiments})
    accuracies = sorted({b for b, _ in looks})
    return {
        (b, off): (_hue(off, [each for _, each in looks]), _MARKERS[accuracies.index(b) % len(_MARKERS)])
        for b, off in looks
    }


def _hue(off: float, offs: Sequence[float]) -> str:
    if not off:
        return INK
    alike = sorted({abs(each) for each in offs if each * off > 0})
    shades = _OVERCONFIDENT if off > 0 else _UNDERCONFIDENT
    return shades[min(alike.index(abs(off)), len(shades) - 1)]


def _look_name(b: float, off: float) -> str:
    kind = "overconfident" if off > 0 else "underconfident" if off < 0 else "none flawed"
    return rf"{kind}, $b$ = {b:g}" + (rf", $\hat{{b}}$ = {b + off:g}" if off else "")


def _draw_points(
    axes: Axes, own: Sequence[Trials], limits: LimitsOf, looks: dict[Look, tuple[str, str]]
) -> None:
    for trials in own:
        scores, (colour, marker) = trials.scores(limits), looks[_look_of(trials)]
        axes.plot(scores.h_k, scores.h_e, marker, color=colour, markersize=3, alpha=0.4, markeredgewidth=0)


# --- Series of experiments -------------------------------------------------------------------------------

_NOT_A_SERIES = ("fill_ratio", "true_accuracy", "flawed_accuracy", "flawed", "trials")
_OF_FILTERS = ("filter_period", "omega", "activation")


def _by_series(experiments: Sequence[Trials], name: Name | None) -> dict[str, list[Trials]]:
    """Swarms without filter first, then those that filter less."""
    name = name or _name_of(experiments)
    series: dict[str, list[Trials]] = {}
    for trials in sorted(experiments, key=lambda trials: list(Filtering).index(trials.experiment.filter)):
        series.setdefault(name(trials.experiment), []).append(trials)
    return series


def _name_of(experiments: Sequence[Trials]) -> Name:
    """Names made of the parameters that vary; those of filters do not name swarms without one."""
    parameters = [trials.experiment.parameters() for trials in experiments]
    filtering = [each for each in parameters if each["filter"] != Filtering.NONE.value] or parameters
    varying = [
        key
        for key in parameters[0]
        if key not in (*_NOT_A_SERIES, "filter")
        and len({each[key] for each in (filtering if key in _OF_FILTERS else parameters)}) > 1
    ]

    def name(experiment: Experiment) -> str:
        has_filter = experiment.filter is not Filtering.NONE
        own = [key for key in varying if has_filter or key not in _OF_FILTERS]
        return ", ".join(
            [FILTER_NAMES[experiment.filter], *(_words(key, experiment.parameters()[key]) for key in own)]
        )

    return name


def _words(key: str, value: Any) -> str:
    if key == "filter_period":
        return rf"$\tau$ = {value}"
    return str(value).replace("_", " ") if isinstance(value, str) else f"{key.replace('_', ' ')} {value:g}"


def _colours(series: Sequence[str] | dict[str, list[Trials]]) -> dict[str, str]:
    """Swarms without a filter are grey if there are others."""
    rest = iter(COLOURS)
    return {
        name: _NO_FILTER if name == FILTER_NAMES[Filtering.NONE] and len(series) > 1 else next(rest)
        for name in series
    }


def _axis(experiments: Sequence[Trials], key: str) -> list[float]:
    return sorted({getattr(trials.experiment, key) for trials in experiments})


def _in_panel(experiments: Sequence[Trials], f: float, b: float) -> list[Trials]:
    return [t for t in experiments if (t.experiment.fill_ratio, t.experiment.true_accuracy) == (f, b)]


def _share(trials: Trials) -> float:
    return trials.experiment.flawed / trials.experiment.robots


def _check_size(panels: int, series: int) -> None:
    if panels > _MOST_PANELS or series > _MOST_SERIES:
        raise UsageError(
            f"{panels} panels with {series} series do not fit a picture; "
            f"plot at most {_MOST_PANELS} with {_MOST_SERIES}"
        )


# --- One trial -------------------------------------------------------------------------------------------


def series(trials: Trials, number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    return series_beside([trials], number)


def series_beside(runs: Sequence[Trials], number: int) -> Figure:
    """As ``series``, of several runs side by side, as in the paper's figure 6."""
    figure = empty_figure(1.0 + 6.0 * len(runs) + (2.0 if len(runs) == 1 else 0), 7.5)
    grid = figure.subplots(len(_SERIES), len(runs), sharex=True, sharey="row", squeeze=False)
    for column, trials in zip(grid.T, runs, strict=True):
        _draw_series(column, trials, _index_of(trials, number))
        if len(runs) > 1:
            column[0].set_title(FILTER_NAMES[trials.experiment.filter], fontsize=10)
        column[-1].set_xlabel("step")
    for axes, (_, label) in zip(grid[:, 0], _SERIES, strict=True):
        axes.set_ylabel(label)
    lines = [("flawed", FLAWED), ("not flawed", OTHER), ("true value (dashed)", INK)]
    handles = [Line2D([], [], color=colour, label=name) for name, colour in lines]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _index_of(trials: Trials, number: int) -> int:
    if number not in trials.numbers:
        raise UsageError(
            f"there is no trial {number}; choose one of {trials.numbers[0]} .. {trials.numbers[-1]}"
        )
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    return trials.numbers.index(number)


def _draw_series(column: Sequence[Axes], trials: Trials, index: int) -> None:
    experiment = trials.experiment
    for axes, (quantity, _) in zip(column, _SERIES, strict=True):
        values = trials.records[quantity][index]
        steps = np.linspace(0, experiment.steps // (len(values) - 1) * (len(values) - 1), len(values))
        for robot in range(experiment.robots - 1, -1, -1):  # flawed ones on top
            colour = FLAWED if robot < experiment.flawed else OTHER
            # b_hat jumps at updates and stands still between them.
            style = "steps-post" if quantity == "b_hat" else "default"
            axes.plot(steps, values[:, robot], color=colour, linewidth=1.2, alpha=0.75, drawstyle=style)
        truth = experiment.true_accuracy if quantity == "b_hat" else experiment.fill_ratio
        axes.axhline(truth, color=INK, linewidth=1.2, linestyle=(0, (5, 3)))
        clean(axes)


# --- All trials over time --------------------------------------------------------------------------------

_OFF = 0.05
"""From which b_hat counts as off."""


def bands(experiments: Sequence[Trials]) -> Figure:
    """b_hat of all robots over all trials: the median, the middle half and the middle 90 % after each filter
    step, a panel for each experiment; its title says how many unflawed robots end more than 0.05 off.

    Raises UsageError if there are too many, or no filter step.
    """
    _check_size(len(experiments), 1)
    if any(not trials.b_hat.shape[1] for trials in experiments):
        raise UsageError(
            "there is no filter step in these trials; run more steps, or a shorter filter_period"
        )
    columns = 6 if len(experiments) > 12 else min(4, len(experiments))
    rows = -(-len(experiments) // columns)
    figure = empty_figure(1.0 + 3.0 * columns, 1.2 + 2.4 * rows)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, trials in zip(grid.flat, experiments, strict=False):
        _draw_bands(axes, trials)
    for axes in grid.flat[len(experiments) :]:
        axes.set_axis_off()
    figure.supxlabel("step", fontsize=10)
    figure.supylabel(r"assumed accuracy $\hat{b}$", fontsize=10)
    lines = [("flawed at the start", FLAWED), ("not flawed", OTHER), ("true accuracy (dashed)", INK)]
    handles = [Line2D([], [], color=colour, label=name) for name, colour in lines]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def _draw_bands(axes: Axes, trials: Trials) -> None:
    experiment = trials.experiment
    flawed = experiment.flawed
    steps = experiment.filter_period * np.arange(1, trials.b_hat.shape[1] + 1)
    for colour, values in ((FLAWED, trials.b_hat[..., :flawed]), (OTHER, trials.b_hat[..., flawed:])):
        if values.size:
            low, lower, middle, upper, high = np.percentile(values, [5, 25, 50, 75, 95], axis=(0, 2))
            axes.fill_between(steps, low, high, color=colour, alpha=0.15, linewidth=0)
            axes.fill_between(steps, lower, upper, color=colour, alpha=0.3, linewidth=0)
            axes.plot(steps, middle, color=colour, linewidth=1.4)
    axes.axhline(experiment.true_accuracy, color=INK, linewidth=1, linestyle=(0, (5, 3)))
    words = rf"$f = {experiment.fill_ratio:g}$, $b = {experiment.true_accuracy:g}$"
    if flawed:
        words += rf", $\hat{{b}} = {experiment.flawed_accuracy:g}$, $P$ = {_share(trials):.0%}"
    axes.set_title(f"{words}\n{_corruption_of(trials)}", fontsize=8)
    clean(axes)


def _corruption_of(trials: Trials) -> str:
    unflawed = trials.b_hat[:, -1, trials.experiment.flawed :]
    if not unflawed.size:
        return "all robots flawed"
    right = trials.experiment.unflawed_accuracy or trials.experiment.true_accuracy
    return f"{np.mean(abs(unflawed - right) > _OFF):.0%} of unflawed robots end off"


# --- Confidence ------------------------------------------------------------------------------------------

_OBSERVED = 100_000


def confidence() -> Figure:
    """The local confidence alpha of an observation against b_hat (eq. 4), as the paper's figure 2: a line for
    each n/t, of which 0.505 and 0.905 are the least and the largest that its study has on average."""
    figure = empty_figure(6, 4)
    axes = figure.subplots()
    b_hat = np.linspace(0.505, 0.995, 393)
    for colour, share in zip(COLOURS, (0.505, 0.7, 0.905), strict=False):
        n = round(share * _OBSERVED)
        alpha = [local_confidence(n, _OBSERVED, float(each)) / _OBSERVED for each in b_hat]
        axes.semilogy(b_hat, alpha, color=colour, linewidth=1.6, label=f"$n/t$ = {share:g}")
    axes.set_xlabel(r"assumed accuracy $\hat{b}$")
    axes.set_ylabel(r"local confidence $\alpha / t$")
    axes.legend(frameon=False)
    clean(axes)
    return figure


# --- Figures ---------------------------------------------------------------------------------------------
