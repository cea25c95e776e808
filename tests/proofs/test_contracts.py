"""Every function that has a contract keeps it, and every loop of the firmware ends: for all arguments, in
every variant that a target can choose."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from proofs.arithmetic import RECIPROCAL_LIMITS, is_tried
from proofs.arithmetic import contracts as contracts_of_arithmetic
from proofs.calls import NAMES, contracts, variants_with
from proofs.loops import prove_loops_end
from proofs.prove import proof_key, prove_contract
from proofs.source import (
    ARITHMETIC,
    FIRMWARE,
    HEADER,
    LANES,
    LANES_HEADER,
    VARIANTS,
    Variant,
    program,
)
from support import CORE, require, run, slow

LONG_PROOFS = ("statistics_after_vote", "divide_by_bits")
"""Functions whose proofs only the slow tests have."""


def variants_to_prove(name: str) -> list[Variant]:
    """Return the variants in which a function has a contract, except those where every argument is tried."""
    return [variant for variant in variants_with(name) if not is_tried(variant, name)]


@pytest.mark.parametrize("name", [name for name in NAMES if name not in LONG_PROOFS])
def test_a_function_keeps_its_contract_in_a_variant(name: str) -> None:
    """A variant is how a target divides, multiplies and shifts. This is the first that has the function.

    A contract says what a function promises for all arguments. A broken one raises UnprovenError.
    """
    first_variant, *_other_variants = variants_to_prove(name)
    prove_contract(program(first_variant, CORE), name, contracts(first_variant))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_function_keeps_its_contract_in_every_variant(name: str) -> None:
    """The same text in two variants is proved once."""
    proofs = {
        proof_key(program(variant, CORE), name, contracts(variant)): variant
        for variant in variants_to_prove(name)
    }
    for variant in proofs.values():
        prove_contract(program(variant, CORE), name, contracts(variant))


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


# design: R34
@pytest.mark.parametrize("variants", [VARIANTS[:1], *slow([(VARIANTS,)])], ids=["first variant", "all"])
@pytest.mark.parametrize("path", FIRMWARE, ids=lambda path: path.name)
def test_every_loop_of_the_firmware_ends(path: Path, variants: tuple[Variant, ...]) -> None:
    """Each loop ends within the turns that a comment beside it states: so no call hangs.

    That loops of the arithmetic end follows from the proofs of its contracts.
    ``prove_loops_end`` raises UnprovenError if a loop might have more. If a function has the same text in two
    variants, one proof is enough.
    """
    proved_texts = set[str]()
    for variant in variants:
        code = program(variant, path)
        for name in code.defined_in(path):
            text = code.definition_text(name)
            if text not in proved_texts:
                prove_loops_end(code, name)
            proved_texts.add(text)


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
