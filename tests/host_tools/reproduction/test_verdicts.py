"""How claims are judged: comparisons and verdicts."""

from __future__ import annotations

from itertools import product

import pytest

from mcp_asdf_tools.reproduction.resampling import Estimate, exactly
from mcp_asdf_tools.reproduction.verdicts import (
    Comparison,
    Expectation,
    Finding,
    Place,
    Scope,
    Verdict,
)

ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW = Expectation
HERE = Place("row", "column")


# --- Comparisons -----------------------------------------------------------------------------------------

CASES: list[tuple[tuple[float, float, float], str]] = [
    # value, low, high; then whether ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW hold with a size of 2
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
        assert Comparison(HERE, Estimate(*numbers), expectation, 2).holds is meaning[answer], expectation


@pytest.mark.parametrize(("numbers", "answers"), CASES)
def test_judgement_has_no_preferred_side(numbers: tuple[float, float, float], answers: str) -> None:
    mirrored = {ABOVE: BELOW, BELOW: ABOVE, SAME: SAME, NOT_ABOVE: NOT_BELOW, NOT_BELOW: NOT_ABOVE}
    for expectation, other in mirrored.items():
        here = Comparison(HERE, Estimate(*numbers), expectation, 2).holds
        assert here is Comparison(HERE, -Estimate(*numbers), other, 2).holds


# --- Verdicts --------------------------------------------------------------------------------------------


def finding(right: int, wrong: int, undecided: int, scope: Scope) -> Finding:
    estimates = [Estimate(9, 8, 10)] * right + [exactly(-9)] * wrong + [Estimate(0, -9, 9)] * undecided
    return Finding([Comparison(HERE, each, ABOVE, 2) for each in estimates], scope)


@pytest.mark.parametrize(
    ("counts", "verdicts"),
    [
        ((4, 0, 0), "agree agree agree"),
        ((3, 0, 1), "agree agree agree"),
        ((3, 1, 0), "mixed agree agree"),
        ((11, 1, 0), "mixed agree agree"),
        ((2, 0, 2), "undecided undecided agree"),
        ((1, 3, 0), "mixed disagree agree"),
        ((3, 9, 0), "mixed disagree agree"),
        ((2, 22, 0), "disagree disagree agree"),
        ((0, 3, 1), "disagree disagree undecided"),
        ((0, 4, 0), "disagree disagree disagree"),
        ((0, 0, 4), "undecided undecided undecided"),
        ((2, 2, 0), "mixed mixed agree"),
        ((1, 0, 0), "agree agree agree"),
        ((0, 1, 0), "disagree disagree disagree"),
    ],
)
def test_verdicts(counts: tuple[int, int, int], verdicts: str) -> None:
    for scope, verdict in zip(Scope, verdicts.split(), strict=True):
        found = finding(*counts, scope)
        assert found.verdict is Verdict(verdict), scope
        assert tuple(found.count(holds) for holds in (True, False, None)) == counts


def test_verdicts_follow_the_words() -> None:
    """A sentence without exceptions has none, none that holds is never mixed, and a hedge only helps."""
    order = [Verdict.DISAGREE, Verdict.MIXED, Verdict.AGREE]
    for right, wrong in product(range(13), repeat=2):
        if not right + wrong:
            continue
        everything, most, some = (finding(right, wrong, 0, scope).verdict for scope in Scope)
        assert (everything is Verdict.AGREE) == (not wrong)
        assert right or everything is most is some is Verdict.DISAGREE
        assert wrong or everything is most is some is Verdict.AGREE
        assert order.index(some) >= order.index(most)
        if most is Verdict.AGREE or everything is Verdict.AGREE:
            assert order.index(most) >= order.index(everything)


def test_sizes_can_be_scaled() -> None:
    found = Finding([Comparison(HERE, Estimate(9, 8, 10), ABOVE, 10)])
    assert found.verdict is Verdict.UNDECIDED
    assert found.scaled(0.5).verdict is Verdict.AGREE
    assert found.scaled(2).verdict is Verdict.DISAGREE
