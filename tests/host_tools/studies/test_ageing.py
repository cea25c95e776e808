"""The study of sensors that age: its experiments and its picture."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import ageing


def experiments_of(rows: dict[str, list[Experiment]]) -> list[Experiment]:
    return [experiment for experiments in rows.values() for experiment in experiments]


def test_six_kinds_of_ageing_have_a_row_for_each_memory() -> None:
    rows = ageing.ageing_rows()
    assert len(rows) == 6 * 2
    assert {experiment.memory for experiment in rows["none ages, longest memory"]} == {2**31}
    assert {experiment.memory for experiment in rows["none ages, short memory"]} == {4096}


def test_swarms_without_flawed_robots_have_three_filters_and_three_fill_ratios() -> None:
    experiments = ageing.ageing_rows()["all age alike, longest memory"]
    assert {experiment.fill_ratio for experiment in experiments} == {0.55, 0.75, 0.95}
    assert {experiment.filter for experiment in experiments} == {"none", "asdf-plus", "robust"}
    assert len(experiments) == 3 * 3


def test_six_of_twenty_robots_age_with_each_of_four_filters() -> None:
    experiments = ageing.ageing_rows()["six age alike, longest memory"]
    assert {(experiment.robots, experiment.flawed) for experiment in experiments} == {(20, 6)}
    assert {experiment.drift_of for experiment in experiments} == {"flawed"}
    assert {experiment.filter for experiment in experiments} == {"none", "asdf-minus", "asdf-plus", "robust"}


def test_all_robots_begin_with_the_right_b_hat() -> None:
    experiments = experiments_of(ageing.ageing_rows())
    accuracies = {(experiment.true_accuracy, experiment.flawed_accuracy) for experiment in experiments}
    assert accuracies == {(0.95, 0.95)}


def test_the_study_has_30_long_trials_and_a_seed_of_its_own() -> None:
    sizes = {
        (experiment.trials, experiment.steps, experiment.seed)
        for experiment in experiments_of(ageing.ageing_rows())
    }

    assert sizes == {(30, 40_000, 90125)}


def test_robots_that_know_the_drift_have_four_trials_and_a_seed_of_their_own() -> None:
    experiments = experiments_of(ageing.peer_rows())
    sizes = {(experiment.trials, experiment.steps, experiment.seed) for experiment in experiments}

    assert sizes == {(4, 40_000, 90126)}
    assert {experiment.fill_ratio for experiment in experiments} == {0.75}
    assert {experiment.flawed for experiment in experiments} == {0}


@pytest.mark.parametrize(("kind", "drift_rate"), [("all age alike", -1e-5), ("each ages in its own way", 0)])
def test_sensors_age_as_their_robots_expect(kind: str, drift_rate: float) -> None:
    experiments = ageing.peer_rows()[f"{kind}, short memory"]
    assert {experiment.drift_rate for experiment in experiments} == {drift_rate}
    assert {bool(experiment.sensor) for experiment in experiments} == {drift_rate == 0}


def test_the_picture_has_a_panel_for_each_kind_of_ageing() -> None:
    rows = {
        label: [run_trials(replace(experiments[0], steps=1000), first=0, trials=1, sampling_interval=500)]
        for label, experiments in ageing.ageing_rows().items()
    }
    axes_of_panels = [axes for axes in ageing.draw_errors(rows).axes if axes.axison]

    assert [axes.get_title("left") for axes in axes_of_panels] == [
        "none ages",
        "all age alike",
        "all age at once",
        "all age, some faster",
        "each ages in its own way",
        "six age alike",
    ]
