"""x and x_bar are exact, no sum or product wraps, and the robust filter decides as exact arithmetic does but
for a margin: for all inputs. The limits of x_hat, alpha and b_hat are tried by ``mcp-asdf crosscheck``."""

from __future__ import annotations

import pytest

from proofs import calls, robust, sums
from proofs.formulas import CORE, LEMMA_SUMMARIES, RESULT_BITS, Claims
from proofs.prove import prove_all
from proofs.source import VARIANTS, Variant, program
from support import slow

CLAIMS_OF_THE_CODE = (*sums.OF_THE_CODE, *robust.OF_THE_CODE, *calls.OF_THE_CODE)
CLAIMS_OF_NUMBERS = (*sums.OF_THE_NUMBERS, *robust.OF_THE_NUMBERS)
SLOW_CLAIMS = (robust.exact_decision_claims,)

CALLEES_BY_FUNCTION = {
    "round_mean": ("quotient",),
    "informed_estimate": ("round_mean", "multiply"),
    "update_b_hat": tuple(RESULT_BITS),
    "robust_test_rejects": tuple(RESULT_BITS),
}
"""The functions that claims of the code are about, each with the callees that may compute anything there."""


def prove_claims_of_the_code(variants: tuple[Variant, ...]) -> int:
    """Prove all claims of the code in these variants, and return how many different texts they have.

    Variants whose functions have the same text need one proof.
    """
    proved_texts = set[str]()
    for variant in variants:
        code = program(variant, CORE)
        code_text = "\n".join(
            code.definition_text(name, {*callees, *LEMMA_SUMMARIES})
            for name, callees in CALLEES_BY_FUNCTION.items()
        )
        if code_text not in proved_texts:
            for claims in CLAIMS_OF_THE_CODE:
                prove_all(claims(code))
        proved_texts.add(code_text)
    return len(proved_texts)


def test_the_c_for_a_cortex_m4_computes_the_documented_integers() -> None:
    """A claim is a formula that z3 proves for every argument; it raises UnprovenError if one is broken."""
    cortex_m4 = VARIANTS[0]
    prove_claims_of_the_code((cortex_m4,))


@pytest.mark.slow
def test_the_c_of_every_target_computes_the_documented_integers() -> None:
    """A target chooses how to divide, multiply and shift; some choices change the text of the functions.

    ``prove_claims_of_the_code`` raises UnprovenError if a claim has no proof for one of the texts.
    """
    number_of_different_texts = prove_claims_of_the_code(VARIANTS)
    assert number_of_different_texts > 1


@pytest.mark.parametrize(
    "claims", [*(claims for claims in CLAIMS_OF_NUMBERS if claims not in SLOW_CLAIMS), *slow(SLOW_CLAIMS)]
)
def test_the_documented_integers_are_as_near_to_exact_numbers_as_stated(claims: Claims) -> None:
    """Each of ``claims`` is a formula about all integers in a range. A broken one raises UnprovenError."""
    prove_all(claims())
