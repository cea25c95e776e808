"""Pictures of convergence against accuracy."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcp_asdf_tools.common import INK, MEDIUM, SMALL, WIDTH, add_caption, add_legend, clean, empty_figure
from mcp_asdf_tools.experiments.plots import slot_of
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import LimitsOf, paper_limits
from mcp_asdf_tools.experiments.series_names import Name, by_series, caption_of, check_size, share_of

_MARKERS = "osD^v"
_OVERCONFIDENT = ("#56b4e9", "#0072b2", "#023858", "#000000")
_UNDERCONFIDENT = ("#e69f00", "#d55e00", "#7f2704", "#3b1102")
"""From slightly to badly wrong: blue and red or orange, as in the paper."""

POINTS = (
    "a point is a trial: blue where flawed robots are overconfident, red or orange where they are "
    "underconfident, darker the farther off"
)


def scatter(
    experiments: Sequence[Trials], limits: LimitsOf = paper_limits, name: Name | None = None
) -> Figure:
    """h_e against h_K, a point for each trial, as the paper's figure 4: a row for each series and f, a column
    for each P; overconfident swarms blue, underconfident ones red or orange, a shape for each b."""
    series = by_series(experiments, name)
    fills = sorted({trials.experiment.fill_ratio for trials in experiments})
    shares = sorted({share_of(trials) for trials in experiments})
    rows = [(key, f) for key in series for f in fills]
    check_size(len(rows) * len(shares), len(series))
    figure = empty_figure(WIDTH if len(shares) > 2 else 0.7 * WIDTH, 1.6 + 1.7 * len(rows))
    grid = figure.subplots(len(rows), len(shares), sharex=True, sharey=True, squeeze=False)
    looks = _looks_of(experiments)
    for (key, f), row in zip(rows, grid, strict=True):
        for axes, share in zip(row, shares, strict=True):
            own = [t for t in series[key] if (t.experiment.fill_ratio, share_of(t)) == (f, share)]
            _draw_points(axes, own, limits, looks)
            axes.set_title(f"{key}\n$f = {f:g}$, $P$ = {share:.0%}", fontsize=SMALL)
    figure.supylabel("accuracy score $h_e$", fontsize=MEDIUM)
    axis = "convergence score $h_K$"
    add_caption(figure, axis, caption_of(experiments, POINTS, limits=limits))
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, label=_look_name(*key))
        for key, (colour, marker) in looks.items()
    ]
    add_legend(figure, handles)
    return figure


Look = tuple[float, float]
"""b, and b_hat less b."""


def _look_of(trials: Trials) -> Look:
    return trials.experiment.true_accuracy, slot_of(trials)[1]


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
    if not own:
        place, centre = (0.5, 0.5), "center"
        axes.text(
            *place, "not run", ha=centre, va=centre, transform=axes.transAxes, fontsize=SMALL, color=INK
        )
    axes.set_xlim(-4, 104)
    axes.set_ylim(-4, 104)
    axes.set_xticks((0, 50, 100))
    axes.set_yticks((0, 50, 100))
    clean(axes)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
