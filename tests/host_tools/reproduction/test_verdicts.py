"""How claims are decided: estimates, comparisons, verdicts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr  # type: ignore[import-untyped]

from mcp_asdf_tools.reproduction.verdicts import (
    Comparison,
    Estimate,
    Expectation,
    Finding,
    Scope,
    Verdict,
    estimate,
    exactly,
    rank_correlation,
)

ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW = Expectation


def sample(seed: int, level: float = 0.0, trials: int = 30) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.random.default_rng(seed).normal(level, 1, trials)


# --- Estimates -------------------------------------------------------------------------------------------


def test_an_estimate_is_the_difference_of_medians() -> None:
    found = estimate([sample(1, 5)], [sample(2)])
    assert found.value == np.median(sample(1, 5)) - np.median(sample(2))
    assert 4 < found.low < found.value < found.high < 6
    assert found == estimate([sample(1, 5)], [sample(2)])


def test_an_estimate_moves_with_its_samples() -> None:
    here, there = estimate([sample(1)], [sample(2)]), estimate([sample(1) + 7], [sample(2)])
    assert there.value == pytest.approx(here.value + 7)
    assert (there.low, there.high) == pytest.approx((here.low + 7, here.high + 7))


def test_four_samples_make_a_difference_of_differences() -> None:
    found = estimate([sample(1, 9), sample(2, 3)], [sample(3, 5), sample(4, 1)])
    assert 4 < found.low < 6 < found.high < 8


def test_another_summary_is_compared() -> None:
    found = estimate([3 * sample(1, trials=200)], [sample(2, 50, trials=200)], np.std)
    assert 1.4 < found.low < 2 < found.high < 2.5


def test_pairs_that_vary_together_have_a_narrow_difference() -> None:
    common = 100 * sample(1)
    together = estimate([common + sample(2)], [common])
    apart = estimate([common + sample(2)], [common[::-1]])
    assert together.high - together.low < 0.2 * (apart.high - apart.low)


def test_rank_correlations_are_spearmans() -> None:
    x, noise = sample(1, trials=60), sample(2, trials=60)
    found = rank_correlation(x, noise - x)
    assert found.value == pytest.approx(spearmanr(x, noise - x).statistic)
    assert -0.9 < found.low < found.value < found.high < -0.2
    assert rank_correlation(x, np.exp(x)).value == pytest.approx(1)
    assert rank_correlation(x, np.zeros(60)) == exactly(0)
    unrelated = rank_correlation(x, noise)
    assert unrelated.low < 0 < unrelated.high


def test_what_does_not_vary_is_exact() -> None:
    assert estimate([np.full(30, 4.0)], [np.full(30, 1.0)]) == exactly(3) == Estimate(3, 3, 3)


def test_intervals_hold_what_they_promise() -> None:
    """The true difference is 0; a 95 % interval should miss it in about one of twenty cases."""
    missed = 0
    for seed in range(100):
        found = estimate([sample(2 * seed)], [sample(2 * seed + 1)])
        missed += not found.low <= 0 <= found.high
    assert 1 <= missed <= 13


# --- Comparisons -----------------------------------------------------------------------------------------

CASES: list[tuple[tuple[float, float, float], str]] = [
    # value, low, high; then whether ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW hold with a margin of 2
    ((9, 5, 13), "yes no no no yes"),
    ((-9, -13, -5), "no yes no yes no"),
    ((0, -1, 1), "no no yes yes yes"),
    ((1, 0.5, 1.5), "no no yes yes yes"),  # sure, but too small to count
    ((3, 1, 5), "yes no no no yes"),
    ((1, 0.5, 5), "? no ? ? yes"),
    ((3, -3, 9), "? ? ? ? ?"),
    ((1, -1, 5), "? no ? ? yes"),
    ((0, -9, 9), "? ? ? ? ?"),
]


@pytest.mark.parametrize(("numbers", "answers"), CASES)
def test_comparisons_are_judged(numbers: tuple[float, float, float], answers: str) -> None:
    meaning = {"yes": True, "no": False, "?": None}
    for expectation, answer in zip(Expectation, answers.split(), strict=True):
        assert Comparison("", Estimate(*numbers), expectation, 2).holds is meaning[answer], expectation


@pytest.mark.parametrize(("numbers", "answers"), CASES)
def test_judgement_has_no_preferred_side(numbers: tuple[float, float, float], answers: str) -> None:
    mirrored = {ABOVE: BELOW, BELOW: ABOVE, SAME: SAME, NOT_ABOVE: NOT_BELOW, NOT_BELOW: NOT_ABOVE}
    for expectation, other in mirrored.items():
        here = Comparison("", Estimate(*numbers), expectation, 2).holds
        assert here is Comparison("", -Estimate(*numbers), other, 2).holds


# --- Verdicts --------------------------------------------------------------------------------------------


def finding(right: int, wrong: int, undecided: int, scope: Scope) -> Finding:
    estimates = [Estimate(9, 8, 10)] * right + [exactly(-9)] * wrong + [Estimate(0, -9, 9)] * undecided
    return Finding([Comparison("", each, ABOVE, 2) for each in estimates], scope)


@pytest.mark.parametrize(
    ("counts", "verdicts"),
    [
        ((4, 0, 0), "agree agree agree"),
        ((3, 0, 1), "agree agree agree"),
        ((3, 1, 0), "mixed agree agree"),
        ((2, 0, 2), "mixed mixed agree"),
        ((1, 3, 0), "mixed disagree agree"),
        ((0, 3, 1), "disagree disagree mixed"),
        ((0, 4, 0), "disagree disagree disagree"),
        ((0, 0, 4), "mixed mixed mixed"),
        ((2, 2, 0), "mixed mixed agree"),
    ],
)
def test_verdicts(counts: tuple[int, int, int], verdicts: str) -> None:
    for scope, verdict in zip(Scope, verdicts.split(), strict=True):
        found = finding(*counts, scope)
        assert found.verdict is Verdict(verdict), scope
        assert tuple(found.count(holds) for holds in (True, False, None)) == counts
