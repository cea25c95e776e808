"""Functions of the C as formulas of the functions that they call, whatever those compute; and the lemmas of
alpha's form. ``sums`` and ``robust`` use this to state what functions of the core compute."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import z3

from proofs.arithmetic import EXACT_RESULTS
from proofs.machine import ConstantTable, Location, Machine, Summary
from proofs.numbers import BitVectorArithmetic, IntegerType, Number
from proofs.prove import Claim, Contract, any_result
from proofs.source import SOURCES, Program

CORE = SOURCES / "mcp_asdf.c"
ONE = 2**23
"""An x_hat of 1."""
RESULT_BITS = {
    **dict.fromkeys(("multiply", "join"), 64),
    **dict.fromkeys(("high_word", "low_word", "multiply_high", "round_mean", "quotient"), 32),
    **dict.fromkeys(("reestimate", "next_slot", "run_robust_filter"), 32),
    **dict.fromkeys(("asdf_test_rejects", "robust_test_rejects"), 1),
}
"""Called functions and the bits of their results. Nothing else is known of them here."""
Claims = Callable[[], Iterator[Claim]]
"""Makes claims about numbers."""


def result_of(name: str, *argument_words: Any) -> Any:
    """Return the term of a called function's result: anything, but the same for the same words.

    A function may also have the robot as an argument, of which there is one.
    """
    argument_sorts = [word.sort() for word in argument_words]
    function = z3.Function(name, *argument_sorts, z3.BitVecSort(RESULT_BITS[name]))
    return function(*argument_words)


def _uninterpreted_summary(name: str) -> Summary:
    """Return a stand-in that gives ``result_of`` its arguments, and may write anything."""

    def call_uninterpreted(machine: Machine, *arguments: Any) -> Number:
        # Whatever its pointers point to may have changed; only the result is tied to the arguments.
        any_result(name)(machine, *arguments)
        argument_words = [argument.term for argument in arguments if isinstance(argument, Number)]
        return Number(result_of(name, *argument_words), IntegerType(RESULT_BITS[name]))

    return call_uninterpreted


def alpha_in_units(alpha: Any) -> Any:
    """Return the 64 bits of an alpha word in units of 2^-24."""
    mantissa, exponent = z3.LShR(alpha, 8), alpha & 31
    return z3.ZeroExt(32, mantissa) << z3.ZeroExt(32, exponent)


def _call_alpha_units(_machine: Machine, alpha: Number) -> dict[str, Number]:
    """Stand in for alpha_units() by its lemma."""
    units = alpha_in_units(alpha.term)
    high, low = EXACT_RESULTS["high_word"](units), EXACT_RESULTS["low_word"](units)
    return {"high": Number(high, IntegerType(32)), "low": Number(low, IntegerType(32))}


def _exact_summary(name: str) -> Summary:
    """Return a stand-in for a function of the arithmetic by its lemma."""

    def call_exact(_machine: Machine, *arguments: Number) -> Number:
        result_term = EXACT_RESULTS[name](*(argument.term for argument in arguments))
        return Number(result_term, IntegerType(RESULT_BITS[name]))

    return call_exact


LEMMA_SUMMARIES: dict[str, Summary] = {
    **{name: _exact_summary(name) for name in ("join", "high_word", "low_word")},
    "alpha_units": _call_alpha_units,
}
"""Functions that are known by their lemmas, where they are not uninterpreted."""


def is_same(actual: Any, expected: Any) -> Any:
    """Return the formula that a structure and the targets of its pointers are as in ``expected``.

    Members that ``expected`` leaves out may hold anything, and so may tables: a table is the same if its
    first word is.
    """
    if isinstance(expected, dict) and isinstance(actual, dict):
        return z3.And([is_same(actual[name], member) for name, member in expected.items()])
    if isinstance(expected, ConstantTable):
        first_index = z3.BitVecVal(0, 32)
        return actual.word_at(first_index) == expected.word_at(first_index)
    return actual == expected


def zeros_like(structure: Any) -> Any:
    """Return a structure like this one in which all members are 0."""
    if isinstance(structure, dict):
        return {name: zeros_like(member) for name, member in structure.items()}
    return z3.BitVecVal(0, structure.size())


def returns_code_of_first(status: Any, *cases: tuple[Any, int]) -> Any:
    """Return the formula that a status is the code of the first case whose condition holds, or else 0."""
    expected_status = z3.BitVecVal(0, status.size())
    # From the last case to the first, so that the first one is asked first.
    for condition, code in reversed(cases):
        expected_status = z3.If(condition, z3.BitVecVal(code, status.size()), expected_status)
    return status == expected_status


def _call_set_b_hat(machine: Machine, robot: Location, b_hat: Number) -> None:
    """Stand in for set_b_hat(), as far as update_b_hat() is concerned."""
    machine.store(robot.select("accuracy", "b_hat"), b_hat)


def function_terms(
    program: Program, name: str, uninterpreted_names: Iterable[str] = RESULT_BITS
) -> tuple[dict[str, Any], Any, Any]:
    """Run a function on unknown arguments, while the functions that it calls may compute anything.

    Returns the terms of the arguments by name, the term of the result, and the terms of what the first
    argument points to afterwards, None if it is no pointer. Members of structures have their own names.
    """
    summaries = dict(LEMMA_SUMMARIES)
    for called_name in uninterpreted_names:
        # The function itself is executed, even if others know it as uninterpreted.
        if called_name != name:
            summaries[called_name] = _uninterpreted_summary(called_name)
    summaries["set_b_hat"] = _call_set_b_hat
    machine = Machine(program, BitVectorArithmetic, summaries)
    parameters = program.parameters(name)
    arguments = [machine.fresh_value(parameter.type, parameter.name) for parameter in parameters]
    argument_terms: dict[str, Any] = {}
    for parameter, argument in zip(parameters, arguments, strict=True):
        terms = machine.terms_of(argument)
        argument_terms |= terms if isinstance(terms, dict) else {parameter.name: terms}
    result = machine.terms_of(machine.call(name, *arguments))
    first_argument = arguments[0]
    target_after = machine.terms_of(first_argument) if isinstance(first_argument, Location) else None
    return argument_terms, result, target_after


# --- The form of alpha ---


def _is_in_units(result: Any, alpha: Any) -> Any:
    return z3.Concat(result["high"], result["low"]) == alpha_in_units(alpha)


def _is_normal(mantissa: Any, exponent: Any) -> Any:
    """Return that the mantissa has 24 bits; and the exponent, modulo 2^32, is at least -31."""
    return z3.And(mantissa >> 23 == 1, z3.Or(exponent >= -31, exponent >= 0))


def _is_rounded_alpha(result: Any, mantissa: Any, exponent: Any) -> Any:
    """Return that the result is the largest confidence if the exponent is too large for it.

    Otherwise it is the number itself, or whole units of it, rounded down, with shift 0.
    """
    # An alpha word has the mantissa in its upper 24 bits, and the shift, up to 31, below it.
    largest_alpha, exact_alpha = 0xFFFFFF1F, mantissa << 8 | exponent
    whole_units = z3.LShR(mantissa, -exponent) << 8
    return z3.If(
        exponent > 31, result == largest_alpha, result == z3.If(exponent >= 0, exact_alpha, whole_units)
    )


CONTRACTS = {
    "alpha_units": Contract(_is_in_units),
    "alpha_word_from_mantissa": Contract(_is_rounded_alpha, requires=_is_normal),
}
