"""The picture of the O(1) claim on silicon: what a call costs against t and against m."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcp_asdf_tools.common.figures import (
    COLOURS,
    MEDIUM,
    WIDTH,
    add_caption,
    add_legend,
    clean,
    empty_figure,
)

from .images import ROOT
from .measurement import Figures

PATH = ROOT / "docs" / "images" / "cost.png"

_TARGETS = {
    "cycles": ("ATmega328P",),
    "instructions": ("Cortex-M0+", "RV32IMC", "Cortex-M3", "Cortex-M4"),
}
"""A row of panels for each unit: on the AVR cycles are counted."""
_COLOURS = dict(
    zip(
        [name for names in _TARGETS.values() for name in names],
        (COLOURS[i] for i in (1, 0, 2, 3, 7)),
        strict=True,
    )
)

_WIDTHS = {"Cortex-M3": 4.5}
"""Of lines below others, here almost the same, so that both are seen."""


def draw(figures: Figures) -> Figure:
    """Two panels for each unit at -O2: lines are the maximum; of a step, shades reach down to the minimum."""
    figure = empty_figure(WIDTH, 6.4)
    grid = figure.subplots(len(_TARGETS), 2, sharex="col", sharey="row")
    for (unit, names), (by_age, by_messages) in zip(_TARGETS.items(), grid, strict=True):
        for name in names:
            series = figures["targets"][name]["-O2"]["firmware"]["series"]
            if series["unit"] != unit:
                raise ValueError(f"{name} was measured in {series['unit']}, not in {unit}")
            _draw_target(by_age, by_messages, series, _COLOURS[name], _WIDTHS.get(name, 1.4))
        by_age.set_ylabel(f"{unit} of a call", fontsize=MEDIUM)
        by_age.set_xscale("log", base=2)
        for axes in (by_age, by_messages):
            axes.set_ylim(0, None)
            clean(axes)
    grid[0, 0].set_title("step", fontsize=MEDIUM)
    grid[0, 1].set_title("receive (solid) and settle (dashed)", fontsize=MEDIUM)
    grid[1, 0].set_xlabel("observations $t$", fontsize=MEDIUM)
    grid[1, 1].set_xlabel("messages in the round $m$", fontsize=MEDIUM)
    add_caption(
        figure, "", "Lines are the maximum that was seen; of a step, shades reach down to the minimum."
    )
    add_legend(figure, [Line2D([], [], color=colour, label=name) for name, colour in _COLOURS.items()])
    return figure


def _draw_target(by_age: Axes, by_messages: Axes, series: Figures, colour: str, width: float) -> None:
    at, least, most = zip(*series["step"], strict=True)
    by_age.plot(at, most, color=colour, linewidth=width)
    by_age.fill_between(at, least, most, color=colour, alpha=0.12, linewidth=0)
    for call, style in (("receive", ".-"), ("settle", ".--")):
        at, _, most = zip(*series[call], strict=True)
        by_messages.plot(at, most, style, color=colour, linewidth=width, markersize=3.5 + width)
