"""The lemmas of ``mcp_asdf.c``: what its quotients of sums are worth, and the form of alpha."""

from __future__ import annotations

from typing import Any

import z3

from proofs.arithmetic import contracts as arithmetic_contracts
from proofs.machine import Machine, Summary
from proofs.numbers import Number, Type
from proofs.prove import Contract
from proofs.source import SOURCES, Variant

CORE = SOURCES / "mcp_asdf.c"
ONE = 2**23
WORD = Type(32)


def _are_units(found: Any, alpha: Any) -> Any:
    mantissa, shift = z3.LShR(alpha, 8), alpha & 31
    return z3.Concat(found["high"], found["low"]) == z3.ZeroExt(32, mantissa) << z3.ZeroExt(32, shift)


# --- alpha -----------------------------------------------------------------------------------------------


def _is_normal(mantissa: Any, exponent: Any) -> Any:
    """24 bits; the exponent modulo 2^32, at least -31."""
    return z3.And(mantissa >> 23 == 1, z3.Or(exponent >= -31, exponent >= 0))


def _is_on_grid(found: Any, mantissa: Any, exponent: Any) -> Any:
    """The largest confidence; the number itself; or whole units of it, rounded down, with shift 0."""
    largest, exact = 0xFFFFFF1F, mantissa << 8 | exponent
    below = z3.LShR(mantissa, -exponent) << 8
    return z3.If(exponent > 31, found == largest, found == z3.If(exponent >= 0, exact, below))


def _is_accuracy(after: Any, _: Any, b_hat: Any) -> Any:
    """The header's statements about the members, except the squares."""
    held = after["accuracy"]
    half = b_hat == 1 << 31
    c = z3.If(z3.ULT(b_hat, 1 << 31), b_hat, -b_hat)
    says_nothing = z3.UGT(c, C_MOST)
    is_scaled = z3.LShR((-2 * c) << held["g_shift"], 31) == 1
    return z3.And(
        held["b_hat"] == b_hat,
        z3.Or(half, is_scaled),
        held["c"] == z3.If(says_nothing, z3.BitVecVal(2**32 - 1, 32), c),
        z3.Or(half, z3.ULE(held["g_shift"], 11) == z3.Not(says_nothing)),
        z3.Or(z3.ULE(held["g_shift"], 30), z3.And(half, held["g_shift"] == 31)),
        z3.If(
            half,
            held["rare_shift"] == 0,
            z3.And(z3.UGE(held["rare_shift"], 2), z3.ULE(held["rare_shift"], 38)),
        ),
    )


C_MOST = (1 << 31) - (1 << 19)
"""The largest c that says something."""


def _square(machine: Machine, g: Number, p: Number) -> Number:
    """square_of_ratio(), which takes g and p of 32 bits, if b_hat is not 1/2."""
    is_long = z3.And(z3.ULE(1 << 31, g.term), z3.ULE(1 << 31, p.term))
    machine.claim(z3.Or(is_long, machine.given["b_hat"] == 1 << 31), "what square_of_ratio requires")
    return machine.unknown("square", WORD)


def _b_hat_in_range(_: Any, b_hat: Any) -> Any:
    return z3.And(z3.UGE(b_hat, 1 << 12), z3.ULE(b_hat, 2**32 - 2**12))


def _of_alpha(lower: dict[str, Contract]) -> dict[str, Contract]:
    def stand_in(*names: str) -> dict[str, Summary]:
        return {name: lower[name].stands_in(name) for name in names}

    shifts = ("shift_left", "shift_right", "shift_right_64", "upper", "leading_zeros")
    words = stand_in("join", "high_word", "low_word", *shifts)
    return {
        "alpha_word": Contract(_is_on_grid, requires=_is_normal, uses=words),
        "set_b_hat": Contract(
            _is_accuracy,
            requires=_b_hat_in_range,
            uses={**words, "square_of_ratio": _square},
        ),
    }


def contracts(variant: Variant) -> dict[str, Contract]:
    """All of them, for one variant. ``accuracy`` shows what the other functions compute, and that they keep
    what they owe those they call."""
    return {"units": Contract(_are_units), **_of_alpha(arithmetic_contracts(variant))}
