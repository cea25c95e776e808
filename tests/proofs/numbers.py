"""C's integers as terms of the solver: as bit vectors, or as mathematical integers.

Bit vectors are exact for every operator, and settle what shifts and masks do. Mathematical integers suit
products and quotients, which take the solver too long on bit vectors; there an operator is only allowed where
it means arithmetic. Both state what C leaves undefined as a claim, to be proved where the operator stands.
"""

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
    def minimum(self) -> int:
        """The smallest value of the type."""
        return -(1 << (self.bits - 1)) if self.signed else 0

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


class BitVectorArithmetic:
    """C's operators on bit vectors. Both operands have the same type, but for a shift's count.

    ``require`` is called with each claim on which the meaning of an operator depends.
    """

    def __init__(self, require: Require) -> None:
        self.require = require

    def constant(self, value: int, type_: IntegerType) -> Number:
        """Return a number with this value."""
        return Number(z3.BitVecVal(value, type_.bits), type_)

    def fresh_number(self, name: str, type_: IntegerType) -> tuple[Number, Any]:
        """Return a number with any value, and the formula that it is in the range of its type."""
        number = Number(z3.BitVec(name, type_.bits), type_)
        return number, self.is_in_range(number)

    def is_in_range(self, _number: Number) -> Any:
        """Return the formula that a number is in the range of its type: every bit vector is."""
        return z3.BoolVal(True)

    def convert(self, number: Number, type_: IntegerType) -> Number:
        """Return a number as C converts it to another type."""
        if type_.bits == 1:  # _Bool is 1 for every number but 0
            return Number(z3.If(number.term != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1)), type_)
        added_bits = type_.bits - number.type.bits
        if added_bits > 0:
            # A longer type keeps the value: a signed one repeats its sign.
            extend = z3.SignExt if number.type.signed else z3.ZeroExt
            return Number(extend(added_bits, number.term), type_)
        if added_bits < 0:
            # A shorter type keeps the lower bits.
            return Number(z3.Extract(type_.bits - 1, 0, number.term), type_)
        return Number(number.term, type_)

    def binary(self, symbol: str, left_operand: Number, right_operand: Number) -> Number:
        """Return the result of an operator, and require that it is defined: C forbids signed overflow."""
        if symbol in ("<<", ">>"):
            self.require(z3.ULT(right_operand.term, left_operand.type.bits), "shift by the width or more")
            # The solver shifts by a count of the same length only.
            right_operand = self.convert(right_operand, IntegerType(left_operand.type.bits))
        elif symbol in ("/", "%"):
            self.require(right_operand.term != 0, "division by 0")
        elif left_operand.type.signed and symbol in _OVERFLOW_CHECKS:
            for is_within_range in _OVERFLOW_CHECKS[symbol]:
                self.require(is_within_range(left_operand.term, right_operand.term), f"overflow of {symbol}")
        result_term = _BIT_VECTOR_OPERATORS[left_operand.type.signed][symbol](
            left_operand.term, right_operand.term
        )
        return Number(result_term, left_operand.type)

    def compare(self, symbol: str, left_operand: Number, right_operand: Number) -> Any:
        """Return the formula that a comparison of two numbers is true."""
        return _BIT_VECTOR_OPERATORS[left_operand.type.signed][symbol](left_operand.term, right_operand.term)


Operator = Callable[[Any, Any], Any]
_OVERFLOW_CHECKS: dict[str, tuple[Operator, ...]] = {
    "+": (lambda a, b: z3.BVAddNoOverflow(a, b, True), z3.BVAddNoUnderflow),
    "-": (z3.BVSubNoOverflow, lambda a, b: z3.BVSubNoUnderflow(a, b, True)),
    "*": (lambda a, b: z3.BVMulNoOverflow(a, b, True), z3.BVMulNoUnderflow),
}
"""The formulas that a signed operator neither exceeds the largest value nor falls below the smallest."""
_PYTHON_OPERATORS: dict[str, Operator] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "<<": operator.lshift},
    **{"&": operator.and_, "|": operator.or_, "^": operator.xor},
}
_COMPARISONS: dict[str, Operator] = {
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge},
    **{"==": operator.eq, "!=": operator.ne},
}
# Python's operators on bit vectors mean signed numbers, so unsigned ones need functions of the solver.
_UNSIGNED_OPERATORS: dict[str, Operator] = {
    **{"/": z3.UDiv, "%": z3.URem, ">>": z3.LShR},
    **{"<": z3.ULT, "<=": z3.ULE, ">": z3.UGT, ">=": z3.UGE},
}
_BIT_VECTOR_OPERATORS = {
    False: {**_PYTHON_OPERATORS, **_COMPARISONS, **_UNSIGNED_OPERATORS},
    True: {**_PYTHON_OPERATORS, **_COMPARISONS, ">>": operator.rshift},
}
"""Operators by signedness and symbol; the firmware divides no signed number."""


class IntegerArithmetic:
    """C's operators on mathematical integers.

    Where an operator might leave the range of its type, an unsigned result is reduced modulo 2^bits, as C
    says, and a signed result has a claim that it is in range. An operator without a meaning in arithmetic
    is an error. ``require`` is called with each claim.
    """

    def __init__(self, require: Require) -> None:
        self.require = require

    def constant(self, value: int, type_: IntegerType) -> Number:
        """Return a number with this value."""
        return Number(z3.IntVal(value), type_)

    def fresh_number(self, name: str, type_: IntegerType) -> tuple[Number, Any]:
        """Return a number with any value, and the formula that it is in the range of its type."""
        number = Number(z3.Int(name), type_)
        return number, self.is_in_range(number)

    def is_in_range(self, number: Number) -> Any:
        """Return the formula that a number is in the range of its type."""
        return z3.And(number.type.minimum <= number.term, number.term <= number.type.maximum)

    def convert(self, number: Number, type_: IntegerType) -> Number:
        """Return a number as C converts it to another type."""
        # A range within the other one needs no reduction.
        if number.type.minimum >= type_.minimum and number.type.maximum <= type_.maximum:
            return Number(number.term, type_)
        assert not type_.signed, "whole numbers cannot be made signed"
        return Number(number.term % (type_.maximum + 1), type_)

    def binary(self, symbol: str, left_operand: Number, right_operand: Number) -> Number:
        """Return the result of an operator, and require that it is defined."""
        exact_term = self._exact_result(symbol, left_operand.term, right_operand.term)
        if left_operand.type.signed:
            is_in_range = z3.And(
                left_operand.type.minimum <= exact_term, exact_term <= left_operand.type.maximum
            )
            self.require(is_in_range, f"overflow of {symbol}")
            return Number(exact_term, left_operand.type)
        # The other operators give no more than their left operand, or bits that both have.
        may_wrap = symbol in ("+", "-", "*", "<<")
        return Number(
            exact_term % (left_operand.type.maximum + 1) if may_wrap else exact_term, left_operand.type
        )

    def compare(self, symbol: str, left_operand: Number, right_operand: Number) -> Any:
        """Return the formula that a comparison of two numbers is true."""
        return _COMPARISONS[symbol](left_operand.term, right_operand.term)

    def _exact_result(self, symbol: str, left_operand: Any, right_operand: Any) -> Any:
        """Return the term of an operator's result, not reduced to its type."""
        if symbol in ("+", "-", "*"):
            return _PYTHON_OPERATORS[symbol](left_operand, right_operand)
        if symbol == "<<":
            return left_operand * (1 << constant_value(right_operand))
        if symbol == ">>":
            return left_operand / (1 << constant_value(right_operand))
        if symbol == "/":
            # The solver rounds down and C towards 0, which is the same here, as no operand is negative.
            self.require(right_operand > 0, "division by 0")
            return left_operand / right_operand
        if symbol == "&":
            mask = constant_value(right_operand)
            assert mask & (mask + 1) == 0, "whole numbers know no mask but the lower bits"
            return left_operand % (mask + 1)
        if symbol == "|":
            return self._join_bits(left_operand, right_operand)
        raise NotImplementedError(f"{symbol} of whole numbers")

    def _join_bits(self, left_operand: Any, right_operand: Any) -> Any:
        """Return ``|`` of terms, and require that no bit is set in both: then it is their sum."""
        # One operand has zeros below a boundary, and the other is below it. These boundaries occur.
        have_separate_bits = [
            z3.And(high % (1 << boundary) == 0, low < 1 << boundary)
            for high, low in ((left_operand, right_operand), (right_operand, left_operand))
            for boundary in (1, 8, 9, 16, 32)
        ]
        self.require(z3.Or(have_separate_bits), "bits in the same place")
        return left_operand + right_operand


def is_constant(term: Any) -> bool:
    """Return whether a term is a literal number."""
    return bool(z3.is_int_value(term) or z3.is_bv_value(term))


def constant_value(term: Any) -> int:
    """Return the value of a term that simplifies to a constant; another term is an error."""
    simplified_term = z3.simplify(term)
    if is_constant(simplified_term):
        return int(simplified_term.as_long())
    raise NotImplementedError(f"{simplified_term} would have to be a constant")
