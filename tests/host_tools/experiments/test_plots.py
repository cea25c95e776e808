"""Pictures show what they say: their artists are compared with the numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import COLOURS, FLAWED, OTHER, WITHOUT
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.plots import (
    LETTERS,
    MEASURES,
    boxes,
    confidence,
    curve,
    median_interval,
    scatter,
)
from mcp_asdf_tools.experiments.results import Trials, table_of, write_table
from mcp_asdf_tools.experiments.scores import Limits, paper_limits, score
from mcp_asdf_tools.experiments.time_plots import BODY_RADIUS, bands, series_beside, trajectories
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Filtering
from mcp_asdf_tools.world.arena import Arena

LIMITS = Limits(300, 0.45)
BASE = Experiment(robots=4, flawed=0, steps=300, filter_period=100, trials=5, filter="none")
CELLS = ((0, 0.95), (2, 0.55), (2, 0.75), (4, 0.55))
MODES: tuple[tuple[Filtering, int], ...] = (("none", 100), ("asdf-plus", 100), ("asdf-plus", 150))
GRID = [
    replace(BASE, flawed=flawed, fill_ratio=f, flawed_accuracy=b_hat, filter=mode, filter_period=period)
    for f in (0.55, 0.95)
    for flawed, b_hat in CELLS
    for mode, period in MODES
]
MOVING = Experiment(topology="dynamic", robots=12, flawed=5, steps=400, filter_period=100, trials=2)
SWEPT = grid(
    robots=6, steps=200, trials=7, filter_period=50, topology="dynamic", fill_ratio=[0.55, 0.95],
    density=[2.0, 0.5], omega=[0.05, 0.9, 0.02],
)  # fmt: skip


def results_of(experiment: Experiment, sampling_interval: int = 0) -> Trials:
    return run_trials(experiment, 0, experiment.trials, sampling_interval)


@pytest.fixture(scope="module")
def results() -> list[Trials]:
    return [results_of(experiment) for experiment in GRID]


@pytest.fixture(scope="module")
def swept() -> list[Trials]:
    return [results_of(experiment) for experiment in SWEPT]


def panels(figure: Figure) -> dict[str, Axes]:
    return {axes.get_title(): axes for axes in figure.axes}


def legend_of(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


# --- Scores ----------------------------------------------------------------------------------------------


def test_boxes_are_where_and_what_they_should_be(results: list[Trials]) -> None:
    """Points are the trials' scores beside each other, lines their medians; grey without a filter."""
    figure = boxes(results, lambda _: LIMITS)
    assert list(panels(figure)) == ["$f = 0.55$, $b = 0.95$", "$f = 0.95$, $b = 0.95$"]
    slots = [0, 1, 2, 3]
    for f, axes in zip((0.55, 0.95), figure.axes, strict=True):
        lines = [np.array(line.get_xydata()) for line in axes.lines]
        clouds = [
            (*np.array(line.get_xydata()).T, line.get_color())
            for line in axes.lines
            if line.get_marker() == "."
        ]
        clouds.sort(key=lambda cloud: cloud[0].mean())
        own = [trials for trials in results if trials.experiment.fill_ratio == f]
        order = sorted(own, key=lambda each: (each.experiment.flawed, each.experiment.flawed_accuracy))
        for slot, index, trials, (x, y, colour) in zip(
            np.repeat(slots, 3), [0, 1, 2] * 4, order, clouds, strict=True
        ):
            scores = score(trials.convergence_steps, trials.errors, LIMITS).h
            assert np.array_equal(y, scores)
            assert abs(x.mean() - (slot + (index - 1) * 0.86 / 3)) < 0.05
            assert len(set(x)) == len(x)
            assert np.ptp(x) < 0.86 / 3
            assert colour == (WITHOUT, COLOURS[0], COLOURS[1])[index]
            assert any(len(line) == 2 and (line[:, 1] == np.median(scores)).all() for line in lines)
        labels = [label.get_text() for label in axes.get_xticklabels()]
        assert labels == ["+0\n0%", "-0.4\n50%", "-0.2\n50%", "-0.4\n100%"]
        assert axes.get_ylim()[0] == 0


def test_series_are_named_by_what_varies(results: list[Trials]) -> None:
    names = ["no filter", "ASDF+, filter period 100", "ASDF+, filter period 150"]
    assert legend_of(boxes(results, lambda _: LIMITS)) == names
    figure = boxes(results, lambda _: LIMITS, lambda _: "all of them")
    assert legend_of(figure) == ["all of them"]
    assert figure.get_size_inches() == pytest.approx((0.7 * 9, 1.4 + 2 * 2.6))


def test_captions_say_how_to_read_a_figure(results: list[Trials]) -> None:
    words = boxes(results, lambda _: LIMITS)._supxlabel.get_text().replace("\N{NO-BREAK SPACE}", " ")  # type: ignore[attr-defined]
    words = " ".join(words.split())
    assert "robots 4, topology fully-connected, steps 300, seed 1, omega 0.05, 5 trials of each" in words
    assert "$K_{max}$ = 300, $e_{max}$ = 0.45" in words
    assert "whiskers to the last trial within 1.5" in words


def test_points_are_the_trials_in_the_papers_colours(results: list[Trials]) -> None:
    """Rows are series and f, columns P; underconfident swarms are red or orange, overconfident ones blue."""
    over = results_of(replace(BASE, flawed=2, true_accuracy=0.55, flawed_accuracy=0.95))
    figure = scatter([*results, over], lambda _: LIMITS)
    found = panels(figure)
    own = [t for t in results if t.experiment.fill_ratio == 0.95 and t.experiment.filter == "none"]
    for share, count in ((0, 1), (2, 2), (4, 1)):
        axes = found[f"no filter\n$f = 0.95$, $P$ = {share / 4:.0%}"]
        expected = [t for t in own if t.experiment.flawed == share]
        assert len(axes.lines) == len(expected) == count
        for trials, line in zip(expected, axes.lines, strict=True):
            scores = score(trials.convergence_steps, trials.errors, LIMITS)
            assert np.array_equal(np.array(line.get_xydata()), np.stack([scores.h_k, scores.h_e], axis=1))
    lines = found["no filter\n$f = 0.55$, $P$ = 50%"].lines
    assert [line.get_color() for line in lines] == ["#d55e00", "#e69f00", "#0072b2"]
    assert len({line.get_marker() for line in lines}) == 2
    assert found["no filter\n$f = 0.55$, $P$ = 0%"].lines[0].get_color() == "#222222"
    assert r"$b$ = 0.55, $\hat{b}$ = 0.95" in legend_of(figure)


def test_what_does_not_fit_a_picture_is_refused(results: list[Trials]) -> None:
    many = [replace(results[0], experiment=replace(GRID[0], seed=seed)) for seed in range(9)]
    for draw in (boxes, scatter, lambda each: curve(each, "omega", "seed")):
        with pytest.raises(UsageError, match="9 series do not fit"):
            draw(many)
    assert len(boxes(many[:8]).legends[0].get_texts()) == 8
    many = [replace(results[0], experiment=replace(GRID[0], fill_ratio=f / 40)) for f in range(33)]
    with pytest.raises(UsageError, match="33 panels"):
        boxes(many)


# --- Curves ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("y", MEASURES)
def test_points_are_medians_and_bands_their_intervals(swept: list[Trials], y: str) -> None:
    """A panel for each f, a curve for each density, a point for each omega, however they are ordered."""
    figure = curve(swept[::-1], "omega", "D", y)
    for axes, f in zip(figure.axes, (0.55, 0.95), strict=True):
        assert axes.get_title() == f"fill ratio {f}, true accuracy 0.95"
        for line, band, density in zip(axes.lines, axes.collections, (0.5, 2.0), strict=True):
            own = {
                float(trials.experiment.omega): MEASURES[y](trials, paper_limits)
                for trials in swept
                if (trials.experiment.fill_ratio, trials.experiment.density) == (f, density)
            }
            assert np.array_equal(line.get_xdata(), [0.02, 0.05, 0.9])
            assert np.array_equal(line.get_ydata(), [np.median(own[omega]) for omega in (0.02, 0.05, 0.9)])
            ends = np.asarray(band.get_paths()[0].vertices)
            for omega, sample in own.items():
                heights = ends[ends[:, 0] == omega, 1]
                assert (heights.min(), heights.max()) == median_interval(sample)[1:]
    assert figure.axes[0].get_xscale() == "log"
    assert legend_of(figure) == ["density 0.5", "density 2"]


@pytest.mark.parametrize(
    ("x", "values", "expected"),
    [
        ("tau", [50, 100, 150], [50, 100, 150]),
        ("P", ["0%", "50%", "100%"], [0, 0.5, 1]),
        ("filter", ["none", "asdf-plus"], ["asdf-plus", "none"]),
    ],
)
def test_any_parameter_can_be_along_the_axis(x: str, values: list[object], expected: list[object]) -> None:
    many = grid(**{"robots": 6, "steps": 200, "trials": 3, "filter_period": 50, LETTERS.get(x, x): values})
    (axes,) = curve([results_of(each) for each in many], x).axes
    assert np.asarray(axes.lines[0].get_xdata()).tolist() == expected
    assert axes.get_xscale() == "linear"


@pytest.mark.parametrize(("trials", "beyond"), [(5, 1), (6, 1), (30, 10), (100, 40)])
def test_intervals_of_medians_are_those_of_the_tables(trials: int, beyond: int) -> None:
    """Ranks from the binomial distribution, as printed in books on nonparametric statistics."""
    values = np.random.default_rng(trials).permutation(trials).astype(float)
    assert median_interval(values) == (np.median(values), beyond - 1, trials - beyond)


# --- Over time, confidence, paths ------------------------------------------------------------------------


def test_bands_hold_all_robots_of_all_trials(results: list[Trials]) -> None:
    (trials,) = [each for each in results if each.experiment == replace(GRID[4], fill_ratio=0.55)]
    figure = bands([trials] * 5)
    assert [axes.axison for axes in figure.axes] == [True] * 5 + [False] * 3
    flawed, healthy, truth = figure.axes[0].lines
    assert (flawed.get_color(), healthy.get_color()) == (FLAWED, OTHER)
    assert np.array_equal(flawed.get_xdata(), [100, 200, 300])
    assert np.array_equal(flawed.get_ydata(), np.median(trials.b_hat[..., :2], axis=(0, 2)))
    assert np.array_equal(healthy.get_ydata(), np.median(trials.b_hat[..., 2:], axis=(0, 2)))
    assert np.all(np.asarray(truth.get_ydata()) == 0.95)
    lows = [np.asarray(band.get_paths()[0].vertices)[:, 1].min() for band in figure.axes[0].collections]
    assert lows[:2] == [np.percentile(trials.b_hat[..., :2], q, axis=(0, 2)).min() for q in (5, 25)]
    off = np.mean(abs(trials.b_hat[:, -1, 2:] - 0.95) > 0.05)
    assert figure.axes[0].get_title().endswith(f"more than 0.05 off: {off:.0%} of healthy robots")
    with pytest.raises(UsageError, match="there is no filter step"):
        bands([results_of(replace(BASE, filter_period=1000))])


def test_series_beside_each_other_show_their_records() -> None:
    runs = [results_of(replace(BASE, flawed=1, trials=1, filter=mode), 10) for mode in ("none", "asdf-plus")]
    panels = np.array(series_beside(runs, 0).axes).reshape(3, 2)
    for column, trials in zip(panels.T, runs, strict=True):
        for axes, quantity in zip(column, ("b_hat", "x_hat", "x"), strict=True):
            drawn = np.array([line.get_ydata() for line in axes.lines[:4]])
            assert np.array_equal(drawn[::-1, :31].T, trials.records[quantity][0])
            assert np.array_equal(axes.lines[0].get_xdata()[:31], np.arange(0, 301, 10))
    with pytest.raises(UsageError, match=r"there is no trial 1; choose one of 0 \.\. 0"):
        series_beside(runs, 1)


def test_confidence_is_the_papers_equation() -> None:
    (axes,) = confidence().axes
    for line, share in zip(axes.lines, (0.505, 0.7, 0.905), strict=True):
        for b_hat, alpha in np.array(line.get_xydata())[::40]:
            if 1 - b_hat < share < b_hat:  # not saturated: alpha = (2 b_hat - 1)^2 t^3 / (n (t - n))
                assert alpha == pytest.approx((2 * b_hat - 1) ** 2 / (share * (1 - share)), rel=1e-4)
            if share > b_hat:
                inner = b_hat**2 - (2 * b_hat - 1) * share
                expected = (2 * b_hat - 1) ** 2 * inner / (b_hat * (b_hat - 1)) ** 2
                assert alpha == pytest.approx(expected, rel=1e-4)


def test_paths_lead_from_start_to_end() -> None:
    arena = Arena(MOVING, 1)
    start, path = arena.positions, arena.record(300).position
    (axes,) = trajectories(MOVING, 1, 300).axes
    lines = axes.lines[::-1]  # the flawed robots are drawn last
    for robot, (mark, line) in enumerate(zip(lines[::2], lines[1::2], strict=True)):
        assert np.array_equal(np.array(line.get_xydata()), [start[robot], *path[:, robot]])
        assert np.array_equal(np.array(mark.get_xydata()), [start[robot]])
        assert line.get_color() == (FLAWED if robot < 5 else OTHER)
    bodies = [patch for patch in axes.patches if isinstance(patch, Circle)][::-1]
    assert [body.center for body in bodies] == [tuple(place) for place in path[-1]]
    assert {body.radius for body in bodies} == {BODY_RADIUS}
    assert to_hex(bodies[0].get_facecolor()) == FLAWED
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$x$ (m)", "$y$ (m)")


@pytest.mark.parametrize(
    ("experiment", "trial", "step", "words"),
    [
        (BASE, 0, 10, "do not move"),
        (MOVING, 2, 10, r"there is no step 10 of trial 2; choose steps of 1 \.\. 400, trials of 0 \.\. 1"),
        (MOVING, 0, 0, "there is no step 0"),
        (MOVING, 0, 401, "there is no step 401"),
    ],
)
def test_what_cannot_be_drawn_is_told(experiment: Experiment, trial: int, step: int, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        trajectories(experiment, trial, step)


# --- The command -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "suffix", "start"),
    [("trajectories", "pdf", b"%PDF"), ("boxes", "svg", b"<?xml"), ("bands", "png", b"\x89PNG")],
)
def test_the_command_draws(kind: str, suffix: str, start: bytes, tmp_path: Path) -> None:
    """Equal results give equal files."""
    found, picture = tmp_path / "run.parquet", tmp_path / f"picture.{suffix}"
    write_table(found, table_of(run_trials(MOVING, 0, 1)))
    written = []
    for _ in range(2):
        assert cli.main(["plot", str(found), str(picture), "--step", "50", "--kind", kind]) == 0
        written.append(picture.read_bytes())
    assert written[0].startswith(start)
    assert written[0] == written[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["two.parquet", "x.png", "--kind", "series"], "series shows one experiment, and 2 match"),
        (["two.parquet", "x.png", "--kind", "curve", "--x", "omega"], "the results differ in seed too"),
        (["p.parquet", "x.png", "--kind", "curve", "--x", "omega"], "the results differ in flawed too"),
        (
            ["r.parquet", "x.png", "--kind", "curve"],
            "--x is ''; choose a parameter, or one of the",
        ),
        (["r.parquet", "x.png", "--kind", "curve", "--x", "tau", "--hue", "tao"], "--hue is 'tao'; choose"),
        (["r.parquet", "x.png", "--kind", "curve", "--x", "tau", "--y", "h"], "--y is 'h'; choose one of H,"),
    ],
)
def test_bad_usage_is_told(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    experiments = (BASE, replace(BASE, seed=2), replace(BASE, flawed=1))
    one, two, three = (table_of(run_trials(each, 0, 1)) for each in experiments)
    write_table(Path("r.parquet"), one)
    write_table(Path("two.parquet"), pa.concat_tables([one, two]))
    write_table(Path("p.parquet"), pa.concat_tables([one, three]))
    assert cli.main(["plot", *arguments]) == 2
    assert words in capsys.readouterr().err
