"""C's integers as bit vectors of the solver, with C's conversions and operators."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import z3

Require = Callable[[Any, str], None]
"""Takes a formula that must hold where the program is, and a description of it."""


@dataclass(frozen=True)
class IntegerType:
    """An integer type of C."""

    bits: int
    signed: bool = False

    @property
    def maximum(self) -> int:
        """The largest value of the type."""
        value_bits = self.bits - 1 if self.signed else self.bits
        return (1 << value_bits) - 1


@dataclass(frozen=True)
class Number:
    """A value of an integer type, as a term of the solver."""

    term: Any
    type: IntegerType


def constant(value: int, type_: IntegerType) -> Number:
    """Return a number with this value."""
    return Number(z3.BitVecVal(value, type_.bits), type_)


def convert(number: Number, type_: IntegerType) -> Number:
    """Return a number as C converts it to another type."""
    if type_.bits == 1:  # _Bool is 1 for every number but 0
        return Number(z3.If(number.term != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1)), type_)
    added_bits = type_.bits - number.type.bits
    term = number.term
    if added_bits > 0:
        # A longer type keeps the value: a signed one repeats its sign.
        extend = z3.SignExt if number.type.signed else z3.ZeroExt
        term = extend(added_bits, term)
    elif added_bits < 0:
        # A shorter type keeps the lower bits.
        term = z3.Extract(type_.bits - 1, 0, term)
    # A literal stays a literal.
    return Number(z3.simplify(term) if z3.is_bv_value(number.term) else term, type_)


Operator = Callable[[Any, Any], Any]
_OPERATORS: dict[str, Operator] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "<<": operator.lshift},
    **{"&": operator.and_, "|": operator.or_, "^": operator.xor, "==": operator.eq, "!=": operator.ne},
}
# Python's operators on bit vectors mean signed numbers, so unsigned ones need functions of the solver.
_SIGNED_OPERATORS: dict[str, Operator] = {
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, ">>": operator.rshift},
}
_UNSIGNED_OPERATORS: dict[str, Operator] = {
    **{"<": z3.ULT, "<=": z3.ULE, ">": z3.UGT, ">=": z3.UGE, ">>": z3.LShR, "/": z3.UDiv, "%": z3.URem},
}
OPERATORS = {True: {**_OPERATORS, **_SIGNED_OPERATORS}, False: {**_OPERATORS, **_UNSIGNED_OPERATORS}}
"""Operators and comparisons by signedness and symbol. The firmware divides no signed numbers."""


def apply_operator(symbol: str, left_operand: Number, right_operand: Number, require: Require) -> Number:
    """Return the result of an operator on two numbers of the same type; a shift's count may have another.

    ``require`` is called with what must hold for C to define the result. Raises NotImplementedError if the
    operator is not known for the type.
    """
    type_ = left_operand.type
    if symbol not in OPERATORS[type_.signed]:
        raise NotImplementedError(
            f"{symbol} of {'signed' if type_.signed else 'unsigned'} numbers is not known"
        )
    if symbol in ("<<", ">>"):
        require(z3.ULT(right_operand.term, type_.bits), "shift by the width or more")
        # The solver shifts by a count of the same length only.
        right_operand = convert(right_operand, IntegerType(type_.bits))
    elif symbol in ("/", "%"):
        require(right_operand.term != 0, "division by 0")
    operate = OPERATORS[type_.signed][symbol]
    result = Number(operate(left_operand.term, right_operand.term), type_)
    if type_.signed and symbol in ("+", "-", "*", "<<"):
        # Twice as many bits hold every result.
        long_type = IntegerType(2 * type_.bits, signed=True)
        exact_term = operate(convert(left_operand, long_type).term, convert(right_operand, long_type).term)
        require(convert(result, long_type).term == exact_term, f"overflow of {symbol}")
    return result


def compare(symbol: str, left_operand: Number, right_operand: Number) -> Any:
    """Return the formula that a comparison of two numbers of the same type is true."""
    return OPERATORS[left_operand.type.signed][symbol](left_operand.term, right_operand.term)


def constant_value(term: Any) -> int | None:
    """Return the value of a term that simplifies to a constant, or None."""
    simplified_term = z3.simplify(term)
    return int(simplified_term.as_long()) if z3.is_bv_value(simplified_term) else None
