"""Bootstrap intervals of medians, quartiles and rank correlations over the trials of an experiment.

A sample has a value for each trial. A resample draws as many of its trials again, with replacement; the
spread of a statistic over many resamples shows how much of it is chance.

All samples of one length are resampled by the same indices. Trial i of every experiment with one seed has the
same floor and the same random numbers, so what two samples have in common cancels in the difference of their
statistics.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Sample = NDArray[np.float64]
"""Values of an experiment, one per trial."""

RESAMPLES = 20_000
"""Enough for the claim with most comparisons: its corrected interval leaves out a tail of one in 3000."""


class Interval(NamedTuple):
    """A number and the two ends of its confidence interval."""

    value: float
    low: float
    high: float

    def __neg__(self) -> Interval:
        """Return the interval of the negated number: its ends change places."""
        return Interval(-self.value, low=-self.high, high=-self.low)


@dataclass(frozen=True)
class Resampled:
    """A statistic of a sample, and the same statistic of each bootstrap resample."""

    value: float
    resamples: NDArray[np.float32]

    def __sub__(self, other: Resampled) -> Resampled:
        """Return the difference of two statistics: of their values, and of their resamples in pairs."""
        return Resampled(self.value - other.value, self.resamples - other.resamples)

    def __truediv__(self, other: Resampled) -> Resampled:
        """Return the ratio of two statistics: of their values, and of their resamples in pairs."""
        return Resampled(self.value / other.value, self.resamples / other.resamples)

    def minus_constant(self, constant: float) -> Resampled:
        """Return the statistic less a number that is not subject to chance."""
        return Resampled(self.value - constant, self.resamples - np.float32(constant))

    def interval(self, confidence: float) -> Interval:
        """Return the value with the range of the middle resamples, whose share is ``confidence`` (0 to 1).

        If all resamples are equal, the range is the value alone.
        """
        are_all_equal = self.resamples.min() == self.resamples.max()
        if are_all_equal:
            # The resamples are float32, so they may differ from the value by rounding.
            return Interval(self.value, low=self.value, high=self.value)
        # As many resamples lie below the range as above it.
        share_below_low = (1 - confidence) / 2
        share_below_high = (1 + confidence) / 2
        low, high = np.quantile(self.resamples, [share_below_low, share_below_high])
        return Interval(self.value, float(low), float(high))


@lru_cache(maxsize=4)
def resample_indices(trials: int) -> NDArray[np.uint16]:
    """Draw the trials of every resample with replacement; shape (RESAMPLES, trials), always the same.

    The seed of the draws is fixed: the report of one study is the same each time it is made.
    """
    return np.random.default_rng(1).integers(trials, size=(RESAMPLES, trials), dtype=np.uint16)


def resample_quantile(sample: Sample, quantile: float) -> Resampled:
    """Return a quantile of a sample and of its resamples. O(RESAMPLES trials)."""
    resamples = sample[resample_indices(len(sample))]  # shape (RESAMPLES, trials)
    quantiles = np.quantile(resamples, quantile, axis=1, overwrite_input=True)
    # float32 halves the memory of the measures that are kept; its rounding is far below an interval.
    return Resampled(float(np.quantile(sample, quantile)), quantiles.astype(np.float32))


def resample_median(sample: Sample) -> Resampled:
    """Return the median of a sample and of its resamples."""
    return resample_quantile(sample, 0.5)


def resample_interquartile_range(sample: Sample) -> Resampled:
    """Return the upper less the lower quartile of a sample and of its resamples."""
    return resample_quantile(sample, 0.75) - resample_quantile(sample, 0.25)


def resample_rank_correlation(first: Sample, second: Sample) -> Resampled:
    """Return Spearman's coefficient of two paired samples and of their resamples.

    It is 0 where a sample does not vary.
    """
    batch_count = 50  # to rank all resamples at once takes several arrays of RESAMPLES x trials float64
    # Both samples have the same indices, so that pairs stay together.
    batches = np.array_split(resample_indices(len(first)), batch_count)
    resamples = np.concatenate([_spearman(first[indices], second[indices]) for indices in batches])
    # The sample itself is a single row.
    [value] = _spearman(first[np.newaxis], second[np.newaxis])
    return Resampled(float(value), resamples.astype(np.float32))


def _spearman(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Spearman's coefficient of each row of two arrays; 0 for a row that does not vary."""
    from scipy import stats  # type: ignore[import-untyped]  # noqa: PLC0415 (loads slowly)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.ConstantInputWarning)
        coefficients = stats.spearmanrho(first, second, axis=-1).statistic
    # Where all values of a row are equal, the coefficient is not defined, and scipy returns NaN.
    defined_coefficients: NDArray[np.float64] = np.nan_to_num(coefficients, nan=0.0)
    return defined_coefficients


def largest_of_resampled(statistics: Sequence[Resampled]) -> Resampled:
    """Return the largest of several statistics.

    Its value is the largest of their values, and each of its resamples is the largest of theirs.
    """
    value = max(statistic.value for statistic in statistics)
    resamples = np.array([statistic.resamples for statistic in statistics])  # each statistic has a row
    return Resampled(value, resamples.max(axis=0))


def mean_of_resampled(statistics: Sequence[Resampled]) -> Resampled:
    """Return the mean of several statistics.

    Its value is the mean of their values, and each of its resamples is the mean of theirs.
    """
    value = float(np.mean([statistic.value for statistic in statistics]))
    return Resampled(value, np.mean([statistic.resamples for statistic in statistics], axis=0))
