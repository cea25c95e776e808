"""Intervals of medians, quartiles and correlations, against NumPy, SciPy and the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import iqr, kurtosis, skew, spearmanr  # type: ignore[import-untyped]

from mcp_asdf_tools.reproduction.resampling import (
    BEST_OF_30,
    MEDIAN,
    RESAMPLES,
    SPREAD,
    Estimate,
    Sample,
    _drawn,
    exactly,
    falls_apart,
    interval,
    rank_correlation,
    summarized,
)


def sample(seed: int, level: float = 0.0, trials: int = 30) -> Sample:
    return np.random.default_rng(seed).normal(level, 1, trials)


def difference(left: Sample, right: Sample, confidence: float = 0.95) -> Estimate:
    one, other = summarized(left, MEDIAN), summarized(right, MEDIAN)
    return interval(one.value - other.value, one.again - other.again, confidence)


def best(values: Sample, axis: int = -1) -> Sample:
    return np.asarray(np.quantile(values, 0.5 ** (1 / 30), axis=axis))


@pytest.mark.parametrize("trials", [2, 7, 30, 61])
def test_summaries_of_samples_and_resamples_are_numpys(trials: int) -> None:
    """With ties."""
    values = np.round(sample(trials, trials=trials), 1)
    drawn = values[_drawn(trials, RESAMPLES)]
    for summary, statistic in ((MEDIAN, np.median), (SPREAD, iqr), (BEST_OF_30, best)):
        found = summarized(values, summary)
        assert found.value == pytest.approx(statistic(values, axis=-1))
        assert found.again == pytest.approx(statistic(drawn, axis=1), abs=1e-6)


def test_trials_are_drawn_together() -> None:
    """Trial i of all cells saw the same world: what it has in common cancels, and levels add."""
    common = 100 * sample(1)
    together, apart = difference(common + sample(2), common), difference(common + sample(2), common[::-1])
    assert together.high - together.low < 0.2 * (apart.high - apart.low)
    assert difference(common + 7, common) == pytest.approx((7, 7, 7), abs=1e-4)
    assert interval(5, np.arange(101.0), 0.9) == pytest.approx((5, 5, 95))
    assert interval(0.1, np.full(9, 0.1, np.float32), 0.9) == exactly(0.1)


def test_a_sample_that_falls_apart_has_a_high_coefficient_of_bimodality() -> None:
    """By SciPy's skewness and kurtosis; what cannot be seen does not count."""
    groups = [np.append(sample(seed, trials=10 + seed), sample(9, seed, 40 - seed)) for seed in range(1, 30)]
    spread = [np.linspace(0, 99, 30), -20 * np.log(np.linspace(0.01, 1, 300))]
    for each in (*spread, np.zeros(30), *(scale * group for group in groups for scale in (0.3, 2, 10))):
        is_seen = each.std() >= 2
        coefficient = (skew(each) ** 2 + 1) / kurtosis(each, fisher=False) if is_seen else 0
        assert falls_apart(each) is bool(coefficient > 2 / 3), coefficient


def test_rank_correlations_are_spearmans() -> None:
    x, noise = sample(1, trials=60), sample(2, trials=60)
    found = rank_correlation(x, noise - x, 0.95)
    assert found.value == pytest.approx(spearmanr(x, noise - x).statistic)
    assert -0.9 < found.low < found.value < found.high < -0.2
    assert rank_correlation(x, np.exp(x), 0.95).value == pytest.approx(1)
    assert rank_correlation(x, np.zeros(60), 0.95) == exactly(0)


def test_intervals_hold_what_they_promise() -> None:
    """The true difference is 0; a 95 % interval should miss it in about one of twenty cases."""
    pairs = [(sample(2 * seed), sample(2 * seed + 1)) for seed in range(40)]
    assert 1 <= sum(not found.low <= 0 <= found.high for found in (difference(*each) for each in pairs)) <= 6
