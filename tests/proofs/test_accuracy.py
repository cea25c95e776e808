"""x and x_bar are exact, the errors of x_hat, alpha and b_hat have limits, and the robust filter decides as
exact arithmetic does, but for a margin: for all inputs."""

from __future__ import annotations

from fractions import Fraction

import pytest

from mcp_asdf_tools.crosscheck import bounds
from proofs import accuracy, calls, robust, sums
from proofs.formulas import BY_LEMMA, CORE, RESULTS, Claims
from proofs.prove import prove_all
from proofs.source import VARIANTS, Variant, program
from support import slow

OF_THE_CODE = (*accuracy.OF_THE_CODE, *sums.OF_THE_CODE, *robust.OF_THE_CODE, *calls.OF_THE_CODE)
OF_THE_NUMBERS = (*accuracy.OF_THE_NUMBERS, *sums.OF_THE_NUMBERS, *robust.OF_THE_NUMBERS)


FORMED = {
    **dict.fromkeys(("estimate", "set_b_hat", "square_of_ratio"), tuple(RESULTS)),
    **dict.fromkeys(("reestimate", "update_b_hat", "robust_test_rejects"), tuple(RESULTS)),
    "round_mean": ("quotient",),
    "informed_estimate": ("round_mean", "multiply"),
}
"""Functions that claims are about, and those that they call, of which nothing is known."""


@pytest.mark.parametrize("variants", [VARIANTS[:1], *slow([(VARIANTS,)])], ids=["one", "all"])
def test_the_code_forms_these_numbers(variants: tuple[Variant, ...]) -> None:
    """In every variant; equal texts need one proof."""
    done = set[str]()
    for variant in variants:
        code = program(variant, CORE)
        text = "\n".join(code.text(name, {*opaque, *BY_LEMMA}) for name, opaque in FORMED.items())
        for claims in OF_THE_CODE if text not in done else ():
            prove_all(claims(code))
        done.add(text)
    assert len(done) > 1 or len(variants) == 1


LONG = (accuracy.of_lengths, robust.of_the_decision)


@pytest.mark.parametrize(
    "claims", [*(claims for claims in OF_THE_NUMBERS if claims not in LONG), *slow(LONG)]
)
def test_roundings_are_within_their_limits(claims: Claims) -> None:
    prove_all(claims())


@pytest.mark.parametrize("b", [Fraction(1, 2) + Fraction(1, 2**12), Fraction(3, 5), Fraction(99, 100)])
def test_the_limits_are_those_of_the_design(b: Fraction) -> None:
    """The roundings' shares, multiplied, are what the cross-check allows and the page of accuracy states."""
    below, above = bounds.alpha_error(1, 2, b)
    r = 1 / abs(2 * b - 1)
    kept = (1 - accuracy.BELOW[0]) * (1 - accuracy.BELOW[1]) * (1 - accuracy.BELOW[2])
    assert below == 1 - kept < Fraction(1, 2**26)
    assert above == (1 + r / 2**30) ** 2 / (1 - accuracy.DIVISOR_LOSES) - 1
    assert above < r / 2**29 + Fraction(1, 2**29)
    below, above = bounds.alpha_error(0, 2, b)
    kept = 1 - accuracy.SUM_LOSES
    for share in accuracy.SQUARE_LOSES:
        kept *= 1 - share
    assert 1 - kept < below == Fraction(1, 2**22) + Fraction(1, 2**27)
    assert above == accuracy.SQUARE_GAINS


@pytest.mark.parametrize("x_bar", [Fraction(0), Fraction(9, 20), Fraction(11, 20), Fraction(1)])
def test_the_limit_of_b_hat_is_that_of_the_design(x_bar: Fraction) -> None:
    """Error of x_bar at most, made larger by eq. 8, and the loss in its quotient."""
    off = 4 * x_bar + 3 if x_bar > bounds.HALF else max(4 * x_bar + 2, Fraction(1))
    limit = (off / abs(2 * x_bar - 1) + 7) / 2**32
    assert bounds.b_hat_error(x_bar) == limit < Fraction(1, 2**26)
