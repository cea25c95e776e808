"""Every function of the header keeps its contract for all arguments, in every variant that a target can
choose."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import z3

from proofs.arithmetic import PREPARED, contracts, is_tried
from proofs.prove import UnprovenError, prove, prove_lemma
from proofs.source import ARITHMETIC, HEADER, LANES, LANES_HEADER, VARIANTS, Program, Variant, program
from support import require, run

LEMMAS = sorted({name for variant in VARIANTS for name in contracts(variant)})
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
CITED = re.compile(r"Lemmas? (\w+(?:, \w+)*)\.")


@pytest.mark.parametrize("name", LEMMAS)
def test_lemma(name: str) -> None:
    done: set[str] = set()
    for variant in VARIANTS:
        code, lemmas = program(variant), contracts(variant)
        if name in code.functions and not is_tried(variant, name):
            prove_lemma(code, name, lemmas, done)
    assert done


@pytest.mark.parametrize("divide", PREPARED)
def test_every_divisor_is_prepared(divide: int, tmp_path: Path) -> None:
    """Where reciprocals come from a table or from binary32, too many operators for the solver; not too many
    divisors for a computer. The sanitizer sees a conversion that does not fit."""
    least, lost = PREPARED[divide]
    bounds = {
        "MCP_ASDF_DIVIDE": divide,
        "LEAST": least,
        "LOST_TIMES": lost.numerator,
        "LOST_OVER": lost.denominator,
    }
    flags = ("-std=c99", "-O2", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all")
    chosen = [f"-D{name}={value}" for name, value in bounds.items()]
    chosen += ["-include", str(LANES_HEADER)] if divide == LANES else []
    source = Path(__file__).with_name("every_divisor.c")
    run(
        require("gcc", "gcc"), *flags, *chosen, f"-I{HEADER.parent}", source, "-o", tmp_path / "every_divisor"
    )
    run(tmp_path / "every_divisor")


def test_each_function_has_a_lemma_and_its_comment_names_it() -> None:
    defined = {name for variant in VARIANTS for name in program(variant).defined_in(*ARITHMETIC)}
    text = "\n".join(path.read_text(encoding="utf-8") for path in ARITHMETIC)
    comments = " ".join(COMMENT.findall(text)).replace("\n * ", " ")
    cited = [name for names in CITED.findall(comments) for name in names.split(", ")]
    assert sorted(cited) == LEMMAS == sorted(defined)


def test_a_product_is_that_of_its_halves() -> None:
    """(2^16 a1 + a0) (2^16 b1 + b0), as the lemmas of the split products write it."""
    a0, a1, b0, b1 = z3.Ints("a0 a1 b0 b1")
    multiplied = 2**32 * (a1 * b1) + 2**16 * (a1 * b0 + a0 * b1) + a0 * b0
    prove((2**16 * a1 + a0) * (2**16 * b1 + b0) == multiplied, about="halves")


# --- Broken code has no proof ----------------------------------------------------------------------------

BROKEN = {
    "shift_left_wide": ("1000", "((masked) ^ 31U)", "((masked) ^ 15U)"),
    "shift_right_64": ("1000", "(count & 32U) != 0U", "(count & 16U) != 0U"),
    "leading_zeros": ("1000", "value >> 28 == 0", "value >> 27 == 0"),
    "shift_left_by": ("1010", "count >= 8U;", "count >= 9U;"),
    "shift_right_by": ("1010", "count >= 8U; count = (uint8_t)(count - 8U)", "count >= 8U; count = count"),
    "multiply": ("1100", "middle2 << 16 |", "middle2 << 15 |"),
    "prepare": ("1000", "(d >> 15) + 1U", "(d >> 15)"),
    "take_digit": ("1000", "- digit * d", "- (digit + 1) * d"),
    "divide_by_bits": ("3000", "if (a >= d)", "if (a > d)"),
    "divide_24": ("1000", "second + (uint32_t)(a >= d)", "second + (uint32_t)(a > d)"),
    "ratio": ("1000", "(upper(d, shift) >> 1) + 1U", "(upper(d, shift) >> 1)"),
    "quotient": ("1000", "divide_31(found.high", "divide_31(found.high / 2"),
}
"""Functions, a variant, and a change of its code that breaks it."""


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_function_has_no_proof(name: str, tmp_path: Path) -> None:
    digits, right, wrong = BROKEN[name]
    texts = {path.name: path.read_text(encoding="utf-8") for path in ARITHMETIC}
    assert right in "".join(texts.values())
    for file, text in texts.items():
        (tmp_path / file).write_text(text.replace(right, wrong), encoding="utf-8")
    path = tmp_path / HEADER.name
    with pytest.raises(UnprovenError):
        prove_lemma(Program(path, Variant(digits)), name, contracts(Variant(digits)), set())
