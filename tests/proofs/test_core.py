"""Sums' quotients, the form of alpha, and that every loop of the firmware ends: for all inputs, any memory
contents, every variant."""

from __future__ import annotations

from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import z3
from pycparser import c_ast

from proofs import arithmetic
from proofs.core import CORE, contracts
from proofs.loops import KNOWN, loops_in, prove_ends
from proofs.prove import UnprovenError, prove, prove_lemma
from proofs.source import SOURCES, VARIANTS, Program, Variant, nodes, program

LEMMAS = sorted(contracts(VARIANTS[0]))
FIRMWARE = (CORE, SOURCES / "mcp_asdf_image.c", SOURCES / "mcp_asdf_frame.c")


@pytest.mark.parametrize("name", LEMMAS)
def test_lemma(name: str) -> None:
    done: set[str] = set()
    for variant in VARIANTS:
        lemmas = {**arithmetic.contracts(variant), **contracts(variant)}
        prove_lemma(program(variant, CORE), name, lemmas, done)
    assert done


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


@pytest.mark.parametrize("path", [SOURCES / "mcp_asdf_target_avr.h", *FIRMWARE], ids=lambda path: path.name)
def test_every_loop_states_its_bound(path: Path) -> None:
    """Those of the arithmetic are proved with the lemma of their function, in every variant."""
    lines = path.read_text(encoding="utf-8").splitlines()
    stated = [line for line in lines if line.lstrip().startswith(("for ", "while ", "do "))]
    assert stated and all("/* at most " in line for line in stated)


def test_there_is_no_other_way_to_loop() -> None:
    code = [program(variant, path) for variant in VARIANTS for path in FIRMWARE]
    assert not [node for each in code for body in each.functions.values() for node in nodes(body, c_ast.Goto)]


# --- Broken code has no proof ------------------------------------------------------------------------------

BROKEN = {
    "units": ("alpha >> 8, alpha)", "alpha >> 7, alpha)"),
    "alpha_word": ("(0U - exponent) & 31U", "(1U - exponent) & 31U"),
    "set_b_hat": ("g < INFORMATIVE ? UINT32_MAX", "g < INFORMATIVE / 2 ? UINT32_MAX"),
    "reestimate": ("robot->t", "robot->t >> robot->n"),
}
"""Functions, and a change of their code that breaks them."""


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_function_has_no_proof(name: str, tmp_path: Path) -> None:
    right, wrong = BROKEN[name]
    before, start, after = CORE.read_text(encoding="utf-8").partition(f" {name}(")
    assert right in after
    path, variant = tmp_path / CORE.name, Variant("1000")
    path.write_text(before + start + after.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(UnprovenError):
        lemmas = {**arithmetic.contracts(variant), **contracts(variant)}
        prove_lemma(Program(path, variant), name, lemmas, set())
