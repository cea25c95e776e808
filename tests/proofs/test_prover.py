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
from proofs.source import CORE, VARIANTS, program

CODE = program(VARIANTS[0], CORE)


def never(*_arguments: Any) -> z3.BoolRef:
    """Return a condition that nothing fulfils."""
    return z3.BoolVal(False)


def test_a_claim_that_some_number_breaks_is_not_proved() -> None:
    """Not every word is above 0. The error has one that is not."""
    with pytest.raises(UnprovenError, match="broken by"):
        prove(z3.UGT(z3.BitVec("p", 32), 0))


def test_a_claim_that_the_solver_cannot_settle_is_not_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is true: a prime has no factors. But the solver gives up before it has tried all numbers."""
    monkeypatch.setattr(solver, "STEP_LIMITS", (10**5,))
    p, q = z3.BitVecs("p q", 64)
    large_prime = 16769023
    with pytest.raises(UnprovenError, match="not settled"):
        prove(p * q != large_prime, z3.UGT(p, 1), z3.UGT(q, 1), z3.ULT(p, 2**31), z3.ULT(q, 2**31))


def test_words_are_not_taken_for_integers_without_a_limit() -> None:
    """A product of two odd words may be 1 modulo 2^32, though none of them is."""
    p, q = z3.BitVecs("p q", 32)
    with pytest.raises(UnprovenError, match="broken by"):
        prove(p * q != 1, p == 3)


def test_a_negative_word_is_not_taken_for_a_positive_one() -> None:
    """Extended by its sign, a word of 32 bits may exceed 2^32, as only a negative one does."""
    p, q = z3.BitVec("p", 32), z3.BitVec("q", 64)
    with pytest.raises(UnprovenError, match="broken by"):
        prove(z3.ULT(z3.SignExt(32, p) * q, 2**32), q == 1)


def test_a_word_cut_out_of_a_shifted_one_is_not_taken_to_end_with_its_zeros() -> None:
    """The translation to integers takes a | b for a + b if a ends with at least as many zeros as b has bits.

    A shift has given the word 8 zeros at its end. They are cut off here, so that its lowest bit may be 1.
    """
    p, q = z3.BitVecs("p q", 32)
    without_zeros = z3.Extract(39, 8, z3.ZeroExt(8, p) << 8)
    with pytest.raises(UnprovenError, match="broken by"):
        prove(without_zeros | 1 == without_zeros + 1, p * q == 1)


@pytest.mark.parametrize("is_function", [False, True])
def test_unknowns_of_one_name_and_two_sizes_are_not_taken_for_one(is_function: bool) -> None:
    """A word that is translated to an integer, as it is where there is a product, loses its size.

    Functions of one name are also different if one takes a word of 8 bits and the other one of 16 bits.
    """
    p, q = z3.BitVecs("p q", 32)
    byte_sort, half_sort = z3.BitVecSort(8), z3.BitVecSort(16)
    if is_function:
        byte = z3.Function("same", byte_sort, byte_sort)(z3.BitVecVal(1, 8))
        half = z3.Function("same", half_sort, half_sort)(z3.BitVecVal(1, 16))
    else:
        byte, half = z3.BitVec("same", 8), z3.BitVec("same", 16)

    with pytest.raises(UnprovenError, match="broken by"):
        prove(z3.ZeroExt(8, byte) == half, p * q == 0)


def test_formulas_without_a_translation_to_integers_are_settled_as_words() -> None:
    """The translator does not know ^, so it refuses the facts here, and the solver gets no integers.

    The words still decide the claim by all facts: it has a proof if both words are equal, and else none.
    """
    p, q = z3.BitVecs("p q", 8)
    is_same, is_different = p ^ q == 0, p ^ q != 0
    for fact in (is_same, is_different):
        with pytest.raises(NotImplementedError):
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
