"""The paper's metrics: convergence step K, absolute error e, and the scores h_K, h_e and H of a trial.

Section "Metrics" of the paper and its equations of the separate, the scaled and the overall score.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment

DELTA = 0.01
"""Error bound within which an estimate has converged."""

E_MAX = 0.45
"""e_max of all the paper's figures."""

_CHUNK = 1024


def convergence_step(series: NDArray[np.uint32] | NDArray[np.float64], delta: float = DELTA) -> int:
    """K: the first step from which on the series stays within ``delta`` of its value there.

    The least K with abs(x[K] - x[k]) < delta for all k >= K; the last step always is one. ``series`` is the
    informed estimate of steps 0 .. T, in any unit that ``delta`` has too. NaN settles at the last step at the
    earliest.

    One scan from the end with the extremes so far, by chunks first: where those after a chunk are 2 delta
    apart, no step in it can be near both. O(T), with constant extra memory.
    """
    starts = np.arange(0, len(series), _CHUNK)
    lows = np.append(_from_the_end(np.minimum, np.minimum.reduceat(series, starts)), series[-1])
    highs = np.append(_from_the_end(np.maximum, np.maximum.reduceat(series, starts)), series[-1])
    for index in np.flatnonzero(highs[1:] - lows[1:] < 2 * delta):
        chunk = series[starts[index] : starts[index] + _CHUNK]
        below = chunk - _from_the_end(np.minimum, np.minimum(chunk, lows[index + 1]))
        above = _from_the_end(np.maximum, np.maximum(chunk, highs[index + 1])) - chunk
        near = (below < delta) & (above < delta)
        if near.any():
            return int(starts[index] + near.argmax())
    return len(series) - 1


def _from_the_end(extreme: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    """The extreme of each value and all after it."""
    result: NDArray[Any] = extreme.accumulate(values[::-1])[::-1]
    return result


class Limits(NamedTuple):
    """K_max in steps and e_max, both above 0: the values that score 0."""

    k_max: float
    e_max: float


LimitsOf = Callable[["Experiment"], Limits]
"""Chooses the limits for the trials of an experiment."""


def paper_limits(experiment: Experiment) -> Limits:
    """K_max and e_max of the paper's figures: the length of a trial, and 0.45."""
    return Limits(experiment.steps, E_MAX)


def chosen_limits(k_max: float | None, e_max: float | None) -> LimitsOf:
    """These limits, and the paper's for None. Raises UsageError for limits of 0 or less."""
    for name, value in (("K_max", k_max), ("e_max", e_max)):
        if value is not None and not 0 < value < float("inf"):
            raise UsageError(f"{name} is {value}; it must be above 0")

    def limits_of(experiment: Experiment) -> Limits:
        given = zip((k_max, e_max), paper_limits(experiment), strict=True)
        return Limits(*(other if value is None else value for value, other in given))

    return limits_of


@dataclass(frozen=True)
class Scores:
    """Scores of each trial, shape (trials,): 0 .. 100 if no K and e is above its limit."""

    h_k: NDArray[np.float64]
    h_e: NDArray[np.float64]

    @property
    def h(self) -> NDArray[np.float64]:
        """H, the mean of the two."""
        return 0.5 * (self.h_k + self.h_e)

    @property
    def values(self) -> tuple[NDArray[np.float64], ...]:
        """H, h_K and h_e."""
        return self.h, self.h_k, self.h_e


def score(convergence_steps: ArrayLike, errors: ArrayLike, limits: Limits) -> Scores:
    """Scores of trials from K and e of every robot, both of shape (trials, robots). NaN counts as e_max."""
    k = np.asarray(convergence_steps, dtype=np.float64)
    e = np.nan_to_num(np.asarray(errors, dtype=np.float64), nan=limits.e_max)
    return Scores(_scaled_mean(k, limits.k_max), _scaled_mean(e, limits.e_max))


def _scaled_mean(values: NDArray[np.float64], most: float) -> NDArray[np.float64]:
    """100 times the mean of 1 - value / most over the robots, times exp(-IQR / most)."""
    result: NDArray[np.float64] = (
        100.0 * (1.0 - values / most).mean(axis=1) * np.exp(-_interquartile_range(values) / most)
    )
    return result


def _interquartile_range(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper less lower quartile of each row; a quartile between two values is their middle."""
    upper, lower = np.percentile(values, [75, 25], axis=1, method="midpoint")
    result: NDArray[np.float64] = upper - lower
    return result
