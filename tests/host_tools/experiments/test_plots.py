"""Pictures show what they say: their artists are compared with the numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from mcp_asdf_tools import library
from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import COLOURS, FLAWED, INK, OTHER, number_in_words
from mcp_asdf_tools.experiments.curve_plot import MEASURES, plot_curve
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.plot_panels import colours_of_filters, median_interval
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.score_plots import plot_boxes, plot_scatter
from mcp_asdf_tools.experiments.scores import Limits
from mcp_asdf_tools.experiments.time_plots import plot_accuracy_bands, plot_errors_over_time, plot_series
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.filters import FILTERS

LIMITS = Limits(200, 0.4)
BASE = Experiment(robots=4, flawed=0, steps=300, filter_period=100, trials=5, filter="none")
CELLS = ((0, 0.95), (2, 0.55), (2, 0.75), (4, 0.55))
WITHOUT, ROBUST = "#999999", "#009e73"
MODES: tuple[tuple[str, int], ...] = (("none", 100), ("asdf-plus", 100), ("asdf-plus", 150))
GRID = [
    replace(BASE, flawed=flawed, fill_ratio=f, flawed_accuracy=b_hat, filter=mode, filter_period=period)
    for f in (0.55, 0.95)
    for flawed, b_hat in CELLS
    for mode, period in MODES
]

GRAPHS = [[(0, 1)], [(0, 1), (0, 2), (0, 10), (0, 11)], [(a, b) for a in range(4) for b in range(a)]]
MOVING: dict[str, Any] = {"robots": 6, "steps": 200, "trials": 7, "filter_period": 50, "topology": "dynamic"}


def results_of(experiment: Experiment, sampling_interval: int = 0) -> Trials:
    return run_trials(experiment, 0, experiment.trials, sampling_interval)


@pytest.fixture(scope="module")
def results() -> list[Trials]:
    return [results_of(experiment) for experiment in GRID]


def legend_of(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def check_panels(figure: Figure, rows: int, columns: int, height: float, *titles: str) -> None:
    """Panels fit a page, and can be compared: rows, columns and inches, common axes, no frame."""
    assert tuple(figure.get_size_inches()) == pytest.approx((9 if columns > 1 else 6.3, 1.4 + rows * height))
    shown = [axes for axes in figure.axes if axes.axison]
    for axes in shown:
        assert axes.get_subplotspec().get_geometry()[:2] == (rows, columns)  # type: ignore[union-attr]
        assert not axes.spines["top"].get_visible()
        assert axes is shown[0] or axes.get_shared_y_axes().joined(axes, shown[0])
    assert not titles or [axes.get_title() or axes.get_title("left") for axes in shown] == [*titles]


def check_medians(line: Any, band: Any, samples: dict[float, Any]) -> None:
    """A line goes through the medians of samples at their places, in a band of their intervals."""
    ends = np.asarray(band.get_paths()[0].vertices)
    assert np.array_equal(line.get_xdata(), [*samples])
    for (place, sample), median in zip(samples.items(), line.get_ydata(), strict=True):
        heights = ends[ends[:, 0] == place, 1]
        assert (median, heights.min(), heights.max()) == median_interval(sample)
    assert not band.get_edgecolor().size


def caption_of(figure: Figure) -> str:
    words: str = figure._supxlabel.get_text()  # type: ignore[attr-defined]
    return " ".join(words.split())


def test_boxes_are_where_and_what_they_should_be(results: list[Trials]) -> None:
    """Points are the trials' scores beside each other, lines their medians; grey without a filter."""
    figure = plot_boxes(results, LIMITS)
    assert legend_of(figure) == ["no filter", "ASDF+, filter period 100", "ASDF+, filter period 150"]
    for f, axes in zip((0.55, 0.95), figure.axes, strict=True):
        assert axes.get_title() == f"$f = {f}$, $b = 0.95$"
        medians = [np.array(line.get_ydata()) for line in axes.lines if len(line.get_xydata()) == 2]  # type: ignore[arg-type]
        clouds = [
            (*np.array(line.get_xydata()).T, line.get_color())
            for line in axes.lines
            if line.get_marker() == "." and not line.get_markeredgewidth()
        ]
        clouds.sort(key=lambda cloud: cloud[0].mean())
        own = [trials for trials in results if trials.experiment.fill_ratio == f]
        assert len(axes.lines) == 7 * len(own), "a box is six lines: nothing is drawn twice"
        order = sorted(own, key=lambda each: (each.experiment.flawed, each.experiment.flawed_accuracy))
        for number, (trials, (x, y, colour)) in enumerate(zip(order, clouds, strict=True)):
            slot, index = divmod(number, 3)
            scores = trials.scores(LIMITS)["H"]
            assert np.array_equal(y, scores)
            assert abs(x.mean() - (slot + (index - 1) * 0.86 / 3)) < 0.05
            assert len(set(x)) == len(x)
            assert 0.1 < np.ptp(x) < 0.86 / 3
            assert colour == (WITHOUT, COLOURS[0], COLOURS[1])[index]
            assert any((line == np.median(scores)).all() for line in medians)
        labels = [label.get_text() for label in axes.get_xticklabels()]
        assert labels == ["+0\n0%", "-0.4\n50%", "-0.2\n50%", "-0.4\n100%"]
        assert axes.get_xlim() == (-0.5, 3.5)
        assert axes.get_ylim() == (0, 103)
    check_panels(figure, 2, 1, 2.6)
    assert figure.get_supylabel() == "score $H$"
    words = caption_of(figure)
    assert words.startswith(r"$\hat{b} - b$ of flawed robots")
    assert "robots 4, topology fully-connected, steps 300, seed 1, omega 0.05, 5 trials of each" in words
    assert "$K_{max}$ = 200, $e_{max}$ = 0.4; a point is a trial" in words
    assert legend_of(plot_boxes(results, series_name=lambda _: "all of them")) == ["all of them"]


def test_points_are_the_trials_in_the_papers_colours(results: list[Trials]) -> None:
    """Rows are series and f, columns P; underconfident swarms are red, overconfident ones blue."""
    over = results_of(replace(BASE, flawed=2, true_accuracy=0.55, flawed_accuracy=0.95))
    figure = plot_scatter([*results, over], LIMITS)
    check_panels(figure, 6, 3, 1.7)
    found = {axes.get_title(): axes for axes in figure.axes}
    own = [t for t in results if t.experiment.fill_ratio == 0.95 and t.experiment.filter == "none"]
    for share, count in ((0, 1), (2, 2), (4, 1)):
        axes = found[f"no filter\n$f = 0.95$, $P$ = {share / 4:.0%}"]
        expected = [t for t in own if t.experiment.flawed == share]
        assert len(axes.lines) == len(expected) == count
        for trials, line in zip(expected, axes.lines, strict=True):
            _, *scores = trials.scores(LIMITS).values()
            assert np.array_equal(np.array(line.get_xydata()), np.stack(scores, axis=1))
    far, near, blue = lines = found["no filter\n$f = 0.55$, $P$ = 50%"].lines
    reds, blues = zip(*(np.array(to_rgb(line.get_color()))[[0, 2]] for line in lines), strict=True)
    assert reds[0] > blues[0] and reds[1] > blues[1] and reds[2] < blues[2]
    assert sum(to_rgb(far.get_color())) < sum(to_rgb(near.get_color()))
    assert axes.get_xlim() == axes.get_ylim() == (-4, 104)
    assert far.get_marker() == near.get_marker() != blue.get_marker()
    assert found["no filter\n$f = 0.55$, $P$ = 0%"].lines[0].get_color() == "#222222"
    assert r"$b$ = 0.55, $\hat{b}$ = 0.95" in legend_of(figure)
    assert "$b$ = 0.95, none flawed" in legend_of(figure)


def test_what_does_not_fit_a_picture_is_refused(results: list[Trials]) -> None:
    many = [replace(results[0], experiment=replace(GRID[0], seed=seed)) for seed in range(9)]
    for plot in (plot_boxes, plot_scatter, lambda each: plot_curve(each, "omega", "seed")):
        with pytest.raises(UsageError, match="9 series do not fit"):
            plot(many)
    assert len(plot_boxes(many[:8]).legends[0].get_texts()) == 8
    many = [replace(results[0], experiment=replace(GRID[0], fill_ratio=f / 40)) for f in range(33)]
    assert len(plot_boxes(many[:32]).axes) == 32
    with pytest.raises(UsageError, match="33 panels"):
        plot_boxes(many)


@pytest.mark.parametrize("y", MEASURES)
def test_points_are_medians_and_bands_their_intervals(y: str) -> None:
    """A curve for each density, a point for each omega, however they are ordered."""
    omegas, densities = [0.05, 0.9, 0.02], [2.0, 0.5]
    many = grid(**MOVING, density=densities, omega=omegas)
    swept = [results_of(each) for each in many]
    figure = plot_curve(swept, "omega", "density", y)
    (axes,) = figure.axes
    for line, band, density in zip(axes.lines, axes.collections, sorted(densities), strict=True):
        own = {float(each.experiment.omega): each for each in swept if each.experiment.density == density}
        check_medians(line, band, {omega: own[omega].measures()[y] for omega in sorted(omegas)})
    assert legend_of(figure) == ["density 0.5", "density 2"]
    check_panels(figure, 1, 1, 3.8)


def test_curves_have_panels_or_go_into_axes_of_ones_own() -> None:
    """A function of the trials is as good as a measure, a curve may be absent, and a range is no interval."""
    varied: dict[str, Any] = {"flawed": [1, 2], "filter": ["none", "robust"], "steps": 60}
    many = grid(robots=[4, 5, 6], trials=2, **varied) + grid(robots=7, trials=7, **varied)
    swept = [results_of(each) for each in many if (each.robots, each.filter) != (6, "robust")]
    figure = plot_curve(swept, "flawed", "filter", facet="robots")
    check_panels(figure, 2, 3, 2.6, *(f"robots {robots}" for robots in (4, 5, 6, 7)))
    for axes, robots in zip(figure.axes, (4, 5, 6, 7), strict=False):
        own = [each.measures()["H"] for each in swept if each.experiment.robots == robots]
        drawn = np.array([line.get_ydata() for line in axes.lines])
        assert np.array_equal(drawn.T.ravel(), np.median(own, axis=1))
    assert legend_of(figure) == ["filter none", "filter robust"]
    assert "2 to 7 trials of each" in caption_of(figure) and "fewer than 6, else 95 %" in caption_of(figure)
    whole: Any = Figure()
    axes = whole.subfigures().subplots()
    assert plot_curve(swept[:4:2], "flawed", y=lambda each: each.errors[:, 0], ax=axes) is whole
    assert np.array_equal(axes.lines[0].get_ydata(), [np.median(each.errors[:, 0]) for each in swept[:4:2]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("share of flawed robots", "<lambda>")
    assert axes.get_legend() is None
    plot_curve(swept[:4], "flawed", "filter", ax=axes)
    assert [each.get_text() for each in axes.get_legend().get_texts()] == legend_of(figure)
    assert not axes.get_legend().get_frame_on()
    with pytest.raises(UsageError, match="give one of them"):
        plot_curve(swept[:4], "flawed", "filter", facet="robots", ax=axes)


def test_errors_over_time_are_medians_of_the_swarms_means() -> None:
    """At the steps of the records, also where these do not divide a trial."""
    common = replace(BASE, flawed=2, steps=290, trials=6)
    many = [replace(common, filter=name, fill_ratio=f) for name in ("none", "robust") for f in (0.55, 0.95)]
    swarms = [results_of(each, 50) for each in many]
    panels = {"both": swarms, "none": swarms[:2], "robust": swarms[2:], "one": swarms[:1]}
    figure = plot_errors_over_time(panels)
    check_panels(figure, 2, 3, 1.9, *panels)
    both, _, robust, *_ = figure.axes
    for line, band, own in zip(both.lines, both.collections, (swarms[:2], swarms[2:]), strict=True):
        errors = np.concatenate([abs(each.records["x"] - each.experiment.fill_ratio).mean(2) for each in own])
        check_medians(line, band, dict(zip(range(0, 290, 50), errors.T, strict=True)))
    assert [line.get_color() for line in (*both.lines, *robust.lines)] == [WITHOUT, ROBUST, ROBUST]
    assert both.get_yscale() == "log" and legend_of(figure) == ["no filter", "robust"]
    assert "bands their 95 % intervals" in caption_of(figure)


@pytest.mark.parametrize(
    ("x", "values", "expected"),
    [
        ("filter_period", [50, 100, 150], [50, 100, 150]),
        ("flawed", ["0%", "50%", "100%"], [0, 0.5, 1]),
        ("filter", ["none", "asdf-plus"], ["none", "asdf-plus"]),
        ("graph", GRAPHS, [0, 1, 2]),
        ("filter", ["robust", "asdf-plus", "asdf-minus", "none"], [*FILTERS]),
    ],
)
def test_any_parameter_can_be_along_the_axis(x: str, values: list[object], expected: list[object]) -> None:
    given = MOVING | {x: values} | ({"topology": "graph", "robots": 12} if x == "graph" else {})
    many = grid(**given)
    (axes,) = plot_curve([results_of(each) for each in many], x).axes
    assert np.asarray(axes.lines[0].get_xdata()).tolist() == expected
    if x == "graph":
        shown = ["0 1", "0 1; 0 2; 0 10; 0 11", "0 1; 0 2; 0 3; 1 2;  ..."]
        assert [each.get_text() for each in axes.get_xticklabels()] == shown


def test_the_robust_filter_is_last_and_green() -> None:
    """Without omega, which its test has not: it neither varies nor stands in the caption for this filter."""
    common = replace(BASE, flawed=2, trials=1)
    by_filter = {each: results_of(replace(common, filter=each)) for each in reversed(FILTERS)}
    often = results_of(replace(common, filter="robust", filter_period=50))
    figure = plot_boxes([often, *by_filter.values()])
    names = [swarm_filter.typeset_term for swarm_filter in FILTERS.values()]
    shown = [f"{each}, filter period 100" for each in names[1:]]
    assert legend_of(figure) == ["no filter", *shown[:2], "robust, filter period 50", shown[2]]
    colours = [handle.get_color() for handle in figure.legends[0].get_lines()]
    assert colours == [WITHOUT, COLOURS[0], COLOURS[1], ROBUST, COLOURS[3]]
    assert "omega 0.05" in caption_of(figure)
    assert "omega" not in caption_of(plot_boxes([often, by_filter["none"]]))
    (axes,) = plot_curve([*by_filter.values()], "flawed", "filter").axes
    assert [line.get_color() for line in axes.lines] == [WITHOUT, COLOURS[0], COLOURS[1], ROBUST]
    alike = colours_of_filters(["none", "none", "asdf-plus", "robust", "robust"])
    assert (alike[0], alike[3]) == (WITHOUT, ROBUST) and len({*alike}) == 5, "each can be told apart"
    strict = replace(by_filter["asdf-plus"].experiment, omega=0.1)
    mixed = [*(by_filter | {"asdf-plus": replace(by_filter["asdf-plus"], experiment=strict)}).values()]
    assert [axes.get_title().split("\n")[0] for axes in plot_accuracy_bands(mixed).axes] == names
    assert len(plot_curve(mixed[:2], "filter").axes[0].lines) == 1
    with pytest.raises(UsageError, match="the results differ in omega too"):
        plot_curve(mixed, "filter")


@pytest.mark.parametrize(("trials", "beyond"), [(5, 1), (6, 1), (30, 10), (100, 40)])
def test_intervals_of_medians_are_those_of_the_tables(trials: int, beyond: int) -> None:
    """Ranks from the binomial distribution, as printed in books on nonparametric statistics."""
    values = np.random.default_rng(trials).permutation(trials).astype(float)
    assert median_interval(values) == (np.median(values), beyond - 1, trials - beyond)
    assert median_interval(np.repeat([0.0, 5, 9], [1, 28, 1])) == (5, 5, 5)


def test_bands_hold_all_robots_of_all_trials(results: list[Trials]) -> None:
    (trials,) = [each for each in results if each.experiment == replace(GRID[4], fill_ratio=0.55)]
    figure = plot_accuracy_bands([trials] * 5)
    assert [axes.axison for axes in figure.axes] == [True] * 5 + [False]
    flawed, healthy, truth = figure.axes[0].lines
    assert (flawed.get_color(), healthy.get_color()) == (FLAWED, OTHER)
    assert np.array_equal(flawed.get_xdata(), [100, 200, 300])
    assert np.array_equal(flawed.get_ydata(), np.median(trials.b_hat[..., :2], axis=(0, 2)))
    assert np.array_equal(healthy.get_ydata(), np.median(trials.b_hat[..., 2:], axis=(0, 2)))
    assert np.all(np.asarray(truth.get_ydata()) == 0.95)
    heights = np.asarray(figure.axes[0].collections[0].get_paths()[0].vertices)[:, 1]
    low, high = np.percentile(trials.b_hat[..., :2], [5, 95], axis=(0, 2))
    assert (heights.min(), heights.max()) == (low.min(), high.max())
    off = np.mean(abs(trials.b_hat[:, -1, 2:] - 0.95) > 0.05)
    title = figure.axes[0].get_title().replace("\xa0", " ")
    cell, _, words = title.replace("\n", " ").partition(" more than 0.05 off: ")
    assert cell == r"$f$ = 0.55, $b$ = 0.95, $\hat{b}$ = 0.55, $P$ = 50%"
    assert words == f"{off:.0%} of healthy robots"
    check_panels(figure, 2, 3, 2.1)
    whole = results_of(replace(trials.experiment, flawed=4))
    four = plot_accuracy_bands([trials, trials, trials, whole])
    check_panels(four, 2, 2, 2.1)
    assert len(four.axes[3].lines) == 2 and four.axes[3].get_title().endswith("off: -")
    other = results_of(replace(trials.experiment, filter="none"))
    assert [axes.get_title().split("\n")[0] for axes in plot_accuracy_bands([trials, other]).axes] == [
        "no filter",
        "ASDF+",
    ]
    with pytest.raises(UsageError, match="these trials have no filter step"):
        plot_accuracy_bands([trials, results_of(replace(BASE, filter_period=1000))])


def test_series_beside_each_other_show_their_records() -> None:
    """Room is for all but the first moments, which are wild, and the longest; flawed robots lie on top."""
    one = replace(BASE, flawed=1, trials=1)
    runs = [results_of(one, 2), results_of(replace(one, filter="asdf-plus", steps=200), 30)]
    figure = plot_series(runs, 0)
    panels = np.array(figure.axes).reshape(3, 2)
    for row, name, truth in zip(panels, ("b_hat", "x_hat", "x"), (0.95, 0.55, 0.55), strict=True):
        settled = np.concatenate([runs[0].records[name][0][3:], runs[1].records[name][0], [[truth] * 4]])
        margin = max(0.06 * np.ptp(settled), 0.01)
        for axes, trials in zip(row, runs, strict=True):
            assert axes.get_ylim() == pytest.approx((settled.min() - margin, settled.max() + margin))
            assert axes.get_xlim() == (0, 300)
            assert [line.get_color() for line in axes.lines] == [OTHER] * 3 + [FLAWED, INK]
            drawn = np.array([line.get_ydata() for line in axes.lines[:4]])
            assert np.array_equal(drawn[::-1].T, trials.records[name][0])
            steps = range(0, 301, 2) if trials is runs[0] else range(0, 200, 30)
            assert np.array_equal(axes.lines[0].get_xdata(), steps)
            assert axes.texts[0].get_text().strip() == f"{'b' if name == 'b_hat' else 'f'} = {truth}"
            assert axes.texts[0].get_position() == (1, truth)
            assert np.asarray(axes.lines[4].get_ydata()).tolist() == [truth] * 2
            assert axes.lines[0].get_drawstyle() == ("steps-post" if name == "b_hat" else "default")
    titles = [axes.get_title("left") for axes in panels.flat]
    words = "4 robots, 1 flawed,\nfully-connected, seed 1, trial 0"
    assert titles == [f"no filter: {words}", f"ASDF+, $\\tau$ = 100: {words}", "", "", "", ""]
    assert [axes.get_ylabel().split("$")[0] for axes in panels[:, 0]] == [
        *("assumed accuracy ", "local estimate ", "informed estimate "),
    ]
    assert [axes.get_xlabel() for axes in panels.flat] == [""] * 4 + ["step"] * 2
    assert legend_of(figure) == ["flawed robots", "healthy robots", "true value"]
    assert plot_series(runs[:1], 0).axes[0].get_title("left") == titles[0]
    with pytest.raises(UsageError, match=r"there is no trial 1; choose one of 0 \.\. 0"):
        plot_series(runs, 1)


def test_numbers_in_words() -> None:
    shown: dict[float | str, str] = {"asdf_plus": "asdf plus", 0.25: "0.25", 1e3: "1000"}
    shown |= {65535: "65535", 65536: "2^16", 65537: "65537"}
    assert {value: number_in_words(value) for value in shown} == shown


@pytest.mark.parametrize(
    ("kind", "chosen", "options", "words"),
    [
        ("series", [0, 1], {}, "2 experiments match; choose one with where filter="),
        ("series", [0], {}, "nothing was recorded over time"),
        ("curve", [0, 1], {"x": "omega"}, "the results differ in filter too"),
        ("curve", [0, 3], {"x": "omega"}, "the results differ in flawed_accuracy, flawed too"),
        ("curve", [0], {}, "x is ''; choose a parameter: robots, topology"),
        ("curve", [0], {"x": "omega", "hue": "tao"}, "hue is 'tao'; choose"),
        ("curve", [0], {"x": "omega", "y": "h"}, "y is 'h'; choose one of H,"),
        ("curve", [0], {"x": "omega", "y": lambda trials: trials.errors}, r"y gives shape \(5, 4\)"),
        ("curve", [0], {"x": "omega", "y": "e", "limits": Limits()}, "limits would do nothing"),
        ("curve", [0], {"x": "omega", "facet": "flawed", "ax": object()}, "facet makes panels and ax is one"),
        ("boxes", [], {}, "there is no experiment to draw"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused(
    kind: str, chosen: list[int], options: dict[str, Any], words: str, results: list[Trials]
) -> None:
    with pytest.raises(UsageError, match=words):
        library.PLOTS[kind]([results[index] for index in chosen], **options)


@pytest.mark.parametrize(("suffix", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_the_command_draws(suffix: str, start: bytes, tmp_path: Path) -> None:
    """Equal results give equal files."""
    found, picture = tmp_path / "run.parquet", tmp_path / f"picture.{suffix}"
    write_tables(found, [trials_to_table(run_trials(BASE, 0, 1))])
    written = []
    for _ in range(2):
        assert cli.main(["plot", str(found), str(picture)]) == 0
        written.append(picture.read_bytes())
    assert written[0].startswith(start)
    assert written[0] == written[1]
