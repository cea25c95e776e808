"""The picture of the O(1) claim: operations of every call against t, m and q."""

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
from mcp_asdf_tools.crosscheck.operation_count import CallCount

_COLOURS = dict(
    zip(("step", "settle", "observe", "receive", "x"), (COLOURS[i] for i in (7, 1, 0, 2, 3)), strict=True)
)
_LABELS = {"t": "observations t", "m": "messages in the round m", "q": "entries of the table q"}


def draw(counts: dict[str, CallCount]) -> Figure:
    """Return a figure of three panels: lines are the maximum, shades reach down to the minimum."""
    figure = empty_figure(WIDTH, 4)
    panels = figure.subplots(1, len(_LABELS), sharey=True)
    for axes, (axis, label) in zip(panels, _LABELS.items(), strict=True):
        for call, count in counts.items():
            _draw_call(axes, call, sorted(count.axes[axis].items()))
        axes.set_xlabel(label, fontsize=MEDIUM)
        clean(axes)
    panels[0].set_xscale("log", base=2)
    panels[0].set_ylim(0, None)
    panels[0].set_ylabel("integer operations per call", fontsize=MEDIUM)
    add_caption(figure, "", "Lines are the maximum, shades reach down to the minimum.")
    add_legend(figure, [Line2D([], [], color=_COLOURS[call], label=call) for call in counts])
    return figure


def _draw_call(axes: Axes, call: str, points: list[tuple[int, tuple[int, int]]]) -> None:
    if not points:
        return
    values = [value for value, _ in points]
    least, most = zip(*(range_ for _, range_ in points), strict=True)
    axes.plot(values, most, color=_COLOURS[call], linewidth=1.4)
    axes.fill_between(values, least, most, color=_COLOURS[call], alpha=0.12, linewidth=0)
