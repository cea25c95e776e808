"""The study of sensors that age: rows and picture of its page."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import ageing
from mcp_asdf_tools.studies.ageing_sensors import (
    SuddenlyWorseSensors,
    UnequallyAgeingSensors,
    WanderingSensors,
)
from mcp_asdf_tools.studies.peers import KnownWanderingSensors


def test_each_way_to_age_has_a_row_for_each_memory() -> None:
    rows = {ageing.row_label(experiment) for experiment in ageing.ageing_experiments()}
    assert len(rows) == 12


def test_the_ageing_picture_has_a_panel_for_each_way() -> None:
    experiments = [
        run_trials(replace(experiment, steps=4000), 0, 1, 1000)
        for experiment in ageing.ageing_experiments()[:38:5]
    ]
    lasting = [each.experiment for each in experiments if each.experiment.memory == ageing.LONGEST_MEMORY]
    titles = [axes.get_title("left") for axes in ageing.draw_errors(experiments).axes if axes.axison]
    assert titles == list(dict.fromkeys(ageing.ageing_label(experiment) for experiment in lasting))


def test_robots_that_know_the_drift_are_12_experiments() -> None:
    experiments = ageing.peer_experiments()
    rows = {ageing.row_label(experiment) for experiment in experiments}
    assert rows == {
        "all age alike, longest memory",
        "all age alike, short memory",
        "each ages in its own way, longest memory",
        "each ages in its own way, short memory",
    }
    assert len(experiments) == len(rows) * 3  # three columns of the table


def test_robots_that_know_the_drift_start_with_the_right_b_hat() -> None:
    experiments = ageing.peer_experiments()
    assert {experiment.flawed for experiment in experiments} == {0}
    assert {(experiment.fill_ratio, experiment.trials, experiment.seed) for experiment in experiments} == {
        (0.75, 4, 90126)
    }
    assert {experiment.drift_rate for experiment in experiments} == {-1e-5, 0}


@pytest.mark.parametrize(
    ("changes", "label"),
    [
        ({}, "none ages"),
        ({"drift": "linear", "drift_rate": -1e-5}, "all age alike"),
        ({"sensor": SuddenlyWorseSensors}, "all age at once"),
        ({"sensor": UnequallyAgeingSensors}, "all age, some faster"),
        ({"sensor": WanderingSensors}, "each ages in its own way"),
        ({"sensor": KnownWanderingSensors}, "each ages in its own way"),
        ({"drift": "linear", "drift_rate": -1e-5, "drift_of": "flawed"}, "6 of 20 age alike"),
    ],
)
def test_a_way_to_age_has_a_name(changes: dict[str, Any], label: str) -> None:
    assert ageing.ageing_label(Experiment(robots=20, flawed=6, **changes)) == label


def test_the_study_has_its_own_seed_and_30_long_trials() -> None:
    experiments = ageing.ageing_experiments()
    assert len(experiments) == 3 * 2 * (5 * 3 + 4)  # fill ratios, memories, ways to age and filters
    assert {(experiment.seed, experiment.trials, experiment.steps) for experiment in experiments} == {
        (90125, 30, 40_000)
    }
    assert {experiment.fill_ratio for experiment in experiments} == {0.55, 0.75, 0.95}
    assert {(experiment.true_accuracy, experiment.flawed_accuracy) for experiment in experiments} == {
        (0.95, 0.95)
    }
