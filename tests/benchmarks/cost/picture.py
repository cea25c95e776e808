"""The picture of the O(1) claim on silicon: what a call costs against t and against m."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .images import ROOT
from .measurement import Figures

PATH = ROOT / "docs" / "images" / "cost.png"

# Colours that stay apart for the colour-blind.
_COLOURS = dict(
    zip(
        ("ATmega328P", "Cortex-M0+", "RV32IMC", "Cortex-M3", "Cortex-M4"),
        ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#222222"),
        strict=True,
    )
)


def draw(figures: Figures) -> Figure:
    """Two panels at -O2: lines are the most that was seen; of a step, shades reach down to the least."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    by_age, by_messages = figure.subplots(1, 2, sharey=True)
    for name, colour in _COLOURS.items():
        series = figures["targets"][name]["-O2"]["firmware"]["series"]
        label = f"{name} ({series['unit']})"
        at, least, _ = zip(*series["step"], strict=True)
        most = _line(by_age, series["step"], colour, "-", label)
        by_age.fill_between(at, least, most, color=colour, alpha=0.12, linewidth=0)
        _line(by_messages, series["receive"], colour, ".-", label)
        _line(by_messages, series["settle"], colour, ".--", label)
    by_age.set(title="step", xlabel="observations t", ylabel="instructions or cycles of a call", yscale="log")
    by_age.set_xscale("log", base=2)
    by_messages.set(title="receive (solid) and settle (dashed)", xlabel="messages in the round m")
    for axes in (by_age, by_messages):
        axes.grid(color="#dddddd", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*by_age.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _line(axes: Axes, points: list[list[int]], colour: str, style: str, label: str) -> tuple[int, ...]:
    at, _, most = zip(*points, strict=True)
    axes.plot(at, most, style, color=colour, linewidth=1.4, markersize=5, label=label)
    return most
