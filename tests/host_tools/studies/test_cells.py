"""The paper's experiments as cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, cells_of, experiment_of

ASDF_MINUS_CELL = Cell(StudyPart.DYNAMIC, 0.55, 0.95, 0.55, 50, "asdf-minus", 2000)


def first_experiment(study_part: StudyPart) -> Experiment:
    return experiment_of(cells_of(study_part)[0], StudySize())


@pytest.mark.parametrize(
    ("study_part", "count"),
    [
        # for each f and b: 4 without flawed robots, 2 x 3 x 7 partly flawed, 2 x 4 entirely flawed
        (StudyPart.FULLY_CONNECTED, 4 * (4 + 42 + 8)),
        (StudyPart.DYNAMIC, 4 * (4 + 42 + 8)),
        (StudyPart.PHYSICAL, 2 + 3 * 3 * 2),
    ],
)
def test_the_study_has_each_experiment_of_the_paper_once(study_part: StudyPart, count: int) -> None:
    experiments = {experiment_of(cell, StudySize()) for cell in cells_of(study_part)}
    assert len(cells_of(study_part)) == len(experiments) == count


@pytest.mark.parametrize("study_part", StudyPart)
def test_each_experiment_of_the_study_has_the_one_name_that_is_its_normal_form(study_part: StudyPart) -> None:
    """Some have several: without flawed robots ASDF- is no filter."""
    assert all(cell.normal == cell for cell in cells_of(study_part))


@pytest.mark.parametrize(
    ("study_part", "robots", "steps"),
    [
        (StudyPart.FULLY_CONNECTED, 10, 40_000),
        (StudyPart.DYNAMIC, 20, 40_000),
        (StudyPart.PHYSICAL, 8, 10_000),
    ],
)
def test_swarms_are_as_large_and_trials_as_long_as_the_papers(
    study_part: StudyPart, robots: int, steps: int
) -> None:
    experiment = first_experiment(study_part)
    assert (experiment.robots, experiment.steps, experiment.trials) == (robots, steps, 30)


def test_the_dynamic_swarm_has_density_1() -> None:
    assert first_experiment(StudyPart.DYNAMIC).sides[0] == pytest.approx(0.7 * np.sqrt(20 * np.pi))


def test_the_physical_experiment_has_the_papers_platform_and_rates() -> None:
    experiment = first_experiment(StudyPart.PHYSICAL)
    assert (experiment.sides, experiment.floor, experiment.speed) == ((3.0353, 3.0226), "code", 0.1)
    assert experiment.steps_per_second / experiment.observation_period == 2


def test_the_physical_robots_see_perfectly() -> None:
    cells = cells_of(StudyPart.PHYSICAL)
    assert {(cell.fill_ratio, cell.true_accuracy) for cell in cells} == {(0.448, 1.0)}
    assert {experiment_of(cell, StudySize()).flawed for cell in cells} == {0, 2, 4, 8}


def test_without_flawed_robots_asdf_minus_is_no_filter() -> None:
    cell = replace(ASDF_MINUS_CELL, flawed_percent=0)
    assert cell.normal == Cell(StudyPart.DYNAMIC, 0.55, 0.95, 0.95, 0, "none", 1000)


def test_with_flawed_robots_alone_asdf_minus_is_asdf_plus() -> None:
    cell = replace(ASDF_MINUS_CELL, flawed_percent=100)
    assert cell.normal == replace(cell, filter="asdf-plus")


def test_a_partly_flawed_swarm_with_a_filter_stays_as_it_is() -> None:
    assert ASDF_MINUS_CELL.normal == ASDF_MINUS_CELL


def test_a_size_shortens_trials_but_never_lengthens_them() -> None:
    physical = cells_of(StudyPart.PHYSICAL)[0]
    assert experiment_of(physical, StudySize(steps=4000)).steps == 4000
    assert experiment_of(physical, StudySize(steps=40_000)).steps == 10_000


@pytest.mark.parametrize(
    ("study_size", "allows_verdicts"),
    [
        (StudySize(30, 40_000), True),
        (StudySize(29, 40_000), False),
        (StudySize(30, 39_999), False),
    ],
)
def test_verdicts_need_the_papers_trials_and_steps(study_size: StudySize, allows_verdicts: bool) -> None:
    assert study_size.allows_verdicts is allows_verdicts
