"""The picture of the O(1) claim: operations of every call against t, m and q."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mcp_asdf_tools.crosscheck.operation_count import CallCount

# Colours that stay apart for the colour-blind.
_COLOURS = {
    "step": "#222222",
    "settle": "#d55e00",
    "observe": "#0072b2",
    "receive": "#009e73",
    "x": "#cc79a7",
}
_LABELS = {"t": "observations t", "m": "messages in the round m", "q": "entries of the table q"}


def draw(counts: dict[str, CallCount]) -> Figure:
    """Return a figure of three panels: lines are the maximum, shades reach down to the minimum."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(_LABELS), sharey=True)
    for axes, (axis, label) in zip(panels, _LABELS.items(), strict=True):
        for call, count in counts.items():
            _draw_call(axes, call, sorted(count.axes[axis].items()))
        axes.set_xlabel(label)
        axes.grid(color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_xscale("log", base=2)
    panels[0].set_ylim(0, None)
    panels[0].set_ylabel("integer operations per call")
    figure.legend(
        *panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=len(counts), frameon=False
    )
    return figure


def _draw_call(axes: Axes, call: str, points: list[tuple[int, tuple[int, int]]]) -> None:
    if not points:
        return
    values = [value for value, _ in points]
    least, most = zip(*(range_ for _, range_ in points), strict=True)
    axes.plot(values, most, color=_COLOURS[call], linewidth=1.4, label=call)
    axes.fill_between(values, least, most, color=_COLOURS[call], alpha=0.12, linewidth=0)
