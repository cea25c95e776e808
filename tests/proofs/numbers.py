"""C's integers as terms of the solver: as words of bits, or as whole numbers.

Words are exact for every operator, and settle what shifts and masks do. Whole numbers know products and
quotients, which words of bits take too long for; an operator is only allowed where it means arithmetic. Both
state what C leaves undefined as a claim, to be proved where the operator stands.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import z3

Claim = Callable[[Any, str], None]
"""Takes a formula that must hold where the program is, and what it is about."""


@dataclass(frozen=True)
class Type:
    """An integer type."""

    bits: int
    signed: bool = False

    @property
    def least(self) -> int:
        return -(1 << self.bits - 1) if self.signed else 0

    @property
    def most(self) -> int:
        return (1 << self.bits - self.signed) - 1


@dataclass(frozen=True)
class Number:
    """A value of an integer type, as a term of the solver."""

    term: Any
    type: Type


class Words:
    """Integers as words of bits. Of two numbers, an operator takes those of one type; a shift may differ."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim

    def constant(self, value: int, type_: Type) -> Number:
        return Number(z3.BitVecVal(value, type_.bits), type_)

    def unknown(self, name: str, type_: Type) -> tuple[Number, Any]:
        """Return a number about which only this formula is known."""
        return Number(z3.BitVec(name, type_.bits), type_), z3.BoolVal(True)

    def fits(self, _: Number) -> Any:
        """Return the claim that the number is one of its type."""
        return z3.BoolVal(True)

    def convert(self, number: Number, type_: Type) -> Number:
        more = type_.bits - number.type.bits
        if type_.bits == 1:
            return Number(z3.If(number.term != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1)), type_)
        if more > 0:
            extend = z3.SignExt if number.type.signed else z3.ZeroExt
            return Number(extend(more, number.term), type_)
        return Number(z3.Extract(type_.bits - 1, 0, number.term) if more else number.term, type_)

    def binary(self, name: str, left: Number, right: Number) -> Number:
        if name in ("<<", ">>"):
            right = self._count(left, right)
        elif name in ("/", "%"):
            self.claim(right.term != 0, "division by 0")
        elif left.type.signed and name in _NO_OVERFLOW:
            for fits in _NO_OVERFLOW[name]:
                self.claim(fits(left.term, right.term), f"overflow of {name}")
        return Number(_ON_WORDS[left.type.signed][name](left.term, right.term), left.type)

    def _count(self, left: Number, right: Number) -> Number:
        self.claim(z3.ULT(right.term, left.type.bits), "shift by the width or more")
        return self.convert(right, Type(left.type.bits))

    def compare(self, name: str, left: Number, right: Number) -> Any:
        return _ON_WORDS[left.type.signed][name](left.term, right.term)


_NO_OVERFLOW: dict[str, tuple[Callable[[Any, Any], Any], ...]] = {
    "+": (lambda a, b: z3.BVAddNoOverflow(a, b, True), z3.BVAddNoUnderflow),
    "-": (z3.BVSubNoOverflow, lambda a, b: z3.BVSubNoUnderflow(a, b, True)),
    "*": (lambda a, b: z3.BVMulNoOverflow(a, b, True), z3.BVMulNoUnderflow),
}
Operator = Callable[[Any, Any], Any]
_OF_PYTHON: dict[str, Operator] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "<<": operator.lshift},
    **{"&": operator.and_, "|": operator.or_, "^": operator.xor},
}
_COMPARED: dict[str, Operator] = {
    **{"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge},
    **{"==": operator.eq, "!=": operator.ne},
}
_ON_UNSIGNED: dict[str, Operator] = {
    **{"/": z3.UDiv, "%": z3.URem, ">>": z3.LShR},
    **{"<": z3.ULT, "<=": z3.ULE, ">": z3.UGT, ">=": z3.UGE},
}
_ON_WORDS = {
    False: {**_OF_PYTHON, **_COMPARED, **_ON_UNSIGNED},
    True: {**_OF_PYTHON, **_COMPARED, ">>": operator.rshift},
}
"""By signedness; the firmware divides no signed number."""


class Integers:
    """Integers as whole numbers, brought into their type's range where an operator might leave it."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim

    def constant(self, value: int, type_: Type) -> Number:
        return Number(z3.IntVal(value), type_)

    def unknown(self, name: str, type_: Type) -> tuple[Number, Any]:
        number = Number(z3.Int(name), type_)
        return number, self.fits(number)

    def fits(self, number: Number) -> Any:
        return z3.And(number.type.least <= number.term, number.term <= number.type.most)

    def convert(self, number: Number, type_: Type) -> Number:
        if number.type.least >= type_.least and number.type.most <= type_.most:
            return Number(number.term, type_)
        assert not type_.signed, "whole numbers cannot be made signed"
        return Number(number.term % (type_.most + 1), type_)

    def binary(self, name: str, left: Number, right: Number) -> Number:
        exact = _ON_INTEGERS[name](left, right, self.claim)
        if left.type.signed:
            fits = z3.And(left.type.least <= exact, exact <= left.type.most)
            self.claim(fits, f"overflow of {name}")
            return Number(exact, left.type)
        grows = name in ("+", "-", "*", "<<")
        return Number(exact % (left.type.most + 1) if grows else exact, left.type)

    def compare(self, name: str, left: Number, right: Number) -> Any:
        return _COMPARED[name](left.term, right.term)


def known(term: Any) -> int:
    """Return the value of a term that is a constant."""
    simple = z3.simplify(term)
    if z3.is_int_value(simple) or z3.is_bv_value(simple):
        return int(simple.as_long())
    raise NotImplementedError(f"{simple} would have to be a constant")


def _divided(left: Number, right: Number, claim: Claim) -> Any:
    claim(right.term > 0, "division by 0")
    return left.term / right.term


def _masked(left: Number, right: Number, _: Claim) -> Any:
    mask = known(right.term)
    assert mask & (mask + 1) == 0, "whole numbers know no mask but the lower bits"
    return left.term % (mask + 1)


def _joined(left: Number, right: Number, claim: Claim) -> Any:
    """Return ``|`` of numbers whose bits are in different places, which is their sum."""
    apart = [
        z3.And(high % (1 << place) == 0, low < 1 << place)
        for high, low in ((left.term, right.term), (right.term, left.term))
        for place in (1, 8, 9, 16, 32)
    ]
    claim(z3.Or(apart), "bits in the same place")
    return left.term + right.term


_ON_INTEGERS: dict[str, Callable[[Number, Number, Claim], Any]] = {
    "+": lambda a, b, _: a.term + b.term,
    "-": lambda a, b, _: a.term - b.term,
    "*": lambda a, b, _: a.term * b.term,
    "<<": lambda a, b, _: a.term * (1 << known(b.term)),
    ">>": lambda a, b, _: a.term / (1 << known(b.term)),
    "/": _divided,
    "&": _masked,
    "|": _joined,
}
