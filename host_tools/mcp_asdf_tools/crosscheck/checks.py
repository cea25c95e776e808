"""Checks of single values of a robot's state. They return one line per wrong value."""

from __future__ import annotations

from fractions import Fraction

from mcp_asdf_tools.crosscheck.bounds import Bounds
from mcp_asdf_tools.crosscheck.scenario import State


def alpha_units(word: int) -> int:
    """Return the confidence for which an alpha word stands, in units of 2**-24: mantissa * 2**shift."""
    mantissa = word >> 8  # bits 8 to 31
    shift = word % 32  # bits 0 to 4
    return mantissa << shift


def check_exact(state: State, expected: State) -> list[str]:
    """Compare ``state`` with the fields of ``expected``, and return one line per field that differs."""
    problems = []
    for name, expected_value in expected.items():
        if state[name] != expected_value:
            problems.append(f"{name} is {state[name]}, exactly {expected_value}")
    return problems


def check_bounds(name: str, value: Fraction, bounds: Bounds) -> list[str]:
    """Return a line, with ``name``, if the value is out of bounds, and an empty list if not."""
    lower, upper = bounds
    if lower <= value <= upper:
        return []
    return [f"{name} is {float(value):.9g}, outside {float(lower):.9g} to {float(upper):.9g}"]


def check_whether_updated(is_updated: bool, expected: bool | None) -> list[str]:
    """Return a line if b_hat was re-estimated although it must not be, or the other way round.

    The result is an empty list if it is right, and for an ``expected`` of None in any case: there rounding
    decides whether b_hat is re-estimated.
    """
    if expected is None or is_updated == expected:
        return []
    if is_updated:
        return ["b_hat is re-estimated, wrongly"]
    return ["b_hat is not re-estimated, wrongly"]
