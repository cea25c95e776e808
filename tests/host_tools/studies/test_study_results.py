"""Measures of the paper's study: from the trials of a cell to a number for claims.

A cell is one kind of swarm. H is the paper's score of a trial, from 0 to 100.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from host_tools.studies.conftest import trials_with
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.cells import Cell, StudyPart
from mcp_asdf_tools.studies.study_results import StudyResults

pytestmark = pytest.mark.usefixtures("few_resamples")

FLAWED_CELL = Cell(
    StudyPart.FULLY_CONNECTED,
    fill_ratio=0.95,
    true_accuracy=0.55,
    flawed_accuracy=0.95,
    flawed_percent=30,
    filter="asdf-plus",
)
FLAWLESS_CELL = FLAWED_CELL.without_flawed_robots.normal


def trials_that_converge_at(*steps: int) -> Trials:
    """Make one trial of 40,000 steps per given step. All four robots of the trial converge at that step."""
    trials = trials_with(robots=4, flawed=1, steps=40_000)
    convergence_steps = np.repeat(np.array(steps)[:, np.newaxis], 4, axis=1)
    errors = np.zeros(convergence_steps.shape)
    return replace(trials, convergence_steps=convergence_steps, errors=errors)


FLAWED_TRIALS = trials_that_converge_at(20_000, 24_000, 28_000, 36_000, 40_000)
FLAWLESS_TRIALS = trials_that_converge_at(0, 4000, 8000, 12_000, 16_000)
RESULTS = StudyResults({FLAWED_CELL: FLAWED_TRIALS, FLAWLESS_CELL: FLAWLESS_TRIALS})


@pytest.mark.parametrize("score", ["H", "h_K", "h_e"])
def test_the_measure_of_a_score_is_its_median_over_the_trials(score: str) -> None:
    scores = FLAWED_TRIALS.scores()[score]
    assert RESULTS.measure(FLAWED_CELL, score).value == pytest.approx(np.median(scores))


def test_the_measure_of_b_hat_is_the_mean_of_the_healthy_robots_after_the_last_filter_step() -> None:
    """The first of four robots is flawed. In the end the others assume 0.6, 0.8 and 0.7."""
    after_two_filter_steps = [[0.9, 0.9, 0.5, 0.5], [0.1, 0.6, 0.8, 0.7]]
    results = StudyResults({FLAWED_CELL: trials_with(b_hat=after_two_filter_steps)})
    assert results.measure(FLAWED_CELL, "b_hat").value == pytest.approx(0.7)


def test_the_spread_of_h_is_its_interquartile_range() -> None:
    lower_quartile, upper_quartile = np.quantile(FLAWED_TRIALS.scores()["H"], [0.25, 0.75])
    spread = RESULTS.measure(FLAWED_CELL, "spread of H").value
    assert spread == pytest.approx(upper_quartile - lower_quartile)


def test_the_best_h_of_30_is_missed_by_all_of_30_trials_in_half_of_the_cases() -> None:
    """One trial misses it with the probability q, and 30 trials with q^30, which is 1/2."""
    q = 0.5 ** (1 / 30)
    best = RESULTS.measure(FLAWED_CELL, "best H of 30").value
    assert best == pytest.approx(np.quantile(FLAWED_TRIALS.scores()["H"], q))


def test_the_loss_of_h_is_the_median_h_of_the_same_swarm_without_flawed_robots_less_its_own() -> None:
    median_without_flawed_robots = np.median(FLAWLESS_TRIALS.scores()["H"])
    median_with_flawed_robots = np.median(FLAWED_TRIALS.scores()["H"])
    loss = RESULTS.measure(FLAWED_CELL, "loss of H").value
    assert loss == pytest.approx(median_without_flawed_robots - median_with_flawed_robots)


def test_a_measure_that_is_asked_for_twice_is_computed_once() -> None:
    assert RESULTS.measure(FLAWED_CELL, "H") is RESULTS.measure(FLAWED_CELL, "H")


def test_a_cell_without_flawed_robots_has_one_sample_whatever_accuracy_flawed_ones_would_assume() -> None:
    """Flawed robots may assume several accuracies. A swarm without flawed robots is run only once."""
    cell_with_another_assumption = replace(FLAWLESS_CELL, flawed_accuracy=0.75)
    h = RESULTS.sample(cell_with_another_assumption, "H")
    assert h.tolist() == RESULTS.sample(FLAWLESS_CELL, "H").tolist()


def test_a_measure_of_a_cell_that_was_not_run_raises_a_key_error() -> None:
    cell_that_was_not_run = replace(FLAWED_CELL, flawed_percent=50)
    with pytest.raises(KeyError):
        RESULTS.measure(cell_that_was_not_run, "H")


def test_results_have_the_parts_of_the_study_of_which_cells_were_run() -> None:
    assert RESULTS.parts == [StudyPart.FULLY_CONNECTED]
    assert RESULTS.trials_of(StudyPart.FULLY_CONNECTED) == [FLAWED_TRIALS, FLAWLESS_TRIALS]
    assert RESULTS.trials_of(StudyPart.DYNAMIC) == []


def test_the_largest_difference_between_robots_of_a_trial_is_0_if_all_are_alike() -> None:
    differences = RESULTS.largest_differences_between_robots(StudyPart.FULLY_CONNECTED)
    assert differences == {"K": 0, "e": 0}  # convergence step, and error at that step
