"""The prover refuses what it has not proved: broken claims, undecided claims, and contracts of nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import z3

from proofs import arithmetic, solver
from proofs.integers import as_integers
from proofs.prove import Contract, always, prove_contract
from proofs.solver import UnprovenError, prove
from proofs.source import VARIANTS, program
from support import CORE

CODE = program(VARIANTS[0], CORE)


def never(*_arguments: Any) -> z3.BoolRef:
    """Return a condition that nothing fulfils."""
    return z3.BoolVal(False)


P, Q = z3.BitVecs("p q", 32)
ONE_OF_8_BITS, ONE_OF_16_BITS = z3.BitVecVal(1, 8), z3.BitVecVal(1, 16)


def unknown_function(sort: z3.BitVecSortRef) -> z3.FuncDeclRef:
    """Return an unknown function of a word, which has this sort as the result has."""
    return z3.Function("same", sort, sort)


@pytest.mark.parametrize(
    ("claim", "fact"),
    [
        pytest.param(z3.UGT(P, 0), z3.BoolVal(True), id="a word may be 0"),
        pytest.param(P * Q != 1, P == 3, id="a product may be 1 modulo 2^32"),
        pytest.param(
            z3.ULT(z3.SignExt(32, P) * z3.ZeroExt(32, Q), 2**32), Q == 1, id="a word may be negative"
        ),
        # A shift has given the word 8 zeros at its end, and they are cut off again.
        pytest.param(
            z3.Extract(39, 8, z3.ZeroExt(8, P) << 8) | 1 == P + 1, P * Q == 1, id="a word may end with a 1"
        ),
        pytest.param(
            z3.ZeroExt(8, z3.BitVec("same", 8)) == z3.BitVec("same", 16),
            P * Q == 0,
            id="words of one name and two sizes may differ",
        ),
        pytest.param(
            z3.ZeroExt(8, unknown_function(z3.BitVecSort(8))(ONE_OF_8_BITS))
            == unknown_function(z3.BitVecSort(16))(ONE_OF_16_BITS),
            P * Q == 0,
            id="functions of one name and two sizes may differ",
        ),
    ],
)
def test_a_claim_that_some_numbers_break_is_not_proved(claim: Any, fact: Any) -> None:
    """The error has such numbers. Where there is a product, words are translated to integers, without a size.

    Each claim but the first one would have a proof if the translation missed the case that the id states.
    """
    with pytest.raises(UnprovenError, match="broken by"):
        prove(claim, fact)


def test_a_claim_that_the_solver_cannot_settle_is_not_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is true: a prime has no factors. But the solver gives up before it has tried all numbers."""
    monkeypatch.setattr(solver, "STEP_LIMITS", (10**5,))
    p, q = z3.BitVecs("p q", 64)
    large_prime = 16769023
    with pytest.raises(UnprovenError, match="not settled"):
        prove(p * q != large_prime, z3.UGT(p, 1), z3.UGT(q, 1), z3.ULT(p, 2**31), z3.ULT(q, 2**31))


def test_the_error_about_a_claim_that_is_not_settled_names_what_has_no_translation_to_integers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Integers might have settled it, so whoever adds such code to the firmware may add the translation."""
    monkeypatch.setattr(solver, "STEP_LIMITS", (1,))
    p, q = z3.BitVecs("p q", 64)
    with pytest.raises(UnprovenError, match=r"not settled, .*; no translation to integers of bvxor"):
        prove(p * q != 35, p ^ q == 1)


def test_formulas_without_a_translation_to_integers_are_settled_as_words() -> None:
    """The translator does not know ^, so it refuses the facts here, and the solver gets no integers.

    The words still decide the claim by all facts: it has a proof if both words are equal, and else none.
    """
    p, q = z3.BitVecs("p q", 8)
    is_same, is_different = p ^ q == 0, p ^ q != 0
    for fact in (is_same, is_different):
        with pytest.raises(NotImplementedError, match="no translation to integers of bvxor"):
            as_integers([fact])

    prove(p * p == q * q, is_same)
    with pytest.raises(UnprovenError, match="broken by"):
        prove(p * p == q * q, is_different)


def test_a_contract_that_no_argument_meets_has_no_proof() -> None:
    """A claim about all arguments of an empty set says nothing about a function."""
    for_no_argument = Contract(always, requires=never)
    with pytest.raises(UnprovenError, match="nothing is found"):
        prove_contract(CODE, "add", {"add": for_no_argument})


def test_a_call_that_breaks_what_the_called_function_requires_has_no_proof() -> None:
    """multiply_high() calls multiply() with any numbers, and multiply() must here have a number above 7."""
    contracts = {
        "multiply_high": Contract(always, used_lemmas=("multiply",)),
        "multiply": Contract(always, requires=lambda first, _second: z3.UGT(first, 7)),
    }

    with pytest.raises(UnprovenError, match="what multiply requires"):
        prove_contract(CODE, "multiply_high", contracts)


def test_a_call_with_a_constant_for_which_a_lemma_has_no_proof_is_refused() -> None:
    """divide_24() calls take_digit() for 12 bits. Here take_digit() has a contract for 7 bits alone."""
    lemmas = arithmetic.contracts(VARIANTS[0])
    contracts = {**lemmas, "take_digit": replace(lemmas["take_digit"], constant_values=(7,))}

    with pytest.raises(UnprovenError, match="what take_digit requires"):
        prove_contract(CODE, "divide_24", contracts)
