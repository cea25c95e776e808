"""Broken code has no proof."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from proofs import accuracy, arithmetic, calls, images, robust, sums
from proofs.formulas import CORE
from proofs.images import IMAGE
from proofs.prove import Contract, UnprovenError, always, any_result, prove_all, prove_contract, prove_lemma
from proofs.source import ARITHMETIC, HEADER, SOURCES, VARIANTS, Program, Variant, program
from support import slow

BROKEN = (
    ("shift_left_wide", "1000", "((masked) ^ 31U)", "((masked) ^ 15U)"),
    ("shift_right_64", "1000", "(count & 32U) != 0U", "(count & 16U) != 0U"),
    ("leading_zeros", "1000", "value >> 28 == 0", "value >> 27 == 0"),
    ("shift_left_by", "1010", "count >= 8U;", "count >= 9U;"),
    ("divide_by_bits", "3000", "at most 4 */", "at most 3 */"),
    ("multiply", "1100", "both_middles << 16 |", "both_middles << 15 |"),
    ("prepare", "1000", "(d >> 15) + 1U", "(d >> 15)"),
    ("take_digit", "1000", "- digit * d", "- (digit + 1) * d"),
    ("divide_by_bits", "3000", "if (a >= d)", "if (a > d)"),
    ("divide_24", "1000", "second + (uint32_t)(a >= d)", "second + (uint32_t)(a > d)"),
    ("ratio", "1000", "(upper(d, shift) >> 1) + 1U", "(upper(d, shift) >> 1)"),
    ("quotient", "1000", "divide_31(words.high", "divide_31(words.high / 2"),
    ("alpha_units", "1000", "alpha >> 8, alpha)", "alpha >> 7, alpha)"),
    ("alpha_word_from_mantissa", "1000", "(0U - exponent) & 31U", "(1U - exponent) & 31U"),
    ("", "1000", "g < INFORMATIVE_G ? UINT32_MAX", "g < INFORMATIVE_G / 2 ? UINT32_MAX"),
    ("", "1000", "total - 2U * errors", "total - errors"),
    ("", "1000", "2U * g_shift - shift;", "2U * g_shift + shift;"),
    ("", "1000", "(n - white) ^", "(n + white) ^"),
    ("", "1000", "exponent -= 32U", "exponent -= 31U"),
    ("", "1000", "multiply(t - rare_observations, accuracy->common)", "multiply(t, accuracy->common)"),
    ("", "1000", "2U * c_shift", "c_shift"),
    ("", "1000", "multiply_high(ratio, ratio)", "multiply_high(ratio, g)"),
    ("", "1000", "x_bar = ~x_bar;", "x_bar = 0U - x_bar;"),
    ("", "1000", "dividend < divisor ? dividend : divisor", "dividend"),
    ("", "1000", "(upper_sum << 9) | (lower_sum >> 23)", "upper_sum << 9 | lower_sum >> 24"),
    ("", "1000", "sum - product >= alpha", "sum - product > alpha"),
    ("", "1000", "b_hat < MCP_ASDF_B_HAT_MAX ? b_hat", "b_hat <= MCP_ASDF_B_HAT_MIN ? b_hat"),
    (
        *("", "1000", "? run_robust_filter(robot) : run_asdf_filter(robot)"),
        "? run_asdf_filter(robot) : run_robust_filter(robot)",
    ),
    ("", "1000", "if (robot->t == 0U)", "if (robot->n == 0U)"),
    ("", "1000", "filter == MCP_ASDF_ADAPTIVE ? 2U : 1U", "filter == MCP_ASDF_ADAPTIVE ? 1U : 2U"),
    ("", "1000", "variance_of_share > variance_of_p ?", "variance_of_share < variance_of_p ?"),
    ("", "1000", "? 0U - 2U * b_hat", "? 1U - 2U * b_hat"),
    ("", "1000", "high_word(multiply(robot->t, low", "low_word(multiply(robot->t, low"),
    ("", "1000", "multiply_high(~b_hat, ~x)", "multiply_high(~b_hat, x)"),
    (
        "",
        "1000",
        "times_half_word(REJECTED_SIGMAS_SQUARED, robot->robust.dispersion), variance) >> 8",
        "12U * 256U, variance) >> 8",
    ),
    ("next_slot", "1000", "shift_left(UINT32_MAX, turn)", "shift_left(UINT32_MAX, turn + 1U)"),
    ("next_slot", "1000", "if (has_confidence)", "if (!has_confidence)"),
    ("take_vote", "1000", "votes | VOTES_OF_MAX_GAIN", "votes | 1U"),
    ("take_vote", "1000", "< MCP_ASDF_VOTES_MAX ? 1U", "<= MCP_ASDF_VOTES_MAX ? 1U"),
    ("take_vote", "1000", "if (distance > spread)", "if (distance >= spread)"),
    ("take_vote", "1000", "limited_distance = spread;", "limited_distance = distance;"),
    ("take_vote", "1000", "new_spread > MCP_ASDF_SPREAD_MIN ? new_spread", "new_spread > 0U ? new_spread"),
    ("take_vote", "1000", "is_own ? 0U : (uint8_t)(slot + 1U)", "is_own ? 1U : (uint8_t)(slot + 1U)"),
    ("take_vote", "1000", "return estimate << 7; }", "return estimate << 6; }"),
    (
        "run_robust_filter",
        "1000",
        "count < MCP_ASDF_TESTED_ESTIMATES_MIN",
        "count <= MCP_ASDF_TESTED_ESTIMATES_MIN",
    ),
    ("run_robust_filter", "1000", "!is_supported(robot", "is_supported(robot"),
    ("run_robust_filter", "1000", "!= initial_b_hat ? initial_b_hat", "== initial_b_hat ? initial_b_hat"),
    ("run_robust_filter", "1000", "++robot->counters.tests", "++robot->counters.updates"),
    ("", "1000", "b_hat > MCP_ASDF_B_HAT_MIN ? b_hat", "b_hat > 0U ? b_hat"),
    (
        "mcp_asdf_observe",
        "1000",
        "t >= robot->config->memory;",
        "t >= robot->config->memory - (robot->config->memory == 1U << 30);",
    ),
    ("mcp_asdf_observe", "1000", "((n >> 1) & 1U)", "(n & 1U)"),
    ("mcp_asdf_observe", "1000", "robot->updated = 0;", ""),
    ("mcp_asdf_observe", "1000", "begin_batch(robot);", ""),
    ("mcp_asdf_receive", "1000", "sender == robot->id", "(sender == robot->id && sender != 0U)"),
    ("mcp_asdf_receive", "1000", "== robot->id", "== robot->id || (sender == 127U && robot->id == 90U)"),
    ("mcp_asdf_receive", "1000", "(sender & 7U)", "(sender & 6U)"),
    ("mcp_asdf_receive", "1000", "sender % MCP_ASDF_SLOTS", "sender % 16U"),
    ("mcp_asdf_receive", "1000", "(x_hat + 64U) >> 7", "x_hat >> 7"),
    ("mcp_asdf_settle", "1000", "--robot->filter_left == 0U", "--robot->filter_left <= 1U"),
    ("mcp_asdf_settle", "1000", "        publish_round_sums(robot);", ""),
    ("mcp_asdf_settle", "1000", "heard.all[1]", "heard.all[0]"),
    ("", "1000", "++robot->counters.updates", "++robot->counters.tests"),
    ("", "1000", "    robot->updated = 1;", "    robot->alpha = robot->updated = 1;"),
    ("asdf_test_rejects", "1000", "m <= q ? m", "m < q ? m"),
    ("asdf_test_rejects", "1000", "> upper_part", ">= upper_part"),
    ("mcp_asdf_save", "1000", "(uint32_t)robot->updated << 16", "(uint32_t)robot->updated << 15"),
    ("mcp_asdf_save", "1000", "pass_word(image, robot->t)", "pass_word(image, robot->n)"),
    ("mcp_asdf_restore", "1000", "has_magic_word && pass_word(&input", "has_magic_word || pass_word(&input"),
    ("mcp_asdf_restore", "1000", "    *robot = restored;", "    *robot = fresh;"),
    ("mcp_asdf_save", "1000", "pass_word(image, robust->turn)", "pass_word(image, robust->votes)"),
    ("mcp_asdf_restore", "1000", "turn <= MCP_ASDF_SLOTS ?", "turn < MCP_ASDF_SLOTS ?"),
    ("mcp_asdf_restore", "1000", "status != MCP_ASDF_OK", "status == MCP_ASDF_ERR_ID"),
)
"""A function that loses its lemma, or none where the numbers change that the code forms; a variant; what is
replaced, and by what."""


QUICK_FUNCTIONS = ("shift_left_wide", "multiply", "mcp_asdf_settle")
"""Functions whose broken code is tried in ``make test``."""
CASES = [
    *(case for case in BROKEN if case[0] in QUICK_FUNCTIONS),
    *slow(case for case in BROKEN if case[0] not in QUICK_FUNCTIONS),
]
CLAIMS_OF_NUMBERS = (
    *robust.OF_THE_CODE,
    *calls.OF_THE_CODE,
    *accuracy.OF_THE_CODE,
    *sums.OF_THE_CODE,
)


def write_broken_sources(folder: Path, function: str, right: str, wrong: str) -> None:
    """Write the firmware's sources into a folder, with a text in them replaced by a wrong one.

    In the two C files it is replaced from the function's definition on, or everywhere if it stands before.
    """
    is_found = False
    for path in (*ARITHMETIC, CORE, IMAGE, SOURCES / "mcp_asdf_robust.h"):
        text = path.read_text(encoding="utf-8")
        is_found |= right in text
        before, rest = "", text
        if path in (CORE, IMAGE):
            start = max(text.find(f" {function}("), 0)
            if right in text[start:]:
                before, rest = text[:start], text[start:]
        (folder / path.name).write_text(before + rest.replace(right, wrong), encoding="utf-8")
    assert is_found, right


def file_of(function: str, variant: Variant) -> Path:
    """Return the file to parse for the contract of a function."""
    if function in arithmetic.contracts(variant):
        return HEADER
    return IMAGE if function in images.CONTRACTS else CORE


@pytest.mark.parametrize(("name", "digits", "right", "wrong"), CASES)
def test_a_firmware_with_a_planted_mistake_has_no_proof(
    name: str, digits: str, right: str, wrong: str, tmp_path: Path
) -> None:
    """``name`` is the function whose contract it breaks, or "" where it breaks a claim about its numbers.

    ``digits`` choose how the firmware divides, multiplies and shifts.
    """
    write_broken_sources(tmp_path, name, right, wrong)
    variant = Variant(digits)
    code = Program(tmp_path / file_of(name, variant).name, variant)

    with pytest.raises(UnprovenError):
        if name:
            prove_lemma(code, name, {**calls.contracts(variant), **images.CONTRACTS}, set())
        else:
            for claims in CLAIMS_OF_NUMBERS:
                prove_all(claims(code))


# --- Contracts that promise nothing -----------------------------------------------------------------------


def contracts_of(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions that the firmware has in a variant, by the functions' names."""
    contracts = {**calls.contracts(variant), **images.CONTRACTS}
    return {
        name: contract for name, contract in contracts.items() if name in code_of(name, variant).functions
    }


def code_of(name: str, variant: Variant) -> Program:
    """Return the file that defines a function, or includes its definition, as a variant compiles it."""
    return program(variant, IMAGE if name in images.CONTRACTS else CORE)


def prove_of_any_result(name: str, variant: Variant, contract: Contract) -> None:
    """Prove that a function keeps a contract whatever it returns and writes: only an empty one is kept so."""
    anything = replace(contract, steps=(), uses=(), invariant=None, instead={name: any_result(name)})
    prove_contract(code_of(name, variant), name, {name: anything})


NAMES = sorted({name for variant in VARIANTS for name in calls.contracts(variant)} | images.CONTRACTS.keys())


@pytest.mark.parametrize("name", NAMES)
def test_a_function_that_may_return_anything_breaks_its_contract(name: str) -> None:
    """Otherwise the contract would promise nothing, and every code would keep it."""
    first_variant = next(variant for variant in VARIANTS if name in contracts_of(variant))
    with pytest.raises(UnprovenError, match="broken by"):
        prove_of_any_result(name, first_variant, contracts_of(first_variant)[name])


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_functions_that_may_return_anything_break_all_contracts_of_a_variant(variant: Variant) -> None:
    for name, contract in contracts_of(variant).items():
        with pytest.raises(UnprovenError, match="broken by"):
            prove_of_any_result(name, variant, contract)


def test_a_contract_that_promises_nothing_is_kept_by_any_result() -> None:
    prove_of_any_result("multiply", VARIANTS[0], Contract(always))
