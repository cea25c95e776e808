"""Functions of the C as formulas of the functions that they call, whatever those compute; and the lemmas of
alpha's form. ``sums`` and ``robust`` say with them what functions of the core compute."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import z3

from proofs.arithmetic import EXACT
from proofs.machine import Machine, Place, Summary, Table
from proofs.numbers import Number, Type, Words
from proofs.prove import Contract, any_result
from proofs.source import SOURCES, Program

CORE = SOURCES / "mcp_asdf.c"
ONE = 2**23
RESULTS = {
    **dict.fromkeys(("multiply", "join"), 64),
    **dict.fromkeys(("high_word", "low_word", "multiply_high", "round_mean", "quotient"), 32),
    **dict.fromkeys(("reestimate", "next_slot", "run_robust_filter"), 32),
    **dict.fromkeys(("asdf_test_rejects", "robust_test_rejects"), 1),
}
"""Called functions and the bits of their results. Nothing else is known of them here."""
Claim = tuple[str, Any, list[Any]]
"""Name of a claim, its formula, and of what it follows."""
Claims = Callable[[], Iterator[Claim]]


def call(name: str, *arguments: Any) -> Any:
    """Return the result of a function of the C: anything, but the same for the same words.

    A function may also have the robot as an argument, of which there is one.
    """
    function = z3.Function(name, *(each.sort() for each in arguments), z3.BitVecSort(RESULTS[name]))
    return function(*arguments)


def _stands_in(name: str) -> Summary:
    def summary(machine: Machine, *arguments: Any) -> Number:
        any_result(name)(machine, *arguments)
        words = (each.term for each in arguments if isinstance(each, Number))
        return Number(call(name, *words), Type(RESULTS[name]))

    return summary


def units(alpha: Any) -> Any:
    """Return the 64 bits of an alpha word in units of 2^-24."""
    return z3.ZeroExt(32, z3.LShR(alpha, 8)) << z3.ZeroExt(32, alpha & 31)


def _in_words(_: Machine, alpha: Number) -> dict[str, Number]:
    whole = units(alpha.term)
    return {name: Number(EXACT[f"{name}_word"](whole), Type(32)) for name in ("high", "low")}


def _exactly(name: str) -> Summary:
    return lambda _, *given: Number(EXACT[name](*(each.term for each in given)), Type(RESULTS[name]))


BY_LEMMA: dict[str, Summary] = {
    **{name: _exactly(name) for name in ("join", "high_word", "low_word")},
    "alpha_units": _in_words,
}
"""Functions that are known by their lemmas, where they are not opaque."""


def same(after: Any, before: Any) -> Any:
    """Return the claim that a structure and the targets of its pointers are as in ``before``.

    Tables may hold anything. A table is the same if its first word is.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        return z3.And([same(after[name], each) for name, each in before.items()])
    if isinstance(before, Table):
        return after.word(z3.BitVecVal(0, 32)) == before.word(z3.BitVecVal(0, 32))
    return after == before


def nothing(value: Any) -> Any:
    """Return a structure like this one in which all members are 0."""
    if isinstance(value, dict):
        return {name: nothing(member) for name, member in value.items()}
    return z3.BitVecVal(0, value.size())


def returns(status: Any, *cases: tuple[Any, int]) -> Any:
    """Return the code of the first case that is so, or 0."""
    found = z3.BitVecVal(0, status.size())
    for condition, code in reversed(cases):
        found = z3.If(condition, z3.BitVecVal(code, status.size()), found)
    return status == found


def _keep_b_hat(machine: Machine, robot: Place, b_hat: Number) -> None:
    """set_b_hat(), as far as update_b_hat() is concerned."""
    machine.store(Place(robot.variable, (*robot.path, "accuracy", "b_hat")), b_hat)


def formed(program: Program, name: str, opaque: Iterable[str] = RESULTS) -> tuple[dict[str, Any], Any]:
    """Return the terms of a function's unknown arguments by name, and its result.

    Members of structures have their own names. If the first argument is a pointer that the function may
    write to, the target of the pointer stands behind the result.
    """
    called = BY_LEMMA | {each: _stands_in(each) for each in opaque if each != name}
    machine = Machine(program, Words, called | {"set_b_hat": _keep_b_hat})
    given: dict[str, Any] = {}
    values = [machine.unknown_of(each.type, each.name) for each in program.parameters(name)]
    for parameter, value in zip(program.parameters(name), values, strict=True):
        seen = machine.seen(value)
        given |= seen if isinstance(seen, dict) else {parameter.name: seen}
    found = machine.seen(machine.call(name, *values))
    return given, (found, machine.seen(values[0]) if isinstance(values[0], Place) else None)


# --- The form of alpha ---


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


CONTRACTS = {
    "alpha_units": Contract(_are_units),
    "alpha_word_from_mantissa": Contract(_is_on_grid, requires=_is_normal),
}
