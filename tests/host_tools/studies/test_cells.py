"""The paper's experiments as cells: a cell is one combination of what the paper varies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, cells_of, experiment_of


def first_experiment(study_part: StudyPart) -> Experiment:
    return experiment_of(cells_of(study_part)[0], StudySize())


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
    cells = cells_of(study_part)
    experiments = {experiment_of(cell, StudySize()) for cell in cells}

    assert len(cells) == count
    assert len(experiments) == count


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
    experiment = first_experiment(study_part)

    assert experiment.robots == robots
    assert experiment.steps == steps
    assert experiment.trials == 30


def test_the_dynamic_swarm_of_20_robots_with_a_radio_range_of_0_7_m_has_density_1() -> None:
    """Density is N pi r^2 by the area of the square floor, so this area is 20 pi 0.7^2 square metres."""
    area = 20 * np.pi * 0.7**2
    width, _height = first_experiment(StudyPart.DYNAMIC).sides
    assert width == pytest.approx(np.sqrt(area))


def test_the_physical_experiment_has_the_papers_platform_speed_and_two_observations_in_a_second() -> None:
    """The sides of the platform are in metres, and the speed is in metres per second."""
    experiment = first_experiment(StudyPart.PHYSICAL)

    assert experiment.sides == (3.0353, 3.0226)
    assert experiment.floor == "code"
    assert experiment.speed == 0.1
    assert experiment.steps_per_second / experiment.observation_period == 2


def test_physical_robots_have_perfect_sensors_on_a_floor_of_0_448_black() -> None:
    """Of the eight robots, 0, 2, 4 or 8 are flawed."""
    experiments = [experiment_of(cell, StudySize()) for cell in cells_of(StudyPart.PHYSICAL)]
    assert {experiment.fill_ratio for experiment in experiments} == {0.448}
    assert {experiment.true_accuracy for experiment in experiments} == {1.0}
    assert {experiment.flawed for experiment in experiments} == {0, 2, 4, 8}


# --- Normal form -----------------------------------------------------------------------------------------

HALF_FLAWED_CELL = Cell(
    study_part=StudyPart.DYNAMIC,
    fill_ratio=0.55,
    true_accuracy=0.95,
    flawed_accuracy=0.55,
    flawed_percent=50,
    filter="asdf-minus",
    filter_period=2000,
)
"""With ASDF- only flawed robots filter. Here half of the robots are flawed."""


def test_the_normal_form_of_a_cell_with_asdf_minus_and_no_flawed_robots_is_one_without_a_filter() -> None:
    """What flawed robots would assume, and how often a filter would run, makes no difference then."""
    normal_cell = replace(HALF_FLAWED_CELL, flawed_percent=0).normal

    assert normal_cell.filter == "none"
    assert normal_cell.flawed_accuracy == 0.95  # the true one
    assert normal_cell.filter_period == 1000  # the first choice


def test_the_normal_form_of_a_cell_with_asdf_minus_and_flawed_robots_alone_is_one_with_asdf_plus() -> None:
    cell = replace(HALF_FLAWED_CELL, flawed_percent=100)
    assert cell.normal == replace(cell, filter="asdf-plus")


def test_a_partly_flawed_swarm_with_a_filter_is_its_own_normal_form() -> None:
    assert HALF_FLAWED_CELL.normal == HALF_FLAWED_CELL


# --- Size ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("steps_of_size", "steps"), [(4000, 4000), (40_000, 10_000)])
def test_a_size_of_the_study_shortens_trials_but_never_lengthens_them(steps_of_size: int, steps: int) -> None:
    """Physical trials have 10,000 steps in the paper."""
    physical_cell, *_others = cells_of(StudyPart.PHYSICAL)
    assert experiment_of(physical_cell, StudySize(steps=steps_of_size)).steps == steps


@pytest.mark.parametrize(
    ("trials", "steps", "allows_verdicts"), [(30, 40_000, True), (29, 40_000, False), (30, 39_999, False)]
)
def test_claims_get_verdicts_only_if_trials_are_as_many_and_as_long_as_the_papers(
    trials: int, steps: int, allows_verdicts: bool
) -> None:
    assert StudySize(trials, steps).allows_verdicts is allows_verdicts
