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

from mcp_asdf.reference import local_confidence
from mcp_asdf_tools.common import COLOURS, FLAWED, GREY, INK, OTHER, UsageError, clean, empty_figure
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits
from mcp_asdf_tools.robots import Filtering

_NO_FILTER = GREY
_SHADES = ("#222222", "#56b4e9", "#0072b2", "#e69f00", "#d55e00", "#8a4f7d", "#009e73", "#cc79a7")
"""Of proportions of flawed robots, from none."""
_MARKERS = "osD^v"

MODE_NAMES = {
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
    paper's figures 4 and 6; a colour for each ``name``, by default made of all else that varies.

    Raises UsageError if there is more than fits a picture, as ``scatter`` does.
    """
    series = _by_series(experiments, name)
    fills, accuracies = _axis(experiments, "fill_ratio"), _axis(experiments, "true_accuracy")
    _check_size(len(fills) * len(accuracies), len(series))
    figure = empty_figure(1.2 + 4.4 * len(accuracies), 1.2 + 2.6 * len(fills))
    grid = figure.subplots(len(fills), len(accuracies), sharey=True, squeeze=False)
    for row, f in zip(grid, fills, strict=True):
        for axes, b in zip(row, accuracies, strict=True):
            own = [_in_panel(trials, f, b) for trials in series.values()]
            _draw_boxes(axes, own, limits, list(_colours(series).values()))
            axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=10)
            clean(axes)
    figure.supxlabel(r"$\hat{b} - b$ of flawed robots, and their proportion $P$", fontsize=10)
    figure.supylabel("score $H$", fontsize=10)
    handles = [Patch(facecolor=colour, edgecolor=INK, label=key) for key, colour in _colours(series).items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


def scatter(
    experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None
) -> Figure:
    """h_e against h_K, as the paper's figure 5: a row for each series, a column for each f and b, a colour
    for each P and a shape for each b_hat; a point for each trial, a larger one for the medians."""
    series = _by_series(experiments, name)
    panels = sorted({(t.experiment.fill_ratio, t.experiment.true_accuracy) for t in experiments})
    _check_size(len(panels) * len(series), len(series))
    cells = [(key, panel) for key in series for panel in panels]
    columns = len(panels) if len(panels) > 1 else len(series)
    figure = empty_figure(1.2 + 2.5 * columns, 1.6 + 2.3 * len(cells) / columns)
    grid = figure.subplots(len(cells) // columns, columns, sharex=True, sharey=True, squeeze=False)
    shares = sorted({_share(trials) for trials in experiments})
    for axes, (key, (f, b)) in zip(grid.flat, cells, strict=True):
        _draw_points(axes, _in_panel(series[key], f, b), limits, shares)
        axes.set_title(f"{key}\n$f = {f:g}$, $b = {b:g}$", fontsize=9)
        clean(axes)
    figure.supxlabel("convergence score $h_K$", fontsize=10)
    figure.supylabel("accuracy score $h_e$", fontsize=10)
    handles = _point_handles(experiments, shares)
    figure.legend(handles=handles, loc="outside upper center", ncols=2 * columns, frameon=False, fontsize=8)
    return figure


def _draw_boxes(
    axes: Axes, series: Sequence[Sequence[Trials]], limits: LimitsOf, colours: Sequence[str]
) -> None:
    """Groups of boxes side by side: P after P, within it b_hat after b_hat, within it the series."""
    slots = sorted({_slot(trials) for own in series for trials in own})
    width = 0.86 / len(series)
    for index, (own, colour) in enumerate(zip(series, colours, strict=True)):
        for trials in own:
            axes.boxplot(
                trials.scores(limits).h,
                positions=[slots.index(_slot(trials)) + (index + 0.5) * width - 0.43],
                widths=0.85 * width,
                manage_ticks=False,
                patch_artist=True,
                boxprops={"facecolor": colour, "edgecolor": INK, "linewidth": 0.5},
                medianprops={"color": INK, "linewidth": 1},
                whiskerprops={"linewidth": 0.5},
                capprops={"linewidth": 0.5},
                flierprops={"markersize": 2, "marker": ".", "markeredgecolor": colour},
            )
    axes.set_xlim(-0.5, len(slots) - 0.5)
    axes.set_xticks(range(len(slots)), [_off(slot) for slot in slots], fontsize=7)
    _mark_shares(axes, slots)


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


def _draw_points(axes: Axes, own: Sequence[Trials], limits: LimitsOf, shares: Sequence[float]) -> None:
    offs = sorted({_slot(trials)[1] for trials in own if _slot(trials)[0]}, key=abs)
    for trials in own:
        scores, (share, off) = trials.scores(limits), _slot(trials)
        colour, marker = _shade(share, shares), _MARKERS[offs.index(off) if share else 0]
        axes.plot(scores.h_k, scores.h_e, marker, color=colour, markersize=3, alpha=0.35, markeredgewidth=0)
        middle = np.median(scores.h_k), np.median(scores.h_e)
        axes.plot(*middle, marker, color=colour, markersize=6, markeredgecolor=INK, markeredgewidth=0.6)


def _shade(share: float, shares: Sequence[float]) -> str:
    return _SHADES[shares.index(share) % len(_SHADES)]


def _point_handles(experiments: Sequence[Trials], shares: Sequence[float]) -> list[Line2D]:
    """Of the legend: the colours of P, then the shapes of how far b_hat is off."""
    colours = [
        Line2D([], [], linestyle="", marker="o", color=_shade(share, shares), label=f"$P$ = {share:.0%}")
        for share in shares
    ]
    offs = sorted({abs(_slot(trials)[1]) for trials in experiments if _slot(trials)[0]})
    shapes = [
        Line2D(
            [],
            [],
            linestyle="",
            marker=marker,
            color="none",
            markeredgecolor=INK,
            label=rf"$|\hat{{b}} - b|$ = {off:g}",
        )
        for off, marker in zip(offs, _MARKERS, strict=False)
    ]
    return [*colours, *shapes]


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
            [MODE_NAMES[experiment.filter], *(_words(key, experiment.parameters()[key]) for key in own)]
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
        name: _NO_FILTER if name == MODE_NAMES[Filtering.NONE] and len(series) > 1 else next(rest)
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
    """As ``series``, of several runs side by side, as in the paper's figure 7."""
    figure = empty_figure(1.0 + 6.0 * len(runs) + (2.0 if len(runs) == 1 else 0), 7.5)
    grid = figure.subplots(len(_SERIES), len(runs), sharex=True, sharey="row", squeeze=False)
    for column, trials in zip(grid.T, runs, strict=True):
        _draw_series(column, trials, _index_of(trials, number))
        if len(runs) > 1:
            column[0].set_title(MODE_NAMES[trials.experiment.filter], fontsize=10)
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
