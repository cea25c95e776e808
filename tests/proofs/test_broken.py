"""Broken code has no proof, and no contract is kept by code that does anything."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from proofs import calls
from proofs.loops import prove_loops_end
from proofs.prove import Contract, always, prove_contract, stand_in
from proofs.solver import UnprovenError
from proofs.source import ARITHMETIC, SOURCES, VARIANTS, Program, Variant, program
from support import CORE, slow

CORTEX_M4 = VARIANTS[0]
WITHOUT_CHOICES = Variant("1000")
"""A target that divides in hardware, and has no other fast instruction."""
VARIANTS_WITH = {
    "shift_left_by": Variant("1010"),
    "divide_by_bits": Variant("3000"),
    "multiply": Variant("1100"),
}
"""Variants that have the definitions with mistakes here. All other functions are those of WITHOUT_CHOICES."""

MISTAKES = (
    ("shift_left_wide", "((masked) ^ 31U)", "((masked) ^ 15U)"),
    ("shift_right_64", "(count & 32U) != 0U", "(count & 16U) != 0U"),
    ("leading_zeros", "value >> 28 == 0", "value >> 27 == 0"),
    ("shift_left_by", "count >= 8U;", "count >= 9U;"),
    ("divide_by_bits", "at most 4 */", "at most 3 */"),
    ("divide_by_bits", "if (a >= d)", "if (a > d)"),
    ("divide_by_bits", "}\n            a <<= 1;", "} else { byte &= 127U; } a <<= 1;"),
    ("divide_by_bits", "}\n            a <<= 1;", "} else { --d; } a <<= 1;"),
    ("multiply", "both_middles << 16 |", "both_middles << 15 |"),
    ("prepare", "(d >> 15) + 1U", "(d >> 15)"),
    ("take_digit", "- digit * d", "- (digit + 1) * d"),
    ("divide_24", "second + (uint32_t)(a >= d)", "second + (uint32_t)(a > d)"),
    ("ratio", "(divisor >> 1) + 1U", "(divisor >> 1)"),
    ("quotient", "divide_31(words.high", "divide_31(words.high / 2"),
    ("alpha_units", "alpha >> 8, alpha)", "alpha >> 7, alpha)"),
    ("alpha_word_from_mantissa", "(0U - exponent) & 31U", "(1U - exponent) & 31U"),
    ("reestimate", "b_hat > MCP_ASDF_B_HAT_MIN ? b_hat", "b_hat > 0U ? b_hat"),
    ("reestimate", "if (x_bar < Q32_HALF)", "if (x_bar >= Q32_HALF)"),
    ("reestimate", "dividend < divisor ? dividend : divisor;", "dividend;"),
    ("end_batch", "robot->n - robust->batch_n", "robot->n - robust->batch_t"),
    ("run_robust_filter", "sorted[(count - 1U) / 2U]", "sorted[count / 2U]"),
    ("next_slot", "shift_left(UINT32_MAX, turn)", "shift_left(UINT32_MAX, turn + 1U)"),
    ("statistics_after_vote", "if (distance > spread)", "if (distance >= spread)"),
    ("take_vote", "is_own ? robot->x_hat", "!is_own ? robot->x_hat"),
    ("run_robust_filter", "!is_supported(robot", "is_supported(robot"),
    (
        "mcp_asdf_observe",
        "t >= robot->config->memory;",
        "t >= robot->config->memory - (robot->config->memory == 1U << 30);",
    ),
    ("mcp_asdf_observe", "begin_batch(robot);", ""),
    ("mcp_asdf_receive", "== robot->id", "== robot->id || (sender == 127U && robot->id == 90U)"),
    ("mcp_asdf_receive", "(x_hat + 64U) >> 7", "x_hat >> 7"),
    ("mcp_asdf_settle", "        publish_round_sums(robot);", ""),
    ("asdf_test_rejects", "m <= q ? m", "m < q ? m"),
    ("round_mean", "(upper_sum << 9) | (lower_sum >> 23)", "upper_sum << 9 | lower_sum >> 24"),
    ("informed_estimate", "sum - product >= alpha", "sum - product > alpha"),
    ("robust_test_rejects", "multiply_high(~b_hat, ~x)", "multiply_high(~b_hat, x)"),
    ("update_b_hat", "    robot->updated = 1;", "    robot->alpha = robot->updated = 1;"),
)
"""For each contract a mistake or two: the function that loses its contract, what stands in the firmware, and
what stands there instead. Among them are mistakes at one value of 2^32, at one pair of ids, and on one side
of a branch in a later turn of a loop."""

QUICK_FUNCTIONS = ("shift_left_wide", "multiply", "mcp_asdf_settle")
"""Functions whose broken code is tried in ``make test``."""


def parse_with_mistake(folder: Path, function: str, original_code: str, mistaken_code: str) -> Program:
    """Parse the core, whose sources are copied into a folder, with a mistake in place of the original code.

    The variant is one that has the function.
    """
    is_found = False
    for path in (*ARITHMETIC, CORE, SOURCES / "mcp_asdf_robust.h"):
        source_text = path.read_text(encoding="utf-8")
        is_found |= original_code in source_text
        mistaken_text = source_text.replace(original_code, mistaken_code)
        (folder / path.name).write_text(mistaken_text, encoding="utf-8")
    assert is_found, original_code
    return Program(folder / CORE.name, VARIANTS_WITH.get(function, WITHOUT_CHOICES))


@pytest.mark.parametrize(
    ("function", "original_code", "mistaken_code"),
    [
        *(mistake for mistake in MISTAKES if mistake[0] in QUICK_FUNCTIONS),
        *slow(mistake for mistake in MISTAKES if mistake[0] not in QUICK_FUNCTIONS),
    ],
)
def test_a_function_with_a_mistake_has_no_proof_of_its_contract(
    function: str, original_code: str, mistaken_code: str, tmp_path: Path
) -> None:
    """A contract says what a function promises for all arguments. A mistake replaces a text of the C.

    The function stands in the header of the arithmetic or in the core.
    """
    code = parse_with_mistake(tmp_path, function, original_code, mistaken_code)

    with pytest.raises(UnprovenError):
        prove_contract(code, function, calls.contracts(code.variant))


# --- Loops -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "original_code", "mistaken_code"),
    [
        ("huber_step", "i < count; ++i) { /* at most 32", "i <= count; ++i) { /* at most 32"),
        ("median_distance", "at most 17 turns", "at most 16 turns"),
        ("sort_estimates", "++slot)", "slot += 0U)"),
        ("is_supported", "supporters += ", "--i; supporters += "),
        ("huber_step", "++inside;", "++inside; ++count;"),
        ("huber_step", "++inside;", "do { ++inside; } while (inside != 3U);"),
        ("run_robust_filter", "    ++robot->", "again: if (count) { goto again; } ++robot->"),
    ],
)
def test_a_loop_with_a_mistake_is_not_taken_to_end(
    function: str, original_code: str, mistaken_code: str, tmp_path: Path
) -> None:
    """Each mistake gives a loop more turns than its comment states, or its body changes what its head uses.

    The last two make a loop by ``do`` or ``goto``, which are always refused.
    """
    code = parse_with_mistake(tmp_path, function, original_code, mistaken_code)

    with pytest.raises(AssertionError):  # of which UnprovenError is a kind
        prove_loops_end(code, function)


# --- Contracts that promise nothing -----------------------------------------------------------------------


def prove_of_any_result(name: str, variant: Variant, contract: Contract) -> None:
    """Prove a contract of a function that returns and writes anything. Only an empty contract holds."""
    anything = replace(contract, used_lemmas=(), stand_ins={name: stand_in(name)})
    prove_contract(program(variant, CORE), name, {name: anything})


@pytest.mark.parametrize("name", calls.NAMES)
def test_a_function_that_may_return_anything_breaks_its_contract(name: str) -> None:
    """Otherwise the contract would promise nothing, and every code would keep it.

    A variant is how a target divides, multiplies and shifts; the first that has the function is taken.
    """
    variant, *_other_variants = calls.variants_with(name)
    contract = calls.contracts(variant)[name]

    with pytest.raises(UnprovenError, match="broken by"):
        prove_of_any_result(name, variant, contract)


def test_a_contract_that_promises_nothing_is_kept_by_any_result() -> None:
    """There is a proof, so whoever asks that any result breaks a contract notices an empty one.

    multiply() returns any number here, and its contract is always kept.
    """
    promises_nothing = Contract(always)
    prove_of_any_result("multiply", CORTEX_M4, promises_nothing)
