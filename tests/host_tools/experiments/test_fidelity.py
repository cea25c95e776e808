"""Scores have the distributions of an independent float64 program and of the authors' physics simulation.

A short version of tests/benchmarks/fidelity.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks import fidelity
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.metrics import score

FLOAT64_EXPERIMENTS = fidelity.read_stored_experiments()
AUTHORS_EXPERIMENTS = fidelity.read_stored_experiments(fidelity.PHYSICS)


def smallest_p_value_of_simulated_scores(
    stored_experiments: list[fidelity.StoredExperiment], trials: int
) -> float:
    """Return the least probability of so large a difference by chance, over all scores of experiments.

    Each experiment is simulated with so many trials. Their scores are compared with the stored scores. The
    probability is corrected for the number of comparisons, by Holm's method.
    """
    p_values = [
        fidelity.p_values(fidelity.simulate(stored.experiment, trials), stored.scores)
        for stored in stored_experiments
    ]
    return fidelity.smallest(p_values)


def test_the_stored_scores_of_the_float64_program_follow_our_definition_of_scores() -> None:
    """All ten robots have the same estimate, so their quartiles are equal, and h_K is 100 (1 - K / 40,000).

    K is the step of convergence. Likewise h_e is 100 (1 - e / 0.45), where e is the error in that step. So K
    and e of each trial follow from its stored scores, which are then computed again.
    """
    for stored in FLOAT64_EXPERIMENTS:
        for h_k, h_e, h in stored.scores:  # of each trial
            step = round(40_000 * (1 - h_k / 100))
            error = 0.45 * (1 - h_e / 100)
            steps_of_robots = [step] * 10
            errors_of_robots = [error] * 10
            # The function takes lists of trials, here of one, and returns lists.
            scores = score([steps_of_robots], [errors_of_robots], k_max=40_000, e_max=0.45)
            assert scores["h_K"] == pytest.approx([h_k], abs=1e-5)
            assert scores["H"] == pytest.approx([h], abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stored_experiments", "trials"),
    [(FLOAT64_EXPERIMENTS, 32), (AUTHORS_EXPERIMENTS, 20)],
    ids=["float64 program", "authors' simulation"],
)
def test_scores_of_simulate_have_the_distribution_of_those_of_independent_programs(
    stored_experiments: list[fidelity.StoredExperiment], trials: int
) -> None:
    """Programs of others made the stored scores; trials of the same experiments are simulated here.

    If the distribution is the same, a difference as large as the largest has a probability of at least 1 %.
    """
    assert smallest_p_value_of_simulated_scores(stored_experiments, trials) >= 0.01


@pytest.fixture(scope="module")
def overconfident_experiment() -> fidelity.StoredExperiment:
    """Scores of the float64 program for 10 robots. Five robots assume 0.95, and 0.55 is true."""
    overconfident = Experiment(
        robots=10,
        steps=40_000,
        filter="asdf-minus",
        fill_ratio=0.95,
        true_accuracy=0.55,
        flawed=5,
        flawed_accuracy=0.95,
    )
    (stored_experiment,) = [stored for stored in FLOAT64_EXPERIMENTS if stored.experiment == overconfident]
    return stored_experiment


def test_scores_of_simulate_have_the_distribution_of_those_that_are_stored_of_one_experiment(
    overconfident_experiment: fidelity.StoredExperiment,
) -> None:
    """This is the quick version of the test before: one experiment in place of all.

    Its robots are overconfident. A difference as large as the largest one has a probability of at least 1 %.
    """
    assert smallest_p_value_of_simulated_scores([overconfident_experiment], trials=48) >= 0.01


@pytest.mark.parametrize(
    "changed_parameter", [{"true_accuracy": 0.75}, {"filter_period": 2000}, {"flawed": 1}]
)
def test_the_comparison_of_scores_notices_an_experiment_with_another_parameter(
    changed_parameter: dict[str, Any], overconfident_experiment: fidelity.StoredExperiment
) -> None:
    """The probability that scores of such an experiment have the stored distribution is below 1 in 10,000."""
    other_experiment = replace(overconfident_experiment.experiment, **changed_parameter)
    other_scores = fidelity.simulate(other_experiment, trials=48)
    p_values = fidelity.p_values(other_scores, overconfident_experiment.scores)
    assert min(p_values) < 0.0001
