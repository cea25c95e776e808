"""The study of the robust filter: its experiments, cells and picture."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from host_tools.studies.conftest import short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import peers, robust_filter, study_program
from mcp_asdf_tools.studies.study_program import BOTH_FLAWS, FLAWS
from support import ROOT

MOVING: dict[str, Any] = {"topology": "dynamic", "latency": 1, "robots": 20, "flawed": 6}


def parameters_of(experiments: list[Experiment], *names: str) -> set[tuple[Any, ...]]:
    """Return the different values of some parameters that experiments have."""
    return {tuple(getattr(experiment, name) for name in names) for experiment in experiments}


# --- Experiments -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "robots", "flawed"),
    [("moving, 10 % flawed", 20, 2), ("fully connected, 30 % flawed", 10, 3), ("moving, 0 % flawed", 20, 0)],
)
def test_the_grid_has_swarms_of_the_papers_sizes(row: str, robots: int, flawed: int) -> None:
    experiments = robust_filter.grid_rows()[row]
    assert parameters_of(experiments, "robots", "flawed") == {(robots, flawed)}


def test_the_grid_has_eight_kinds_of_flawed_swarms_with_each_filter() -> None:
    experiments = robust_filter.grid_rows()["moving, 30 % flawed"]
    worlds = parameters_of(experiments, "fill_ratio", "true_accuracy", "flawed_accuracy")
    assert len(worlds) == 8
    assert len(experiments) == 8 * 4


def test_the_grid_has_30_trials_as_long_as_the_papers() -> None:
    (size,) = parameters_of(robust_filter.grid_rows()["moving, 10 % flawed"], "trials", "steps", "seed")
    assert size == (30, 40_000, 4711)


@pytest.mark.parametrize(
    ("row", "parameter", "value"),
    [
        ("moving", "density", 1),
        ("moving", "latency", 1),
        ("moving, latency 0", "latency", 0),
        ("moving, density 0.25", "density", 0.25),
        ("moving, 3 robots", "robots", 3),
        ("moving, b -0.1 on white", "white_offset", -0.1),
        ("moving slowly", "speed", 0.007),
        ("moving slowly, 0 % flawed", "flawed", 0),
        ("static ring", "topology", "graph"),
        ("moving, sensors age alike", "drift_rate", -1e-5),
        ("fully connected, 5 robots", "robots", 5),
    ],
)
def test_a_row_beyond_the_grid_is_named_after_what_is_different(
    row: str, parameter: str, value: float
) -> None:
    assert parameters_of(robust_filter.beyond_rows()[row], parameter) == {(value,)}


def test_a_row_beyond_the_grid_has_as_many_robots_as_it_says() -> None:
    """The label of a row, such as "moving, 3 robots", stands in the table of a page."""
    rows = robust_filter.beyond_rows()
    stated_robots = []
    for row, experiments in rows.items():
        match = re.search(r"(\d+) robots", row)
        if match is not None:
            robots = int(match[1])
            stated_robots.append(robots)
            assert parameters_of(experiments, "robots") == {(robots,)}

    assert sorted(stated_robots) == [3, 3, 5, 5, 10, 127, 127]


@pytest.mark.parametrize("row", ["static ring", "static grid"])
def test_each_of_20_robots_has_four_neighbours_in_a_static_graph(row: str) -> None:
    for experiment in robust_filter.beyond_rows()[row]:
        receivers = [receiver for _, receiver in experiment.graph.links]
        assert [receivers.count(robot) for robot in range(20)] == [4] * 20


def test_robots_of_a_graph_hear_those_some_places_away() -> None:
    edges = [set(edge.split()) for edge in robust_filter.static_graph((3,)).split("; ")]
    # A circle in steps of 3 of 20 passes each robot once.
    assert len(edges) == 20
    assert {robot for edge in edges for robot in edge} == {str(robot) for robot in range(20)}


def test_flawed_robots_are_not_all_together_in_a_static_graph() -> None:
    edges = [tuple(map(int, edge.split())) for edge in robust_filter.static_graph((1,)).split("; ")]
    flawed_beside_flawed = [edge for edge in edges if max(edge) < 6]
    assert len(flawed_beside_flawed) < 5


def test_large_fully_connected_swarms_have_fewer_trials() -> None:
    rows = robust_filter.beyond_rows()
    assert parameters_of(rows["fully connected, 127 robots"], "trials", "steps") == {(12, 20_000)}
    assert parameters_of(rows["fully connected"], "trials", "steps") == {(30, 20_000)}


@pytest.mark.parametrize(
    ("row", "steps", "flawed"),
    [
        ("moving, 0 % flawed", 20_000, 0),
        ("moving, 30 % flawed", 20_000, 6),
        ("fully connected, 30 % flawed, 10,000 steps", 10_000, 3),
    ],
)
def test_peers_share_three_worlds_with_the_usual_filters(row: str, steps: int, flawed: int) -> None:
    experiments = robust_filter.peer_rows()[row]
    assert parameters_of(experiments, "steps", "flawed", "trials") == {(steps, flawed, 8)}
    assert len(experiments) == 2 * 7  # two kinds of flaws, seven columns of the table


def test_fully_connected_swarms_with_liars_have_12_trials() -> None:
    experiments = robust_filter.world_rows()["fully connected, 1 liar"]
    assert parameters_of(experiments, "trials", "flawed", "latency") == {(12, 6, 0)}


def test_moving_swarms_with_liars_have_eight_trials_of_20_000_steps() -> None:
    experiments = robust_filter.world_rows()["moving, 1 liar"]
    assert parameters_of(experiments, "trials", "steps", "flawed", "latency") == {(8, 20_000, 6, 1)}


def test_the_floor_changes_for_robots_with_a_short_memory() -> None:
    experiments = robust_filter.world_rows()["moving, the floor changes, 5 liars"]
    assert parameters_of(experiments, "memory", "steps", "trials") == {(4096, 40_000, 8)}


# --- Cells -----------------------------------------------------------------------------------------------


def test_liars_are_not_counted_in_the_error() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none")
    trials.records["x"][:, :, :15] = trials.experiment.fill_ratio
    seen = robust_filter.as_honest_robots_see_it(trials)
    assert study_program.late_errors(seen).tolist() == [0, 0]


def test_all_robots_are_counted_where_none_lies() -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.LossyRobot, filter="none")
    assert robust_filter.as_honest_robots_see_it(trials).records["x"].shape[2] == 20


def test_the_error_after_the_floor_changes_is_that_of_the_new_floor() -> None:
    (trials,) = short_trials(sensor=peers.ChangingFloor, filter="none")
    trials.records["x"][:] = 0.95
    seen = robust_filter.as_honest_robots_see_it(trials)
    assert study_program.late_errors(seen).tolist() == [0, 0]


def test_a_cell_of_the_grid_has_score_errors_and_harm(few_resamples: None) -> None:
    (trials,) = short_trials(filter="robust")
    cell = robust_filter.grid_text([trials])
    number = r"[\d.]+( \([\d.]+\.\.[\d.]+\))?"
    assert re.fullmatch(rf"{number}, 0\.\d+( \(.*\))?, 0\.\d+, {number} %", cell)


def test_a_cell_of_other_tables_has_errors_and_harm(few_resamples: None) -> None:
    trials = short_trials(filter="robust", sensors=BOTH_FLAWS)
    cell = robust_filter.errors_text(trials)
    assert re.fullmatch(r"0\.\d+( \(.*\))?, 0\.\d+( \(.*\))?, [\d.]+( \([\d.]+\.\.[\d.]+\))? %", cell)


def test_liars_do_not_count_as_harmed(few_resamples: None) -> None:
    (trials,) = short_trials(robots=20, flawed=0, firmware=peers.five_liars, filter="none")
    trials.b_hat[:, -1, 15:] = 0.5
    seen = robust_filter.as_honest_robots_see_it(trials)
    assert study_program.harmed_percents(seen).tolist() == [0, 0]


def test_harm_is_a_percentage(few_resamples: None) -> None:
    (trials,) = short_trials(filter="robust")
    trials.b_hat[:, -1, :] = trials.experiment.true_accuracy
    trials.b_hat[:, -1, 3] = 0.5  # one of the three healthy robots
    assert robust_filter.grid_text([trials]).endswith(", 33.3 %")


def test_a_cell_without_healthy_robots_has_no_harm(few_resamples: None) -> None:
    (trials,) = short_trials(filter="robust", flawed=4)
    assert not robust_filter.grid_text([trials]).endswith("%")


@pytest.mark.slow
@pytest.mark.parametrize("flaw", ["underconfident", "overconfident"])
@pytest.mark.parametrize(("filter_name", "column"), [("none", 0), ("asdf-minus", 1), ("robust", 2)])
def test_the_page_has_about_what_ten_trials_of_another_seed_give(
    flaw: str, filter_name: str, column: int
) -> None:
    page = (ROOT / "docs/internals/robust.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| moving, \.3 flawed \| {flaw} \|(.*)\|$", page, re.MULTILINE)
    assert row is not None
    (experiment,) = m.grid(**MOVING, **FLAWS[flaw], filter=filter_name, steps=40_000, trials=10, seed=5)
    trials = run_trials(experiment, first=0, trials=10, sampling_interval=1000)
    error = float(np.median(study_program.late_errors(trials)))

    assert error == pytest.approx(float(row[1].split("|")[column]), rel=0.5)


# --- Picture ---------------------------------------------------------------------------------------------


def test_the_picture_has_a_panel_for_each_swarm_and_kind_of_flaw(monkeypatch: pytest.MonkeyPatch) -> None:
    experiments_by_panel: dict[str, list[Trials]] = {}

    def record_panels(panels: dict[str, list[Trials]]) -> Figure:
        experiments_by_panel.update(panels)
        return Figure()

    monkeypatch.setattr(robust_filter, "plot_errors_over_time", record_panels)
    trials = short_trials(**MOVING, filter="none", sensors=BOTH_FLAWS)
    grid = {"moving, 30 % flawed": trials, "moving, 50 % flawed": trials}
    figure = robust_filter.draw_errors(grid, {"moving, 5 liars": trials})
    assert figure.get_supxlabel() == "step"
    fill_ratios = {
        title: [each.experiment.fill_ratio for each in panel] for title, panel in experiments_by_panel.items()
    }
    assert fill_ratios == {
        "30 % flawed, underconfident": [0.55],
        "30 % flawed and 5 liars, underconfident": [0.55],
        "50 % flawed, underconfident": [0.55],
        "30 % flawed, overconfident": [0.95],
        "30 % flawed and 5 liars, overconfident": [0.95],
        "50 % flawed, overconfident": [0.95],
    }
