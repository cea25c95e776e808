"""The paper's metrics: convergence step K, absolute error e, and the scores h_K, h_e and H of a trial.

Section "Metrics" of the paper and its equations of the separate, the scaled and the overall score.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

DELTA = 0.01
"""Error bound within which an estimate has converged."""

_CHUNK_LENGTH = 1024
"""Values that ``convergence_step`` examines at a time."""


def convergence_step(series: NDArray[np.uint32] | NDArray[np.float64], delta: float = DELTA) -> int:
    """Return K, the first step from which on the series stays within ``delta`` of its value there.

    K is the least with abs(x[K] - x[k]) < delta for all k >= K; the last step always is one. ``series`` is
    the informed estimate of steps 0 .. T, in any unit that ``delta`` has too. Up to a NaN no step is K, but
    for the last one. O(T), with constant extra memory.
    """
    # A value is near all later ones if it is near the lowest and the highest of them. To find these for every
    # step would take long, so they are found for chunks of steps first.
    chunk_starts = np.arange(0, len(series), _CHUNK_LENGTH)
    lowest_after = _extremes_after_chunks(np.minimum, series, chunk_starts)
    highest_after = _extremes_after_chunks(np.maximum, series, chunk_starts)
    # Where the values after a chunk are 2 delta apart, no value in the chunk can be near all of them.
    may_have_k = highest_after - lowest_after < 2 * delta
    for index in np.flatnonzero(may_have_k):
        chunk = series[chunk_starts[index] : chunk_starts[index] + _CHUNK_LENGTH]
        is_near = _is_near_all_later(chunk, lowest_after[index], highest_after[index], delta)
        if is_near.any():
            return int(chunk_starts[index] + is_near.argmax())  # argmax finds the first one
    last_step = len(series) - 1
    return last_step


def _is_near_all_later(
    chunk: NDArray[Any], lowest_after: float, highest_after: float, delta: float
) -> NDArray[np.bool_]:
    """Return an array that is True where a value of a chunk is near all later values of the series.

    Near means that they differ by less than ``delta``. Later values are those in the rest of the chunk and
    those after it, of which ``lowest_after`` is the lowest and ``highest_after`` the highest.
    """
    # Element i is the lowest or highest of all values from value i of the chunk to the end of the series.
    lowest_to_end = _extremes_to_end(np.minimum, np.minimum(chunk, lowest_after))
    highest_to_end = _extremes_to_end(np.maximum, np.maximum(chunk, highest_after))
    # Unsigned values do not wrap around here, as neither difference is ever negative.
    is_near: NDArray[np.bool_] = (chunk - lowest_to_end < delta) & (highest_to_end - chunk < delta)
    return is_near


def _extremes_after_chunks(
    extreme: np.ufunc, series: NDArray[Any], chunk_starts: NDArray[np.int64]
) -> NDArray[Any]:
    """Return an array whose element i is the extreme of all values of a series after its chunk i.

    ``extreme`` is np.minimum for the lowest values, or np.maximum for the highest. No values come after the
    last chunk; its element is the last value of the series.
    """
    extremes_of_chunks = extreme.reduceat(series, chunk_starts)
    extremes_from_chunks = _extremes_to_end(extreme, extremes_of_chunks)
    # What comes after a chunk begins with the next chunk.
    last_value = series[-1]
    return np.append(extremes_from_chunks[1:], last_value)


def _extremes_to_end(extreme: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    """Return an array whose element i is the extreme of ``values[i:]``.

    ``extreme`` is np.minimum for the lowest values, or np.maximum for the highest.
    """
    extremes_from_last: NDArray[Any] = extreme.accumulate(values[::-1])
    return extremes_from_last[::-1]


def score(
    convergence_steps: ArrayLike, errors: ArrayLike, k_max: float, e_max: float
) -> dict[str, NDArray[np.float64]]:
    """Return the scores H, h_K and h_e of trials by name, shape (trials,), from K and e of every robot.

    ``convergence_steps`` and ``errors`` have the shape (trials, robots). With means over the robots,

        h_K = mean(100 (k_max - K) / k_max) exp(-IQR_K / k_max)
        h_e = mean(100 (e_max - e) / e_max) exp(-IQR_e / e_max)
        H = (h_K + h_e) / 2

    where IQR is the interquartile range over the robots. Scores are 0 .. 100 if no K and e is above its
    limit. An error of NaN counts as e_max.
    """
    k = np.asarray(convergence_steps, dtype=np.float64)
    e = np.nan_to_num(np.asarray(errors, dtype=np.float64), nan=e_max)
    h_k = _scaled_mean(k, k_max)
    h_e = _scaled_mean(e, e_max)
    return {"H": 0.5 * (h_k + h_e), "h_K": h_k, "h_e": h_e}


def _scaled_mean(values: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    """Return 100 times the mean of 1 - value / limit over the robots, times exp(-IQR / limit).

    ``values`` has the shape (trials, robots), and the result the shape (trials,). IQR is the interquartile
    range, and a quartile between two values is their middle.
    """
    robot_axis = 1
    mean_scores = (1.0 - values / limit).mean(axis=robot_axis)
    upper, lower = np.percentile(values, [75, 25], axis=robot_axis, method="midpoint")
    interquartile_ranges = upper - lower
    scaled: NDArray[np.float64] = 100.0 * mean_scores * np.exp(-interquartile_ranges / limit)
    return scaled
