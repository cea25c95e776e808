"""Pictures of results: scores over the share of flawed robots, h_K against h_e, a trial over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from host_tools.errors import UsageError
from host_tools.results import Trials
from host_tools.scores import Limits, score

# The first eight stay apart for the colour-blind.
_MORE = ("#999999", "#f0e442", "#6a3d9a", "#7a5230")
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a4f7d", "#222222", *_MORE)
_FLAWED, _OTHER, _TRUTH = COLOURS[1], COLOURS[0], COLOURS[7]

_PANEL = ("fill_ratio", "true_accuracy", "flawed_accuracy")
_SYMBOLS = {"fill_ratio": "f", "true_accuracy": "b", "flawed_accuracy": r"\hat{b}"}
_SERIES = (
    ("b_hat", r"assumed accuracy $\hat{b}$"),
    ("x_hat", r"local estimate $\hat{x}$"),
    ("x", r"informed estimate $x$"),
)
_MOST_SERIES = len(COLOURS)
_MOST_PANELS = 24

Panel = tuple[Any, ...]
Draw = Callable[[Axes, dict[str, list[Trials]], Limits], None]


def boxes(experiments: Sequence[Trials], limits: Limits) -> Figure:
    """H over the proportion of flawed robots P: a panel for each f, b and flawed b_hat, a colour for all else
    that varies.

    Raises UsageError if there is more than fits a picture, as ``scatter`` does.
    """
    figure = _grid(experiments, limits, _draw_boxes)
    figure.supxlabel("proportion of flawed robots P", fontsize=10)
    figure.supylabel("score H", fontsize=10)
    return figure


def scatter(experiments: Sequence[Trials], limits: Limits) -> Figure:
    """h_e against h_K: a point for each trial, a cross for each experiment's medians."""
    figure = _grid(experiments, limits, _draw_points)
    figure.supxlabel("convergence score $h_K$", fontsize=10)
    figure.supylabel("accuracy score $h_e$", fontsize=10)
    return figure


def series(trials: Trials, number: int) -> Figure:
    """b_hat, x_hat and x of every robot over the steps of one recorded trial.

    Raises UsageError if there is no such trial or nothing was recorded.
    """
    if number not in trials.numbers:
        raise UsageError(
            f"there is no trial {number}; choose one of {trials.numbers[0]} .. {trials.numbers[-1]}"
        )
    if not trials.records:
        raise UsageError("nothing was recorded over time; run mcp-asdf simulate with --record")
    experiment, index = trials.experiment, trials.numbers.index(number)
    figure = _empty_figure(9, 7.5)
    for axes, (quantity, label) in zip(figure.subplots(3, 1, sharex=True), _SERIES, strict=True):
        values = trials.records[quantity][index]
        steps = np.linspace(0, experiment.steps // (len(values) - 1) * (len(values) - 1), len(values))
        for robot in range(experiment.robots - 1, -1, -1):  # flawed ones on top
            colour = _FLAWED if robot < experiment.flawed else _OTHER
            # b_hat jumps at updates and stands still between them.
            style = "steps-post" if quantity == "b_hat" else "default"
            axes.plot(steps, values[:, robot], color=colour, linewidth=1.2, alpha=0.75, drawstyle=style)
        truth = experiment.true_accuracy if quantity == "b_hat" else experiment.fill_ratio
        axes.axhline(truth, color=_TRUTH, linewidth=1.2, linestyle=(0, (5, 3)))
        axes.set_ylabel(label)
        _clean(axes)
    figure.axes[-1].set_xlabel("step")
    lines = [("flawed", _FLAWED), ("not flawed", _OTHER), ("true value (dashed)", _TRUTH)]
    handles = [Line2D([], [], color=colour, label=name) for name, colour in lines]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _empty_figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _clean(axes: Axes) -> None:
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _grid(experiments: Sequence[Trials], limits: Limits, draw: Draw) -> Figure:
    """A panel for each combination of f, b and flawed b_hat, and in it a colour for each series."""
    names = _series_names(experiments)
    panels: dict[Panel, dict[str, list[Trials]]] = {}
    for trials, name in zip(experiments, names, strict=True):
        key = tuple(getattr(trials.experiment, attribute) for attribute in _PANEL)
        panels.setdefault(key, {each: [] for each in dict.fromkeys(names)})[name].append(trials)
    if len(set(names)) > _MOST_SERIES or len(panels) > _MOST_PANELS:
        raise UsageError(
            f"{len(panels)} panels with {len(set(names))} series do not fit a picture; "
            f"plot at most {_MOST_PANELS} with {_MOST_SERIES}"
        )
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = _empty_figure(3.6 * columns + 1.2, 2.8 * rows + 0.8)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (key, groups) in zip(grid.flat, panels.items(), strict=False):
        draw(axes, groups, limits)
        title = ", ".join(f"${_SYMBOLS[name]} = {value:g}$" for name, value in zip(_PANEL, key, strict=True))
        axes.set_title(title, fontsize=10)
        _clean(axes)
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    handles = [Patch(color=COLOURS[i], label=name) for i, name in enumerate(dict.fromkeys(names))]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def _series_names(experiments: Sequence[Trials]) -> list[str]:
    """What sets each experiment apart beside its panel and P, in words."""
    parameters = [trials.experiment.parameters() for trials in experiments]
    apart = (*_PANEL, "flawed", "trials")
    varying = [
        name for name in parameters[0] if name not in apart and len({each[name] for each in parameters}) > 1
    ]
    if not varying:
        return [parameters[0]["mode"]] * len(experiments)
    return [", ".join(_words(name, each[name]) for name in varying) for each in parameters]


def _words(name: str, value: Any) -> str:
    return str(value) if isinstance(value, str) else f"{name.replace('_', ' ')} {value:g}"


def _draw_boxes(axes: Axes, groups: dict[str, list[Trials]], limits: Limits) -> None:
    counts = sorted(
        {trials.experiment.flawed / trials.experiment.robots for own in groups.values() for trials in own}
    )
    width = 0.8 / len(groups)
    for index, own in enumerate(groups.values()):
        for trials in own:
            place = counts.index(trials.experiment.flawed / trials.experiment.robots)
            axes.boxplot(
                score(trials.settled, trials.errors, limits).h,
                positions=[place + (index + 0.5) * width - 0.4],
                widths=0.85 * width,
                manage_ticks=False,
                patch_artist=True,
                boxprops={"facecolor": COLOURS[index], "edgecolor": _TRUTH, "linewidth": 0.6},
                medianprops={"color": _TRUTH},
                whiskerprops={"linewidth": 0.6},
                capprops={"linewidth": 0.6},
                flierprops={"markersize": 2, "marker": ".", "markeredgecolor": COLOURS[index]},
            )
    axes.set_xticks(range(len(counts)), [f"{count:.0%}" for count in counts])


def _draw_points(axes: Axes, groups: dict[str, list[Trials]], limits: Limits) -> None:
    for index, own in enumerate(groups.values()):
        for trials in own:
            scores = score(trials.settled, trials.errors, limits)
            axes.plot(scores.h_k, scores.h_e, ".", color=COLOURS[index], markersize=4, alpha=0.4)
            axes.plot(
                np.median(scores.h_k),
                np.median(scores.h_e),
                "X",
                color=COLOURS[index],
                markeredgecolor=_TRUTH,
            )
