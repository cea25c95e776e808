"""The lemmas of ``mcp_asdf.c``: the form of alpha. ``accuracy`` and ``sums`` show what its other functions
compute, and that they keep what they owe those they call."""

from __future__ import annotations

from typing import Any

import z3

from proofs.formulas import units
from proofs.prove import Contract
from proofs.source import SOURCES

CORE = SOURCES / "mcp_asdf.c"
ONE = 2**23
C_MOST = (1 << 31) - (1 << 19)
"""The largest c that says something."""


def _are_units(found: Any, alpha: Any) -> Any:
    return z3.Concat(found["high"], found["low"]) == units(alpha)


def _is_normal(mantissa: Any, exponent: Any) -> Any:
    """24 bits; the exponent modulo 2^32, at least -31."""
    return z3.And(mantissa >> 23 == 1, z3.Or(exponent >= -31, exponent >= 0))


def _is_on_grid(found: Any, mantissa: Any, exponent: Any) -> Any:
    """The largest confidence; the number itself; or whole units of it, rounded down, with shift 0."""
    largest, exact = 0xFFFFFF1F, mantissa << 8 | exponent
    below = z3.LShR(mantissa, -exponent) << 8
    return z3.If(exponent > 31, found == largest, found == z3.If(exponent >= 0, exact, below))


CONTRACTS = {"units": Contract(_are_units), "alpha_word": Contract(_is_on_grid, requires=_is_normal)}
