"""Pictures of scores by cell, as boxes or points; and of the confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby, takewhile

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from mcp_asdf.reference import local_confidence
from mcp_asdf_tools.common import (
    INK,
    MEDIUM,
    SMALL,
    WIDTH,
    add_caption,
    add_legend,
    clean,
    empty_figure,
    ordered_colours,
)
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits
from mcp_asdf_tools.experiments.series_names import (
    Name,
    Style,
    by_series,
    caption_of,
    check_size,
    share_of,
    styles_of,
)

Scores = NDArray[np.float64]

BOXES = (
    "boxes from quartile to quartile, whiskers to the last trial within 1.5 of their length, points beyond; "
    "the line is the median; cells whose trials fall into two groups have a point for each trial instead"
)
POINTS = "a point is a trial, the line the median"


def boxes(experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None) -> Figure:
    """H over the proportion of flawed robots P and their accuracy b_hat: a panel for each f and b, as in the
    paper's figures 3 and 5; a colour for each ``name``, by default made of all else that varies.

    Cells whose trials fall into two groups have points in place of a box. Raises UsageError if there is more
    than fits a picture, as ``scatter`` does.
    """
    return _in_slots(experiments, limits, name, _draw_box_or_strip, BOXES)


def strips(
    experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None
) -> Figure:
    """The same with a point for every trial, which shows what a box hides: cells with two modes."""
    return _in_slots(experiments, limits, name, _draw_strip, POINTS)


DrawSlot = Callable[[Axes, Scores, float, float, Style], None]
"""Draws scores around a place, with a width and a look."""


def _in_slots(
    experiments: Sequence[Trials], limits: LimitsOf, name: Name | None, draw: DrawSlot, marks: str
) -> Figure:
    series = by_series(experiments, name)
    styles = styles_of(series)
    fills, accuracies = _axis(experiments, "fill_ratio"), _axis(experiments, "true_accuracy")
    check_size(len(fills) * len(accuracies), len(series))
    figure = empty_figure(WIDTH if len(accuracies) > 1 else 0.7 * WIDTH, 1.4 + 2.6 * len(fills))
    grid = figure.subplots(len(fills), len(accuracies), sharey=True, squeeze=False)
    for row, f in zip(grid, fills, strict=True):
        for axes, b in zip(row, accuracies, strict=True):
            panel = _panel_of(series, styles, limits, f, b)
            _draw_panel(axes, panel, len(series), draw)
            axes.set_title(f"$f = {f:g}$, $b = {b:g}$", fontsize=MEDIUM)
    figure.supylabel("score $H$", fontsize=MEDIUM)
    axis = r"$\hat{b} - b$ of flawed robots, and their proportion $P$"
    add_caption(figure, axis, caption_of(experiments, marks, limits=limits))
    add_legend(figure, [_patch(key, style) for key, style in styles.items()])
    return figure


def _patch(label: str, style: Style) -> Patch:
    width = 1.5 if style.is_hollow else 0.5
    return Patch(facecolor=style.face, edgecolor=style.edge, linewidth=width, label=label)


Slot = tuple[float, float]
"""P, and b_hat less b."""

Panel = list[tuple[Slot, int, Style, Scores]]
"""Scores of cells with their slot, and number and look of their series."""


def _panel_of(
    series: dict[str, list[Trials]], styles: dict[str, Style], limits: LimitsOf, f: float, b: float
) -> Panel:
    return [
        (slot_of(trials), index, styles[key], trials.scores(limits).h)
        for index, (key, own) in enumerate(series.items())
        for trials in own
        if (trials.experiment.fill_ratio, trials.experiment.true_accuracy) == (f, b)
    ]


def _draw_panel(axes: Axes, panel: Panel, series: int, draw: DrawSlot) -> None:
    """Groups side by side: P after P, within it b_hat after b_hat, within it the series; 0 to 100."""
    slots = sorted({slot for slot, *_ in panel})
    _draw_cells(axes, panel, slots, series, draw)
    axes.set_ylim(0, 103)
    axes.set_xlim(-0.5, len(slots) - 0.5)
    axes.set_xticks(range(len(slots)), [_off(slot) for slot in slots])
    _mark_shares(axes, slots)
    clean(axes)
    axes.tick_params(axis="x", labelsize=SMALL - 1)
    _draw_zoomed(axes, panel, slots, series, draw)


def _draw_cells(axes: Axes, panel: Panel, slots: Sequence[Slot], series: int, draw: DrawSlot) -> None:
    width = 0.86 / series
    for slot, index, style, scores in panel:
        draw(axes, scores, slots.index(slot) + (index + 0.5) * width - 0.43, 0.85 * width, style)


_NEAR_FULL = 85.0
"""Score from which on slots are too flat to be read."""


def _draw_zoomed(axes: Axes, panel: Panel, slots: Sequence[Slot], series: int, draw: DrawSlot) -> None:
    """The first slots once more, magnified, where their scores are all near 100."""
    lowest = {slot: min(_whisker(scores) for own, _, _, scores in panel if own == slot) for slot in slots}
    flat = list(takewhile(lambda slot: lowest[slot] >= _NEAR_FULL, slots))
    if len(flat) < 2:
        return
    shown = [cell for cell in panel if cell[0] in flat]
    low = max(_NEAR_FULL - 5, min(lowest[slot] for slot in flat) - 1)
    inset = axes.inset_axes((0.07, 0.08, len(flat) / len(slots) - 0.08, 0.58))
    _draw_cells(inset, shown, flat, series, draw)
    inset.set_xlim(-0.5, len(flat) - 0.5)
    inset.set_ylim(low, 100.3)
    inset.set_xticks([])
    _separate(inset, flat)
    clean(inset)
    inset.tick_params(labelsize=SMALL - 2)
    inset.set_title("magnified", fontsize=SMALL - 1, loc="left", pad=2)


def _whisker(scores: Scores) -> float:
    """Where the lower whisker ends, at most 1.5 box lengths below the box."""
    lower, upper = np.percentile(scores, [25, 75])
    return max(float(scores.min()), float(lower - 1.5 * (upper - lower)))


# --- Cells -----------------------------------------------------------------------------------------------

_TWO_GROUPS = 0.85
"""Share of the variance that a cut into two groups explains, from which there are two: a uniform distribution
has 0.75, a normal one 0.64."""
_LEAST_GROUP, _LEAST_TRIALS = 0.1, 3
"""Share of the trials, and trials, that a group has at least."""
_LEAST_DISTANCE = 5.0
"""Between the groups' means, in points: less would not be seen."""


def falls_into_two_groups(scores: Scores) -> bool:
    """True if some cut, with a tenth of the trials on either side, explains most of the variance."""
    ordered, count = np.sort(scores), len(scores)
    least = max(_LEAST_TRIALS, round(_LEAST_GROUP * count))
    cuts = np.arange(least, count - least + 1)
    variance = float(ordered.var())
    if not len(cuts) or not variance:
        return False
    sums = np.cumsum(ordered)
    left, right = sums[cuts - 1] / cuts, (sums[-1] - sums[cuts - 1]) / (count - cuts)
    between = cuts * (count - cuts) / count**2 * (right - left) ** 2
    best = int(between.argmax())
    return bool(between[best] >= _TWO_GROUPS * variance and right[best] - left[best] >= _LEAST_DISTANCE)


def _draw_box_or_strip(axes: Axes, scores: Scores, place: float, width: float, style: Style) -> None:
    draw = _draw_strip if falls_into_two_groups(scores) else _draw_box
    draw(axes, scores, place, width, style)


def _draw_box(axes: Axes, scores: Scores, place: float, width: float, style: Style) -> None:
    line = {"linewidth": 0.6, "color": style.edge}
    width_of_edge = 1.1 if style.is_hollow else 0.5
    axes.boxplot(
        scores,
        positions=[place],
        widths=width,
        manage_ticks=False,
        patch_artist=True,
        boxprops={"facecolor": style.face, "edgecolor": style.edge, "linewidth": width_of_edge},
        medianprops={"color": INK, "linewidth": 1},
        whiskerprops=line,
        capprops=line,
        flierprops={"markersize": 2, "marker": ".", "markeredgecolor": style.colour},
    )


_GOLDEN = 0.618


def _draw_strip(axes: Axes, scores: Scores, place: float, width: float, style: Style) -> None:
    """Points spread evenly over the width, and a line at the median."""
    aside = (np.arange(len(scores)) * _GOLDEN % 1 - 0.5) * width
    size, edge = (2.2, 0.5) if style.is_hollow else (3.5, 0.0)
    axes.plot(
        place + aside,
        scores,
        "o" if style.is_hollow else ".",
        color=style.colour,
        markerfacecolor="none" if style.is_hollow else style.colour,
        markersize=size,
        alpha=0.6,
        markeredgewidth=edge,
    )
    middle = float(np.median(scores))
    axes.plot([place - width / 2, place + width / 2], [middle, middle], color=INK, linewidth=1.2)


# --- Places ----------------------------------------------------------------------------------------------


def slot_of(trials: Trials) -> Slot:
    """Where an experiment is on the axis; without flawed robots their accuracy does not matter."""
    experiment = trials.experiment
    if not experiment.flawed:
        return 0.0, 0.0
    return share_of(trials), round(experiment.flawed_accuracy - experiment.true_accuracy, 9)


def _off(slot: Slot) -> str:
    return f"{slot[1]:+.2g}".replace("-", "\N{MINUS SIGN}") if slot[0] else ""


def _mark_shares(axes: Axes, slots: Sequence[Slot]) -> None:
    """P below the slots that have it, and lines between them."""
    for share, middle in _separate(axes, slots).items():
        axes.annotate(
            f"{share:.0%}",
            (middle, 0),
            (0, -16),
            axes.get_xaxis_transform(),
            "offset points",
            ha="center",
            va="top",
            fontsize=SMALL,
        )


def _separate(axes: Axes, slots: Sequence[Slot]) -> dict[float, float]:
    """Lines between the slots of different P; returns the middle of the slots of each."""
    middles, start = {}, 0
    for share, group in groupby(slots, lambda slot: slot[0]):
        count = len(list(group))
        middles[share] = start + (count - 1) / 2
        start += count
        axes.axvline(start - 0.5, color="#bbbbbb", linewidth=0.8)
    return middles


def _axis(experiments: Sequence[Trials], key: str) -> list[float]:
    return sorted({getattr(trials.experiment, key) for trials in experiments})


# --- Confidence ------------------------------------------------------------------------------------------

_OBSERVED = 100_000


def confidence() -> Figure:
    """The local confidence alpha of an observation against b_hat (eq. 4), as the paper's figure 2: a line for
    each n/t, of which 0.505 and 0.905 are the least and the largest that its study has on average."""
    figure = empty_figure(0.7 * WIDTH, 4)
    axes = figure.subplots()
    b_hat = np.linspace(0.505, 0.995, 393)
    shares = (0.505, 0.7, 0.905)
    for colour, share in zip(ordered_colours(len(shares)), shares, strict=True):
        n = round(share * _OBSERVED)
        alpha = [local_confidence(n, _OBSERVED, float(each)) / _OBSERVED for each in b_hat]
        axes.semilogy(b_hat, alpha, color=colour, linewidth=1.6, label=f"$n/t$ = {share:g}")
    axes.set_xlabel(r"assumed accuracy $\hat{b}$", fontsize=MEDIUM)
    axes.set_ylabel(r"local confidence $\alpha / t$", fontsize=MEDIUM)
    axes.legend(frameon=False, fontsize=SMALL)
    clean(axes)
    return figure
