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


@pytest.mark.slow
@pytest.mark.parametrize("variants", [VARIANTS[:1], VARIANTS], ids=["one", "all"])
def test_the_c_computes_the_numbers_that_the_proofs_of_its_errors_are_about(
    variants: tuple[Variant, ...],
) -> None:
    """In one or in every variant of its arithmetic; where two have the same text one proof is enough."""
    proved_texts = set[str]()
    for variant in variants:
        code = program(variant, CORE)
        text = "\n".join(code.text(name, {*opaque, *BY_LEMMA}) for name, opaque in FORMED.items())
        if text in proved_texts:
            continue

        for claims in OF_THE_CODE:
            prove_all(claims(code))

        proved_texts.add(text)
    if len(variants) > 1:
        assert len(proved_texts) > 1, "variants with different texts"


LONG = (accuracy.of_lengths, robust.of_the_decision)


@pytest.mark.parametrize(
    "claims", [*(claims for claims in OF_THE_NUMBERS if claims not in LONG), *slow(LONG)]
)
def test_roundings_are_within_their_limits(claims: Claims) -> None:
    prove_all(claims())


@pytest.mark.parametrize("b", [Fraction(1, 2) + Fraction(1, 2**12), Fraction(3, 5), Fraction(99, 100)])
def test_the_limits_of_a_confidence_after_tiles_of_both_colours_are_those_that_are_proved(
    b: Fraction,
) -> None:
    """The cross-check allows so much, docs/design.md states it, and it follows from each rounding's limit.

    A confidence, alpha, may be too small by the share ``below`` and too large by ``above``; b is the accuracy
    of the sensor, and one of two tiles was black.
    """
    below, above = bounds.alpha_error(1, 2, b)

    kept = (1 - accuracy.BELOW[0]) * (1 - accuracy.BELOW[1]) * (1 - accuracy.BELOW[2])
    assert below == 1 - kept < Fraction(1, 2**26)
    r = 1 / abs(2 * b - 1)
    assert above == (1 + r / 2**30) ** 2 / (1 - accuracy.DIVISOR_LOSES) - 1
    assert above < r / 2**29 + Fraction(1, 2**29)


@pytest.mark.parametrize("b", [Fraction(1, 2) + Fraction(1, 2**12), Fraction(3, 5), Fraction(99, 100)])
def test_the_limits_of_a_confidence_after_tiles_of_one_colour_are_those_that_are_proved(b: Fraction) -> None:
    """As in the test above, where none of two tiles was black."""
    below, above = bounds.alpha_error(0, 2, b)

    kept = 1 - accuracy.SUM_LOSES
    for share in accuracy.SQUARE_LOSES:
        kept *= 1 - share
    assert 1 - kept < below
    assert below == Fraction(1, 2**22) + Fraction(1, 2**27)
    assert above == accuracy.SQUARE_GAINS


@pytest.mark.parametrize("x_bar", [Fraction(0), Fraction(9, 20), Fraction(11, 20), Fraction(1)])
def test_the_limit_of_an_updated_accuracy_s_error_is_that_of_the_design(x_bar: Fraction) -> None:
    """The largest error of x_bar, what the neighbours estimate, made larger by eq. 8, and its quotient's own.

    In units of 2**-32.
    """
    error_of_x_bar = 4 * x_bar + 3 if x_bar > bounds.HALF else max(4 * x_bar + 2, Fraction(1))
    error_of_quotient = 7
    limit = (error_of_x_bar / abs(2 * x_bar - 1) + error_of_quotient) / 2**32

    assert bounds.b_hat_error(x_bar) == limit
    assert limit < Fraction(1, 2**26)
