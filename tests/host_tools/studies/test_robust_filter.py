"""The study of the robust filter: its experiments, cells and picture."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import mcp_asdf_tools as m
from host_tools.studies.conftest import page_path, parse_table, two_trials_with
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import peers, robust_filter, study_program
from mcp_asdf_tools.studies.study_program import PARAMETERS_BY_FLAW

# --- Experiments -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", ["static ring", "static grid"])
def test_each_of_20_robots_has_four_neighbours_in_a_static_graph(row: str) -> None:
    """The study's table has a row of experiments with each graph. Links lead from senders to receivers."""
    experiments_by_row = robust_filter.beyond_rows()

    for experiment in experiments_by_row[row]:
        receivers = [receiver for _sender, receiver in experiment.graph.links]
        for robot in range(20):
            assert receivers.count(robot) == 4


def edges_on_circle(places_between_neighbours: int) -> list[tuple[int, int]]:
    """20 robots stand on a circle. Return the pairs that hear each other: they are so many places apart."""
    edges = []
    # The graph is a text such as "3 5; 5 7".
    for edge in robust_filter.static_graph([places_between_neighbours]).split("; "):
        first_robot, second_robot = edge.split()
        edges.append((int(first_robot), int(second_robot)))
    return edges


def test_every_third_place_on_a_circle_of_20_joins_all_robots_with_20_edges() -> None:
    """Each robot hears the robot three places on. As 3 and 20 have no common divisor, all are joined."""
    edges = edges_on_circle(places_between_neighbours=3)

    assert len(edges) == 20
    first_robots_of_edges = {first_robot for first_robot, _second_robot in edges}
    second_robots_of_edges = {second_robot for _first_robot, second_robot in edges}
    assert first_robots_of_edges == set(range(20))
    assert second_robots_of_edges == set(range(20))


def test_the_six_flawed_robots_do_not_all_stand_side_by_side_on_a_circle() -> None:
    """Robots 0 to 5 are flawed. Each hears those beside it, so six in a row would have five edges."""
    flawed_robots = range(6)
    edges_among_flawed_robots = [
        (first_robot, second_robot)
        for first_robot, second_robot in edges_on_circle(places_between_neighbours=1)
        if first_robot in flawed_robots and second_robot in flawed_robots
    ]

    assert len(edges_among_flawed_robots) < 5


# --- Cells -----------------------------------------------------------------------------------------------


def test_liars_are_counted_neither_in_the_error_of_a_swarm_nor_as_harmed_by_the_filter() -> None:
    """15 honest robots estimate the share of black, 0.5, rightly; the last five robots, which lie, say 0.

    A robot is harmed if its b_hat ends far from the accuracy of its sensor: 0.5 is far from 0.9.
    """
    trials_of_all_robots = two_trials_with(
        robots=20,
        flawed=0,
        firmware=peers.five_liars,
        fill_ratio=0.5,
        true_accuracy=0.9,
        x=[0.5] * 15 + [0.0] * 5,
        b_hat=[0.9] * 15 + [0.5] * 5,
    )

    trials_of_honest_robots = robust_filter.as_honest_robots_see_it(trials_of_all_robots)

    assert study_program.late_errors(trials_of_honest_robots).tolist() == [0, 0]
    assert study_program.harmed_percents(trials_of_honest_robots).tolist() == [0, 0]


def test_the_error_of_a_swarm_without_liars_is_the_mean_error_of_all_its_robots() -> None:
    """Nine robots estimate the share of black, 0.5, rightly, and the last one estimates 0.

    It is no liar: robots of this firmware lose messages. So no robot is left out.
    """
    trials_of_all_robots = two_trials_with(
        robots=10, flawed=0, firmware=peers.LossyRobot, fill_ratio=0.5, x=[0.5] * 9 + [0.0]
    )

    trials_of_honest_robots = robust_filter.as_honest_robots_see_it(trials_of_all_robots)

    mean_error = (9 * 0.0 + 0.5) / 10
    assert study_program.late_errors(trials_of_honest_robots) == pytest.approx([mean_error, mean_error])


def test_the_error_on_a_floor_that_changes_is_measured_against_its_share_of_black_at_the_end() -> None:
    """The floor is 0.55 black at first and 0.95 in the end, which is what all robots estimate."""
    trials = two_trials_with(sensor=peers.ChangingFloor, fill_ratio=0.55, x=0.95)
    trials_with_final_floor = robust_filter.as_honest_robots_see_it(trials)
    assert study_program.late_errors(trials_with_final_floor).tolist() == [0, 0]


@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize(
    ("x", "b_hat", "flawed", "text"),
    [
        (0.6, 0.9, 1, "100.0, 0.100, 0.0000, 0.0 %"),
        (0.5, [0.9, 0.9, 0.9, 0.5], 1, "100.0, 0.0000, 0.0000, 33.3 %"),
        (0.5, 0.9, 4, "100.0, 0.0000, 0.0000"),
    ],
    ids=["later error", "harm", "no healthy robots"],
)
def test_a_cell_of_the_grid_has_score_late_error_error_at_convergence_and_harm(
    x: float, b_hat: float | list[float], flawed: int, text: str
) -> None:
    """All robots converged at once without an error, which is worth 100 points, and estimate x later.

    One of three healthy robots is harmed if its b_hat ends at 0.5 instead of 0.9. Without healthy robots the
    percentage is left out.
    """
    trials = two_trials_with(robots=4, flawed=flawed, fill_ratio=0.5, true_accuracy=0.9, x=x, b_hat=b_hat)
    assert robust_filter.grid_text([trials]) == text


@pytest.mark.usefixtures("few_resamples")
def test_a_cell_of_other_tables_has_both_errors_and_the_percentage_of_harmed_robots() -> None:
    """The error of underconfident robots stands before the error of overconfident ones.

    The floor of underconfident swarms is 0.55 black, and the floor of overconfident ones 0.95. b_hat of all
    robots is the accuracy of their sensors, so none is harmed.
    """
    underconfident = two_trials_with(**PARAMETERS_BY_FLAW["underconfident"], x=0.65, b_hat=0.95)
    overconfident = two_trials_with(**PARAMETERS_BY_FLAW["overconfident"], x=0.75, b_hat=0.55)

    error_of_underconfident = 0.65 - 0.55
    error_of_overconfident = 0.95 - 0.75
    assert robust_filter.errors_text([overconfident, underconfident]) == (
        f"{error_of_underconfident:.3f}, {error_of_overconfident:.3f}, 0.0 %"
    )


def late_error_on_page(flaw: str, column: str) -> float:
    """Return the late error that docs/internals/robust.md has for 30 % flawed robots in moving swarms."""
    page = page_path("robust").read_text(encoding="utf-8")
    [markdown] = re.findall(r"^\| case \| swarm \|.*?\n\n", page, re.DOTALL | re.MULTILINE)
    lines = markdown.splitlines()
    [row] = [line for line in lines if line.startswith(f"| moving, .3 flawed | {flaw} |")]
    table = parse_table("\n".join([*lines[:2], row]))
    [[_flaw, *errors]] = table.rows.values()
    return float(dict(zip(table.columns[1:], errors, strict=True))[column])


@pytest.mark.slow
@pytest.mark.parametrize("flaw", ["underconfident", "overconfident"])
@pytest.mark.parametrize(
    ("filter_name", "column"), [("none", "no filter"), ("asdf-minus", "ASDF-"), ("robust", "robust")]
)
def test_ten_trials_of_another_seed_give_about_the_errors_on_the_page_of_the_robust_filter(
    flaw: str, filter_name: str, column: str
) -> None:
    """The page has medians over 40 trials of moving swarms with 30 % flawed robots."""
    swarm: dict[str, Any] = {"topology": "dynamic", "latency": 1, "robots": 20, "flawed": 6}
    (experiment,) = m.grid(
        **swarm, **PARAMETERS_BY_FLAW[flaw], filter=filter_name, steps=40_000, trials=10, seed=5
    )
    trials = run_trials(experiment, first=0, trials=10, sampling_interval=1000)

    median_error = float(np.median(study_program.late_errors(trials)))

    # The median of so few trials may be half as large again, or half as large.
    assert median_error == pytest.approx(late_error_on_page(flaw, column), rel=0.5)


# --- Picture ---------------------------------------------------------------------------------------------


@pytest.fixture
def results_by_panel_title(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Trials]]:
    """Collect, instead of drawing, the results of each panel of a picture by the panel's title."""
    results_by_panel_title: dict[str, list[Trials]] = {}

    def record_panels(panels: dict[str, list[Trials]]) -> Figure:
        results_by_panel_title.update(panels)
        return Figure()

    monkeypatch.setattr(robust_filter, "plot_errors_over_time", record_panels)
    return results_by_panel_title


def test_the_picture_of_the_robust_filter_has_a_panel_for_each_swarm_and_kind_of_flaw(
    results_by_panel_title: dict[str, list[Trials]],
) -> None:
    """The plot has three swarms. Two have only flawed robots. The third has 5 liars and 30 % flawed robots.

    Each swarm has run with underconfident and with overconfident flawed robots, which get a panel each.
    """
    underconfident = two_trials_with(**PARAMETERS_BY_FLAW["underconfident"])
    overconfident = two_trials_with(**PARAMETERS_BY_FLAW["overconfident"])
    both_results = [underconfident, overconfident]
    swarms_without_liars = {"moving, 30 % flawed": both_results, "moving, 50 % flawed": both_results}
    swarms_with_liars = {"moving, 5 liars": both_results}

    figure = robust_filter.draw_errors(grid=swarms_without_liars, worlds=swarms_with_liars)

    assert results_by_panel_title == {
        "30 % flawed, underconfident": [underconfident],
        "30 % flawed and 5 liars, underconfident": [underconfident],
        "50 % flawed, underconfident": [underconfident],
        "30 % flawed, overconfident": [overconfident],
        "30 % flawed and 5 liars, overconfident": [overconfident],
        "50 % flawed, overconfident": [overconfident],
    }
    assert figure.get_supxlabel() == "step"
