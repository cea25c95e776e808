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


def assert_alike(cells: list[fidelity.Cell], trials: int) -> None:
    values = [fidelity.p_values(fidelity.simulate(cell.experiment, trials), cell.scores) for cell in cells]
    assert fidelity.smallest(values) >= fidelity.LEVEL


def test_the_float64_program_has_30_trials_of_each_of_46_experiments() -> None:
    assert [len(cell.scores) for cell in CONNECTED] == [30] * 46


def test_scores_of_the_float64_program_follow_from_steps_and_errors_as_here() -> None:
    """All its robots have one estimate, so step and error follow from h_K and h_e, and give H again."""
    for cell in CONNECTED:
        h_k, h_e, h = cell.scores.T
        steps, errors = np.rint(40_000 * (1 - h_k / 100)), 0.45 * (1 - h_e / 100)
        # Trials by robots, of which there are ten alike.
        own = score(np.repeat(steps[:, None], 10, 1), np.repeat(errors[:, None], 10, 1), 40_000, 0.45)

        assert own["h_K"] == pytest.approx(h_k, abs=1e-5)
        assert own["H"] == pytest.approx(h, abs=1e-5)


def test_the_authors_simulation_has_its_trials_of_each_of_11_experiments() -> None:
    assert sorted(len(cell.scores) for cell in PHYSICS) == [12] * 3 + [30] * 8
    assert {cell.experiment.filter for cell in PHYSICS} == {"none", "asdf-minus", "asdf-plus"}


def test_experiments_compared_with_the_authors_simulation_have_its_arena() -> None:
    """A square of 5.5486 m."""
    for cell in PHYSICS:
        assert cell.experiment.sides == pytest.approx((5.5486, 5.5486), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
def test_scores_here_have_the_distribution_of_an_independent_float64_program(every: int) -> None:
    assert_alike(CONNECTED[::every], trials=32)


@pytest.mark.slow
@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
def test_scores_here_have_the_distribution_of_the_authors_simulation(every: int) -> None:
    assert_alike(PHYSICS[1::every], trials=20)


@pytest.mark.parametrize("change", [{"true_accuracy": 0.75}, {"filter_period": 2000}, {"flawed": 1}])
def test_the_comparison_notices_another_experiment(change: dict[str, Any]) -> None:
    wanted = replace(
        Experiment(robots=10, steps=40_000, filter="asdf-minus"),
        **{"fill_ratio": 0.95, "true_accuracy": 0.55, "flawed": 5, "flawed_accuracy": 0.95},  # type: ignore[arg-type]
    )
    (cell,) = [cell for cell in CONNECTED if cell.experiment == wanted]
    other = replace(cell.experiment, **change)

    assert min(fidelity.p_values(fidelity.simulate(other, trials=64), cell.scores)) < 1e-4
