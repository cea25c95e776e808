"""The paper's metrics: convergence step K, absolute error e, and the scores h_K, h_e and H of a trial.

Section "Metrics" of the paper and its equations of the separate, the scaled and the overall score.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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


@dataclass(frozen=True)
class Limits:
    """The values that score 0: K_max in steps, None for the length of a trial, and e_max; by default those of
    the paper's figures. Raises UsageError for limits of 0 or less."""

    k_max: float | None = None
    e_max: float = E_MAX

    def __post_init__(self) -> None:
        for name, value in (("K_max", self.k_max), ("e_max", self.e_max)):
            if value is not None and not 0 < value < float("inf"):
                raise UsageError(f"{name} is {value}; it must be above 0")

    def of(self, experiment: Experiment) -> tuple[float, float]:
        """K_max and e_max for the trials of an experiment."""
        return experiment.steps if self.k_max is None else self.k_max, self.e_max


PAPERS = Limits()


SCORES = ("H", "h_K", "h_e")


def score(
    convergence_steps: ArrayLike, errors: ArrayLike, k_max: float, e_max: float
) -> dict[str, NDArray[np.float64]]:
    """SCORES of trials by name, shape (trials,), from K and e of every robot, both of shape (trials, robots).

    They are 0 .. 100 if no K and e is above its limit; H is the mean of the other two. NaN counts as e_max.
    """
    k = np.asarray(convergence_steps, dtype=np.float64)
    e = np.nan_to_num(np.asarray(errors, dtype=np.float64), nan=e_max)
    h_k, h_e = _scaled_mean(k, k_max), _scaled_mean(e, e_max)
    return dict(zip(SCORES, (0.5 * (h_k + h_e), h_k, h_e), strict=True))


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
