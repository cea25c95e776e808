"""Resampled statistics and their intervals, compared with NumPy's, SciPy's and the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import iqr, spearmanr  # type: ignore[import-untyped]

from mcp_asdf_tools.studies.bootstrap import (
    Interval,
    Resampled,
    Sample,
    mean_of_resampled,
    resample_indices,
    resample_interquartile_range,
    resample_median,
    resample_quantile,
    resample_rank_correlation,
)


def normal_sample(seed: int, trials: int = 30) -> Sample:
    """Draw a number with a standard normal distribution for each trial."""
    return np.random.default_rng(seed).normal(0, 1, trials)


def resample_quantile_of_90_percent(sample: Sample) -> Resampled:
    return resample_quantile(sample, 0.9)


def quantile_of_90_percent(values: Sample, axis: int) -> Sample:
    quantiles: Sample = np.quantile(values, 0.9, axis)
    return quantiles


@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize("trials", [2, 7, 30])
@pytest.mark.parametrize(
    ("resample", "statistic"),
    [
        (resample_median, np.median),
        (resample_interquartile_range, iqr),
        (resample_quantile_of_90_percent, quantile_of_90_percent),
    ],
)
def test_a_statistic_of_a_sample_and_of_each_of_its_resamples_is_that_of_numpy_or_scipy(
    resample: Callable[[Sample], Resampled], statistic: Callable[..., Sample], trials: int
) -> None:
    """A sample has a value for each trial. A resample has trials of the sample, drawn by their indices."""
    sample = np.round(normal_sample(seed=trials, trials=trials), 1)  # some values are equal
    values_by_resample_and_trial = sample[resample_indices(trials)]

    resampled = resample(sample)

    assert resampled.value == pytest.approx(statistic(sample, axis=0))
    statistic_of_each_resample = statistic(values_by_resample_and_trial, axis=1)  # over its trials
    # Resamples are kept in single precision.
    assert resampled.resamples == pytest.approx(statistic_of_each_resample, abs=1e-6)


def width_of(interval: Interval) -> float:
    return interval.high - interval.low


def test_what_two_samples_have_in_common_trial_by_trial_cancels_in_their_difference() -> None:
    """The common numbers vary a hundred times as much as the difference, so the interval would be wide.

    They do not cancel if the trials of one sample come in another order.
    """
    common = 100 * normal_sample(seed=1)
    common_in_another_order = common[::-1]
    median_of_sum = resample_median(common + normal_sample(seed=2))

    paired_difference = median_of_sum - resample_median(common)
    unpaired_difference = median_of_sum - resample_median(common_in_another_order)

    width_of_paired = width_of(paired_difference.interval(0.95))
    width_of_unpaired = width_of(unpaired_difference.interval(0.95))
    assert width_of_paired < 0.2 * width_of_unpaired


def test_a_constant_difference_of_two_samples_has_an_interval_without_width() -> None:
    """Each trial of one sample is 7 higher than in the other. Single precision makes errors up to 1e-5."""
    sample = normal_sample(seed=1)
    difference = resample_median(sample + 7) - resample_median(sample)
    assert difference.interval(0.95) == pytest.approx(Interval(value=7, low=7, high=7), abs=1e-5)


def test_an_interval_of_90_percent_leaves_out_5_percent_of_the_resamples_at_either_end() -> None:
    """The statistics of the 101 resamples are the numbers from 0 to 100."""
    resampled = Resampled(value=50, resamples=np.arange(101, dtype=np.float32))
    assert resampled.interval(0.9) == pytest.approx(Interval(value=50, low=5, high=95))


def test_equal_resamples_give_an_interval_of_the_exact_value_although_they_are_rounded() -> None:
    """Nine resamples are 0.1 in single precision, which differs from 0.1 in double precision."""
    resampled = Resampled(value=0.1, resamples=np.full(9, 0.1, np.float32))
    assert resampled.interval(0.9) == Interval(value=0.1, low=0.1, high=0.1)


def test_a_constant_is_subtracted_from_the_value_and_from_each_resample() -> None:
    difference = Resampled(value=93, resamples=np.array([92, 94], np.float32)).minus_constant(90)

    assert difference.value == 3
    assert difference.resamples.tolist() == [2, 4]


def test_the_mean_of_two_statistics_is_taken_resample_by_resample() -> None:
    first = Resampled(value=1, resamples=np.array([0, 2], np.float32))
    second = Resampled(value=3, resamples=np.array([2, 4], np.float32))

    mean = mean_of_resampled([first, second])

    assert mean.value == (1 + 3) / 2
    assert mean.resamples.tolist() == [(0 + 2) / 2, (2 + 4) / 2]


@pytest.mark.usefixtures("few_resamples")
def test_the_rank_correlation_is_that_of_scipy_with_an_interval_around_it() -> None:
    """The samples are x and y = z - x, with 60 random x and z. Their correlation is about -1 / sqrt(2)."""
    x = normal_sample(seed=1, trials=60)
    z = normal_sample(seed=2, trials=60)
    y = z - x

    value, low, high = resample_rank_correlation(x, y).interval(0.95)

    assert value == pytest.approx(spearmanr(x, y).statistic)
    assert -0.9 < low < value < high < -0.2


def test_the_rank_correlation_is_zero_where_a_sample_does_not_vary() -> None:
    """The second sample has 30 zeros. Without variation a correlation is not defined."""
    correlation = resample_rank_correlation(normal_sample(seed=1, trials=30), np.zeros(30))
    assert correlation.interval(0.95) == Interval(value=0, low=0, high=0)


@pytest.mark.slow
def test_intervals_of_95_percent_miss_the_true_difference_in_about_one_of_twenty_cases() -> None:
    """In each of 40 cases both samples are drawn from the same distribution, so the true difference is 0.

    5 percent of 40 intervals are 2. By chance there may be 1 to 6.
    """
    misses = 0
    for case in range(40):
        first_median = resample_median(normal_sample(seed=2 * case))
        second_median = resample_median(normal_sample(seed=2 * case + 1))
        _value, low, high = (first_median - second_median).interval(0.95)
        if not low <= 0 <= high:
            misses += 1

    assert 1 <= misses <= 6
