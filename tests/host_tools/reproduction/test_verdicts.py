"""How claims are judged: comparisons and verdicts."""

from __future__ import annotations

import pytest

from mcp_asdf_tools.reproduction.resampling import Estimate, exactly
from mcp_asdf_tools.reproduction.verdicts import Comparison, Expectation, Finding, Place, Scope, Verdict

ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW = Expectation
MIRRORED = {ABOVE: BELOW, BELOW: ABOVE, SAME: SAME, NOT_ABOVE: NOT_BELOW, NOT_BELOW: NOT_ABOVE}
HERE = Place("row", "column")


@pytest.mark.parametrize(
    ("numbers", "answers"),
    [
        # value, low, high; then whether ABOVE, BELOW, SAME, NOT_ABOVE, NOT_BELOW hold with a size of 2
        ((9, 5, 13), "yes no no no yes"),
        ((-9, -13, -5), "no yes no yes no"),
        ((0, -1, 1), "no no yes yes yes"),
        ((1, 0.5, 1.5), "no no yes yes yes"),  # sure, but too small to count
        ((3, 1, 5), "yes no no no yes"),
        ((2, 1, 5), "yes no no no yes"),
        ((2, 0, 5), "? no ? ? yes"),
        ((1, 0.5, 2), "? no ? ? yes"),
        ((1, -2, 1.5), "no ? ? yes ?"),
        ((1, 0.5, 5), "? no ? ? yes"),
        ((3, -3, 9), "? ? ? ? ?"),
    ],
)
def test_comparisons_are_judged_without_a_preferred_side(
    numbers: tuple[float, float, float], answers: str
) -> None:
    meaning = {"yes": True, "no": False, "?": None}
    for expectation, answer in zip(Expectation, answers.split(), strict=True):
        estimate = Estimate(*numbers)
        assert Comparison(HERE, estimate, expectation, 2).holds is meaning[answer], expectation
        assert Comparison(HERE, -estimate, MIRRORED[expectation], 2).holds is meaning[answer], expectation


def finding(right: int, wrong: int, undecided: int, scope: Scope) -> Finding:
    estimates = [Estimate(9, 8, 10)] * right + [exactly(-9)] * wrong + [Estimate(0, -9, 9)] * undecided
    return Finding([Comparison(HERE, each, ABOVE, 2) for each in estimates], scope)


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
def test_verdicts(counts: tuple[int, int, int], verdicts: str) -> None:
    for scope, verdict in zip(Scope, verdicts.split(), strict=True):
        found = finding(*counts, scope)
        assert found.verdict is Verdict(verdict), scope
        assert tuple(found.count(holds) for holds in (True, False, None)) == counts
