"""Curves over any parameter: their points, intervals and names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import WITHOUT, ordered_colours, period_colour, share_colour
from mcp_asdf_tools.experiments.curves import LETTERS, MEASURES, curve, median_interval
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.results import Trials, experiments_in, table_of, write_table
from mcp_asdf_tools.experiments.scores import paper_limits
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Filtering

BASE = {"robots": 6, "flawed": "50%", "steps": 300, "filter_period": 100, "trials": 8, "topology": "dynamic"}
GRID = grid(**BASE, omega=[0.02, 0.05, 0.9], density=[0.5, 2.0], fill_ratio=[0.55, 0.95])


def results_of(experiment: Experiment) -> Trials:
    (trials,) = experiments_in(table_of(run_trials(experiment, 0, experiment.trials)))
    return trials


@pytest.fixture(scope="module")
def results() -> list[Trials]:
    return [results_of(each) for each in GRID]


@pytest.mark.parametrize("y", MEASURES)
def test_points_are_medians_and_bands_their_intervals(results: list[Trials], y: str) -> None:
    """A panel for each f, a curve for each density, a point for each omega, however they are ordered."""
    figure = curve(results[::-1], "omega", "D", y)
    for axes, f in zip(figure.axes, (0.55, 0.95), strict=True):
        assert axes.get_title() == f"$f = {f:g}$, $b = 0.95$"
        for line, band, density in zip(axes.lines, axes.collections, (0.5, 2.0), strict=True):
            own = [
                MEASURES[y](trials, paper_limits)
                for trials in results
                if (trials.experiment.fill_ratio, trials.experiment.density) == (f, density)
            ]
            assert np.array_equal(line.get_xdata(), [0.02, 0.05, 0.9])
            assert np.array_equal(line.get_ydata(), np.median(own, axis=1))
            assert np.asarray(band.get_paths()[0].vertices)[:, 1].min() == min(
                median_interval(each)[1] for each in own
            )
    assert figure.axes[0].get_xscale() == "log"
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "swarm density $D$ = 0.5",
        "swarm density $D$ = 2",
    ]


@pytest.mark.parametrize(
    ("x", "values", "expected"),
    [
        ("tau", [50, 100, 150], [50, 100, 150]),
        ("P", ["0%", "50%", "100%"], [0, 0.5, 1]),
        ("N", [4, 6, 8], [4, 6, 8]),
        ("b_hat", [0.55, 0.75], [0.55, 0.75]),
        ("filter", ["none", "asdf-plus"], ["asdf-plus", "none"]),
    ],
)
def test_any_parameter_can_be_along_the_axis(x: str, values: list[object], expected: list[object]) -> None:
    swept = {**BASE, "topology": "fully-connected", LETTERS.get(x, x): values}
    (axes,) = curve([results_of(each) for each in grid(**swept)], x).axes
    assert np.asarray(axes.lines[0].get_xdata()).tolist() == expected


@pytest.mark.parametrize(("trials", "beyond"), [(5, 1), (6, 1), (30, 10), (100, 40)])
def test_intervals_of_medians_are_those_of_the_tables(trials: int, beyond: int) -> None:
    """Ranks from the binomial distribution, as printed in books on nonparametric statistics."""
    values = np.random.default_rng(trials).permutation(trials).astype(float)
    assert median_interval(values) == (np.median(values), beyond - 1, trials - beyond)


def test_intervals_hold_what_they_promise() -> None:
    rng = np.random.default_rng(1)
    samples = np.where(
        rng.random((2000, 25)) < 0.4, rng.normal(0, 1, (2000, 25)), rng.normal(9, 1, (2000, 25))
    )
    whole = np.median(np.where(rng.random(10**6) < 0.4, rng.normal(0, 1, 10**6), rng.normal(9, 1, 10**6)))
    found = np.array([median_interval(sample) for sample in samples])
    missed = np.mean((whole < found[:, 1]) | (whole > found[:, 2]))
    assert 0.01 <= missed <= 0.06


def test_what_varies_beside_is_named(results: list[Trials]) -> None:
    with pytest.raises(UsageError, match="the results differ in omega too"):
        curve(results, "density")


def test_the_command_draws_curves(tmp_path: Path, results: list[Trials]) -> None:
    tables = [table_of(run_trials(each, 0, each.trials)) for each in GRID]
    write_table(tmp_path / "r.parquet", pa.concat_tables(tables))
    picture = tmp_path / "curves.svg"
    options = ["--kind", "curve", "--x", "omega", "--hue", "density", "--y", "K"]
    assert cli.main(["plot", str(tmp_path / "r.parquet"), str(picture), *options]) == 0
    assert picture.read_bytes().startswith(b"<?xml")


def test_too_many_curves_are_refused(results: list[Trials]) -> None:
    many = [replace(results[0], experiment=replace(GRID[0], seed=seed)) for seed in range(13)]
    with pytest.raises(UsageError, match="13 values of seed do not fit a picture"):
        curve(many, "omega", "seed")


def test_curves_have_the_colours_of_their_meaning(results: list[Trials]) -> None:
    """Those of a filtering period and of a share are the same in every picture."""

    def colours(hue: str, values: list[object]) -> list[object]:
        own = [replace(results[0].experiment, **{hue: value, "omega": 0.05}) for value in values]  # type: ignore[arg-type]
        trials = [replace(results[0], experiment=each) for each in own]
        return [line.get_color() for line in curve(trials, "omega", hue).axes[0].lines]

    assert colours("filter_period", [250, 1000]) == [period_colour(250), period_colour(1000)]
    assert colours("flawed", [0, 3, 6]) == [share_colour(share) for share in (0, 0.5, 1)]
    assert colours("filter", [Filtering.NONE, Filtering.ASDF_PLUS])[1] == WITHOUT
    assert colours("density", [0.5, 2.0]) == ordered_colours(2)
    assert len(set(colours("filter_period", [100, 110, 120]))) == 3
