"""Results of trials: convergence steps, errors and records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import DELTA, convergence_step

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""Recorded values of a robot, named as the attributes of ``Robot``."""


@dataclass(frozen=True)
class Measured:
    """Results of trials ``first`` .. of an experiment; the first axis is the trial.

    Attributes:
        first: Number of the first trial.
        convergence_steps: K of each robot, shape (trials, N).
        errors: e of each robot, shape (trials, N).
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        tests: Hypothesis tests run by each robot, shape (trials, N), modulo 65536, as ``updates``.
        updates: Re-estimates of b_hat by each robot, shape (trials, N).
        records: Values of QUANTITIES once per ``sampling_interval`` steps, from step 0 on, shape (quantities,
            trials, T // sampling_interval + 1, N); no rows without recording.
    """

    first: int
    convergence_steps: NDArray[np.int64]
    errors: NDArray[np.float64]
    b_hat: NDArray[np.float64]
    tests: NDArray[np.int64]
    updates: NDArray[np.int64]
    records: NDArray[np.float64]


def measure(
    series: NDArray[np.uint32] | NDArray[np.float64], unit: float, fill_ratio: float
) -> tuple[int, float]:
    """K and e of one series of informed estimates, given in units of ``unit``."""
    step = convergence_step(series, DELTA / unit)
    return step, abs(float(series[step]) * unit - fill_ratio)


def measured_trial(
    experiment: Experiment,
    trial: int,
    x: NDArray[np.float64],
    b_hat: NDArray[np.float64],
    counts: Sequence[NDArray[np.int64]],
) -> Measured:
    """One trial from its series of x, shape (N, T + 1)."""
    pairs = [measure(series, 1.0, experiment.fill_ratio) for series in x]
    return Measured(
        trial,
        np.array([[step for step, _ in pairs]]),
        np.array([[error for _, error in pairs]]),
        b_hat.reshape(1, -1, experiment.robots),
        counts[0].reshape(1, -1),
        counts[1].reshape(1, -1),
        np.empty((len(QUANTITIES), 1, 0, experiment.robots)),
    )
