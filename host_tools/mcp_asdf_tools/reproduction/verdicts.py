"""Statements about experiments, decided by comparing medians with bootstrapped confidence intervals.

A claim is a function from results to a ``Finding``: comparisons, each with its numbers and whether it holds,
and how many of them the claim needs. What the claims say is the business of ``paper_claims``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, rankdata  # type: ignore[import-untyped]

MARGIN = 2.0
"""Points of a score of 0 to 100 below which a difference counts for nothing: it cannot be seen in the paper's
figures."""

ENOUGH = 0.75
"""Share of the comparisons that makes most of them."""

CONFIDENCE = 0.95
_RESAMPLES = 2000
_SEED = 1

Sample = NDArray[np.float64]
Summary = Callable[..., Any]
"""Statistic of a sample; called with an array and the axis of the trials."""


class Expectation(Enum):
    """Claimed result of a comparison."""

    ABOVE = "above"
    BELOW = "below"
    SAME = "the same"
    NOT_ABOVE = "not above"
    NOT_BELOW = "not below"


class Scope(Enum):
    """How many comparisons a claim is about."""

    ALL = "all"
    """None may fail. A quarter may be open."""
    MOST = "most"
    """Three quarters must hold: where the paper says "in general", "overall", "almost all"."""
    SOME = "some"
    """One must hold."""


class Verdict(Enum):
    """Verdict on a claim."""

    AGREE = "agree"
    MIXED = "mixed"
    """Some comparisons hold and others do not, or too many cannot be decided."""
    DISAGREE = "disagree"


@dataclass(frozen=True)
class Estimate:
    """A number and the bounds of its confidence interval."""

    value: float
    low: float
    high: float

    def __neg__(self) -> Estimate:
        return Estimate(-self.value, -self.high, -self.low)


@dataclass(frozen=True)
class Comparison:
    """One difference and what it should be.

    Attributes:
        label: Which cells are compared, in words.
        estimate: The difference.
        expectation: What the claim says of it.
        margin: Size from which it counts, in the same unit.
    """

    label: str
    estimate: Estimate
    expectation: Expectation
    margin: float

    @property
    def holds(self) -> bool | None:
        """Whether the claim is right here; None if the interval leaves it open."""
        return _RULES[self.expectation](self.estimate, self.margin)


@dataclass(frozen=True)
class Finding:
    """Results of a claim's comparisons, at least one."""

    comparisons: Sequence[Comparison]
    scope: Scope = Scope.ALL

    def count(self, holds: bool | None) -> int:
        """How many comparisons hold (True), fail (False) or are open (None)."""
        return sum(each.holds is holds for each in self.comparisons)

    @property
    def verdict(self) -> Verdict:
        """Agree or disagree if enough comparisons hold or fail, otherwise mixed."""
        total, right, wrong = len(self.comparisons), self.count(True), self.count(False)
        agrees, disagrees = {
            Scope.ALL: (right >= ENOUGH * total and not wrong, wrong >= ENOUGH * total and not right),
            Scope.MOST: (right >= ENOUGH * total, wrong >= ENOUGH * total),
            Scope.SOME: (right > 0, wrong == total),
        }[self.scope]
        return Verdict.AGREE if agrees else Verdict.DISAGREE if disagrees else Verdict.MIXED


def estimate(left: Sequence[Sample], right: Sequence[Sample], summary: Summary = np.median) -> Estimate:
    """The sum of the summaries of ``left`` less that of ``right``, with the confidence interval.

    All samples hold as many trials, which are resampled together: trial i of all saw the same world. The same
    samples give the same bounds. O(resamples trials).
    """

    def difference(*samples: Sample, axis: int) -> Any:
        values = [summary(sample, axis=axis) for sample in samples]
        return sum(values[: len(left)]) - sum(values[len(left) :])

    return _with_interval(difference, (*left, *right))


def rank_correlation(first: Sample, second: Sample) -> Estimate:
    """Spearman's coefficient with its confidence interval; 0 where a sample does not vary."""

    def coefficient(*samples: Sample, axis: int) -> Any:
        ranks = [rankdata(sample, axis=axis) for sample in samples]
        x, y = (rank - rank.mean(axis=axis, keepdims=True) for rank in ranks)
        scale = np.sqrt((x * x).sum(axis=axis) * (y * y).sum(axis=axis))
        return (x * y).sum(axis=axis) / np.where(scale == 0, 1, scale)

    return _with_interval(coefficient, (first, second))


def _with_interval(statistic: Summary, samples: tuple[Sample, ...]) -> Estimate:
    value = float(statistic(*samples, axis=-1))
    if all(np.ptp(sample) == 0 for sample in samples):
        return exactly(value)
    interval = bootstrap(
        samples,
        statistic,
        paired=True,
        vectorized=True,
        n_resamples=_RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(_SEED),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def exactly(value: float) -> Estimate:
    """A number that is not subject to chance."""
    return Estimate(value, value, value)


# --- When a comparison holds -----------------------------------------------------------------------------


def _is_above(estimate: Estimate, margin: float) -> bool:
    """Surely above 0, and enough to count."""
    return estimate.low > 0 and estimate.value >= margin


def _above(estimate: Estimate, margin: float) -> bool | None:
    if _is_above(estimate, margin):
        return True
    return False if estimate.high < margin else None


def _not_below(estimate: Estimate, margin: float) -> bool | None:
    if estimate.low > -margin:
        return True
    return False if _is_above(-estimate, margin) else None


def _same(estimate: Estimate, margin: float) -> bool | None:
    if -margin < estimate.low and estimate.high < margin:
        return True
    return False if _is_above(estimate, margin) or _is_above(-estimate, margin) else None


_RULES: dict[Expectation, Callable[[Estimate, float], bool | None]] = {
    Expectation.ABOVE: _above,
    Expectation.BELOW: lambda estimate, margin: _above(-estimate, margin),
    Expectation.SAME: _same,
    Expectation.NOT_ABOVE: lambda estimate, margin: _not_below(-estimate, margin),
    Expectation.NOT_BELOW: _not_below,
}
