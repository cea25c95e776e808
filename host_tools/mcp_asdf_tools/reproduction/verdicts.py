"""Judgements: when a comparison holds, and what many comparisons make of a claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from mcp_asdf_tools.reproduction.resampling import Estimate

CONFIDENCE = 0.95
"""That none of a claim's comparisons is decided wrongly."""

MOST = 0.75
"""Share of comparisons that must hold for what the paper says "in general"."""

FEW = 0.1
"""Share of holding comparisons up to which a claim without exceptions is not mixed but wrong."""


class Expectation(Enum):
    """Claimed result of a comparison."""

    ABOVE = "above"
    BELOW = "below"
    SAME = "the same"
    NOT_ABOVE = "not above"
    NOT_BELOW = "not below"


class Scope(Enum):
    """How many comparisons a claim is about, by its words."""

    ALL = "all"
    """No exception: the sentence has none."""
    MOST = "most"
    """"In general", "overall", "almost all", "largely", "likely": three quarters."""
    SOME = "some"
    """"In some cases", "may", "can": one."""


class Verdict(Enum):
    """Verdict on a claim."""

    AGREE = "agree"
    MIXED = "mixed"
    DISAGREE = "disagree"
    UNDECIDED = "undecided"
    """Another verdict would follow if comparisons that are open held, or if they failed."""


class Place(NamedTuple):
    """Where a comparison is shown: row and column of its claim's table."""

    row: str
    column: str


@dataclass(frozen=True)
class Comparison:
    """One difference and what it should be.

    Attributes:
        place: Which cells are compared, in words.
        estimate: The difference.
        expectation: What the claim says of it.
        size: From which it counts, in the same unit.
        is_strong: True if the interval, not only the difference, must be beyond the size.
        share: Of trials in which the first cell is better, where those of a cell fall into two groups.
    """

    place: Place
    estimate: Estimate
    expectation: Expectation
    size: float
    is_strong: bool = False
    share: float | None = None

    @property
    def label(self) -> str:
        """Which cells are compared, in a line."""
        return ": ".join(filter(None, self.place))

    @property
    def holds(self) -> bool | None:
        """True if the claim is right here; None if the interval leaves it open."""
        expectation, size = self.expectation, self.size
        is_turned = expectation in (Expectation.BELOW, Expectation.NOT_ABOVE)
        ours = -self.estimate if is_turned else self.estimate
        if expectation in (Expectation.ABOVE, Expectation.BELOW):
            is_right = ours.low >= size if self.is_strong else _is_above(ours, size)
            return _decided(is_right, ours.high < size)
        if expectation is Expectation.SAME:
            is_off = _is_above(ours, size) or _is_above(-ours, size)
            return _decided(-size < ours.low and ours.high < size, is_off)
        return _decided(ours.low > -size, _is_above(-ours, size))


def _is_above(estimate: Estimate, size: float) -> bool:
    """Surely above 0, and enough to count."""
    return estimate.low > 0 and estimate.value >= size


def _decided(is_right: bool, is_wrong: bool) -> bool | None:
    return True if is_right else False if is_wrong else None


@dataclass(frozen=True)
class Finding:
    """Results of a claim's comparisons, at least one."""

    comparisons: Sequence[Comparison]
    scope: Scope = Scope.ALL

    def count(self, holds: bool | None) -> int:
        """How many comparisons hold (True), fail (False) or are open (None)."""
        return sum(each.holds is holds for each in self.comparisons)

    def scaled(self, factor: float) -> Finding:
        """The same with all sizes multiplied."""
        scaled = [replace(each, size=factor * each.size) for each in self.comparisons]
        return Finding(scaled, self.scope)

    @property
    def verdict(self) -> Verdict:
        """The one that follows however the open comparisons turn out."""
        right = self.count(True)
        outcomes = {self._verdict(right + more) for more in range(self.count(None) + 1)}
        return outcomes.pop() if len(outcomes) == 1 else Verdict.UNDECIDED

    def _verdict(self, right: int) -> Verdict:
        """If so many comparisons hold and all others fail."""
        total = len(self.comparisons)
        if self.scope is Scope.SOME:
            return Verdict.AGREE if right else Verdict.DISAGREE
        least, most = (1.0, FEW) if self.scope is Scope.ALL else (MOST, 1 - MOST)
        if right >= least * total:
            return Verdict.AGREE
        return Verdict.DISAGREE if right <= most * total else Verdict.MIXED
