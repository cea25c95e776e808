"""The study of robots that read every tile twice: its experiments, cells and picture."""

from __future__ import annotations

import pytest

from host_tools.studies.conftest import page_path, tables_in, two_trials_with
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import study_program, two_readings
from mcp_asdf_tools.studies.peers import column_label


def experiment_of(row: str, column: str) -> Experiment:
    """Return the only experiment of a row that a column of the table has."""
    (experiment,) = [
        experiment
        for experiment in two_readings.two_readings_rows()[row]
        if column_label(experiment) == column
    ]
    return experiment


def test_the_table_of_harm_has_the_percentage_of_healthy_robots_that_were_harmed() -> None:
    """The first of four robots is flawed. One of three healthy ones ends with 0.5 instead of 0.9."""
    trials = two_trials_with(robots=4, flawed=1, true_accuracy=0.9, b_hat=[0.9, 0.9, 0.9, 0.5])
    assert two_readings.harm_text([trials]) == "33.3"


def test_the_table_of_harm_is_empty_for_a_swarm_without_healthy_robots() -> None:
    """All four robots are flawed, so nobody can be harmed."""
    trials = two_trials_with(robots=4, flawed=4)
    assert two_readings.harm_text([trials]) == ""


def run_trial_with_two_readings(row: str) -> Trials:
    """Run a trial of the robots in a row of the study's table, which read each tile twice."""
    return run_trials(experiment_of(row, "two readings"), first=0, trials=1, sampling_interval=500)


@pytest.mark.slow
@pytest.mark.parametrize(("flaw", "largest_error"), [("underconfident", 0.005), ("overconfident", 0.1)])
def test_robots_that_are_all_flawed_estimate_the_floor_well_if_they_read_each_tile_twice(
    flaw: str, largest_error: float
) -> None:
    """They find the accuracy of their sensors from how often independent readings disagree."""
    trial = run_trial_with_two_readings(f"all flawed, {flaw}")

    [late_error] = study_program.late_errors(trial)
    assert late_error < largest_error


@pytest.mark.slow
def test_two_independent_readings_harm_no_healthy_robot() -> None:
    """All sensors are poor, with b = 0.55, and no robot is flawed."""
    trial = run_trial_with_two_readings("none flawed, overconfident")
    assert two_readings.harm_text([trial]) == "0.0"


@pytest.mark.slow
def test_sensors_that_repeat_a_tenth_of_their_readings_harm_as_many_healthy_robots_as_the_page_says() -> None:
    """Such a sensor disagrees less often with itself, and seems better. The page has six such trials."""
    row = "none flawed, tenth repeated, overconfident"
    percent_on_page = tables_in(page_path("two_readings"))["harm"][row]["two readings"]

    percent_harmed = two_readings.harm_text([run_trial_with_two_readings(row)])

    assert percent_harmed == percent_on_page
