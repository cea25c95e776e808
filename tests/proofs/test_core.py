"""The form of alpha, the calls, a vote of the robust filter, and that every loop of the firmware ends: for
all inputs, in every variant."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import z3
from pycparser import c_ast

from proofs import calls, formulas, robust
from proofs.formulas import CORE
from proofs.machine import Machine
from proofs.numbers import BitVectorArithmetic
from proofs.prove import Contract, always, prove, prove_all, prove_contract, prove_lemma, prove_obligations
from proofs.source import SOURCES, VARIANTS, Program, Variant, nodes, program
from support import slow

FIRMWARE = (CORE, SOURCES / "mcp_asdf_image.c", SOURCES / "mcp_asdf_frame.c", SOURCES / "mcp_asdf_small.c")


LEMMAS = [*formulas.CONTRACTS, *robust.CONTRACTS, *calls.CONTRACTS]
LONG_PROOFS = ("take_vote", "asdf_test_rejects", "mcp_asdf_receive")
"""Functions whose proofs take so long that only the slow tests have them."""
CORTEX_M4 = VARIANTS[0]


def prove_lemma_in(variants: Iterable[Variant], name: str) -> None:
    """Prove the lemma of a function in these variants of the core; equal texts are proved once."""
    proved = set[Any]()
    for variant in variants:
        prove_lemma(program(variant, CORE), name, calls.contracts(variant), proved)
    assert proved


@pytest.mark.parametrize("name", [name for name in LEMMAS if name not in LONG_PROOFS])
def test_a_function_keeps_its_contract_on_a_cortex_m4(name: str) -> None:
    """A contract says what a function promises for all arguments. A broken contract raises UnprovenError."""
    prove_lemma_in([CORTEX_M4], name)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEMMAS)
def test_a_function_keeps_its_contract_in_every_variant(name: str) -> None:
    """A variant is how a target divides, multiplies and shifts. A broken contract raises UnprovenError."""
    prove_lemma_in(VARIANTS, name)


def test_one_more_message_keeps_the_sums_of_a_round_in_their_ranges() -> None:
    """The sums of the confidences and estimates of 127 neighbours at most fit into their words.

    ``prove_all`` raises UnprovenError if one of the claims about them is broken for some numbers.
    """
    claims_about_a_message = calls.one_more_message_claims()
    prove_all(claims_about_a_message)


# --- Loops -------------------------------------------------------------------------------------------------


LIMITS = {
    ("is_valid_table", "hash_index"): (0, 129),
    ("mcp_asdf_x_hat_from_code", "bits"): (1, 23),  # what its header asks of a caller
}
"""Lowest and highest value of what counters are compared with or start from, by function and variable."""


REQUIREMENTS = {"long_code_from_alpha": lambda alpha: z3.LShR(alpha, 8) != 0}
"""What must hold of a function's argument for its loop to end, by the function's name.

The function's callers see to it.
"""


def prove_ends(code: Program, name: str, loop: Any) -> None:
    """Prove that a loop ends, whatever memory holds.

    Of a ``for`` the counter is enough, as its body does not change it (rule 14.2 of MISRA). A ``while`` needs
    the whole function, with unknown arguments.
    """
    if isinstance(loop, c_ast.While):
        prove_contract(code, name, {name: Contract(always, requires=REQUIREMENTS.get(name, always))})
        return
    machine = Machine(code, BitVectorArithmetic)
    for declaration in nodes(code.functions[name], c_ast.Decl):
        if (name, declaration.name) in LIMITS:
            lowest, highest = LIMITS[name, declaration.name]
            machine.declare_unknown(declaration)
            value = machine.load(machine.local_variable(declaration.name)).term
            machine.assume(z3.And(z3.UGE(value, lowest), z3.ULE(value, highest)))
    machine.execute(c_ast.For(loop.init, loop.cond, loop.next, c_ast.EmptyStatement(), loop.coord))
    prove_obligations(machine, name)


# design: R34
@pytest.mark.parametrize("variant", [CORTEX_M4, *slow(VARIANTS[1:])], ids=str)
@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_every_loop_of_the_firmware_ends(path: Path, variant: Variant) -> None:
    """It does within the turns that a comment beside it states: so no call hangs.

    The variables beside a loop's counter may hold anything, in each turn anew. ``prove_ends`` raises
    UnprovenError if the loop might go on.
    """
    code = program(variant, path)
    for name in code.defined_in(path):
        function = code.functions[name]
        for loop in (*nodes(function, c_ast.For), *nodes(function, c_ast.While)):
            prove_ends(code, name, loop)


# design: R34
@pytest.mark.parametrize("variant", [CORTEX_M4, *slow(VARIANTS[1:])], ids=str)
@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_no_function_calls_itself(path: Path, variant: Variant) -> None:
    """Nor does one through others: so the stack that the firmware needs has a limit."""
    code = program(variant, path)
    for name in code.functions:
        for callee in code.callees(name):
            called_from_there = code.closure(callee)  # directly and through others
            assert name not in called_from_there, f"{name} calls {callee}, from which it is called again"


def test_a_table_whose_length_is_accepted_has_at_most_129_words() -> None:
    """The first word of a table is "MCT" and its number of thresholds, q. Two more words follow these.

    The loop that reads it goes to the lowest byte of that word plus 2. z3, a solver, proves for every word
    that is accepted, with a q from 2 to 127, that this is 129 at most.
    """
    mct_without_q = 0x4D435400
    first_word = z3.BitVec("first_word", 32)
    is_accepted = z3.And(z3.UGE(first_word, mct_without_q + 2), z3.ULE(first_word, mct_without_q + 127))

    last_index = z3.Extract(7, 0, first_word + 2)  # bits 7 to 0: the lowest byte

    at_most_129 = z3.ULE(last_index, 129)
    prove(at_most_129, is_accepted, description="q + 2")


def test_the_length_of_a_table_is_checked_before_it_is_read() -> None:
    """In the function's text, the condition that refuses a table stands before the loop that reads it."""
    core_text = CORE.read_text(encoding="utf-8")

    refusal = core_text.index("if (head < TABLE_MAGIC + 2U || head > TABLE_MAGIC + MCP_ASDF_MAX_ID) {")
    length = core_text.index("const uint8_t hash_index = (uint8_t)(head + 2U);")
    loop = core_text.index("for (uint8_t i = 0; i < hash_index; ++i)")

    assert length < refusal < loop
