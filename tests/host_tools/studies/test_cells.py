"""The paper's experiments as cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.cells import Cell, Part, StudySize, cells_of, experiment_of

ASDF_MINUS_CELL = Cell(Part.DYNAMIC, 0.55, 0.95, 0.55, 50, "asdf-minus", 2000)


def first_experiment(part: Part) -> Experiment:
    return experiment_of(cells_of(part)[0], StudySize())


@pytest.mark.parametrize(
    ("part", "count"),
    [
        # for each f and b: 4 without flawed robots, 2 x 3 x 7 partly flawed, 2 x 4 entirely flawed
        (Part.FULLY_CONNECTED, 4 * (4 + 42 + 8)),
        (Part.DYNAMIC, 4 * (4 + 42 + 8)),
        (Part.PHYSICAL, 2 + 3 * 3 * 2),
    ],
)
def test_the_study_has_each_experiment_of_the_paper_once(part: Part, count: int) -> None:
    experiments = {experiment_of(cell, StudySize()) for cell in cells_of(part)}
    assert len(cells_of(part)) == len(experiments) == count


@pytest.mark.parametrize("part", Part)
def test_cells_of_the_study_are_normal(part: Part) -> None:
    assert all(cell.normal == cell for cell in cells_of(part))


@pytest.mark.parametrize(
    ("part", "robots", "steps"),
    [(Part.FULLY_CONNECTED, 10, 40_000), (Part.DYNAMIC, 20, 40_000), (Part.PHYSICAL, 8, 10_000)],
)
def test_swarms_are_as_large_and_trials_as_long_as_the_papers(part: Part, robots: int, steps: int) -> None:
    experiment = first_experiment(part)
    assert (experiment.robots, experiment.steps, experiment.trials) == (robots, steps, 30)


def test_the_dynamic_swarm_has_density_1() -> None:
    assert first_experiment(Part.DYNAMIC).sides[0] == pytest.approx(0.7 * np.sqrt(20 * np.pi))


def test_the_physical_experiment_has_the_papers_platform_and_rates() -> None:
    experiment = first_experiment(Part.PHYSICAL)
    assert (experiment.sides, experiment.floor, experiment.speed) == ((3.0353, 3.0226), "code", 0.1)
    assert experiment.steps_per_second / experiment.observation_period == 2


def test_the_physical_robots_see_perfectly() -> None:
    cells = cells_of(Part.PHYSICAL)
    assert {(cell.fill_ratio, cell.true_accuracy) for cell in cells} == {(0.448, 1.0)}
    assert {experiment_of(cell, StudySize()).flawed for cell in cells} == {0, 2, 4, 8}


def test_without_flawed_robots_asdf_minus_is_no_filter() -> None:
    cell = replace(ASDF_MINUS_CELL, flawed_percent=0)
    assert cell.normal == Cell(Part.DYNAMIC, 0.55, 0.95, 0.95, 0, "none", 1000)


def test_with_flawed_robots_alone_asdf_minus_is_asdf_plus() -> None:
    cell = replace(ASDF_MINUS_CELL, flawed_percent=100)
    assert cell.normal == replace(cell, filter="asdf-plus")


def test_a_partly_flawed_swarm_with_a_filter_stays_as_it_is() -> None:
    assert ASDF_MINUS_CELL.normal == ASDF_MINUS_CELL


def test_a_size_shortens_trials_but_never_lengthens_them() -> None:
    physical = cells_of(Part.PHYSICAL)[0]
    assert experiment_of(physical, StudySize(steps=4000)).steps == 4000
    assert experiment_of(physical, StudySize(steps=40_000)).steps == 10_000


@pytest.mark.parametrize(
    ("size", "allows_verdicts"),
    [
        (StudySize(30, 40_000), True),
        (StudySize(29, 40_000), False),
        (StudySize(30, 39_999), False),
    ],
)
def test_verdicts_need_the_papers_trials_and_steps(size: StudySize, allows_verdicts: bool) -> None:
    assert size.allows_verdicts is allows_verdicts
