"""Every function that has a contract keeps it, and every loop of the firmware ends: for all arguments, in
every variant that a target can choose."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import z3
from pycparser import c_ast

from proofs.arithmetic import RECIPROCAL_LIMITS, is_tried
from proofs.arithmetic import contracts as contracts_of_arithmetic
from proofs.calls import contracts
from proofs.machine import Machine, all_paths
from proofs.prove import Contract, always, prove, prove_contract, prove_lemma
from proofs.source import (
    ARITHMETIC,
    CORE,
    HEADER,
    LANES,
    LANES_HEADER,
    SOURCES,
    VARIANTS,
    Program,
    Variant,
    nodes,
    program,
)
from support import require, run, slow

LEMMAS = sorted({name for variant in VARIANTS for name in contracts(variant)})
LONG_PROOFS = ("statistics_after_vote", "divide_by_bits")
"""Functions whose proofs only the slow tests have."""


def variants_to_prove(name: str) -> list[Variant]:
    """Return the variants that define a function, but those where every argument is tried instead."""
    return [
        variant
        for variant in VARIANTS
        if name in contracts(variant)
        and name in program(variant, CORE).functions
        and not is_tried(variant, name)
    ]


@pytest.mark.parametrize("name", [name for name in LEMMAS if name not in LONG_PROOFS])
def test_a_function_keeps_its_contract_in_a_variant(name: str) -> None:
    """A variant is how a target divides, multiplies and shifts. This is the first that has the function.

    A contract says what a function promises for all arguments. A broken one raises UnprovenError.
    """
    first_variant, *_other_variants = variants_to_prove(name)
    prove_lemma(program(first_variant, CORE), name, contracts(first_variant))


@pytest.mark.slow
@pytest.mark.parametrize("name", LEMMAS)
def test_a_function_keeps_its_contract_in_every_variant(name: str) -> None:
    """The same text in two variants is proved once: ``prove_lemma`` adds its proof to ``done_proofs``."""
    done_proofs = set[Any]()
    for variant in variants_to_prove(name):
        prove_lemma(program(variant, CORE), name, contracts(variant), done_proofs)
    assert len(done_proofs) > 0


def test_every_function_of_the_arithmetic_is_proved_in_some_variant() -> None:
    """A function may be defined more than once; which definition a compiler sees depends on the variant.

    Each definition in the headers' texts is one that some variant has, and its function has a contract there.
    Only estimate_digit() has none: the proof of take_digit() enters its code.
    """
    # The first line of a definition begins in the first column.
    definition = re.compile(r"^(?!#|typedef)[A-Za-z_].*?(\w+)\(.*\)(?: \{.*)?$", re.MULTILINE)
    written = [name for path in ARITHMETIC for name in definition.findall(path.read_text(encoding="utf-8"))]

    parsed: dict[tuple[str, int], str] = {}
    for variant in VARIANTS:
        code = program(variant, CORE)
        for name in code.defined_in(*ARITHMETIC):
            assert name == "estimate_digit" or name in contracts_of_arithmetic(variant)
            coordinates = code.functions[name].coord
            parsed[coordinates.file, coordinates.line] = name

    assert sorted(parsed.values()) == sorted(written)


# --- Reciprocals -------------------------------------------------------------------------------------------


def build_every_divisor(divide: int, folder: Path) -> Path:
    """Build every_divisor.c for a way to divide, and return the program.

    Its exit code is 0 if all reciprocals are within the limits that the proofs assume. A sanitizer ends it
    at a conversion that does not fit.
    """
    least_divisor, lost_share = RECIPROCAL_LIMITS[divide]
    definitions = {
        "MCP_ASDF_DIVIDE": divide,
        "LEAST": least_divisor,
        "LOST_TIMES": lost_share.numerator,
        "LOST_OVER": lost_share.denominator,
    }
    flags = ["-std=c99", "-O2", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    flags += [f"-D{name}={value}" for name, value in definitions.items()]
    if divide == LANES:
        flags += ["-include", str(LANES_HEADER)]
    source, built = Path(__file__).with_name("every_divisor.c"), folder / "every_divisor"
    run(require("gcc", "gcc"), *flags, f"-I{HEADER.parent}", source, "-o", built)
    return built


@pytest.mark.parametrize("divide", RECIPROCAL_LIMITS)
def test_the_reciprocal_of_every_divisor_is_as_good_as_the_proofs_assume(divide: int, tmp_path: Path) -> None:
    """A program tries all divisors, and ends with an error if a reciprocal is not as near as assumed.

    Reciprocals come from a table or from floats of 32 bits, which are too hard for the solver.
    """
    run(build_every_divisor(divide, tmp_path))


# --- Loops -------------------------------------------------------------------------------------------------

FIRMWARE = (
    CORE,
    SOURCES / "mcp_asdf_robust.h",
    *(SOURCES / f"mcp_asdf_{part}.c" for part in ("image", "frame", "small")),
)
"""The firmware, but for the arithmetic, whose contracts say that its loops end."""
LIMITS = {
    ("is_valid_table", "hash_index"): (0, 129),
    ("mcp_asdf_x_hat_from_code", "bits"): (1, 23),  # what its header asks of a caller
    # The number of estimates kept is that of sort_estimates(), which counts once in each of 32 turns at most.
    **{(name, "count"): (0, 32) for name in ("median_distance", "huber_step", "is_supported")},
    ("sort_estimates", "i"): (0, 31),  # the count before it is incremented
}
"""The lowest and the highest value of a variable that a loop's counter starts from or is compared with.

The key has the names of the function and of the variable.
"""
REQUIREMENTS = {"long_code_from_alpha": lambda alpha: z3.LShR(alpha, 8) != 0}
"""The condition under which a function's loop ends, by the function's name.

A condition takes the term of the function's argument. The function's callers see to it.
"""


def prove_ends(code: Program, name: str, loop: Any) -> None:
    """Prove that a loop ends, whatever memory holds.

    Of a ``for`` the counter is enough, as its body does not change it (rule 14.2 of MISRA). A ``while`` needs
    the whole function, with unknown arguments.
    """
    if isinstance(loop, c_ast.While):
        prove_contract(code, name, {name: Contract(always, REQUIREMENTS.get(name, always))})
        return

    def execute_empty_loop(machine: Machine) -> None:
        names_in_condition = {identifier.name for identifier in nodes(loop.cond, c_ast.ID)}
        for declaration in nodes(code.functions[name], c_ast.Decl):
            limits = LIMITS.get((name, declaration.name))
            if limits is None and declaration.name not in names_in_condition:
                continue
            value = machine.fresh_argument(declaration)
            machine.declare(declaration.name, declaration.type, value)
            if limits is not None:
                lowest, highest = limits
                machine.facts.append(z3.And(z3.UGE(value.term, lowest), z3.ULE(value.term, highest)))
        machine.execute(c_ast.For(loop.init, loop.cond, loop.next, c_ast.EmptyStatement(), loop.coord))

    for machine, _result in all_paths(lambda path: Machine(code, decisions=path), execute_empty_loop):
        for obligation in machine.obligations:
            prove(obligation.claim, *obligation.facts, description=f"{name}: {obligation.description}")


# design: R34
@pytest.mark.parametrize("variant", [VARIANTS[0], *slow(VARIANTS[1:])], ids=str)
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
@pytest.mark.parametrize("variant", [VARIANTS[0], *slow(VARIANTS[1:])], ids=str)
@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_no_function_calls_itself(path: Path, variant: Variant) -> None:
    """Nor does one through others: so the stack that the firmware needs has a limit."""
    code = program(variant, path)
    for name in code.functions:
        for callee in code.callees(name):
            called_from_there = code.closure(callee)  # directly and through others
            assert name not in called_from_there, f"{name} calls {callee}, from which it is called again"


def test_a_table_whose_length_is_accepted_has_at_most_129_words() -> None:
    """The first word of a table is "MCT" and its number of thresholds, q: 2 to 127. Two more words follow.

    The loop that reads it goes to the lowest byte of that word plus 2. In the function's text, the condition
    that refuses other words stands before the loop.
    """
    mct_without_q = 0x4D435400
    for q in range(2, 128):
        assert (mct_without_q + q + 2) & 0xFF <= 129
    core_text = CORE.read_text(encoding="utf-8")

    refusal = core_text.index("if (head < TABLE_MAGIC + 2U || head > TABLE_MAGIC + MCP_ASDF_MAX_ID) {")
    length = core_text.index("const uint8_t hash_index = (uint8_t)(head + 2U);")
    loop = core_text.index("for (uint8_t i = 0; i < hash_index; ++i)")
    assert length < refusal < loop
