"""Pictures show what they say: their artists are compared with the numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import WITHOUT, are_distinct, number_in_words, period_colour
from mcp_asdf_tools.experiments.arena_plots import BODY_RADIUS, network, trajectories
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.plots import boxes, confidence, falls_into_two_groups, strips
from mcp_asdf_tools.experiments.results import Trials, experiments_in, table_of, write_table
from mcp_asdf_tools.experiments.scatter_plots import scatter
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.series_names import by_series, styles_of
from mcp_asdf_tools.experiments.time_plots import bands, series_beside
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Filtering
from mcp_asdf_tools.world.arenas import make_arena
from mcp_asdf_tools.world.settings import Topology

LIMITS = Limits(300, 0.45)
BASE = Experiment(robots=4, flawed=0, steps=300, filter_period=100, trials=5, filter=Filtering.NONE)
GRID = [
    replace(BASE, flawed=flawed, fill_ratio=f, flawed_accuracy=b_hat, filter=mode, filter_period=period)
    for f in (0.55, 0.95)
    for flawed, b_hat in ((0, 0.95), (2, 0.55), (2, 0.75), (4, 0.55))
    for mode, period in ((Filtering.NONE, 100), (Filtering.ASDF_PLUS, 100), (Filtering.ASDF_PLUS, 150))
]
MOVING = Experiment(topology=Topology.DYNAMIC, robots=12, flawed=5, steps=400, filter_period=100, trials=2)


def results_of(experiment: Experiment, sampling_interval: int = 0) -> Trials:
    measured = run_trials(experiment, 0, experiment.trials, sampling_interval)
    (trials,) = experiments_in(table_of(measured, sampling_interval))
    return trials


@pytest.fixture(scope="module")
def grid() -> list[Trials]:
    return [results_of(experiment) for experiment in GRID]


def panels(figure: Figure) -> dict[str, Axes]:
    return {axes.get_title(): axes for axes in figure.axes if axes.get_visible()}


# --- Scores ----------------------------------------------------------------------------------------------


def test_boxes_are_where_and_what_they_should_be(grid: list[Trials]) -> None:
    found = panels(boxes(grid, lambda _: LIMITS))
    assert list(found) == ["$f = 0.55$, $b = 0.95$", "$f = 0.95$, $b = 0.95$"]
    for f, axes in zip((0.55, 0.95), found.values(), strict=True):
        medians = sorted(_levels(axes, 12))
        own = [trials for trials in grid if trials.experiment.fill_ratio == f]
        slots = {(0, 0.95): 0, (2, 0.55): 1, (2, 0.75): 2, (4, 0.55): 3}
        own.sort(key=lambda trials: (slots[_swarm(trials)], _series(trials)))
        expected = [np.median(score(trials.convergence_steps, trials.errors, LIMITS).h) for trials in own]
        assert [level for _, level in medians] == pytest.approx(expected)
        assert [round(x) for x, _ in medians] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
        labels = [label.get_text().replace("\N{MINUS SIGN}", "-") for label in axes.get_xticklabels()]
        assert labels == ["", "-0.4", "-0.2", "-0.4"]
        assert [text.get_text() for text in axes.texts] == ["0%", "50%", "100%"]


def _swarm(trials: Trials) -> tuple[int, float]:
    return trials.experiment.flawed, trials.experiment.flawed_accuracy


def _series(trials: Trials) -> int:
    experiment = trials.experiment
    return 0 if experiment.filter is Filtering.NONE else 1 + (experiment.filter_period == 150)


def _levels(axes: Axes, count: int) -> list[tuple[float, float]]:
    """Middle and height of the lines across boxes."""
    assert len([patch for patch in axes.patches if isinstance(patch, PathPatch)]) == count
    lines = [
        np.array(line.get_xydata())
        for line in axes.lines
        if line.get_linewidth() == 1 and line.get_linestyle() != "None"
    ]
    found = [(float(line[:, 0].mean()), float(line[0, 1])) for line in lines if len(line) == 2]
    assert len(found) == count
    return found


def test_series_are_named_by_what_varies(grid: list[Trials]) -> None:
    (legend,) = boxes(grid, lambda _: LIMITS).legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["no filter", r"ASDF+, $\tau$ = 100", r"ASDF+, $\tau$ = 150"]
    (legend,) = boxes(grid, lambda _: LIMITS, lambda experiment: "all of them").legends
    assert [text.get_text() for text in legend.get_texts()] == ["all of them"]


def test_a_series_has_its_colour_by_meaning(grid: list[Trials]) -> None:
    """Grey without filter, the green of the period with one; two of one colour are hollow and filled."""
    periods = [
        replace(grid[0], experiment=replace(GRID[0], filter=mode, filter_period=period))
        for mode, period in (
            (Filtering.NONE, 1000),
            (Filtering.ASDF_MINUS, 1000),
            (Filtering.ASDF_PLUS, 1000),
            (Filtering.ASDF_PLUS, 4000),
        )
    ]
    looks = list(styles_of(by_series(periods, None)).values())
    assert [look.colour for look in looks] == [WITHOUT, *map(period_colour, (1000, 1000, 4000))]
    assert [look.is_hollow for look in looks] == [False, True, False, False]
    assert are_distinct([look.colour for look in looks])
    near = [
        replace(each, experiment=replace(each.experiment, filter_period=100 + i))
        for i, each in enumerate(periods)
    ]
    assert are_distinct([look.colour for look in styles_of(by_series(near, None)).values()])


@pytest.mark.parametrize("series", [1, 4, 8])
def test_legends_are_not_cut_off(grid: list[Trials], series: int) -> None:
    many = [replace(grid[0], experiment=replace(GRID[0], seed=10**9 + seed)) for seed in range(series)]
    figure = boxes(many, lambda _: LIMITS)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width
    assert len(legend.get_texts()) == series


def test_panels_begin_at_0_and_what_is_near_100_is_magnified(grid: list[Trials]) -> None:
    def with_scores(flawed: int, k: int) -> Trials:
        steps = np.full((5, 4), k)
        errors = np.zeros((5, 4))
        return replace(
            grid[0], experiment=replace(GRID[0], flawed=flawed), convergence_steps=steps, errors=errors
        )

    (axes,) = boxes(
        [with_scores(flawed, k) for flawed, k in ((0, 0), (1, 3), (2, 290))], lambda _: LIMITS
    ).axes
    assert axes.get_ylim()[0] == 0
    (inset,) = axes.child_axes
    assert inset.get_ylim()[0] > 80
    assert inset.get_xlim() == (-0.5, 1.5)
    (axes,) = boxes([with_scores(flawed, k) for flawed, k in ((0, 290), (1, 3))], lambda _: LIMITS).axes
    assert not axes.child_axes


def test_cells_of_two_groups_have_points(grid: list[Trials]) -> None:
    draws = np.random.default_rng(3)
    assert falls_into_two_groups(np.append(draws.normal(40, 3, 20), draws.normal(80, 3, 10)))
    assert not falls_into_two_groups(draws.normal(60, 10, 300))
    assert not falls_into_two_groups(draws.uniform(0, 100, 300))
    assert not falls_into_two_groups(np.append(np.full(28, 90.0), [20, 21]))
    assert not falls_into_two_groups(np.repeat([98.0, 99.0], 15))
    assert not falls_into_two_groups(np.full(30, 5.0))
    errors = np.repeat([0.0, 0.45], [12, 18])[:, np.newaxis] * np.ones(4)
    steps = np.full((30, 4), 10)
    two = replace(grid[0], numbers=list(range(30)), convergence_steps=steps, errors=errors)
    (axes,) = boxes([two], lambda _: LIMITS).axes
    assert not [patch for patch in axes.patches if isinstance(patch, PathPatch)]
    (points,) = [line for line in axes.lines if line.get_marker() == "."]
    assert len(np.asarray(points.get_ydata())) == 30


def test_captions_say_how_to_read_a_figure(grid: list[Trials]) -> None:
    words = boxes(grid, lambda _: LIMITS)._supxlabel.get_text().replace("\N{NO-BREAK SPACE}", " ")  # type: ignore[attr-defined]
    words = " ".join(words.split())
    assert "4 robots, fully-connected, 300 steps" in words
    assert "5 trials of each experiment" in words
    assert "$K_{max}$ = 300, $e_{max}$ = 0.45" in words
    assert "whiskers to the last trial within 1.5" in words
    assert number_in_words(2**32) == "2^32"
    assert number_in_words(40_000.0) == "40000"


def test_strips_have_every_trial(grid: list[Trials]) -> None:
    axes = panels(strips(grid, lambda _: LIMITS))["$f = 0.95$, $b = 0.95$"]
    clouds = [np.array(line.get_xydata()) for line in axes.lines if line.get_marker() == "."]
    own = [trials for trials in grid if trials.experiment.fill_ratio == 0.95]
    expected = [score(trials.convergence_steps, trials.errors, LIMITS).h for trials in own]
    assert sorted(cloud[:, 1].tolist() for cloud in clouds) == sorted(each.tolist() for each in expected)
    for cloud in clouds:
        assert len(set(cloud[:, 0])) == len(cloud)
        assert np.ptp(cloud[:, 0]) < 0.86 / 3


def test_points_are_the_trials_in_the_papers_colours(grid: list[Trials]) -> None:
    """Rows are series and f, columns P; underconfident swarms are red or orange, overconfident ones blue."""
    over = results_of(replace(BASE, flawed=2, true_accuracy=0.55, flawed_accuracy=0.95))
    figure = scatter([*grid, over], lambda _: LIMITS)
    found = panels(figure)
    own = [t for t in grid if t.experiment.fill_ratio == 0.95 and t.experiment.filter is Filtering.NONE]
    for share, count in ((0, 1), (2, 2), (4, 1)):
        axes = found[f"no filter\n$f = 0.95$, $P$ = {share / 4:.0%}"]
        expected = [t for t in own if t.experiment.flawed == share]
        assert len(axes.lines) == len(expected) == count
        for trials, line in zip(expected, axes.lines, strict=True):
            scores = score(trials.convergence_steps, trials.errors, LIMITS)
            assert np.array_equal(np.array(line.get_xydata()), np.stack([scores.h_k, scores.h_e], axis=1))
    colours = [line.get_color() for line in found["no filter\n$f = 0.55$, $P$ = 50%"].lines]
    assert colours == ["#d55e00", "#e69f00", "#56b4e9"]
    (legend,) = figure.legends
    assert any(text.get_text().startswith("overconfident, $b$ = 0.55") for text in legend.get_texts())


def test_bands_hold_all_robots_of_all_trials(grid: list[Trials]) -> None:
    (trials,) = [
        t for t in grid if _swarm(t) == (2, 0.55) and _series(t) == 1 and t.experiment.fill_ratio == 0.55
    ]
    (axes,) = bands([trials]).axes
    flawed, unflawed, truth = axes.lines
    assert np.array_equal(flawed.get_xdata(), [100, 200, 300])
    assert np.array_equal(flawed.get_ydata(), np.median(trials.b_hat[..., :2], axis=(0, 2)))
    assert np.array_equal(unflawed.get_ydata(), np.median(trials.b_hat[..., 2:], axis=(0, 2)))
    assert np.all(np.asarray(truth.get_ydata()) == 0.95)
    lows = [np.asarray(band.get_paths()[0].vertices)[:, 1].min() for band in axes.collections]
    assert lows[0] == np.percentile(trials.b_hat[..., :2], 5, axis=(0, 2)).min()
    off = np.mean(abs(trials.b_hat[:, -1, 2:] - 0.95) > 0.05)
    assert axes.get_title().endswith(f"{off:.0%} of healthy robots end off")
    with pytest.raises(UsageError, match="there is no filter step"):
        bands([results_of(replace(BASE, filter_period=1000))])


def test_what_does_not_fit_a_picture_is_refused(grid: list[Trials]) -> None:
    many = [replace(grid[0], experiment=replace(GRID[0], seed=seed)) for seed in range(9)]
    for draw in (boxes, scatter):
        with pytest.raises(UsageError, match="9 series do not fit"):
            draw(many)


# --- Over time, confidence -------------------------------------------------------------------------------


def test_series_beside_each_other_show_their_records() -> None:
    runs = [
        results_of(replace(BASE, flawed=1, trials=1, filter=mode), 10)
        for mode in (Filtering.NONE, Filtering.ASDF_PLUS)
    ]
    grid = np.array(series_beside(runs, 0).axes).reshape(3, 2)
    for column, trials in zip(grid.T, runs, strict=True):
        for axes, quantity in zip(column, ("b_hat", "x_hat", "x"), strict=True):
            drawn = np.array([line.get_ydata() for line in axes.lines[:4]])
            assert np.array_equal(drawn[::-1, :31].T, trials.records[quantity][0])
            assert np.array_equal(axes.lines[0].get_xdata()[:31], np.arange(0, 301, 10))


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


# --- The moving world ------------------------------------------------------------------------------------


def robots_drawn(figure: Figure) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    bodies = [patch for patch in figure.axes[0].patches if isinstance(patch, Circle)]
    return np.array([patch.center for patch in bodies if patch.radius == BODY_RADIUS])


def test_paths_lead_from_start_to_end() -> None:
    arena = make_arena(MOVING, 1)
    start = arena.positions
    arena.step(300)
    figure = trajectories(MOVING, 1, 300)
    fading = [each for each in figure.axes[0].collections if isinstance(each, LineCollection)]
    pieces = [np.array(each.get_segments()) for each in fading][::-1]
    paths = [np.concatenate([each[:, 0], each[-1:, 1]]) for each in pieces]
    assert np.array_equal([path[0] for path in paths], start)
    assert np.array_equal([path[-1] for path in paths], arena.positions)
    assert np.array_equal(robots_drawn(figure), arena.positions)
    assert all(np.hypot(*np.diff(path, axis=0).T).max() < 0.015 for path in paths)
    for each in fading:
        strength = np.asarray(each.get_colors())[:, 3]
        assert strength[0] < 0.2
        assert strength[-1] == 1
        assert (np.diff(strength) > 0).all()
    moments = np.array(figure.axes[0].lines[0].get_xydata())
    assert moments.tolist() == [path[step].tolist() for step in range(50, 300, 50) for path in paths]


def test_a_network_shows_who_hears_whom() -> None:
    arena = make_arena(MOVING, 0)
    arena.step(200)
    figure = network(MOVING, 0, 200)
    links, _ = [each for each in figure.axes[0].collections if isinstance(each, LineCollection)]
    drawn = np.array([np.ravel(segment) for segment in links.get_segments()])
    assert len(drawn) == len(arena.links) > 0
    expected = arena.positions[np.sort(arena.links.astype(int), axis=1)].reshape(-1, 4)
    assert sorted(drawn.tolist()) == sorted(expected.tolist())
    assert np.hypot(drawn[:, 2] - drawn[:, 0], drawn[:, 3] - drawn[:, 1]).max() < MOVING.radio_range
    assert np.array_equal(robots_drawn(figure), arena.positions)


def test_circles_overlap_where_two_hear_each_other_or_a_third_stands_between() -> None:
    crowded = replace(MOVING, density=6.0)
    figure = network(crowded, 0, 200)
    links, blocked = [each for each in figure.axes[0].collections if isinstance(each, LineCollection)]
    rings = [patch for patch in figure.axes[0].patches if isinstance(patch, Circle)]
    rings = [ring for ring in rings if ring.radius == crowded.radio_range / 2]
    overlapping = {
        frozenset(tuple(map(float, each.center)) for each in (one, other))
        for index, one in enumerate(rings)
        for other in rings[:index]
        if np.hypot(*np.subtract(one.center, other.center)) < one.radius + other.radius
    }
    drawn = [
        {frozenset(map(tuple, np.asarray(segment).tolist())) for segment in each.get_segments()}
        for each in (links, blocked)
    ]
    assert drawn[0] | drawn[1] == overlapping
    assert drawn[0]
    assert drawn[1]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "a third stands between" in labels


@pytest.mark.parametrize(
    ("experiment", "trial", "step", "words"),
    [
        (BASE, 0, 10, "do not move"),
        (MOVING, 2, 10, "there is no trial 2; choose one of 0 .. 1"),
        (MOVING, 0, 0, "there is no step 0; choose one of 1 .. 400"),
        (MOVING, 0, 401, "there is no step 401"),
    ],
)
def test_what_cannot_be_drawn_is_told(experiment: Experiment, trial: int, step: int, words: str) -> None:
    for draw in (trajectories, network):
        with pytest.raises(UsageError, match=words):
            draw(experiment, trial, step)


# --- The command -----------------------------------------------------------------------------------------

STARTS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.parametrize(("kind", "suffix"), [("trajectories", "pdf"), ("network", "svg"), ("alpha", "png")])
def test_the_command_draws(kind: str, suffix: str, tmp_path: Path) -> None:
    results, picture = tmp_path / "run.parquet", tmp_path / f"picture.{suffix}"
    write_table(results, table_of(run_trials(MOVING, 0, 1)))
    given = [str(picture)] if kind == "alpha" else [str(results), str(picture), "--step", "50"]
    written = []
    for _ in range(2):
        assert cli.main(["plot", *given, "--kind", kind]) == 0
        written.append(picture.read_bytes())
    assert written[0].startswith(STARTS[suffix])
    assert written[0] == written[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["x.png"], "boxes needs results"),
        (["r.parquet", "x.png", "--kind", "alpha"], "needs no results"),
        (["two.parquet", "x.png", "--kind", "network"], "network shows one experiment, and 2 match"),
        (["two.parquet", "x.png", "--kind", "curve", "--x", "omega"], "the results differ in seed too"),
        (["r.parquet", "x.png", "--kind", "curve"], "--x is ''; choose a parameter, such as fill_ratio"),
        (["r.parquet", "x.png", "--kind", "curve", "--x", "tau", "--hue", "tao"], "--hue is 'tao'; choose"),
        (
            ["r.parquet", "x.png", "--kind", "curve", "--x", "tau", "--y", "h"],
            "--y is 'h'; choose one of H, h_K",
        ),
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
    tables = [table_of(run_trials(replace(BASE, seed=seed), 0, 1)) for seed in (1, 2)]
    write_table(Path("r.parquet"), tables[0])
    write_table(Path("two.parquet"), pa.concat_tables(tables))
    assert cli.main(["plot", *arguments]) == 2
    assert words in capsys.readouterr().err
