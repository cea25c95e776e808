"""Sums' quotients, the form of alpha, and that every loop of the firmware ends: for all inputs, any memory
contents, every variant."""

from __future__ import annotations

from collections.abc import Iterable
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import z3
from pycparser import c_ast

from proofs import arithmetic
from proofs.core import C_MOST, CORE, contracts, product_bounds
from proofs.loops import KNOWN, loops_in, prove_ends
from proofs.prove import UnprovenError, prove, prove_contract, prove_safe, safe_callees
from proofs.source import HEADER, SOURCES, VARIANTS, Program, Variant, nodes, program

LEMMAS = sorted(contracts(VARIANTS[0]))
SLOW = "estimate"
"""The one that takes as long as all others together."""
FIRMWARE = (CORE, SOURCES / "mcp_asdf_image.c", SOURCES / "mcp_asdf_frame.c")


def each_of(names: Iterable[str]) -> pytest.MarkDecorator:
    slow = pytest.mark.slow
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=slow) if name == SLOW else name for name in names]
    )


def keeps_contract(code: Program, variant: Variant, name: str) -> None:
    lemmas = contracts(variant)
    prove_safe(code, name, {**arithmetic.contracts(variant), **lemmas})
    prove_contract(code, name, lemmas[name])


@each_of(LEMMAS)
def test_lemma(name: str) -> None:
    """Once for each text of the function and of what it calls that has no lemma of its own."""
    safe, kept = set(), set()
    for variant in VARIANTS:
        code, lemmas = program(variant, CORE), contracts(variant)
        all_lemmas = {**arithmetic.contracts(variant), **lemmas}
        text = code.text(name, safe_callees(name, all_lemmas))
        if text not in safe:
            prove_safe(code, name, all_lemmas)
        safe.add(text)
        text = code.text(name, lemmas[name].uses)
        if text not in kept:
            prove_contract(code, name, lemmas[name])
        kept.add(text)
    assert safe and kept


# --- What contracts of the core take for granted -----------------------------------------------------------


def test_products_are_between_products_of_bounds() -> None:
    a, b, i, j = z3.Ints("a b i j")
    prove(product_bounds(a * b, a, b, i, j), a >= 0, b >= 0, i >= 1, j >= 1, about="size of a product")


@pytest.mark.parametrize("shift", range(12))
def test_the_scale_keeps_its_length(shift: int) -> None:
    """g t, from c t rounded down: at least 2^30 and a word, though twice the rounding is added to it."""
    c, total, least, g = z3.Ints("c total least g")
    known = (
        *(g == 2**32 - 2 * c, total >= 2**31, total < 2**32, c >= 1, c <= C_MOST),
        *(g * 2**shift >= 2**31, g * 2**shift < 2**32),
        *(2**32 * least <= c * total, c * total < 2**32 * (least + 1)),
    )
    scale = (total - 2 * least) * 2**shift
    prove(z3.And(scale >= 2**30, scale < 2**32, 2 * least <= total), *known, about="scale")


def test_a_product_of_all_ones() -> None:
    """(2^32 - 1) b = 2^32 (b - 1) + (2^32 - b)."""
    b = z3.Int("b")
    prove((2**32 - 1) * b / 2**32 == b - 1, b >= 1, b < 2**32, about="c t without information")


def test_a_quotient_of_equally_long_numbers() -> None:
    a, d, found = z3.Ints("a d found")
    ranges = [z3.And(each >= 2**30, each < 2**31) for each in (a, d)]
    is_floor = (found * d <= 2**24 * a, 2**24 * a < (found + 1) * d)
    prove(z3.And(found >= 2**23, found < 2**25), *ranges, *is_floor, about="24 or 25 bits")


def test_a_product_is_that_of_its_halves() -> None:
    """(2^16 a1 + a0) (2^16 b1 + b0), as the lemmas of the split products write it."""
    a0, a1, b0, b1 = z3.Ints("a0 a1 b0 b1")
    multiplied = 2**32 * (a1 * b1) + 2**16 * (a1 * b0 + a0 * b1) + a0 * b0
    prove((2**16 * a1 + a0) * (2**16 * b1 + b0) == multiplied, about="halves")


# --- Loops -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_every_loop_ends(path: Path) -> None:
    """Whatever the variables beside the counter hold, in each turn anew."""
    code = program(VARIANTS[0], path)
    for name in code.defined_in(path):
        for loop in loops_in(code, name):
            prove_ends(code, name, loop)


@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_no_function_calls_itself(path: Path) -> None:
    for variant in VARIANTS if path == CORE else VARIANTS[:1]:  # on which the others do not depend
        code = program(variant, path)
        calls = {name: code.callees(name) for name in code.functions}
        assert list(TopologicalSorter(calls).static_order())  # which refuses a cycle


def test_a_table_that_is_read_has_at_most_129_words() -> None:
    """As table_valid() refuses any other head before its loop."""
    head, magic = z3.BitVec("head", 32), 0x4D435400
    accepted = z3.And(z3.UGE(head, magic + 2), z3.ULE(head, magic + 127))
    prove(KNOWN["table_valid"]["end"](z3.Extract(7, 0, head + 2)), accepted, about="q + 2")
    text = CORE.read_text(encoding="utf-8")
    refusal = text.index("if (head < TABLE_MAGIC + 2U || head > TABLE_MAGIC + MCP_ASDF_MAX_ID) {")
    assert refusal < text.index("for (uint8_t i = 0; i < end; ++i)")
    assert "const uint8_t end = (uint8_t)(head + 2U);" in text[:refusal]


def test_a_loop_that_turns_more_often_than_stated_is_refused(tmp_path: Path) -> None:
    path = tmp_path / CORE.name
    path.write_text(CORE.read_text(encoding="utf-8").replace("at most 129", "at most 128"), encoding="utf-8")
    code = Program(path, VARIANTS[0])
    (loop,) = loops_in(code, "table_valid")
    with pytest.raises(UnprovenError, match="at most 128"):
        prove_ends(code, "table_valid", loop)


@pytest.mark.parametrize("path", [HEADER, *FIRMWARE], ids=lambda path: path.name)
def test_every_loop_states_its_bound(path: Path) -> None:
    """Those of the arithmetic are proved with the lemma of their function, in every variant."""
    lines = path.read_text(encoding="utf-8").splitlines()
    stated = [line for line in lines if line.lstrip().startswith(("for ", "while ", "do "))]
    assert stated and all("/* at most " in line for line in stated)


def test_there_is_no_other_way_to_loop() -> None:
    code = [
        *(program(variant, CORE) for variant in VARIANTS),
        *(program(VARIANTS[0], path) for path in FIRMWARE),
    ]
    assert not [node for each in code for body in each.functions.values() for node in nodes(body, c_ast.Goto)]


# --- Broken code has no proof ------------------------------------------------------------------------------

BROKEN = {
    "units": ("alpha >> 8, alpha)", "alpha >> 7, alpha)"),
    "mean": ("middle << 9 | low >> 23", "middle << 9 | low >> 24"),
    "informed_estimate": ("sum - product >= alpha", "sum - product > alpha"),
    "square_of_ratio": ("divide_24(g >> 1, p >> 1) << 7", "divide_24(g >> 1, p >> 1) << 6"),
    "alpha_word": ("(0U - exponent) & 31U", "(1U - exponent) & 31U"),
    "set_b_hat": ("g < INFORMATIVE ? UINT32_MAX", "g < INFORMATIVE / 2 ? UINT32_MAX"),
    "estimate": ("sum = join(low_word(sum), 0);\n            exponent -= 32U;", ""),
    "reestimate": ("robot->t", "robot->t >> robot->n"),
}
"""Functions, and a change of their code that breaks them."""


def test_each_lemma_has_a_broken_function() -> None:
    assert sorted(BROKEN) == LEMMAS


@each_of(BROKEN)
def test_a_broken_function_has_no_proof(name: str, tmp_path: Path) -> None:
    right, wrong = BROKEN[name]
    before, start, after = CORE.read_text(encoding="utf-8").partition(f" {name}(")
    assert right in after
    path = tmp_path / CORE.name
    path.write_text(before + start + after.replace(right, wrong, 1), encoding="utf-8")
    variant = Variant("1000")
    with pytest.raises(UnprovenError):
        keeps_contract(Program(path, variant), variant, name)
