"""A picture of each claim: its comparisons as cells, coloured by their difference, with interval and mark."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mcp_asdf_tools.common import DIVERGING, INK, empty_figure
from mcp_asdf_tools.reproduction.comparisons import SEEN
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation

MARKS = {True: "\N{CHECK MARK}", False: "\N{BALLOT X}", None: "?"}
"""Holds, fails, open."""

_COLUMN, _ROW, _HEAD, _SIDE = 1.25, 0.44, 0.95, 2.3
"""Sizes in inches."""
_FULL = 30.0
"""Points of a score from which a colour is as strong as can be."""
_WORDS = {
    Expectation.ABOVE: "at least {:g}",
    Expectation.BELOW: "at most \N{MINUS SIGN}{:g}",
    Expectation.SAME: "within \N{PLUS-MINUS SIGN}{:g}",
    Expectation.NOT_ABOVE: "not above {:g}",
    Expectation.NOT_BELOW: "not below \N{MINUS SIGN}{:g}",
}


def heat_map(comparisons: Sequence[Comparison]) -> Figure:
    """A row for each f, b and b_hat, a column for each contrast, whose head ends in what is claimed."""
    rows = list(dict.fromkeys(each.place.row for each in comparisons))
    heads = list(dict.fromkeys(_head(each) for each in comparisons))
    width, height = _SIDE + _COLUMN * len(heads), _HEAD + _ROW * len(rows)
    figure = empty_figure(width, height)
    figure.set_layout_engine("none")
    axes = figure.add_axes((_SIDE / width, 0, 1 - _SIDE / width, 1 - _HEAD / height))
    axes.set_axis_off()
    axes.set_xlim(0, len(heads))
    axes.set_ylim(len(rows), 0)
    strongest = max(abs(each.estimate.value) for each in comparisons)
    full = _FULL if strongest > 1 else max(strongest, 1e-9)  # smaller units have a scale of their own
    for each in comparisons:
        place = heads.index(_head(each)), rows.index(each.place.row)
        colour = DIVERGING(0.5 + 0.35 * min(max(each.estimate.value / full, -1), 1))
        axes.add_patch(Rectangle(place, 1, 1, facecolor=colour, edgecolor="white", linewidth=1.5))
        axes.text(
            place[0] + 0.5, place[1] + 0.5, _numbers(each), ha="center", va="center", fontsize=7.5, color=INK
        )
    for index, row in enumerate(rows):
        axes.text(-0.06, index + 0.5, row, ha="right", va="center", fontsize=8)
    for index, head in enumerate(heads):
        words = "\n".join(textwrap.wrap(head, 21))
        axes.text(index + 0.5, -0.1, words, ha="center", va="bottom", fontsize=7)
    return figure


def _head(comparison: Comparison) -> str:
    return f"{comparison.place.column}: {_WORDS[comparison.expectation].format(comparison.size)}"


def _numbers(comparison: Comparison) -> str:
    return f"{in_words(comparison)} {MARKS[comparison.holds]}".replace(" [", "\n[")


def in_words(comparison: Comparison) -> str:
    """The difference with its interval."""
    estimate = comparison.estimate
    digits = ".1f" if comparison.size >= SEEN else ".3g"
    value, low, high = (format(each, digits).replace("-", "\N{MINUS SIGN}") for each in estimate)
    return value if estimate.low == estimate.high else f"{value} [{low}, {high}]"
