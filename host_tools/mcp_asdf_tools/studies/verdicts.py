"""When a comparison holds, and what the comparisons of a claim together say about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from mcp_asdf_tools.studies.bootstrap import Interval

CONFIDENCE = 0.95
"""Probability that none of a claim's comparisons is decided wrongly."""

MOST_SHARE = 0.75
"""Share of comparisons that must hold where the paper says "in general"; a share of 0.25 refutes it."""

REFUTED_SHARE = 0.1
"""Share of comparisons that hold up to which a claim without a hedge is refuted rather than mixed."""


class Expectation(Enum):
    """What a claim says about a difference; the value is its word in ``claims.toml``."""

    ABOVE = "above"
    BELOW = "below"
    SAME = "the same"
    NOT_ABOVE = "not above"
    NOT_BELOW = "not below"


class Scope(Enum):
    """How many comparisons of a claim must hold, by the paper's words."""

    ALL = "all"
    """No exception: the sentence has none."""
    MOST = "most"
    """"In general", "overall", "almost all", "largely", "likely": three quarters."""
    SOME = "some"
    """"In some cases", "may", "can": one."""


class Verdict(Enum):
    """What the trials say about a claim."""

    AGREE = "agree"
    MIXED = "mixed"
    DISAGREE = "disagree"
    UNDECIDED = "undecided"
    """The verdict depends on comparisons that the intervals leave open."""


@dataclass(frozen=True)
class Comparison:
    """A measured difference, and what a claim expects of it.

    Attributes:
        row: Row of the claim's table: f, b and b_hat of the swarm.
        column: Column of the claim's table: what else the swarm is, and what it is compared with.
        interval: The difference with its confidence interval.
        expectation: What the claim says about the difference.
        size: Smallest difference that counts, in the same unit.
        is_strong: True if the whole interval, not only the difference, must be beyond the size.
    """

    row: str
    column: str
    interval: Interval
    expectation: Expectation
    size: float
    is_strong: bool = False

    @property
    def label(self) -> str:
        """Row and column in one line."""
        return f"{self.row}: {self.column}" if self.row else self.column

    @property
    def holds(self) -> bool | None:
        """True if the claim is right here, False if it is wrong, None if the interval leaves it open."""
        interval, size = self.interval, self.size
        # Below is above with the sign changed, so that no side is preferred.
        match self.expectation:
            case Expectation.ABOVE:
                return _holds_above(interval, size, self.is_strong)
            case Expectation.BELOW:
                return _holds_above(-interval, size, self.is_strong)
            case Expectation.NOT_BELOW:
                return _holds_not_below(interval, size)
            case Expectation.NOT_ABOVE:
                return _holds_not_below(-interval, size)
            case Expectation.SAME:
                return _holds_same(interval, size)


def exact_comparison(
    row: str, column: str, value: float, expectation: Expectation, size: float
) -> Comparison:
    """Return a comparison of numbers that are not subject to chance: its interval has no width."""
    return Comparison(row, column, Interval(value, value, value), expectation, size)


def _is_surely_above(interval: Interval, size: float) -> bool:
    """Return whether a difference is surely above 0 and large enough to count."""
    return interval.low > 0 and interval.value >= size


def _holds_above(interval: Interval, size: float, is_strong: bool) -> bool | None:
    """Return whether a difference is above 0 by the size; None if the interval leaves it open."""
    is_above = interval.low >= size if is_strong else _is_surely_above(interval, size)
    if is_above:
        return True
    return False if interval.high < size else None


def _holds_not_below(interval: Interval, size: float) -> bool | None:
    """Return whether a difference is not below 0 by the size; None if the interval leaves it open."""
    if interval.low > -size:
        return True
    return False if _is_surely_above(-interval, size) else None


def _holds_same(interval: Interval, size: float) -> bool | None:
    """Return whether a difference is within the size; None if the interval leaves it open."""
    if -size < interval.low and interval.high < size:
        return True
    differs = _is_surely_above(interval, size) or _is_surely_above(-interval, size)
    return False if differs else None


def count_holding(comparisons: Sequence[Comparison], holds: bool | None) -> int:
    """Count the comparisons that hold (True), fail (False) or are open (None)."""
    return sum(comparison.holds is holds for comparison in comparisons)


def verdict_of(comparisons: Sequence[Comparison], scope: Scope) -> Verdict:
    """Return the verdict to which every outcome of the open comparisons leads; UNDECIDED if they differ."""
    total = len(comparisons)
    holding, open_count = count_holding(comparisons, True), count_holding(comparisons, None)
    # Any number of the open comparisons may hold.
    possible_counts = range(holding, holding + open_count + 1)
    verdicts = {_verdict_of_count(count, total, scope) for count in possible_counts}
    return verdicts.pop() if len(verdicts) == 1 else Verdict.UNDECIDED


def _verdict_of_count(holding: int, total: int, scope: Scope) -> Verdict:
    """Return the verdict if ``holding`` of ``total`` comparisons hold and all others fail."""
    match scope:
        case Scope.SOME:
            return Verdict.AGREE if holding else Verdict.DISAGREE
        case Scope.MOST:
            agreeing_share, refuted_share = MOST_SHARE, 1 - MOST_SHARE
        case Scope.ALL:
            agreeing_share, refuted_share = 1.0, REFUTED_SHARE
    if holding >= agreeing_share * total:
        return Verdict.AGREE
    return Verdict.DISAGREE if holding <= refuted_share * total else Verdict.MIXED
