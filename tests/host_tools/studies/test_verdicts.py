"""When comparisons hold, and the verdicts that follow.

A comparison is a difference with its interval, of which a claim says that it is above 0, below 0 and so on.
"""

from __future__ import annotations

from typing import NamedTuple

import pytest

from mcp_asdf_tools.studies.bootstrap import Interval
from mcp_asdf_tools.studies.verdicts import (
    Comparison,
    Expectation,
    Scope,
    Verdict,
    count_holding,
    exact_comparison,
    verdict_of,
)

OPEN = None
"""A comparison whose interval does not say whether it holds."""


def compare_with_zero(interval: Interval, expectation: Expectation, is_strong: bool = False) -> Comparison:
    """Make a comparison of a difference with an interval. The smallest difference that counts is 2."""
    return Comparison("row", "column", interval, expectation, size=2, is_strong=is_strong)


class Outcomes(NamedTuple):
    """Whether a difference is as expected, for each of the five expectations."""

    above: bool | None
    below: bool | None
    same: bool | None
    not_above: bool | None
    not_below: bool | None


def compare_by_each_expectation(interval: Interval) -> Outcomes:
    """Return whether a difference is as expected, for each expectation."""
    return Outcomes(
        above=compare_with_zero(interval, Expectation.ABOVE).holds,
        below=compare_with_zero(interval, Expectation.BELOW).holds,
        same=compare_with_zero(interval, Expectation.SAME).holds,
        not_above=compare_with_zero(interval, Expectation.NOT_ABOVE).holds,
        not_below=compare_with_zero(interval, Expectation.NOT_BELOW).holds,
    )


@pytest.mark.parametrize(
    ("interval", "expected_outcomes"),
    [
        # above 0, below 0, the same, not above 0, not below 0
        (Interval(9, 5, 13), Outcomes(True, False, False, False, True)),
        (Interval(-9, -13, -5), Outcomes(False, True, False, True, False)),
        (Interval(0, -1, 1), Outcomes(False, False, True, True, True)),
        (Interval(1, 0.5, 1.5), Outcomes(False, False, True, True, True)),  # above 0, but too small to count
        (Interval(2, 1, 5), Outcomes(True, False, False, False, True)),
        (Interval(2, 0, 5), Outcomes(OPEN, False, OPEN, OPEN, True)),
        (Interval(1, 0.5, 2), Outcomes(OPEN, False, OPEN, OPEN, True)),
        (Interval(1, -2, 1.5), Outcomes(False, OPEN, OPEN, True, OPEN)),
        (Interval(3, -3, 9), Outcomes(OPEN, OPEN, OPEN, OPEN, OPEN)),
    ],
)
def test_a_comparison_holds_if_its_interval_is_on_the_expected_side_and_the_difference_large_enough(
    interval: Interval, expected_outcomes: Outcomes
) -> None:
    """An interval has a difference, a lower and an upper end. A difference below 2 is too small to count.

    An outcome is True if the comparison holds, False if it fails, and None if the interval leaves it open.
    """
    assert compare_by_each_expectation(interval) == expected_outcomes


@pytest.mark.parametrize(
    ("low", "holds_weakly", "holds_strongly"), [(1, True, OPEN), (2, True, True), (-1, OPEN, OPEN)]
)
def test_where_the_paper_says_much_the_whole_interval_must_reach_the_size_and_not_only_the_difference(
    low: float, holds_weakly: bool | None, holds_strongly: bool | None
) -> None:
    """The difference is 3, and the smallest that counts is 2. The same is true of a difference of -3."""
    interval = Interval(value=3, low=low, high=5)

    weak_comparison = compare_with_zero(interval, Expectation.ABOVE, is_strong=False)
    strong_comparison = compare_with_zero(interval, Expectation.ABOVE, is_strong=True)
    strong_comparison_of_negative = compare_with_zero(-interval, Expectation.BELOW, is_strong=True)

    assert weak_comparison.holds is holds_weakly
    assert strong_comparison.holds is holds_strongly
    assert strong_comparison_of_negative.holds is holds_strongly


def test_an_exact_comparison_has_an_interval_without_width() -> None:
    """An exact comparison is of a number that equations give, which is not subject to chance."""
    exact = exact_comparison("row", "column", value=3, expectation=Expectation.ABOVE, size=2)
    assert exact.interval == Interval(value=3, low=3, high=3)


def make_comparisons(holding: int, failing: int, open_count: int) -> list[Comparison]:
    """Make comparisons that expect a difference above 0. So many hold, so many fail, the rest is open."""
    surely_above, surely_below, on_both_sides = Interval(9, 8, 10), Interval(-9, -9, -9), Interval(0, -9, 9)
    intervals = [surely_above] * holding + [surely_below] * failing + [on_both_sides] * open_count
    return [compare_with_zero(interval, Expectation.ABOVE) for interval in intervals]


def test_comparisons_are_counted_by_whether_they_hold_fail_or_are_open() -> None:
    """``count_holding`` counts comparisons by ``holds``: True, False, or None if the comparison is open."""
    nine_comparisons = make_comparisons(holding=4, failing=3, open_count=2)

    assert count_holding(nine_comparisons, holds=True) == 4
    assert count_holding(nine_comparisons, holds=False) == 3
    assert count_holding(nine_comparisons, holds=None) == 2


AGREE, MIXED, DISAGREE, UNDECIDED = Verdict.AGREE, Verdict.MIXED, Verdict.DISAGREE, Verdict.UNDECIDED


class Verdicts(NamedTuple):
    """The verdicts on a claim by how many of its comparisons must hold."""

    all_must_hold: Verdict
    most_must_hold: Verdict
    some_must_hold: Verdict


@pytest.mark.parametrize(
    ("holding", "failing", "open_count", "verdicts"),
    [
        # if all must hold, if most must, if some must
        (4, 0, 0, Verdicts(AGREE, AGREE, AGREE)),
        (3, 0, 1, Verdicts(UNDECIDED, AGREE, AGREE)),
        (19, 1, 1, Verdicts(MIXED, AGREE, AGREE)),
        (2, 1, 1, Verdicts(MIXED, UNDECIDED, AGREE)),
        (3, 1, 0, Verdicts(MIXED, AGREE, AGREE)),
        (2, 0, 2, Verdicts(UNDECIDED, UNDECIDED, AGREE)),
        (1, 3, 0, Verdicts(MIXED, DISAGREE, AGREE)),
        (1, 9, 0, Verdicts(DISAGREE, DISAGREE, AGREE)),
        (0, 3, 1, Verdicts(UNDECIDED, DISAGREE, UNDECIDED)),
        (0, 30, 1, Verdicts(DISAGREE, DISAGREE, UNDECIDED)),
        (0, 4, 0, Verdicts(DISAGREE, DISAGREE, DISAGREE)),
        (2, 2, 0, Verdicts(MIXED, MIXED, AGREE)),
    ],
)
def test_the_verdict_follows_from_how_many_comparisons_hold_and_from_how_many_the_claim_says(
    holding: int, failing: int, open_count: int, verdicts: Verdicts
) -> None:
    """For "most", three quarters must hold. UNDECIDED means that open comparisons may change the verdict."""
    comparisons = make_comparisons(holding=holding, failing=failing, open_count=open_count)

    assert verdict_of(comparisons, Scope.ALL) is verdicts.all_must_hold
    assert verdict_of(comparisons, Scope.MOST) is verdicts.most_must_hold
    assert verdict_of(comparisons, Scope.SOME) is verdicts.some_must_hold


@pytest.mark.parametrize(("row", "label"), [("f 0.5", "f 0.5: H"), ("", "H")])
def test_the_label_of_a_comparison_is_its_row_if_it_has_one_and_its_column(row: str, label: str) -> None:
    """The column is "H". The row is "f 0.5", or is empty."""
    comparison = exact_comparison(row, column="H", value=0, expectation=Expectation.SAME, size=2)
    assert comparison.label == label
