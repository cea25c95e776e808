"""Measures of the paper's study: from the trials of a cell to a number for claims.

A cell is one kind of swarm. H is the paper's score of a trial, from 0 to 100.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from host_tools.studies.conftest import two_trials_with
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.cells import Cell, StudyPart
from mcp_asdf_tools.studies.study_results import StudyResults

pytestmark = pytest.mark.usefixtures("few_resamples")

CELL_WITH_FLAWED_ROBOTS = Cell(
    StudyPart.FULLY_CONNECTED,
    fill_ratio=0.95,
    true_accuracy=0.55,
    flawed_accuracy=0.95,
    flawed_percent=30,
    filter="asdf-plus",
)
CELL_WITHOUT_FLAWED_ROBOTS = CELL_WITH_FLAWED_ROBOTS.without_flawed_robots.normal


def trials_with_h(*h_of_trials: float) -> Trials:
    """Make a trial of four robots for each of these scores H, from 50 to 100.

    All robots of a trial converge at the same step, without an error. So h_e is 100, and as H is the mean of
    h_K and h_e, h_K is 2 H - 100. A trial that converges in its last step, 40,000, has an h_K of 0.
    """
    h_k_of_trials = 2 * np.array(h_of_trials) - 100
    convergence_steps = 40_000 * (1 - h_k_of_trials / 100)
    by_trial_and_robot = np.repeat(np.rint(convergence_steps)[:, np.newaxis], 4, axis=1).astype(np.int64)
    return replace(
        two_trials_with(robots=4, flawed=1, steps=40_000),
        convergence_steps=by_trial_and_robot,
        errors=np.zeros(by_trial_and_robot.shape),
    )


@pytest.mark.parametrize(("score", "median"), [("H", 65), ("h_K", 30), ("h_e", 100)])
def test_the_measure_of_a_score_is_its_median_over_the_trials(score: str, median: float) -> None:
    """H is the mean of h_K and h_e. These trials have no errors, so h_e is 100, and h_K is 2 H - 100."""
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials_with_h(75, 70, 65, 55, 50)})
    assert results.measure(CELL_WITH_FLAWED_ROBOTS, score).value == pytest.approx(median)


def test_the_measure_of_b_hat_is_the_mean_of_the_healthy_robots_after_the_last_filter_step() -> None:
    """The first of four robots is flawed. In the end the others assume 0.6, 0.8 and 0.7."""
    after_first_filter_step = [0.9, 0.9, 0.5, 0.5]
    after_last_filter_step = [0.1, 0.6, 0.8, 0.7]
    trials = two_trials_with(robots=4, flawed=1, b_hat=[after_first_filter_step, after_last_filter_step])
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials})

    mean_of_healthy_robots = (0.6 + 0.8 + 0.7) / 3
    assert results.measure(CELL_WITH_FLAWED_ROBOTS, "b_hat").value == pytest.approx(mean_of_healthy_robots)


def test_the_spread_of_h_is_its_interquartile_range() -> None:
    """Of five trials the second lowest H is the lower quartile, and the second highest the upper one."""
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials_with_h(75, 70, 65, 55, 50)})

    spread = results.measure(CELL_WITH_FLAWED_ROBOTS, "spread of H").value

    assert spread == pytest.approx(70 - 55)


def test_the_best_h_of_30_is_missed_by_all_of_30_trials_in_half_of_the_cases() -> None:
    """If one trial misses it with the probability q, 30 trials do so with q^30, which is to be 1/2."""
    h_of_trials = [75, 70, 65, 55, 50]
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials_with_h(*h_of_trials)})

    best = results.measure(CELL_WITH_FLAWED_ROBOTS, "best H of 30").value

    q = 0.5 ** (1 / 30)
    assert best == pytest.approx(np.quantile(h_of_trials, q))


def test_a_measure_that_is_asked_for_twice_is_computed_once() -> None:
    """Many claims compare the same swarm, and computing a measure with its resamples takes long."""
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials_with_h(75, 70)})

    first_answer = results.measure(CELL_WITH_FLAWED_ROBOTS, "H")
    second_answer = results.measure(CELL_WITH_FLAWED_ROBOTS, "H")

    assert second_answer is first_answer


def test_a_cell_without_flawed_robots_has_one_sample_whatever_accuracy_flawed_ones_would_assume() -> None:
    """Flawed robots may assume several accuracies. A swarm without flawed robots is run only once."""
    results = StudyResults({CELL_WITHOUT_FLAWED_ROBOTS: trials_with_h(100, 95)})
    cell_with_another_assumption = replace(CELL_WITHOUT_FLAWED_ROBOTS, flawed_accuracy=0.75)

    assert results.sample(cell_with_another_assumption, "H") == pytest.approx([100, 95])


def test_a_measure_of_a_cell_that_was_not_run_raises_a_key_error() -> None:
    """Only the cell with 30 % flawed robots has results."""
    results = StudyResults({CELL_WITH_FLAWED_ROBOTS: trials_with_h(75, 70)})
    cell_that_was_not_run = replace(CELL_WITH_FLAWED_ROBOTS, flawed_percent=50)

    with pytest.raises(KeyError):
        results.measure(cell_that_was_not_run, "H")


def test_results_have_the_parts_of_the_study_of_which_cells_were_run() -> None:
    """Both cells belong to the part with fully connected swarms, and none to the part with dynamic ones."""
    trials_with_flawed_robots = trials_with_h(75, 70)
    trials_without_flawed_robots = trials_with_h(100, 95)
    results = StudyResults(
        {
            CELL_WITH_FLAWED_ROBOTS: trials_with_flawed_robots,
            CELL_WITHOUT_FLAWED_ROBOTS: trials_without_flawed_robots,
        }
    )

    assert results.parts == [StudyPart.FULLY_CONNECTED]
    assert results.trials_of(StudyPart.FULLY_CONNECTED) == [
        trials_with_flawed_robots,
        trials_without_flawed_robots,
    ]
    assert results.trials_of(StudyPart.DYNAMIC) == []
