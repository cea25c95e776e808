"""What the sensors of an experiment do: the probability of observing black, by step and robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri  # type: ignore[import-untyped]

from mcp_asdf_tools.experiments.experiment import Drift, Experiment
from mcp_asdf_tools.world.philox import CERTAIN, uniforms


def true_accuracies(experiment: Experiment, trial: int) -> NDArray[np.float64]:
    """The true accuracy b, shape (steps or 1, robots or 1): an axis is 1 long where nothing changes along it.

    O(steps) or, for a Wiener process, O(steps robots).
    """
    step = np.arange(experiment.steps, dtype=np.float64)[:, np.newaxis]
    if experiment.drift is Drift.NONE:
        return np.full((1, 1), experiment.true_accuracy)
    if experiment.drift is Drift.STEPPED:
        step -= step % experiment.drift_period
    path = experiment.true_accuracy + experiment.drift_rate * step
    if experiment.drift is Drift.WIENER:
        path = path + experiment.drift_diffusion * _wiener(experiment, trial)
    return np.clip(path, experiment.lowest_accuracy, 1.0)


def black_probabilities(experiment: Experiment, trial: int) -> NDArray[np.uint32]:
    """p(z = 1) = f b + (1 - f)(1 - b) (eq. 1) in units of 2**-31; shape as ``true_accuracies``.

    Where robots move it is that on a black floor, f = 1; on a white floor a robot observes white with it.
    """
    b, f = true_accuracies(experiment, trial), 1.0 if experiment.is_dynamic else experiment.fill_ratio
    return np.rint((f * b + (1 - f) * (1 - b)) * CERTAIN).astype(np.uint32)


def _wiener(experiment: Experiment, trial: int) -> NDArray[np.float64]:
    """Standard Wiener processes from 0, shape (steps, robots)."""
    moves = ndtri(uniforms(experiment.seed, trial, experiment.robots, experiment.steps))
    moves[0] = 0.0
    paths: NDArray[np.float64] = np.cumsum(moves, axis=0)
    return paths
