"""The paper's experiments as cells: a cell is one combination of what the paper varies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, cells_of, experiment_of


def experiments_of(study_part: StudyPart) -> list[Experiment]:
    """Return the experiments of a part of the study as the paper ran them, one for each cell."""
    return [experiment_of(cell, StudySize()) for cell in cells_of(study_part)]


@pytest.mark.parametrize(
    ("study_part", "count"),
    [
        # For each of 4 pairs of f and b there are 4 filters without flawed robots: none, and ASDF+ with three
        # periods. With 2 wrong b_hat there are 7 filters for each of 3 percentages of flawed robots, as ASDF-
        # has three periods, too, and 4 filters where all robots are flawed.
        (StudyPart.FULLY_CONNECTED, 4 * (4 + 2 * 3 * 7 + 2 * 4)),
        (StudyPart.DYNAMIC, 4 * (4 + 2 * 3 * 7 + 2 * 4)),
        # 2 filters without flawed robots, and with 3 percentages of robots that assume one of 3 b_hat
        (StudyPart.PHYSICAL, 2 + 3 * 3 * 2),
    ],
)
def test_a_part_of_the_study_has_each_experiment_of_the_paper_once(study_part: StudyPart, count: int) -> None:
    """The paper varies the floor, the sensors, the flawed robots and the filter, which makes 216 or 20."""
    experiments = experiments_of(study_part)
    different_experiments = set(experiments)

    assert len(experiments) == count
    assert len(different_experiments) == count


@pytest.mark.parametrize(
    ("study_part", "robots", "steps"),
    [
        (StudyPart.FULLY_CONNECTED, 10, 40_000),
        (StudyPart.DYNAMIC, 20, 40_000),
        (StudyPart.PHYSICAL, 8, 10_000),
    ],
)
def test_a_part_of_the_study_has_as_many_robots_and_steps_and_trials_as_the_paper(
    study_part: StudyPart, robots: int, steps: int
) -> None:
    """The paper runs 30 trials of each experiment."""
    for experiment in experiments_of(study_part):
        assert experiment.robots == robots
        assert experiment.steps == steps
        assert experiment.trials == 30


def test_the_dynamic_swarm_of_20_robots_with_a_radio_range_of_0_7_m_has_density_1() -> None:
    """Density is the area within radio range of all robots, by the area of the floor. The floor is square."""
    first_experiment, *_others = experiments_of(StudyPart.DYNAMIC)
    width, height = first_experiment.sides

    area_within_radio_range = 20 * np.pi * 0.7**2
    assert width == height
    assert area_within_radio_range / (width * height) == pytest.approx(1)


def test_the_physical_experiment_has_the_papers_platform_speed_and_two_observations_in_a_second() -> None:
    """Sides are in metres, and the speed is in metres per second. The floor has the pattern "code"."""
    first_experiment, *_others = experiments_of(StudyPart.PHYSICAL)

    assert first_experiment.sides == (3.0353, 3.0226)
    assert first_experiment.floor == "code"
    assert first_experiment.speed == 0.1
    observations_per_second = first_experiment.steps_per_second / first_experiment.observation_period
    assert observations_per_second == 2


def test_physical_robots_have_perfect_sensors_on_a_floor_of_0_448_black() -> None:
    """Of the eight robots, 0, 2, 4 or 8 are flawed."""
    experiments = experiments_of(StudyPart.PHYSICAL)
    assert {experiment.fill_ratio for experiment in experiments} == {0.448}
    assert {experiment.true_accuracy for experiment in experiments} == {1.0}
    assert {experiment.flawed for experiment in experiments} == {0, 2, 4, 8}


# --- Normal form -----------------------------------------------------------------------------------------


def cell_with_asdf_minus(flawed_percent: int) -> Cell:
    """Return a dynamic swarm in which only the flawed robots filter, every 2000 steps.

    Its sensors have an accuracy of 0.95, and flawed robots assume 0.55.
    """
    return Cell(
        study_part=StudyPart.DYNAMIC,
        fill_ratio=0.55,
        true_accuracy=0.95,
        flawed_accuracy=0.55,
        flawed_percent=flawed_percent,
        filter="asdf-minus",
        filter_period=2000,
    )


def test_the_normal_form_of_a_cell_with_asdf_minus_and_no_flawed_robots_is_one_without_a_filter() -> None:
    """With ASDF- only flawed robots filter, so no robot does.

    What flawed robots would assume, and how often a filter would run, makes no difference then. So in the
    normal form they would assume the true accuracy, 0.95, and the filter would have the shortest period.
    """
    normal_cell = cell_with_asdf_minus(flawed_percent=0).normal

    assert normal_cell.filter == "none"
    assert normal_cell.flawed_accuracy == 0.95
    assert normal_cell.filter_period == 1000


def test_the_normal_form_of_a_cell_with_asdf_minus_and_flawed_robots_alone_is_one_with_asdf_plus() -> None:
    """Where all robots are flawed, all filter, whether only flawed robots are to filter or all (ASDF+)."""
    cell = cell_with_asdf_minus(flawed_percent=100)
    assert cell.normal == replace(cell, filter="asdf-plus")


def test_a_partly_flawed_swarm_with_a_filter_is_its_own_normal_form() -> None:
    """No other combination of parameters is the same experiment as a swarm that is half flawed."""
    half_flawed_cell = cell_with_asdf_minus(flawed_percent=50)
    assert half_flawed_cell.normal == half_flawed_cell


# --- Size ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("steps_of_study", "steps_of_trials"), [(4000, 4000), (40_000, 10_000)])
def test_a_size_of_the_study_shortens_trials_but_never_lengthens_them(
    steps_of_study: int, steps_of_trials: int
) -> None:
    """Physical trials have 10,000 steps in the paper."""
    first_cell, *_others = cells_of(StudyPart.PHYSICAL)
    experiment = experiment_of(first_cell, StudySize(steps=steps_of_study))
    assert experiment.steps == steps_of_trials


@pytest.mark.parametrize(
    ("trials", "steps", "allows_verdicts"), [(30, 40_000, True), (29, 40_000, False), (30, 39_999, False)]
)
def test_claims_get_verdicts_only_if_trials_are_as_many_and_as_long_as_the_papers(
    trials: int, steps: int, allows_verdicts: bool
) -> None:
    """The paper has 30 trials of at most 40,000 steps."""
    assert StudySize(trials=trials, steps=steps).allows_verdicts is allows_verdicts
