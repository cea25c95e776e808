"""Bootstrap of medians and quartiles over trials.

All samples of one length are drawn alike: trial i of all cells saw the same world, so that what it has in
common cancels in a difference.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Sample = NDArray[np.float64]
"""A value for each trial."""

Summary = tuple[tuple[float, int], ...]
"""A number that stands for a sample: a sum of quantiles, each with its weight."""

MEDIAN: Summary = ((0.5, 1),)
SPREAD: Summary = ((0.75, 1), (0.25, -1))
"""The interquartile range."""
BEST_OF_30: Summary = ((0.5 ** (1 / 30), 1),)
"""The score that the best of 30 trials, as many as the paper has, reaches or misses equally often."""

RESAMPLES = 20_000
"""Enough for the corrected interval of the claim with most comparisons, whose tail is one in 8000."""

_SEED = 1
_SEEN = 2.0
"""Points of a score below which a standard deviation hides no groups that matter."""


class Estimate(NamedTuple):
    """A number and the bounds of its confidence interval."""

    value: float
    low: float
    high: float

    def __neg__(self) -> Estimate:
        return Estimate(-self.value, -self.high, -self.low)


class Summarized(NamedTuple):
    """A summary of a sample, and of each of its resamples."""

    value: float
    again: NDArray[np.float32]


def exactly(value: float) -> Estimate:
    """A number that is not subject to chance."""
    return Estimate(value, value, value)


def interval(value: float, again: NDArray[Any], confidence: float) -> Estimate:
    """The percentile interval of resampled values."""
    if np.ptp(again) == 0:
        return exactly(value)
    low, high = np.quantile(again, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Estimate(value, float(low), float(high))


def summarized(sample: Sample, summary: Summary) -> Summarized:
    """The summary of a sample of at most 65 535 trials. O(resamples trials log trials).

    Resamples are sorted as ranks in the sample, of 16 bits, which is ten times as fast as sorting values.
    """
    order = np.argsort(sample, kind="stable")
    ranks = np.empty(len(sample), np.uint16)
    ranks[order] = own = np.arange(len(sample), dtype=np.uint16)
    drawn = np.sort(ranks[_drawn(len(sample), RESAMPLES)], axis=1)
    (value,) = _quantiles(sample[order], own[np.newaxis], summary)
    return Summarized(float(value), _quantiles(sample[order], drawn, summary).astype(np.float32))


def falls_apart(sample: Sample) -> bool:
    """True if a sample seems to have two groups: its coefficient of bimodality is over 2/3."""
    deviations = sample - sample.mean()
    variance = float((deviations**2).mean())
    if variance < _SEEN**2:
        return False
    skewness = float((deviations**3).mean()) / variance**1.5
    return bool((skewness**2 + 1) * variance**2 / (deviations**4).mean() > 2 / 3)


def averaged(sample: Sample) -> Summarized:
    """The mean of a sample, and of each of its resamples. O(resamples trials)."""
    means = sample.astype(np.float32)[_drawn(len(sample), RESAMPLES)].mean(axis=1)
    return Summarized(float(sample.mean()), means)


def _quantiles(ordered: Sample, ranks: NDArray[np.uint16], summary: Summary) -> NDArray[np.float64]:
    """The weighted quantiles of samples whose values have these ranks, in ascending order."""
    last, total = len(ordered) - 1, np.zeros(len(ranks))
    for quantile, weight in summary:
        place, share = int(quantile * last), quantile * last % 1
        low, high = (ordered[ranks[:, each]] for each in (place, min(place + 1, last)))
        total += weight * ((1 - share) * low + share * high)
    return total


@lru_cache(maxsize=4)
def _drawn(trials: int, resamples: int) -> NDArray[np.uint16]:
    """Indices of trials, shape (resamples, trials)."""
    return np.random.default_rng(_SEED).integers(trials, size=(resamples, trials), dtype=np.uint16)


def rank_correlation(first: Sample, second: Sample, confidence: float) -> Estimate:
    """Spearman's coefficient; 0 where a sample does not vary. O(resamples trials log trials)."""
    drawn = _drawn(len(first), RESAMPLES)
    again = np.concatenate(
        [_spearman(*(each[rows] for each in (first, second))) for rows in np.array_split(drawn, 50)]
    )
    (value,) = _spearman(first[np.newaxis], second[np.newaxis])
    return interval(float(value), again, confidence)


def _spearman(*samples: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.stats import rankdata  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

    ranks = [rankdata(sample, axis=-1) for sample in samples]
    x, y = (rank - rank.mean(axis=-1, keepdims=True) for rank in ranks)
    scale = np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1))
    result: NDArray[np.float64] = (x * y).sum(axis=-1) / np.where(scale == 0, 1, scale)
    return result
