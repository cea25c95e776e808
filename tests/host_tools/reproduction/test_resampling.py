"""Intervals of medians, quartiles and correlations, against SciPy and against the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import bootstrap, spearmanr  # type: ignore[import-untyped]

from mcp_asdf_tools.reproduction.resampling import (
    BEST_OF_30,
    MEDIAN,
    RESAMPLES,
    SPREAD,
    Estimate,
    Sample,
    Summary,
    _drawn,
    exactly,
    interval,
    rank_correlation,
    summarized,
)


def sample(seed: int, level: float = 0.0, trials: int = 30) -> Sample:
    return np.random.default_rng(seed).normal(level, 1, trials)


def difference(left: Sample, right: Sample, summary: Summary = MEDIAN, confidence: float = 0.95) -> Estimate:
    one, other = summarized(left, summary), summarized(right, summary)
    return interval(one.value - other.value, one.again - other.again, confidence)


def iqr(values: Sample, axis: int = -1) -> Sample:
    upper, lower = np.percentile(values, [75, 25], axis=axis)
    return np.asarray(upper - lower)


@pytest.mark.parametrize("trials", [2, 7, 30, 61])
def test_summaries_are_numpys(trials: int) -> None:
    values = sample(trials, trials=trials)
    assert summarized(values, MEDIAN).value == pytest.approx(np.median(values))
    assert summarized(values, SPREAD).value == pytest.approx(iqr(values))
    assert summarized(values, BEST_OF_30).value == pytest.approx(np.quantile(values, 0.5 ** (1 / 30)))


@pytest.mark.parametrize(("summary", "statistic"), [(MEDIAN, np.median), (SPREAD, iqr)])
@pytest.mark.parametrize("trials", [2, 30, 61, 300])
def test_every_resample_is_numpys(summary: Summary, statistic: Callable[..., Sample], trials: int) -> None:
    """With ties, in samples below and above a block of trials."""
    values = np.round(sample(trials, trials=trials), 1)
    drawn = values[_drawn(trials, RESAMPLES)]
    assert summarized(values, summary).again == pytest.approx(statistic(drawn, axis=1), abs=1e-6)


@pytest.mark.parametrize(("summary", "statistic"), [(MEDIAN, np.median), (SPREAD, iqr)])
@pytest.mark.parametrize("trials", [30, 61])
def test_intervals_are_scipys(summary: Summary, statistic: object, trials: int) -> None:
    """Of paired samples with ties, at the confidence of a claim with many comparisons."""
    left, right = np.round(sample(1, 5, trials), 1), np.round(3 * sample(2, 0, trials), 1)

    def paired(x: Sample, y: Sample, axis: int = -1) -> Sample:
        return statistic(x, axis=axis) - statistic(y, axis=axis)  # type: ignore[operator,no-any-return]

    for confidence in (0.95, 0.999):
        expected = bootstrap(
            (left, right),
            paired,
            paired=True,
            n_resamples=20_000,
            confidence_level=confidence,
            method="percentile",
            rng=np.random.default_rng(5),
        ).confidence_interval
        found = difference(left, right, summary, confidence)
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=0.35)


def test_the_same_samples_give_the_same_interval() -> None:
    assert difference(sample(1, 5), sample(2)) == difference(sample(1, 5), sample(2))


def test_an_interval_moves_with_its_samples() -> None:
    here, there = difference(sample(1), sample(2)), difference(sample(1) + 7, sample(2))
    assert there == pytest.approx([value + 7 for value in here], abs=1e-5)


def test_trials_are_drawn_together() -> None:
    """Trial i of all cells saw the same world: what it has in common cancels."""
    common = 100 * sample(1)
    together = difference(common + sample(2), common)
    apart = difference(common + sample(2), common[::-1])
    assert together.high - together.low < 0.2 * (apart.high - apart.low)


def test_more_confidence_is_a_wider_interval() -> None:
    narrow, wide = (difference(sample(1), sample(2), confidence=each) for each in (0.9, 0.9999))
    assert wide.low < narrow.low < narrow.high < wide.high


@pytest.mark.slow
def test_rank_correlations_are_spearmans() -> None:
    x, noise = sample(1, trials=60), sample(2, trials=60)
    found = rank_correlation(x, noise - x, 0.95)
    assert found.value == pytest.approx(spearmanr(x, noise - x).statistic)
    assert -0.9 < found.low < found.value < found.high < -0.2
    assert rank_correlation(x, np.exp(x), 0.95).value == pytest.approx(1)
    assert rank_correlation(x, np.zeros(60), 0.95) == exactly(0)
    unrelated = rank_correlation(x, noise, 0.95)
    assert unrelated.low < 0 < unrelated.high


def test_what_does_not_vary_is_exact() -> None:
    assert difference(np.full(30, 4.0), np.full(30, 1.0)) == exactly(3) == Estimate(3, 3, 3)


@pytest.mark.slow
def test_intervals_hold_what_they_promise() -> None:
    """The true difference is 0; a 95 % interval should miss it in about one of twenty cases."""
    missed = 0
    for seed in range(100):
        found = difference(sample(2 * seed), sample(2 * seed + 1))
        missed += not found.low <= 0 <= found.high
    assert 1 <= missed <= 13
