"""When a comparison holds, and what the comparisons of a claim together say about it.

A claim is a sentence of the paper, such as "ASDF+ is much better than no filter". It is compared in many
cells, which are kinds of swarms; each comparison is of a difference, and holds, fails or is open.
"""

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
    """A claim's statement about a difference; the value is its word in ``claims.toml``."""

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
    """The outcome of a claim's comparisons."""

    AGREE = "agree"
    MIXED = "mixed"
    DISAGREE = "disagree"
    UNDECIDED = "undecided"
    """The verdict depends on comparisons that the intervals leave open."""


@dataclass(frozen=True)
class Comparison:
    """A measured difference, and what a claim expects of it.

    Attributes:
        row: Label of the row in the claim's table: f, the share of black floor, b, the sensors' accuracy, and
            b_hat, the accuracy that flawed robots assume at the start.
        column: Label of the column in the claim's table: what is measured, of which swarm, and what is
            subtracted from it.
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
        """The labels of row and column in one line; that of the column alone if the row has none."""
        if not self.row:
            return self.column
        return f"{self.row}: {self.column}"

    @property
    def holds(self) -> bool | None:
        """True if the difference is as expected, False if it is not, None if the interval leaves it open."""
        interval, size = self.interval, self.size
        # "Below" is "above" for the negated difference, so that both have the same rule.
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
    """Return a comparison of a difference that is not subject to chance: its interval has no width."""
    interval = Interval(value=value, low=value, high=value)
    return Comparison(row, column, interval, expectation, size)


def _is_surely_above(interval: Interval, size: float) -> bool:
    """Return whether the whole interval is above 0 and the difference itself is at least the size."""
    return interval.low > 0 and interval.value >= size


def _holds_above(interval: Interval, size: float, is_strong: bool) -> bool | None:
    """Return whether a difference is above 0 by at least the size; None if the interval leaves it open.

    If the claim ``is_strong``, the whole interval must be at least the size; otherwise it is enough that the
    difference is, and that its interval is above 0.
    """
    surely_holds = interval.low >= size if is_strong else _is_surely_above(interval, size)
    if surely_holds:
        return True
    # It fails if not even the upper end of the interval is large enough.
    surely_fails = interval.high < size
    return False if surely_fails else None


def _holds_not_below(interval: Interval, size: float) -> bool | None:
    """Return whether a difference is above minus the size; None if the interval leaves it open.

    It is if all of the interval is. It is not if the interval is below 0, and the difference is minus the
    size or less.
    """
    if interval.low > -size:
        return True
    is_surely_below = _is_surely_above(-interval, size)
    if is_surely_below:
        return False
    return None


def _holds_same(interval: Interval, size: float) -> bool | None:
    """Return whether a difference lies between minus the size and the size; None if it is open.

    It does if all of the interval does. It does not if the interval is on one side of 0, and the difference
    is as far from 0 as the size, or farther.
    """
    if -size < interval.low and interval.high < size:
        return True
    is_surely_above = _is_surely_above(interval, size)
    is_surely_below = _is_surely_above(-interval, size)
    if is_surely_above or is_surely_below:
        return False
    return None


def count_holding(comparisons: Sequence[Comparison], holds: bool | None) -> int:
    """Count the comparisons that hold (True), fail (False) or are open (None)."""
    return sum(comparison.holds is holds for comparison in comparisons)


def verdict_of(comparisons: Sequence[Comparison], scope: Scope) -> Verdict:
    """Return the verdict on a claim of which ``scope`` says how many comparisons must hold.

    It is the verdict to which every outcome of the open comparisons leads, or UNDECIDED if they lead to
    different ones.
    """
    total = len(comparisons)
    holding_count = count_holding(comparisons, True)
    open_count = count_holding(comparisons, None)
    # If all were decided, any number of the open comparisons might hold.
    possible_counts = range(holding_count, holding_count + open_count + 1)
    verdicts = {_verdict_of_count(count, total, scope) for count in possible_counts}
    if len(verdicts) > 1:
        return Verdict.UNDECIDED
    (verdict,) = verdicts
    return verdict


def _verdict_of_count(holding_count: int, total: int, scope: Scope) -> Verdict:
    """Return the verdict if ``holding_count`` of ``total`` comparisons hold and all others fail.

    For SOME it is AGREE or DISAGREE: one that holds is enough. For MOST and ALL there is a share from which
    on the verdict is AGREE, a smaller one up to which it is DISAGREE, and MIXED between the two.
    """
    match scope:
        case Scope.SOME:
            return Verdict.AGREE if holding_count > 0 else Verdict.DISAGREE
        case Scope.MOST:
            agreeing_share = MOST_SHARE
            # As many that fail as would have to hold refute the claim.
            refuted_share = 1 - MOST_SHARE
        case Scope.ALL:
            agreeing_share = 1.0
            refuted_share = REFUTED_SHARE
    if holding_count >= agreeing_share * total:
        return Verdict.AGREE
    if holding_count <= refuted_share * total:
        return Verdict.DISAGREE
    return Verdict.MIXED
