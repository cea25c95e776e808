"""The study of robots that read every tile twice: its experiments, cells and picture."""

from __future__ import annotations

import pytest

from host_tools.experiments.drawn_figures import legend_of, titles_of
from host_tools.studies.conftest import short_trials
from mcp_asdf_tools.common.extensions import name_object
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import study_program, two_readings
from mcp_asdf_tools.studies.peers import column_label
from mcp_asdf_tools.studies.reading_pairs import (
    HalfRepeated,
    IndependentReadings,
    TenthRepeated,
    TwoReadingsRobot,
)


def experiment_of(row: str, column: str) -> Experiment:
    """Return the only experiment of a row that a column of the table has."""
    (experiment,) = [
        experiment
        for experiment in two_readings.two_readings_rows()[row]
        if column_label(experiment) == column
    ]
    return experiment


def test_three_filters_stand_beside_robots_with_two_readings() -> None:
    for experiments in two_readings.two_readings_rows().values():
        columns = [column_label(experiment) for experiment in experiments]
        assert columns == ["no filter", "ASDF-", "robust", "two readings"]


@pytest.mark.parametrize(
    ("label", "flawed", "sensor"),
    [
        ("none flawed", 0, IndependentReadings),
        ("half flawed", 10, IndependentReadings),
        ("all flawed", 20, IndependentReadings),
        ("none flawed, tenth repeated", 0, TenthRepeated),
        ("none flawed, half repeated", 0, HalfRepeated),
    ],
)
def test_a_row_has_the_flawed_robots_and_repetitions_that_it_says(
    label: str, flawed: int, sensor: type[IndependentReadings]
) -> None:
    experiments = two_readings.two_readings_rows()[f"{label}, underconfident"]
    assert {experiment.flawed for experiment in experiments} == {flawed}
    assert {experiment.sensor for experiment in experiments} == {name_object(sensor)}


def test_all_robots_get_10_000_tiles_and_broadcast_once_for_each() -> None:
    """A tile takes two steps: of two readings, or of one and a pause."""
    two_readings_robot = experiment_of("none flawed, overconfident", "two readings")
    usual_robot = experiment_of("none flawed, overconfident", "robust")

    assert two_readings_robot.observation_period == 1
    assert usual_robot.observation_period == 2
    for experiment in (two_readings_robot, usual_robot):
        assert experiment.steps == 2 * 10_000
        assert experiment.comms_period == 2
        assert experiment.filter_period == 2 * 1000


def test_the_study_has_six_trials_and_a_seed_of_its_own() -> None:
    rows = two_readings.two_readings_rows()
    sizes = {
        (experiment.trials, experiment.seed) for experiments in rows.values() for experiment in experiments
    }

    assert sizes == {(6, 4715)}


def test_harm_is_a_percentage_of_the_healthy_robots(few_resamples: None) -> None:
    (trials,) = short_trials(filter="robust")
    trials.b_hat[:, -1, :] = trials.experiment.true_accuracy
    trials.b_hat[:, -1, 3] = 0.5  # one of the three healthy robots
    assert two_readings.harm_text([trials]) == "33.3"


def test_a_swarm_without_healthy_robots_has_no_harm(few_resamples: None) -> None:
    (trials,) = short_trials(filter="robust", flawed=4)
    assert two_readings.harm_text([trials]) == ""


def late_error_and_harm(row: str) -> tuple[float, float]:
    """Return the late error and the percentage of harmed robots of one trial with two readings."""
    experiment = experiment_of(row, "two readings")
    trials = run_trials(experiment, first=0, trials=1, sampling_interval=500)
    return float(study_program.late_errors(trials)[0]), float(study_program.harmed_percents(trials)[0])


@pytest.mark.slow
@pytest.mark.parametrize(("flaw", "limit"), [("underconfident", 0.005), ("overconfident", 0.1)])
def test_two_independent_readings_calibrate_a_swarm_that_is_all_flawed(flaw: str, limit: float) -> None:
    error, _ = late_error_and_harm(f"all flawed, {flaw}")
    assert error < limit


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "percent_harmed"),
    [("none flawed, overconfident", 0), ("none flawed, half repeated, overconfident", 100)],
)
def test_only_readings_that_repeat_each_other_harm_robots_with_poor_sensors(
    row: str, percent_harmed: float
) -> None:
    """A sensor that repeats half of its readings disagrees less often with itself, and seems better."""
    _, harmed = late_error_and_harm(row)
    assert harmed == percent_harmed


def test_the_picture_has_three_swarms_of_each_kind_and_a_line_for_each_column() -> None:
    one_reading = short_trials(filter=["none", "asdf-minus", "robust"])
    two_readings_of_tile = short_trials(filter="robust", firmware=TwoReadingsRobot)
    experiments = [*one_reading, *two_readings_of_tile]
    rows = {label: experiments for label in two_readings.two_readings_rows()}
    figure = two_readings.draw_errors(rows)

    assert titles_of(figure) == [
        "half flawed, underconfident",
        "all flawed, underconfident",
        "none flawed, half repeated, underconfident",
        "half flawed, overconfident",
        "all flawed, overconfident",
        "none flawed, half repeated, overconfident",
    ]
    assert legend_of(figure) == ["no filter", "ASDF-", "robust", "two readings"]
    assert all(len(axes.lines) == 4 for axes in figure.axes)
