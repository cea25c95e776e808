"""The study of rules from related work: its experiments, measures and picture."""

from __future__ import annotations

import pytest

from host_tools.experiments.drawn_figures import legend_of, titles_of
from host_tools.studies.conftest import all_experiments, short_trials, trials_with, values_of
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies import peers, related_work


def columns_of(experiments: list[Experiment]) -> list[str]:
    return [peers.column_label(experiment) for experiment in experiments]


def test_each_rule_that_trims_and_two_filters_run_in_swarms_with_five_liars_and_no_flawed_robots() -> None:
    """W-MSR and the trimmed mean leave out extreme estimates, so they need no filter."""
    experiments = related_work.resilience_rows()["fully connected, 5 liars, underconfident"]

    assert columns_of(experiments) == ["no filter", "robust", "W-MSR", "trimmed mean"]
    assert values_of(experiments, "robots") == {20}
    assert values_of(experiments, "flawed") == {0}
    for experiment in experiments:
        assert peers.firmware_name(experiment).endswith("five_liars")


def test_each_rule_that_trims_and_three_filters_run_in_swarms_with_six_flawed_robots() -> None:
    experiments = related_work.resilience_rows()["moving, 6 flawed, overconfident"]

    assert columns_of(experiments) == ["no filter", "ASDF-", "robust", "W-MSR", "trimmed mean"]
    assert values_of(experiments, "flawed") == {6}


@pytest.mark.parametrize(
    ("row", "topology", "density"),
    [
        ("fully connected, 5 liars, overconfident", "fully-connected", 1.0),
        ("moving, dense, 5 liars, overconfident", "dynamic", 12.0),
        ("moving, 5 liars, overconfident", "dynamic", 1.0),
    ],
)
def test_a_row_with_liars_has_the_topology_and_density_of_its_label(
    row: str, topology: str, density: float
) -> None:
    experiments = related_work.resilience_rows()[row]

    assert values_of(experiments, "topology") == {topology}
    assert values_of(experiments, "density") == {density}


@pytest.mark.parametrize(
    ("row", "columns"),
    [
        ("moving, 6 flawed, underconfident", ["no filter", "ASDF-", "robust", "DMMD"]),
        ("moving, 5 liars, underconfident", ["no filter", "robust", "DMMD"]),
    ],
)
def test_a_vote_on_the_prevailing_colour_runs_in_the_same_swarms_as_filters(
    row: str, columns: list[str]
) -> None:
    """DMMD is such a vote."""
    assert columns_of(related_work.colour_rows()[row]) == columns


def test_more_than_half_of_the_floor_is_black_in_all_swarms_that_name_the_prevailing_colour() -> None:
    for experiment in all_experiments(related_work.colour_rows()):
        assert experiment.fill_ratio > 0.5


def test_the_early_error_is_the_mean_distance_from_f_in_the_first_quarter_without_step_0() -> None:
    """There are eight samples after step 0, so the first quarter has two. All robots estimate f = 0.5."""
    step_0 = [0.9] * 4
    first_quarter = [[0.6] * 4, [0.8] * 4]  # 0.1 and 0.3 from f
    later = [[0.9] * 4] * 6
    trials = trials_with(x=[step_0, *first_quarter, *later])

    mean_distance = (0.1 + 0.3) / 2
    assert related_work.early_errors(trials) == pytest.approx([mean_distance, mean_distance])


def test_only_robots_whose_estimate_is_above_one_half_answer_rightly_that_black_prevails() -> None:
    """0.55 of the floor is black. Two of four robots, with 0.9 and 0.51, are right in both trials."""
    trials = trials_with(fill_ratio=0.55, x=[0.9, 0.51, 0.5, 0.2])
    assert related_work.right_percents(trials).tolist() == [50, 50]


def test_the_percentage_of_right_answers_has_one_decimal(few_resamples: None) -> None:
    """Three of four robots are right that black prevails where it has 0.55 of the floor."""
    trials = trials_with(fill_ratio=0.55, x=[0.9, 0.9, 0.9, 0.2])
    assert related_work.right_text([trials]) == "75.0"


def test_the_picture_has_a_line_for_each_rule_in_three_swarms_of_both_kinds_of_flaws() -> None:
    (unfiltered,) = short_trials(filter="none")
    results = [
        unfiltered,
        *short_trials(filter="robust"),
        *short_trials(filter="none", firmware=[peers.WmsrRobot, peers.TrimmedMeanRobot]),
    ]

    figure = related_work.draw_errors(dict.fromkeys(related_work.resilience_rows(), results))

    assert titles_of(figure) == [
        "fully connected, 5 liars, underconfident",
        "moving, 5 liars, underconfident",
        "moving, 6 flawed, underconfident",
        "fully connected, 5 liars, overconfident",
        "moving, 5 liars, overconfident",
        "moving, 6 flawed, overconfident",
    ]
    assert legend_of(figure) == ["no filter", "W-MSR", "trimmed mean", "robust"]
    for axes in figure.axes:
        assert len(axes.lines) == 4
