"""Scores in the moving world have the distributions of the authors' physics simulation, and of float64.

A short version of tests/benchmarks/fidelity.py; the fully connected study is in test_scores.py.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from benchmarks import fidelity
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.robots.population import Filtering
from mcp_asdf_tools.world.arena import Arena
from support import slow

CELLS = fidelity.read_cells(seed=1, path=fidelity.PHYSICS)
FEW = 10
REPLAY = f"replay: python {fidelity.__file__} dynamic native --trials {FEW}"


def by_authors(experiment: Experiment) -> Experiment:
    return fidelity.by_reference(experiment, "authors")


def cell_of(mode: Filtering, true_accuracy: float, fill_ratio: float) -> fidelity.Cell:
    (found,) = [
        cell
        for cell in CELLS
        if (cell.experiment.filter, cell.experiment.true_accuracy, cell.experiment.fill_ratio)
        == (mode, true_accuracy, fill_ratio)
        and cell.experiment.flawed > 0
    ]
    return found


def test_the_reference_is_whole() -> None:
    assert sorted(len(cell.scores) for cell in CELLS) == [12] * 3 + [30] * 8
    for cell in CELLS:
        assert cell.experiment.sides == pytest.approx((5.5486, 5.5486), abs=1e-4)


def test_the_authors_conventions_have_the_scores_of_their_simulation() -> None:
    """One configuration of those that have thirty trials there."""
    compare_with_authors([next(cell for cell in CELLS if len(cell.scores) == 30)])


@pytest.mark.slow
def test_the_authors_conventions_have_all_scores_of_their_simulation() -> None:
    """Half of the configurations that have thirty trials there."""
    cells = [cell for cell in CELLS if len(cell.scores) == 30][::2]
    assert {cell.experiment.filter for cell in cells} == set(get_args(Filtering))
    compare_with_authors(cells)


def compare_with_authors(cells: list[fidelity.Cell]) -> None:
    authors = [replace(cell, experiment=by_authors(cell.experiment)) for cell in cells]
    corrected = fidelity.holm(np.ravel(fidelity.compare(authors, FEW)).tolist())
    assert min(corrected) >= fidelity.LEVEL, REPLAY


@pytest.mark.parametrize("change", [{"filter": "none"}, *slow([{"true_accuracy": 0.65}, {"flawed": 20}])])
def test_the_comparison_notices_another_experiment(change: dict[str, float | Filtering]) -> None:
    cell = cell_of("asdf-plus", 0.95, 0.55)
    other = by_authors(replace(cell.experiment, **change))  # type: ignore[arg-type]
    assert min(fidelity.p_values(fidelity.simulate(other, 6), cell.scores)) < 1e-4


@pytest.mark.parametrize("moving", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_native_has_the_scores_of_float64(moving: bool) -> None:
    cell = cell_of("asdf-plus", 0.95, 0.55) if moving else fidelity.read_cells()[0]
    native = fidelity.simulate(cell.experiment, 40)
    other = fidelity.by_reference(replace(cell.experiment, seed=1001))
    assert min(fidelity.p_values(native, fidelity.simulate(other, FEW))) > fidelity.LEVEL / 3


def test_degrees_of_trials_are_those_of_the_simulation() -> None:
    """The mean degree of each trial is in the reference, too."""
    with fidelity.PHYSICS.open(encoding="utf-8", newline="") as file:
        theirs = [float(degree) for row in csv.DictReader(file) for degree in row["mean_degree"].split()]
    experiment = CELLS[0].experiment
    ours = [mean_degree(experiment, trial) for trial in range(8)]
    error = np.hypot(np.std(ours) / len(ours) ** 0.5, np.std(theirs) / len(theirs) ** 0.5)
    assert abs(np.mean(ours) - np.mean(theirs)) < 4 * error


def mean_degree(experiment: Experiment, trial: int) -> float:
    arena, links = Arena(experiment, trial), 0
    for _ in range(400):
        arena.step(100)
        links += len(arena.links)
    return 2 * links / (400 * experiment.robots)
