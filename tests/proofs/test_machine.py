"""The machine executes C as the standard defines it.

A right claim about a function has a proof. A wrong claim is refused, and so is code whose behaviour C leaves
undefined. Each case is a function of two unknown words, a and b.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import z3

from proofs.prove import Contract, UnprovenError, always, prove_contract
from proofs.source import Program, Variant

TWO_BRANCHES = "uint32_t r = 0; if (a > 7U) { r += 1U; } if (b > 7U) { r += 2U; } return r;"


def parse_function(folder: Path, body: str) -> Program:
    """Parse a function f of two words with this body, in a file in a folder."""
    path = folder / "f.c"
    path.write_text(
        f"#include <stdint.h>\nuint32_t f(uint32_t a, uint32_t b) {{ {body} }}\n", encoding="utf-8"
    )
    return Program(path, Variant("1000"))


def is_below_half(word: Any) -> Any:
    """Return that the highest bit of a word is 0."""
    return z3.ULT(word, 2**31)


@pytest.mark.parametrize(
    ("body", "right_claim", "wrong_claim"),
    [
        pytest.param(
            TWO_BRANCHES,
            lambda r, a, b: z3.Implies(r == 1, z3.And(z3.UGT(a, 7), z3.ULE(b, 7))),
            lambda r, a, b: r != 1,
            id="the second branch is not taken after the first one was",
        ),
        pytest.param(
            TWO_BRANCHES,
            lambda r, a, b: z3.Implies(r == 2, z3.And(z3.ULE(a, 7), z3.UGT(b, 7))),
            lambda r, a, b: r != 2,
            id="the second branch is taken after the first one was not",
        ),
        pytest.param(
            "return (uint32_t)(int8_t)(a & 255U);",
            lambda r, a, b: z3.Implies(a & 128 != 0, z3.UGE(r, 2**32 - 128)),
            lambda r, a, b: z3.ULE(r, 255),
            id="a longer type repeats the sign",
        ),
        pytest.param(
            "return (uint32_t)((int32_t)a >> 1);",
            lambda r, a, b: z3.Implies(is_below_half(r), is_below_half(a)),
            lambda r, a, b: is_below_half(r),
            id="a shift to the right repeats the sign",
        ),
        pytest.param(
            "const uint8_t sum = (uint8_t)(a + b); return sum;",
            lambda r, a, b: r == (a + b) & 255,
            lambda r, a, b: r == a + b,
            id="a shorter type keeps the lower bits",
        ),
        pytest.param(
            "return (int32_t)a < 7U;",
            lambda r, a, b: (r == 1) == z3.ULT(a, 7),
            lambda r, a, b: z3.Implies(a < 0, r == 1),
            id="a negative number becomes a large one beside an unsigned one",
        ),
        pytest.param(
            "return (int32_t)a < 0x80000000;",
            lambda r, a, b: (r == 1) == z3.ULT(a, 2**31),
            lambda r, a, b: r == 0,
            id="a hexadecimal number that fits no int is unsigned",
        ),
        pytest.param(
            "const _Bool is_set = (_Bool)a; return is_set;",
            lambda r, a, b: (r == 1) == (a != 0),
            lambda r, a, b: r == a & 1,
            id="a truth value is 1 for every number but 0",
        ),
        pytest.param(
            "uint32_t words[2]; words[0] = a; words[1] = b; words[b & 1U] = 0; return words[0];",
            lambda r, a, b: z3.Implies(b & 1 == 1, r == a),
            lambda r, a, b: r == a,
            id="an unknown element is written",
        ),
        pytest.param(
            "uint32_t *p = &a; *p = b; return a;",
            lambda r, a, b: r == b,
            lambda r, a, b: r == a,
            id="a variable is written through a pointer",
        ),
        pytest.param(
            "const uint32_t old = a++; return old;",
            lambda r, a, b: r == a,
            lambda r, a, b: r == a + 1,
            id="the value of a++ is the old one",
        ),
        pytest.param(
            "while (a > 3U) { /* at most 3 turns */ a = a > 5U ? 5U : a - 1U; } return a;",
            lambda r, a, b: z3.ULE(r, 3),
            lambda r, a, b: r == 3,
            id="a loop has no turn, or some",
        ),
        pytest.param(
            "return b != 0U && a / b > 1U;",
            lambda r, a, b: z3.Implies(b == 0, r == 0),
            lambda r, a, b: r == 0,
            id="the right operand counts if the left one is true",
        ),
    ],
)
def test_a_right_claim_about_a_function_has_a_proof_and_a_wrong_one_has_none(
    body: str, right_claim: Any, wrong_claim: Any, tmp_path: Path
) -> None:
    """A claim takes the result r and both arguments. The wrong claim is one that some arguments break."""
    code = parse_function(tmp_path, body)
    prove_contract(code, "f", {"f": Contract(right_claim)})

    with pytest.raises(UnprovenError, match="broken by"):
        prove_contract(code, "f", {"f": Contract(wrong_claim)})


@pytest.mark.parametrize(
    ("defined_body", "undefined_body", "description"),
    [
        pytest.param(
            # b & 32U may be 32, and a has 32 bits.
            "if (a > 7U) { a = 7U; } return a << (b & 31U);",
            "if (a > 7U) { a = 7U; } return a << (b & 32U);",
            "shift by the width",
            id="a shift, behind a branch",
        ),
        pytest.param(
            "return b > 7U ? a >> 31 : a;",
            "return b > 7U ? a >> 32 : a;",
            "shift by the width",
            id="a shift in a condition's operand",
        ),
        pytest.param(
            # The quotient comes before the comparison of b with 0.
            "return b == 0U || a / b > 1U;",
            "return a / b > 1U || b == 0U;",
            "division by 0",
            id="a division",
        ),
        pytest.param(
            # The sum of two numbers of 31 bits may exceed the largest int32_t.
            "return (uint32_t)((int32_t)(a >> 2) + (int32_t)(b >> 2));",
            "return (uint32_t)((int32_t)(a >> 1) + (int32_t)(b >> 1));",
            "overflow of +",
            id="a sum of signed numbers",
        ),
        pytest.param(
            # a % 4U may be 3, and the last element is words[2].
            "uint32_t words[3]; words[a % 3U] = b; return words[0];",
            "uint32_t words[3]; words[a % 4U] = b; return words[0];",
            "an element",
            id="an index",
        ),
        pytest.param(
            # b & 3U may be 3, and i then has the values 0 to 3, in four turns.
            "for (uint32_t i = 0; i < (b & 3U); ++i) { /* at most 3 turns */ ++a; } return a;",
            "for (uint32_t i = 0; i <= (b & 3U); ++i) { /* at most 3 turns */ ++a; } return a;",
            "at most 3 turns",
            id="a loop",
        ),
    ],
)
def test_code_that_c_leaves_undefined_or_that_breaks_its_bound_is_refused(
    defined_body: str, undefined_body: str, description: str, tmp_path: Path
) -> None:
    """Two bodies differ in one place, where the second breaks a rule of C, or a bound that a comment states.

    The contract says nothing about the result of f. So the proof of the second body can only fail at the code
    in this place, and the error has the ``description`` of what is wrong there.
    """
    contracts = {"f": Contract(always)}
    prove_contract(parse_function(tmp_path, defined_body), "f", contracts)

    with pytest.raises(UnprovenError, match=description):
        prove_contract(parse_function(tmp_path, undefined_body), "f", contracts)
