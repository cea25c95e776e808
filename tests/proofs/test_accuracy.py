"""The errors of x_hat, alpha, x_bar and b_hat, for all inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path

import pytest

import exact
from proofs.accuracy import (
    BELOW,
    DIVISOR_LOSES,
    SQUARE_GAINS,
    SQUARE_LOSES,
    SUM_LOSES,
    Claim,
    of_alpha,
    of_alpha_at_an_end,
    of_b_hat,
    of_estimate,
    of_quotient,
    of_reestimate,
    of_set_b_hat,
    of_square_of_ratio,
    of_squares,
    of_x_hat,
)
from proofs.core import CORE
from proofs.prove import UnprovenError, prove, refuse_contradiction
from proofs.source import VARIANTS, Program, program

OF_THE_CODE = {
    "estimate": of_estimate,
    "reestimate": of_reestimate,
    "set_b_hat": of_set_b_hat,
    "square_of_ratio": of_square_of_ratio,
}


def prove_all(claims: Iterable[Claim]) -> None:
    """Each claim from what is known of it, which must not contradict itself."""
    checked: set[int] = set()
    for about, claim, known in claims:
        if len(known) not in checked:
            refuse_contradiction(known, about)
        checked.add(len(known))
        prove(claim, *known, about=about)
    assert checked


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_THE_CODE)
def test_the_code_forms_these_numbers(name: str) -> None:
    """In each text that it has in some variant; what it calls is known by lemmas, which all variants keep."""
    texts = set()
    for variant in VARIANTS:
        code = program(variant, CORE)
        text = code.text(name, code.callees(name))
        if text not in texts:
            prove_all(OF_THE_CODE[name](code))
        texts.add(text)
    assert texts


def test_the_code_of_one_target_forms_these_numbers() -> None:
    """Of estimate() what is inside the scale, which is quick."""
    prove_all(islice(of_estimate(program(VARIANTS[0], CORE)), 12))
    prove_all(of_reestimate(program(VARIANTS[0], CORE)))
    prove_all(of_set_b_hat(program(VARIANTS[0], CORE)))
    prove_all(of_square_of_ratio(program(VARIANTS[0], CORE)))


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("total - 2U * least", "total - least"),
        ("rarer - least, g_shift", "rarer - least, 0"),
        ("scale >> 1) >> 2", "scale >> 1) >> 3"),
        ("(16U - g_shift) - shift + spread_shift", "(16U - g_shift) + shift + spread_shift"),
        ("(n - white) ^", "(n + white) ^"),
        ("exponent += excess", "exponent -= excess"),
        ("exponent += accuracy->rare_shift", "exponent -= accuracy->rare_shift"),
        ("exponent -= 32U", "exponent -= 31U"),
        ("multiply(t - part, accuracy->common)", "multiply(t, accuracy->common)"),
        ("2U * c_shift", "c_shift"),
        ("multiply_high(ratio, ratio)", "multiply_high(ratio, g)"),
        ("shift_left(g, g_shift), 0U - c)", "shift_left(g, g_shift), c)"),
        ("a = ~a;", "a = 0U - a;"),
        ("n = t - n;", "n = t + n;"),
        ("multiply(t, 0U - a)", "multiply(t, a)"),
        ("above < span ? above : span", "above"),
        ("b_hat < MCP_ASDF_B_HAT_MAX ? b_hat", "b_hat <= MCP_ASDF_B_HAT_MIN ? b_hat"),
    ],
)
def test_other_numbers_are_noticed(right: str, wrong: str, tmp_path: Path) -> None:
    text = CORE.read_text(encoding="utf-8")
    assert right in text
    path = tmp_path / CORE.name
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    with pytest.raises(UnprovenError):
        for claims in OF_THE_CODE.values():
            for about, claim, known in claims(Program(path, VARIANTS[0])):
                prove(claim, *known, about=about)


@pytest.mark.parametrize(
    "claims", [of_x_hat, of_alpha, of_squares, of_alpha_at_an_end, of_quotient, of_b_hat]
)
def test_roundings_are_within_their_limits(claims: Callable[[], Iterator[Claim]]) -> None:
    prove_all(claims())


@pytest.mark.parametrize("b", [Fraction(1, 2) + Fraction(1, 2**12), Fraction(3, 5), Fraction(99, 100)])
def test_the_limits_are_those_of_the_design(b: Fraction) -> None:
    """The roundings' shares, multiplied, are what tests/exact.py allows and docs/design.md states."""
    below, above = exact.alpha_error(1, 2, b)
    r = 1 / abs(2 * b - 1)
    kept = (1 - BELOW[0]) * (1 - BELOW[1]) * (1 - BELOW[2])
    assert below == 1 - kept < Fraction(1, 2**26)
    assert above == (1 + r / 2**30) ** 2 / (1 - DIVISOR_LOSES) - 1
    assert above < r / 2**29 + Fraction(1, 2**29)
    below, above = exact.alpha_error(0, 2, b)
    kept = (1 - SUM_LOSES) * (1 - SQUARE_LOSES[0]) * (1 - SQUARE_LOSES[1]) * (1 - SQUARE_LOSES[2])
    assert 1 - kept < below == Fraction(1, 2**22) + Fraction(1, 2**27)
    assert above == SQUARE_GAINS


@pytest.mark.parametrize("x_bar", [Fraction(0), Fraction(9, 20), Fraction(11, 20), Fraction(1)])
def test_the_limit_of_b_hat_is_that_of_the_design(x_bar: Fraction) -> None:
    """Error of x_bar at most, made larger by eq. 8, and the loss in its quotient."""
    off = 4 * x_bar + 3 if x_bar > exact.HALF else max(4 * x_bar + 2, Fraction(1))
    limit = (off / abs(2 * x_bar - 1) + 7) / 2**32
    assert exact.b_hat_error(x_bar) == limit < Fraction(1, 2**26)
