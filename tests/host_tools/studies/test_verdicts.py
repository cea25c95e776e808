"""When comparisons hold, and the verdicts that follow."""

from __future__ import annotations

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

ANSWERS = [
    # value, low, high; whether ABOVE, BELOW, SAME, NOT_ABOVE and NOT_BELOW hold
    ((9, 5, 13), "yes no no no yes"),
    ((-9, -13, -5), "no yes no yes no"),
    ((0, -1, 1), "no no yes yes yes"),
    ((1, 0.5, 1.5), "no no yes yes yes"),  # surely above 0, but too small to count
    ((3, 1, 5), "yes no no no yes"),
    ((2, 1, 5), "yes no no no yes"),
    ((2, 0, 5), "? no ? ? yes"),
    ((1, 0.5, 2), "? no ? ? yes"),
    ((1, -2, 1.5), "no ? ? yes ?"),
    ((1, 0.5, 5), "? no ? ? yes"),
    ((3, -3, 9), "? ? ? ? ?"),
]
HOLDS = {"yes": True, "no": False, "?": None}
CASES = [
    pytest.param(Interval(*numbers), expectation, HOLDS[answer], id=f"{numbers} {expectation.value}")
    for numbers, answers in ANSWERS
    for expectation, answer in zip(Expectation, answers.split(), strict=True)
]
MIRRORED = {
    Expectation.ABOVE: Expectation.BELOW,
    Expectation.BELOW: Expectation.ABOVE,
    Expectation.SAME: Expectation.SAME,
    Expectation.NOT_ABOVE: Expectation.NOT_BELOW,
    Expectation.NOT_BELOW: Expectation.NOT_ABOVE,
}


def comparison(interval: Interval, expectation: Expectation, is_strong: bool = False) -> Comparison:
    return Comparison("row", "column", interval, expectation, SIZE, is_strong)


@pytest.mark.parametrize(("interval", "expectation", "holds"), CASES)
def test_a_comparison_holds_if_its_whole_interval_is_on_the_expected_side(
    interval: Interval, expectation: Expectation, holds: bool | None
) -> None:
    assert comparison(interval, expectation).holds is holds


@pytest.mark.parametrize(("interval", "expectation", "holds"), CASES)
def test_a_difference_in_the_other_direction_gets_the_same_answer(
    interval: Interval, expectation: Expectation, holds: bool | None
) -> None:
    assert comparison(-interval, MIRRORED[expectation]).holds is holds


@pytest.mark.parametrize(
    ("low", "holds_weakly", "holds_strongly"), [(1, True, None), (2, True, True), (-1, None, None)]
)
def test_a_strong_word_bounds_the_whole_interval(
    low: float, holds_weakly: bool | None, holds_strongly: bool | None
) -> None:
    interval = Interval(3, low, 5)
    assert comparison(interval, Expectation.ABOVE).holds is holds_weakly
    assert comparison(interval, Expectation.ABOVE, is_strong=True).holds is holds_strongly
    assert comparison(-interval, Expectation.BELOW, is_strong=True).holds is holds_strongly


def test_an_exact_comparison_has_an_interval_without_width() -> None:
    assert exact_comparison("", "column", 3, Expectation.ABOVE, SIZE).interval == (3, 3, 3)


def comparisons(holding: int, failing: int, open_count: int) -> list[Comparison]:
    intervals = [
        *[Interval(9, 8, 10)] * holding,
        *[Interval(-9, -9, -9)] * failing,
        *[Interval(0, -9, 9)] * open_count,
    ]
    return [comparison(interval, Expectation.ABOVE) for interval in intervals]


def test_comparisons_are_counted_by_outcome() -> None:
    mixed = comparisons(4, 3, 2)
    assert [count_holding(mixed, holds) for holds in (True, False, None)] == [4, 3, 2]


@pytest.mark.parametrize(
    ("counts", "verdicts"),
    [
        # holding, failing, open; then the verdicts if all, most and some must hold
        ((4, 0, 0), "agree agree agree"),
        ((3, 0, 1), "undecided agree agree"),
        ((19, 1, 1), "mixed agree agree"),
        ((2, 1, 1), "mixed undecided agree"),
        ((3, 1, 0), "mixed agree agree"),
        ((2, 0, 2), "undecided undecided agree"),
        ((1, 3, 0), "mixed disagree agree"),
        ((3, 9, 0), "mixed disagree agree"),
        ((1, 9, 0), "disagree disagree agree"),
        ((0, 3, 1), "undecided disagree undecided"),
        ((0, 30, 1), "disagree disagree undecided"),
        ((0, 4, 0), "disagree disagree disagree"),
        ((2, 2, 0), "mixed mixed agree"),
    ],
)
def test_the_verdict_follows_from_the_counts_and_the_scope(
    counts: tuple[int, int, int], verdicts: str
) -> None:
    assert [verdict_of(comparisons(*counts), scope).value for scope in Scope] == verdicts.split()


def test_a_label_is_row_and_column() -> None:
    assert Comparison("f 0.5", "H", Interval(0, 0, 0), Expectation.SAME, SIZE).label == "f 0.5: H"
    assert Comparison("", "H", Interval(0, 0, 0), Expectation.SAME, SIZE).label == "H"


def test_verdicts_are_words_of_the_report() -> None:
    assert [verdict.value for verdict in Verdict] == ["agree", "mixed", "disagree", "undecided"]
