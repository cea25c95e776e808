"""The study of the robust filter: rows, cells and picture of its page."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from host_tools.studies.conftest import OVERCONFIDENT, UNDERCONFIDENT, short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import error_tables, peers, robust_filter
from mcp_asdf_tools.studies.ageing_sensors import WanderingSensors
from support import ROOT

MOVING: dict[str, Any] = {"topology": "dynamic", "latency": 1, "robots": 20, "flawed": 6}


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({}, "moving"),
        ({"topology": "fully-connected", "latency": 0}, "fully connected"),
        ({"robots": 21}, "moving, 21 robots"),
        ({"density": 3}, "moving, density 3"),
        ({"latency": 0}, "moving, latency 0"),
        ({"white_offset": -0.1}, "moving, b -0.1 on white"),
        ({"sensor": WanderingSensors}, "moving, sensors age each in its own way"),
        ({"drift": "linear"}, "moving, sensors age alike"),
    ],
)
def test_a_row_beyond_the_grid_says_what_is_different(changes: dict[str, Any], row: str) -> None:
    assert robust_filter.beyond_row(Experiment(**MOVING | changes)) == row


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({"steps": 20_000}, "moving, 30 % flawed"),
        ({"steps": 10_000}, "moving, 30 % flawed, 10,000 steps"),
        ({"steps": 20_000, "flawed": 0}, "moving, 0 % flawed"),
    ],
)
def test_a_row_of_peers_says_how_many_robots_are_flawed(changes: dict[str, Any], row: str) -> None:
    assert robust_filter.peer_row(Experiment(**MOVING | changes)) == row


def test_hard_worlds_have_the_rows_of_the_page() -> None:
    rows = {robust_filter.world_row(experiment) for experiment in robust_filter.world_experiments()}
    page = (ROOT / "docs/robust.md").read_text(encoding="utf-8")
    table = page.partition("<!-- worlds -->")[2].partition("<!-- end -->")[0]
    assert rows == set(re.findall(r"^\| ((?:fully|moving)[^|]*) \|", table, re.MULTILINE))


def test_liars_are_not_counted_in_the_error() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none")
    trials.records["x"][:, :, :15] = trials.experiment.fill_ratio
    assert robust_filter.late_errors_of_honest_robots(trials) == pytest.approx([0, 0])


def test_the_error_after_the_floor_changes_is_that_of_the_new_floor() -> None:
    (trials,) = short_trials(sensor=peers.ChangingFloor, filter="none")
    trials.records["x"][:] = 0.95
    assert robust_filter.late_errors_of_honest_robots(trials) == pytest.approx([0, 0])


def test_a_cell_of_the_grid_has_score_errors_and_harm() -> None:
    (trials,) = short_trials(filter="robust")
    assert re.fullmatch(r"[\d.]+.*, 0\.\d+.*, 0\.\d+, [\d.]+.* %", robust_filter.grid_text([trials]))


def test_a_cell_without_healthy_robots_has_no_harm() -> None:
    (trials,) = short_trials(filter="robust", flawed=4)
    assert not robust_filter.grid_text([trials]).endswith("%")


@pytest.mark.slow
@pytest.mark.parametrize("share", ["10 %", "30 %"])
@pytest.mark.parametrize(("filter_name", "column"), [("none", 0), ("asdf-minus", 1), ("robust", 3)])
def test_the_page_has_what_few_trials_of_another_seed_give(share: str, filter_name: str, column: int) -> None:
    page = (ROOT / "docs/robust.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| moving, {share} flawed \|(.*)\|$", page, re.MULTILINE)
    assert row is not None
    h, late_error = (float(text.split()[0]) for text in row[1].split("|")[column].split(", ")[:2])
    study_results = [
        run_trials(replace(experiment, seed=5), 0, 3, 1000)
        for experiment in m.read_experiments("robust_grid")
        if experiment.is_dynamic
        and experiment.filter == filter_name
        and error_tables.flawed_label(experiment) == f"{share} flawed"
    ]
    scores = error_tables.mean_of_medians(lambda trials: trials.scores()["H"], study_results)
    assert scores.value == pytest.approx(h, abs=5)
    errors = error_tables.mean_of_medians(error_tables.late_errors, study_results)
    assert errors.value == pytest.approx(late_error, rel=0.5)


def test_the_robust_picture_has_a_panel_for_each_world(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, list[Trials]] = {}

    def note_panels(panels: dict[str, list[Trials]]) -> Figure:
        shown.update(panels)
        return Figure()

    monkeypatch.setattr(robust_filter, "plot_errors_over_time", note_panels)
    common: dict[str, Any] = {**MOVING, "filter": "none", "sensors": [UNDERCONFIDENT, OVERCONFIDENT]}
    grid = short_trials(**{**common, "flawed": [6, 10]})
    worlds = short_trials(**common, firmware=peers.five_liars)
    robust_filter.draw_errors(grid, worlds)
    assert {title: len(experiments) for title, experiments in shown.items()} == {
        f"{world}, {flaw}": 1
        for flaw in ("underconfident", "overconfident")
        for world in ("30 % flawed", "30 % flawed and 5 liars", "50 % flawed")
    }


def test_a_curve_leaves_out_liars_and_most_of_the_values() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none", steps=3200)
    thinned = robust_filter.thin_out(trials)
    assert thinned.records["x"].shape == (2, 17, 15)
    assert thinned.sampling_interval == 200
    assert thinned.records["x"][:, -1].tolist() == trials.records["x"][:, -1, :15].tolist()


# --- Experiments -----------------------------------------------------------------------------------------


def test_peers_meet_each_filter_in_three_worlds_and_two_ways_to_be_wrong() -> None:
    experiments = robust_filter.peer_experiments()
    rows = {robust_filter.peer_row(experiment) for experiment in experiments}
    assert rows == {
        "moving, 0 % flawed",
        "moving, 30 % flawed",
        "fully connected, 30 % flawed, 10,000 steps",
    }
    assert len(experiments) == len(rows) * 2 * 8  # eight columns of the table


def test_peers_and_worlds_have_a_seed_and_trials_of_their_own() -> None:
    experiments = [*robust_filter.peer_experiments(), *robust_filter.world_experiments()]
    assert {experiment.seed for experiment in experiments} == {4713}
    assert {experiment.trials for experiment in experiments} == {8, 12}
    assert {experiment.steps for experiment in experiments} == {10_000, 20_000, 40_000}


def test_hard_worlds_are_45_experiments() -> None:
    experiments = robust_filter.world_experiments()
    assert len(experiments) == 2 * 3 + (3 + 2 * 2) + 2 * 4 * 4
    assert {experiment.flawed for experiment in experiments} == {6}


def test_the_floor_changes_for_robots_with_a_short_memory() -> None:
    changing = [experiment for experiment in robust_filter.world_experiments() if experiment.sensor]
    assert {(experiment.memory, experiment.steps) for experiment in changing} == {(4096, 40_000)}


def test_a_swarm_has_parameters_if_all_are_equal() -> None:
    (experiment,) = m.grid(**UNDERCONFIDENT)
    assert robust_filter.has_parameters(experiment, UNDERCONFIDENT)
    assert not robust_filter.has_parameters(experiment, {**UNDERCONFIDENT, "fill_ratio": 0.95})


def test_robots_beyond_the_grid_also_have_sensors_that_wander() -> None:
    experiments = robust_filter.wandering_experiments()
    rows = {robust_filter.beyond_row(experiment) for experiment in experiments}
    assert rows == {"moving, sensors age each in its own way"}
    assert [experiment.filter for experiment in experiments] == ["none", "asdf-plus", "robust"]
    assert {(experiment.seed, experiment.trials, experiment.steps) for experiment in experiments} == {
        (4712, 30, 20_000)
    }
