"""The study of sensors that age: its experiments and its picture."""

from __future__ import annotations

import pytest

from host_tools.experiments.drawn_figures import titles_of
from host_tools.studies.conftest import all_experiments, short_trials, values_of
from mcp_asdf_tools.studies import ageing


@pytest.mark.parametrize(("memory_label", "memory"), [("longest memory", 2**31), ("short memory", 4096)])
def test_each_of_six_kinds_of_ageing_runs_with_the_longest_and_with_a_short_memory(
    memory_label: str, memory: int
) -> None:
    """A robot halves its counts at so many observations, to forget old ones."""
    rows = ageing.ageing_rows()
    rows_with_memory = {label: row for label, row in rows.items() if label.endswith(memory_label)}

    assert len(rows_with_memory) == 6
    assert values_of(all_experiments(rows_with_memory), "memory") == {memory}


def test_swarms_whose_robots_all_age_alike_run_with_three_filters_on_three_floors() -> None:
    experiments = ageing.ageing_rows()["all age alike, longest memory"]

    assert values_of(experiments, "fill_ratio") == {0.55, 0.75, 0.95}
    assert values_of(experiments, "filter") == {"none", "asdf-plus", "robust"}
    assert len(experiments) == 3 * 3


def test_swarms_of_which_six_robots_age_run_with_all_four_filters() -> None:
    """In an experiment the flawed robots are six of 20, and only their accuracy drifts."""
    experiments = ageing.ageing_rows()["six age alike, longest memory"]

    assert values_of(experiments, "robots") == {20}
    assert values_of(experiments, "flawed") == {6}
    assert values_of(experiments, "drift_of") == {"flawed"}
    assert values_of(experiments, "filter") == {"none", "asdf-minus", "asdf-plus", "robust"}


def test_all_robots_whose_sensors_age_begin_with_the_right_accuracy_of_0_95() -> None:
    experiments = all_experiments(ageing.ageing_rows(), ageing.peer_rows())

    assert values_of(experiments, "true_accuracy") == {0.95}
    assert values_of(experiments, "flawed_accuracy") == {0.95}  # what "flawed" robots assume at first


def test_robots_that_know_how_sensors_age_have_one_floor_and_no_flawed_robots() -> None:
    experiments = all_experiments(ageing.peer_rows())

    assert values_of(experiments, "fill_ratio") == {0.75}
    assert values_of(experiments, "flawed") == {0}


def test_robots_that_know_a_steady_drift_run_with_sensors_that_lose_1e_5_in_a_step() -> None:
    experiments = ageing.peer_rows()["all age alike, short memory"]

    assert values_of(experiments, "drift_rate") == {-1e-5}
    assert values_of(experiments, "sensor") == {""}


def test_robots_that_know_how_accuracies_wander_run_with_wandering_sensors() -> None:
    experiments = ageing.peer_rows()["each ages in its own way, short memory"]

    assert values_of(experiments, "drift_rate") == {0}
    assert values_of(experiments, "sensor") == {"mcp_asdf_tools.studies.ageing_sensors.WanderingSensors"}


def test_the_picture_of_ageing_sensors_has_a_panel_for_each_kind_of_ageing() -> None:
    """Results with a short memory are left out; what a panel draws is not looked at here."""
    any_trials = short_trials()
    figure = ageing.draw_errors(dict.fromkeys(ageing.ageing_rows(), any_trials))

    assert titles_of(figure) == [
        "none ages",
        "all age alike",
        "all age at once",
        "all age, some faster",
        "each ages in its own way",
        "six age alike",
    ]
