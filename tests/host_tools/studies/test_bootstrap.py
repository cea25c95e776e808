"""Resampled statistics and their intervals, beside NumPy's, SciPy's and the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import iqr, spearmanr  # type: ignore[import-untyped]

from mcp_asdf_tools.studies.bootstrap import (
    Resampled,
    Sample,
    mean_of_resampled,
    resample_indices,
    resample_interquartile_range,
    resample_mean,
    resample_median,
    resample_quantile,
    resample_rank_correlation,
)
from support import slow


def normal_sample(seed: int, trials: int = 30) -> Sample:
    return np.random.default_rng(seed).normal(0, 1, trials)


@pytest.mark.parametrize("trials", [2, 7, *slow([30, 61])])
@pytest.mark.parametrize(
    ("resample", "statistic"),
    [
        (resample_median, np.median),
        (resample_interquartile_range, iqr),
        (resample_mean, np.mean),
        (lambda sample: resample_quantile(sample, 0.9), lambda values, axis: np.quantile(values, 0.9, axis)),
    ],
)
def test_statistics_of_a_sample_and_of_its_resamples_are_those_of_numpy(
    resample: Callable[[Sample], Resampled], statistic: Callable[..., Sample], trials: int
) -> None:
    sample = np.round(normal_sample(trials, trials), 1)  # some values are equal
    resampled = resample(sample)
    assert resampled.value == pytest.approx(statistic(sample, axis=-1))
    expected = statistic(sample[resample_indices(trials)], axis=1)

    assert resampled.resamples == pytest.approx(expected, abs=1e-6)


def test_what_two_samples_have_in_common_cancels_in_their_difference() -> None:
    common = 100 * normal_sample(1)
    paired = resample_median(common + normal_sample(2)) - resample_median(common)
    unpaired = resample_median(common + normal_sample(2)) - resample_median(common[::-1])
    assert np.ptp(paired.interval(0.95)[1:]) < 0.2 * np.ptp(unpaired.interval(0.95)[1:])


def test_a_constant_difference_has_an_interval_without_width() -> None:
    sample = normal_sample(1)
    difference = resample_median(sample + 7) - resample_median(sample)
    assert difference.interval(0.95) == pytest.approx((7, 7, 7), abs=1e-5)


def test_an_interval_covers_the_middle_of_the_resamples() -> None:
    assert Resampled(5, np.arange(101, dtype=np.float32)).interval(0.9) == pytest.approx((5, 5, 95))


def test_equal_resamples_give_the_exact_value_as_interval() -> None:
    assert Resampled(0.1, np.full(9, 0.1, np.float32)).interval(0.9) == (0.1, 0.1, 0.1)


def test_a_level_is_subtracted_from_value_and_resamples() -> None:
    above_level = Resampled(93, np.array([92, 94], np.float32)).minus_constant(90)
    assert (above_level.value, above_level.resamples.tolist()) == (3, [2, 4])


def test_the_mean_of_statistics_is_taken_resample_by_resample() -> None:
    first = Resampled(1, np.array([0, 2], np.float32))
    second = Resampled(3, np.array([2, 4], np.float32))
    mean = mean_of_resampled([first, second])
    assert mean.value == (1 + 3) / 2
    assert mean.resamples.tolist() == [(0 + 2) / 2, (2 + 4) / 2]


def test_the_rank_correlation_is_that_of_scipy() -> None:
    x = normal_sample(1, 60)
    y = normal_sample(2, 60) - x
    value, low, high = resample_rank_correlation(x, y).interval(0.95)

    assert value == pytest.approx(spearmanr(x, y).statistic)
    assert -0.9 < low < value < high < -0.2


def test_the_rank_correlation_is_one_for_any_increasing_relation() -> None:
    x = normal_sample(1, 60)
    assert resample_rank_correlation(x, np.exp(x)).value == pytest.approx(1)


def test_the_rank_correlation_is_zero_where_a_sample_does_not_vary() -> None:
    correlation = resample_rank_correlation(normal_sample(1), np.zeros(30))
    assert correlation.interval(0.95) == (0, 0, 0)


@pytest.mark.slow
def test_intervals_of_95_percent_miss_the_truth_in_about_one_of_twenty_cases() -> None:
    misses = 0
    for seed in range(40):
        first, second = normal_sample(2 * seed), normal_sample(2 * seed + 1)
        _, low, high = (resample_median(first) - resample_median(second)).interval(0.95)
        misses += not low <= 0 <= high  # the true difference is 0

    assert 1 <= misses <= 6
