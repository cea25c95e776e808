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

SIZE = 2
"""The smallest difference that counts."""

OPEN = None
"""A comparison whose interval does not say whether it holds."""

OPPOSITE = {
    Expectation.ABOVE: Expectation.BELOW,
    Expectation.BELOW: Expectation.ABOVE,
    Expectation.SAME: Expectation.SAME,
    Expectation.NOT_ABOVE: Expectation.NOT_BELOW,
    Expectation.NOT_BELOW: Expectation.NOT_ABOVE,
}


def comparison(interval: Interval, expectation: Expectation, is_strong: bool = False) -> Comparison:
    return Comparison("row", "column", interval, expectation, SIZE, is_strong)


class Outcomes(NamedTuple):
    """Whether a difference is as expected, for each of the five expectations."""

    above: bool | None
    below: bool | None
    same: bool | None
    not_above: bool | None
    not_below: bool | None


def outcomes(interval: Interval) -> Outcomes:
    """Compare a difference with each expectation."""
    return Outcomes(
        above=comparison(interval, Expectation.ABOVE).holds,
        below=comparison(interval, Expectation.BELOW).holds,
        same=comparison(interval, Expectation.SAME).holds,
        not_above=comparison(interval, Expectation.NOT_ABOVE).holds,
        not_below=comparison(interval, Expectation.NOT_BELOW).holds,
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
    """An interval has a difference, a lower and an upper end. A difference below 2 is too small to count."""
    assert outcomes(interval) == expected_outcomes


@pytest.mark.parametrize("expectation", Expectation)
@pytest.mark.parametrize("interval", [Interval(2, 1, 5), Interval(2, 0, 5), Interval(1, -2, 1.5)])
def test_a_negated_difference_gets_the_answer_of_the_opposite_expectation(
    interval: Interval, expectation: Expectation
) -> None:
    negated = comparison(-interval, OPPOSITE[expectation])
    assert negated.holds is comparison(interval, expectation).holds


@pytest.mark.parametrize(
    ("low", "holds_weakly", "holds_strongly"), [(1, True, OPEN), (2, True, True), (-1, OPEN, OPEN)]
)
def test_where_the_paper_says_much_the_whole_interval_must_reach_the_size_and_not_only_the_difference(
    low: float, holds_weakly: bool | None, holds_strongly: bool | None
) -> None:
    """The difference is 3, where the smallest that counts is 2."""
    interval = Interval(value=3, low=low, high=5)

    assert comparison(interval, Expectation.ABOVE).holds is holds_weakly
    assert comparison(interval, Expectation.ABOVE, is_strong=True).holds is holds_strongly
    assert comparison(-interval, Expectation.BELOW, is_strong=True).holds is holds_strongly


def test_an_exact_comparison_has_an_interval_without_width() -> None:
    exact = exact_comparison("row", "column", value=3, expectation=Expectation.ABOVE, size=SIZE)
    assert exact.interval == Interval(value=3, low=3, high=3)


def comparisons(holding: int, failing: int, open_count: int) -> list[Comparison]:
    """Make so many comparisons that expect a difference above 0."""
    surely_above, surely_below, anything = Interval(9, 8, 10), Interval(-9, -9, -9), Interval(0, -9, 9)
    intervals = [surely_above] * holding + [surely_below] * failing + [anything] * open_count
    return [comparison(interval, Expectation.ABOVE) for interval in intervals]


def test_comparisons_are_counted_by_whether_they_hold_fail_or_are_open() -> None:
    """``count_holding`` counts comparisons by ``holds``: True, False, or None if the comparison is open."""
    nine_comparisons = comparisons(holding=4, failing=3, open_count=2)

    assert count_holding(nine_comparisons, True) == 4
    assert count_holding(nine_comparisons, False) == 3
    assert count_holding(nine_comparisons, OPEN) == 2


AGREE, MIXED, DISAGREE, UNDECIDED = Verdict.AGREE, Verdict.MIXED, Verdict.DISAGREE, Verdict.UNDECIDED


class Verdicts(NamedTuple):
    """The verdicts on a claim by how many of its comparisons must hold."""

    all_must_hold: Verdict
    most_must_hold: Verdict
    some_must_hold: Verdict


def verdicts_of(holding: int, failing: int, open_count: int) -> Verdicts:
    """Return the verdicts on claims with so many comparisons."""
    compared = comparisons(holding, failing, open_count)
    return Verdicts(
        all_must_hold=verdict_of(compared, Scope.ALL),
        most_must_hold=verdict_of(compared, Scope.MOST),
        some_must_hold=verdict_of(compared, Scope.SOME),
    )


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
    assert verdicts_of(holding, failing, open_count) == verdicts


@pytest.mark.parametrize(("row", "label"), [("f 0.5", "f 0.5: H"), ("", "H")])
def test_the_label_of_a_comparison_is_its_row_if_it_has_one_and_its_column(row: str, label: str) -> None:
    assert exact_comparison(row, "H", 0, Expectation.SAME, SIZE).label == label
