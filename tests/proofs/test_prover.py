"""The prover refuses claims that it has not proved: broken claims, undecided claims and empty claims."""

from __future__ import annotations

from typing import Any

import pytest
import z3

from proofs import prove as prover
from proofs.prove import (
    Claim,
    Contract,
    UnprovenError,
    always,
    prove,
    prove_all,
    prove_lemma,
    require_satisfiable,
)
from proofs.source import VARIANTS, program

NEVER = z3.BoolVal(False)
LARGE_PRIME = 16769023
CORTEX_M4 = VARIANTS[0]


def never(*_arguments: Any) -> z3.BoolRef:
    """Return a condition that nothing fulfils."""
    return NEVER


@pytest.fixture(autouse=True)
def _give_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prover, "STEP_LIMITS", (10**5,))


def factors_of_a_large_prime() -> tuple[Any, list[Any]]:
    """Return that the product of two numbers is a prime, and that both exceed 1, which is impossible."""
    p, q = z3.Ints("p q")
    return p * q == LARGE_PRIME, [p > 1, q > 1]


def test_a_claim_that_some_number_breaks_is_not_proved() -> None:
    """Not every integer is above 0. The error has a number that is not."""
    with pytest.raises(UnprovenError, match="broken by"):
        prove(z3.Int("p") > 0)


def test_a_claim_that_the_solver_cannot_settle_is_not_proved() -> None:
    """It is true: a prime has no factors. But the solver gives up before it has tried all numbers."""
    is_product, exceed_1 = factors_of_a_large_prime()
    with pytest.raises(UnprovenError, match="not settled"):
        prove(z3.Not(is_product), *exceed_1)


def test_premises_that_the_solver_cannot_satisfy_prove_nothing() -> None:
    """A prime has no factors, so no numbers fulfil these premises, and anything would follow.

    The solver gives up before it knows.
    """
    is_product, exceed_1 = factors_of_a_large_prime()
    with pytest.raises(UnprovenError, match="nothing is found"):
        require_satisfiable([is_product, *exceed_1], description="factors of a prime")


def test_premises_that_contradict_each_other_prove_nothing() -> None:
    """Everything follows from a contradiction. A real number may be between 0 and 1, and no integer is."""
    real, integer = z3.Real("p"), z3.Int("p")
    claims = [
        Claim("of reals", real * real < 1, [real > 0, real < 1]),
        Claim("of integers", NEVER, [integer > 0, integer < 1]),
    ]

    with pytest.raises(UnprovenError, match="of integers: nothing is found"):
        prove_all(claims)


def test_an_empty_list_of_claims_proves_nothing() -> None:
    """Otherwise a loop over claims that has lost them all would look like a proof."""
    with pytest.raises(UnprovenError, match="nothing is claimed"):
        prove_all([])


def test_a_contract_that_no_argument_meets_has_no_proof() -> None:
    """A claim about all arguments of an empty set says nothing about a function."""
    for_no_argument = Contract(always, requires=never)
    with pytest.raises(UnprovenError, match="nothing is found"):
        prove_lemma(program(CORTEX_M4), "add", {"add": for_no_argument})


def test_a_call_that_breaks_what_the_called_function_requires_has_no_proof() -> None:
    """multiply_high() calls multiply() with any numbers, and multiply() must here have a number above 7."""

    def first_number_is_above_7(first: Any, _second: Any) -> Any:
        return z3.UGT(first, 7)

    contracts = {
        "multiply_high": Contract(always, used_lemmas=("multiply",)),
        "multiply": Contract(always, requires=first_number_is_above_7),
    }

    with pytest.raises(UnprovenError, match="what multiply requires"):
        prove_lemma(program(CORTEX_M4), "multiply_high", contracts)


def test_a_function_that_was_proved_for_one_contract_is_not_taken_as_proved_for_another() -> None:
    """``prove_lemma`` adds to ``done_proofs`` what it has proved. add() never keeps the second contract."""
    code, done_proofs = program(CORTEX_M4), set[Any]()
    always_kept, never_kept = Contract(always), Contract(never)
    prove_lemma(code, "add", {"add": always_kept}, done_proofs)

    with pytest.raises(UnprovenError):
        prove_lemma(code, "add", {"add": never_kept}, done_proofs)
