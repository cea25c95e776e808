"""Scores have the distributions of an independent float64 program and of the authors' physics simulation.

A short version of tests/benchmarks/fidelity.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import fidelity
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import score

CONNECTED, PHYSICS = fidelity.read_cells(), fidelity.read_cells(fidelity.PHYSICS)


def smallest_p_value(cells: list[fidelity.Cell], trials: int) -> float:
    """Return the least probability of so large a difference by chance, over all scores of experiments.

    Each experiment is simulated with so many trials, whose scores are compared with those in its cell. The
    probability is corrected for the number of comparisons, by Holm's method.
    """
    p_values = [fidelity.p_values(fidelity.simulate(cell.experiment, trials), cell.scores) for cell in cells]
    return fidelity.smallest(p_values)


def test_the_stored_scores_of_the_float64_program_are_of_46_experiments_with_30_trials() -> None:
    assert [len(cell.scores) for cell in CONNECTED] == [30] * 46


def test_the_stored_scores_of_the_float64_program_follow_our_definition_of_scores() -> None:
    """All its robots have one estimate, so quartiles do not differ, and h_K and h_e give the step and error.

    Their limits are 40,000 steps and 0.45. Scores are computed again from step and error of ten equal robots.
    """
    for cell in CONNECTED:
        h_k, h_e, h = cell.scores.transpose()
        steps = np.rint(40_000 * (1 - h_k / 100))
        errors = 0.45 * (1 - h_e / 100)
        steps_of_robots, errors_of_robots = np.stack([steps] * 10, axis=1), np.stack([errors] * 10, axis=1)
        scores = score(steps_of_robots, errors_of_robots, k_max=40_000, e_max=0.45)

        assert scores["h_K"] == pytest.approx(h_k, abs=1e-5)
        assert scores["H"] == pytest.approx(h, abs=1e-5)


def test_the_stored_scores_of_the_authors_simulation_are_of_11_experiments_with_three_filters() -> None:
    """Three of them have 12 trials, the others 30."""
    assert sorted(len(cell.scores) for cell in PHYSICS) == [12] * 3 + [30] * 8
    assert {cell.experiment.filter for cell in PHYSICS} == {"none", "asdf-minus", "asdf-plus"}


def test_experiments_compared_with_the_authors_simulation_have_its_square_of_5_5486_m() -> None:
    for cell in PHYSICS:
        assert cell.experiment.sides == pytest.approx((5.5486, 5.5486), abs=1e-4)


@pytest.mark.slow
def test_scores_of_simulate_have_the_distribution_of_those_of_an_independent_float64_program() -> None:
    assert smallest_p_value(CONNECTED, trials=32) >= fidelity.LEVEL


@pytest.mark.slow
def test_scores_of_simulate_have_the_distribution_of_those_of_the_authors_simulation() -> None:
    assert smallest_p_value(PHYSICS, trials=20) >= fidelity.LEVEL


@pytest.fixture(scope="module")
def overconfident_cell() -> fidelity.Cell:
    """The scores of the float64 program for 10 robots, half of which assume 0.95 where 0.55 is true."""
    wanted = Experiment(
        robots=10,
        steps=40_000,
        filter="asdf-minus",
        fill_ratio=0.95,
        true_accuracy=0.55,
        flawed=5,
        flawed_accuracy=0.95,
    )
    (cell,) = [cell for cell in CONNECTED if cell.experiment == wanted]
    return cell


def test_scores_of_simulate_have_the_distribution_of_those_that_are_stored_of_one_experiment(
    overconfident_cell: fidelity.Cell,
) -> None:
    assert smallest_p_value([overconfident_cell], trials=48) >= fidelity.LEVEL


@pytest.mark.parametrize("change", [{"true_accuracy": 0.75}, {"filter_period": 2000}, {"flawed": 1}])
def test_the_comparison_of_scores_notices_an_experiment_with_another_parameter(
    change: dict[str, Any], overconfident_cell: fidelity.Cell
) -> None:
    """The probability that scores of such an experiment have the stored distribution is below 1 in 10,000."""
    scores = fidelity.simulate(replace(overconfident_cell.experiment, **change), trials=48)
    assert min(fidelity.p_values(scores, overconfident_cell.scores)) < 1e-4
