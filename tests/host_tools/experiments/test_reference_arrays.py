"""The reference in arrays against ``ReferenceRobot`` run message by message."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from mcp_asdf_tools.experiments import reference_arrays
from mcp_asdf_tools.experiments.experiment import Convention, Experiment
from mcp_asdf_tools.experiments.trials import _run_by_message as run_by_message
from mcp_asdf_tools.experiments.trials import run_trials

FULL = Experiment(
    firmware="reference", robots=6, flawed=2, fill_ratio=0.7, steps=420, filter_period=60, seed=5
)
MOVING = replace(FULL, topology="dynamic", robots=7, density=3.0)

CASES: dict[str, dict[str, Any]] = {
    "one robot": {"robots": 1, "flawed": 1},
    "only flawed": {"filter": "asdf-minus"},
    "uninformative": {"flawed_accuracy": 0.5},
    "only black": {"fill_ratio": 1.0, "true_accuracy": 1.0},
    "only white": {"fill_ratio": 0.0, "true_accuracy": 1.0},
    "inverted": {"true_accuracy": 0.1, "flawed_accuracy": 0.3},
    "longer than an array": {"robots": 2, "flawed": 1, "steps": 2600, "filter_period": 2500},
    "filter every step": {"filter_period": 1, "steps": 60},
    "rare observations": {"observation_period": 7},
    "no observation": {"observation_period": 500},
    "drift": {"drift": "wiener", "drift_diffusion": 0.01},
}


def assert_same(experiment: Experiment) -> int:
    """Returns the number of updates."""
    own_x, b_hat, tests, updates = reference_arrays.run(experiment, 1)
    robots = run_by_message(experiment, 1, 1)
    replay = f"replay: {experiment.parameters()}"
    assert np.array_equal(b_hat, robots.b_hat[0]), replay
    assert np.array_equal(tests, robots.tests[0]), replay
    assert np.array_equal(updates, robots.updates[0]), replay
    assert np.abs(own_x - robots.records["x"][0].T).max() < 1e-14, replay
    return int(updates.sum())


@pytest.mark.parametrize("name", CASES)
def test_arrays_equal_the_robots(name: str) -> None:
    assert_same(replace(FULL, **CASES[name]))
    assert_same(replace(MOVING, **CASES[name], latency=1, conventions="authors"))


def test_arrays_equal_the_robots_in_random_experiments() -> None:
    source, updates = random.Random(417), []
    for _ in range(20):
        changes: dict[str, Any] = {
            "fill_ratio": source.choice([0.05, 0.5, 0.55, 0.95]),
            "true_accuracy": source.choice([0.55, 0.75, 0.95]),
            "flawed_accuracy": source.choice([0.5, 0.55, 0.95, source.random()]),
            "conventions": source.choice(get_args(Convention)),
            "activation": source.choice(["adaptive", "adaptive", "always"]),
            "omega": source.choice(["0.05", "0.5"]),
            "filter_period": source.choice([7, 20, 100]),
            "steps": source.randint(1, 250),
            "seed": source.getrandbits(64),
        }
        updates.append(
            assert_same(replace(source.choice([FULL, MOVING, replace(MOVING, latency=1)]), **changes))
        )
    assert sum(count > 0 for count in updates) > 10, "otherwise nothing was tested"


def test_the_reference_runs_in_arrays_where_it_can() -> None:
    own, other = run_trials(MOVING, 1, 1), run_by_message(MOVING, 1, 0)
    assert np.array_equal(own.b_hat, other.b_hat)
    assert np.array_equal(own.convergence_steps, other.convergence_steps)
    assert np.allclose(own.errors, other.errors, rtol=0, atol=1e-14)
    for experiment in (replace(MOVING, comms_period=5), replace(MOVING, memory=64)):
        assert not reference_arrays.can_run(experiment)
        assert np.array_equal(run_trials(experiment, 0, 1).b_hat, run_by_message(experiment, 0, 0).b_hat)
