"""Every function of the header keeps its contract for all arguments, in every variant that a target can
choose."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import z3

from proofs.arithmetic import PREPARED, contracts, is_tried
from proofs.prove import prove, prove_lemma
from proofs.source import ARITHMETIC, HEADER, LANES, LANES_HEADER, VARIANTS, program
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
