"""The reference in arrays against ``ReferenceRobot`` run message by message."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal
from typing import get_args

import numpy as np
import pytest

from mcp_asdf_tools.experiments import reference_arrays
from mcp_asdf_tools.experiments.experiment import Convention, Experiment
from mcp_asdf_tools.experiments.trials import _run_by_message as run_by_message
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Activation

FULL = Experiment(
    firmware="reference", robots=6, flawed=2, fill_ratio=0.7, steps=420, filter_period=60, seed=5
)
MOVING = replace(FULL, topology="dynamic", robots=7, density=3.0)
AUTHORS: Convention = "authors"

CASES = {
    "fully connected": FULL,
    "authors": replace(FULL, conventions=AUTHORS),
    "without a test": replace(FULL, activation="always"),
    "authors without a test": replace(FULL, conventions=AUTHORS, activation="always"),
    "only flawed": replace(FULL, filter="asdf-minus"),
    "one robot": replace(FULL, robots=1, flawed=1),
    "uninformative": replace(FULL, flawed_accuracy=0.5),
    "uninformative to the authors": replace(FULL, flawed_accuracy=0.5, conventions=AUTHORS),
    "only black": replace(FULL, fill_ratio=1.0, true_accuracy=1.0),
    "only white": replace(FULL, fill_ratio=0.0, true_accuracy=1.0, conventions=AUTHORS),
    "inverted": replace(FULL, true_accuracy=0.1, flawed_accuracy=0.3),
    "longer than an array": replace(FULL, robots=2, flawed=1, steps=2600, filter_period=2500),
    "filter every step": replace(FULL, filter_period=1, steps=60),
    "moving": MOVING,
    "moving, late": replace(MOVING, latency=1),
    "moving, late, authors": replace(MOVING, latency=1, conventions=AUTHORS),
    "moving, rare observations": replace(MOVING, latency=1, observation_period=7),
    "moving, no observation": replace(MOVING, observation_period=500),
    "moving on a code": replace(MOVING, floor="code", fill_ratio=0.448, observation_period=5),
    "moving, drift": replace(MOVING, drift="wiener", drift_diffusion=0.01),
}


def random_cases(seed: int, count: int) -> Iterator[Experiment]:
    source = random.Random(seed)
    for _ in range(count):
        yield replace(
            source.choice([FULL, MOVING, replace(MOVING, latency=1)]),
            fill_ratio=source.choice([0.05, 0.5, 0.55, 0.95]),
            true_accuracy=source.choice([0.55, 0.75, 0.95]),
            flawed_accuracy=source.choice([0.5, 0.55, 0.95, source.random()]),
            conventions=source.choice(list(get_args(Convention))),
            activation=source.choice(list(get_args(Activation))),
            omega=Decimal(source.choice(["0.05", "0.5"])),
            filter_period=source.choice([7, 20, 100]),
            steps=source.randint(1, 250),
            seed=source.getrandbits(64),
        )


def assert_same(experiment: Experiment) -> int:
    """Returns the number of updates."""
    own_x, b_hat, tests, updates = reference_arrays.run(experiment, 1)
    robots = run_by_message(experiment, 1, 1)
    replay = f"replay: {experiment.parameters()}"
    assert np.array_equal(b_hat, robots.b_hat[0]), replay
    assert np.array_equal(tests, robots.tests[0]), replay
    assert np.array_equal(updates, robots.updates[0]), replay
    x = robots.records["x"][0].T
    assert np.abs(own_x - x).max() < 1e-14, replay
    return int(updates.sum())


@pytest.mark.parametrize("name", CASES)
def test_arrays_equal_the_robots(name: str) -> None:
    assert_same(CASES[name])


def test_arrays_equal_the_robots_in_random_experiments() -> None:
    updates = [assert_same(experiment) for experiment in random_cases(417, 20)]
    assert sum(count > 0 for count in updates) > 10, "otherwise nothing was tested"


def test_the_reference_runs_in_arrays_where_it_can() -> None:
    own, other = run_trials(MOVING, 1, 1), run_by_message(MOVING, 1, 0)
    assert np.array_equal(own.b_hat, other.b_hat)
    assert np.array_equal(own.convergence_steps, other.convergence_steps)
    assert np.allclose(own.errors, other.errors, rtol=0, atol=1e-14)
    for experiment in (replace(MOVING, comms_period=5), replace(MOVING, memory=64)):
        assert not reference_arrays.can_run(experiment)
        assert np.array_equal(run_trials(experiment, 0, 1).b_hat, run_by_message(experiment, 0, 0).b_hat)
