"""Measures of the paper's study: from the trials of a cell to a number for claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies.cells import Cell, StudyPart, StudySize, experiment_of
from mcp_asdf_tools.studies.study_results import StudyResults

pytestmark = pytest.mark.usefixtures("few_resamples")

FLAWED_CELL = Cell(StudyPart.FULLY_CONNECTED, 0.95, 0.55, 0.95, 30, "asdf-plus")
FLAWLESS_CELL = FLAWED_CELL.without_flawed_robots.normal
SHORT = StudySize(trials=6, steps=4000)


@pytest.fixture(scope="module")
def trials() -> dict[Cell, Trials]:
    """Run six short trials with and without flawed robots."""
    return {cell: run_trials(experiment_of(cell, SHORT), 0, 6) for cell in (FLAWED_CELL, FLAWLESS_CELL)}


def test_a_measure_of_a_score_is_the_median_over_the_trials(trials: dict[Cell, Trials]) -> None:
    for name, scores in trials[FLAWED_CELL].scores().items():
        assert StudyResults(trials).measure(FLAWED_CELL, name).value == pytest.approx(np.median(scores))


def test_the_measure_of_b_hat_is_that_of_the_healthy_robots_at_the_end(trials: dict[Cell, Trials]) -> None:
    final_b_hat = trials[FLAWED_CELL].b_hat[:, -1, 3:].mean(axis=1)
    measured = StudyResults(trials).measure(FLAWED_CELL, "b_hat").value
    assert measured == pytest.approx(np.median(final_b_hat))


def test_the_spread_of_h_is_its_interquartile_range(trials: dict[Cell, Trials]) -> None:
    lower, upper = np.quantile(trials[FLAWED_CELL].scores()["H"], [0.25, 0.75])
    measured = StudyResults(trials).measure(FLAWED_CELL, "spread of H").value
    assert measured == pytest.approx(upper - lower)


def test_the_best_h_of_30_is_missed_by_all_of_30_trials_in_half_of_the_cases(
    trials: dict[Cell, Trials],
) -> None:
    best = StudyResults(trials).measure(FLAWED_CELL, "best H of 30").value
    assert best == pytest.approx(np.quantile(trials[FLAWED_CELL].scores()["H"], 0.5 ** (1 / 30)))


def test_the_loss_of_h_is_against_the_same_swarm_without_flawed_robots(trials: dict[Cell, Trials]) -> None:
    flawless, flawed = (np.median(trials[cell].scores()["H"]) for cell in (FLAWLESS_CELL, FLAWED_CELL))
    measured = StudyResults(trials).measure(FLAWED_CELL, "loss of H").value
    assert measured == pytest.approx(flawless - flawed)


def test_a_measure_is_computed_once(trials: dict[Cell, Trials]) -> None:
    results = StudyResults(trials)
    assert results.measure(FLAWED_CELL, "H") is results.measure(FLAWED_CELL, "H")


def test_results_of_an_experiment_are_found_by_any_of_its_names(trials: dict[Cell, Trials]) -> None:
    """Without flawed robots, what these would assume makes no difference."""
    other_name = replace(FLAWLESS_CELL, flawed_accuracy=0.75)
    results = StudyResults(trials)
    assert results.sample(other_name, "H").tolist() == results.sample(FLAWLESS_CELL, "H").tolist()


def test_results_of_an_experiment_that_was_not_run_are_a_key_error(trials: dict[Cell, Trials]) -> None:
    with pytest.raises(KeyError):
        StudyResults(trials).measure(replace(FLAWED_CELL, flawed_percent=50), "H")


def test_parts_are_those_of_the_cells(trials: dict[Cell, Trials]) -> None:
    results = StudyResults(trials)
    assert results.parts == [StudyPart.FULLY_CONNECTED]
    assert results.trials_of(StudyPart.FULLY_CONNECTED) == list(trials.values())
    assert results.trials_of(StudyPart.DYNAMIC) == []


def test_robots_of_a_connected_swarm_do_not_differ(trials: dict[Cell, Trials]) -> None:
    differences = StudyResults(trials).largest_differences_between_robots(StudyPart.FULLY_CONNECTED)
    assert differences == {"K": 0, "e": 0}
