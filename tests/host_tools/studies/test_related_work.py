"""The study of rules from related work: its experiments, measures and picture."""

from __future__ import annotations

import pytest

from host_tools.experiments.drawn_figures import legend_of, titles_of
from host_tools.studies.conftest import short_trials
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies import peers, related_work


def all_experiments() -> list[Experiment]:
    rows = [*related_work.resilience_rows().values(), *related_work.colour_rows().values()]
    return [experiment for row in rows for experiment in row]


def columns_of(experiments: list[Experiment]) -> list[str]:
    return [peers.column_label(experiment) for experiment in experiments]


def test_swarms_with_liars_have_rules_that_trim_beside_two_filters() -> None:
    experiments = related_work.resilience_rows()["fully connected, 5 liars, underconfident"]
    assert columns_of(experiments) == ["no filter", "robust", "W-MSR", "trimmed mean"]
    assert {peers.LIARS[peers.firmware_name(experiment)] for experiment in experiments} == {5}
    assert {experiment.flawed for experiment in experiments} == {0}


def test_flawed_swarms_have_rules_that_trim_beside_three_filters() -> None:
    experiments = related_work.resilience_rows()["moving, 6 flawed, overconfident"]
    assert columns_of(experiments) == ["no filter", "ASDF-", "robust", "W-MSR", "trimmed mean"]
    assert {experiment.flawed for experiment in experiments} == {6}


@pytest.mark.parametrize(
    ("row", "topology", "density"),
    [
        ("fully connected, 5 liars", "fully-connected", 1.0),
        ("moving, dense, 5 liars", "dynamic", 12.0),
        ("moving, 5 liars", "dynamic", 1.0),
    ],
)
def test_a_row_has_the_topology_that_it_says(row: str, topology: str, density: float) -> None:
    experiments = related_work.resilience_rows()[f"{row}, overconfident"]
    assert {(experiment.topology, experiment.density) for experiment in experiments} == {(topology, density)}


def test_a_vote_on_the_colour_stands_beside_the_filters() -> None:
    rows = related_work.colour_rows()
    assert columns_of(rows["moving, 6 flawed, underconfident"]) == ["no filter", "ASDF-", "robust", "DMMD"]
    assert columns_of(rows["moving, 5 liars, underconfident"]) == ["no filter", "robust", "DMMD"]


def test_black_prevails_in_all_worlds() -> None:
    assert all(experiment.fill_ratio > 0.5 for experiment in all_experiments())


def test_the_study_has_six_trials_of_20_robots_and_a_seed_of_its_own() -> None:
    sizes = {(experiment.robots, experiment.trials, experiment.seed) for experiment in all_experiments()}
    assert sizes == {(20, 6, 4714)}


def test_the_early_error_is_that_of_the_first_quarter_without_step_0() -> None:
    """There are eight samples after step 0, so the first quarter has two, with errors of 0.1 and 0.3.

    x has the shape (trials, samples, robots), and 0.5 would be right. Both trials are equal.
    """
    (trials,) = short_trials(filter="none", fill_ratio=0.5, steps=800)
    x = trials.records["x"]
    x[:] = 0.9
    x[:, 1, :] = 0.6
    x[:, 2, :] = 0.8

    assert related_work.early_errors(trials) == pytest.approx([0.2, 0.2])


def test_an_answer_is_right_if_it_is_on_the_side_of_the_fill_ratio() -> None:
    (trials,) = short_trials(filter="none", fill_ratio=0.55)
    trials.records["x"][:, -1, :] = [0.9, 0.51, 0.5, 0.2]
    assert related_work.right_percents(trials) == pytest.approx([50, 50])


def test_answers_have_one_decimal(few_resamples: None) -> None:
    (trials,) = short_trials(filter="none", fill_ratio=0.55)
    trials.records["x"][:, -1, :] = [0.9, 0.9, 0.9, 0.2]
    assert related_work.right_text([trials]) == "75.0"


def test_the_picture_has_three_swarms_of_each_kind_and_a_line_for_each_rule() -> None:
    (trials,) = short_trials(filter="none")
    rules = [peers.WmsrRobot, peers.TrimmedMeanRobot]
    all_trials = [trials, *short_trials(filter="robust"), *short_trials(filter="none", firmware=rules)]
    rows = {label: all_trials for label in related_work.resilience_rows()}
    figure = related_work.draw_errors(rows)

    assert titles_of(figure) == [
        "fully connected, 5 liars, underconfident",
        "moving, 5 liars, underconfident",
        "moving, 6 flawed, underconfident",
        "fully connected, 5 liars, overconfident",
        "moving, 5 liars, overconfident",
        "moving, 6 flawed, overconfident",
    ]
    assert legend_of(figure) == ["no filter", "W-MSR", "trimmed mean", "robust"]
    assert all(len(axes.lines) == 4 for axes in figure.axes)
