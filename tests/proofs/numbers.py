"""C's integers as terms of the solver: as words of bits, or as whole numbers.

Words are exact for every operator, and settle what shifts and masks do. Whole numbers know products and
quotients, which words of bits take too long for; an operator is only allowed where it means arithmetic. Both
state what C leaves undefined as a claim, to be proved where the operator stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

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


class Arithmetic(Protocol):
    """One of the two ways to see an integer."""

    def __init__(self, claim: Claim) -> None: ...

    def constant(self, value: int, type_: Type) -> Number: ...

    def unknown(self, name: str, type_: Type) -> tuple[Number, Any]:
        """A number of which nothing is known but this formula."""

    def convert(self, number: Number, type_: Type) -> Number: ...

    def binary(self, operator: str, left: Number, right: Number) -> Number:
        """An operator on two numbers of one type; for shifts, the types may differ."""

    def compare(self, operator: str, left: Number, right: Number) -> Any: ...


class Words:
    """Integers as words of bits."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim

    def constant(self, value: int, type_: Type) -> Number:
        return Number(z3.BitVecVal(value, type_.bits), type_)

    def unknown(self, name: str, type_: Type) -> tuple[Number, Any]:
        return Number(z3.BitVec(name, type_.bits), type_), z3.BoolVal(True)

    def convert(self, number: Number, type_: Type) -> Number:
        more = type_.bits - number.type.bits
        if type_.bits == 1:
            return Number(z3.If(number.term != 0, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1)), type_)
        if more > 0:
            extend = z3.SignExt if number.type.signed else z3.ZeroExt
            return Number(extend(more, number.term), type_)
        return Number(z3.Extract(type_.bits - 1, 0, number.term) if more else number.term, type_)

    def binary(self, operator: str, left: Number, right: Number) -> Number:
        if operator in ("<<", ">>"):
            right = self._count(left, right)
        elif operator in ("/", "%"):
            self.claim(right.term != 0, "division by 0")
            if left.type.signed:
                self.claim(z3.And(left.term >= 0, right.term > 0), "division of a negative number")
        elif left.type.signed and operator in _NO_OVERFLOW:
            for fits in _NO_OVERFLOW[operator]:
                self.claim(fits(left.term, right.term), f"overflow of {operator}")
        return Number(_ON_WORDS[operator, left.type.signed](left.term, right.term), left.type)

    def _count(self, left: Number, right: Number) -> Number:
        self.claim(z3.ULT(right.term, left.type.bits), "shift by the width or more")
        return self.convert(right, Type(left.type.bits))

    def compare(self, operator: str, left: Number, right: Number) -> Any:
        return _WORDS_COMPARED[operator, left.type.signed](left.term, right.term)


_NO_OVERFLOW: dict[str, tuple[Callable[[Any, Any], Any], ...]] = {
    "+": (lambda a, b: z3.BVAddNoOverflow(a, b, True), z3.BVAddNoUnderflow),
    "-": (z3.BVSubNoOverflow, lambda a, b: z3.BVSubNoUnderflow(a, b, True)),
    "*": (lambda a, b: z3.BVMulNoOverflow(a, b, True), z3.BVMulNoUnderflow),
}
_EITHER: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "&": lambda a, b: a & b,
    "|": lambda a, b: a | b,
    "^": lambda a, b: a ^ b,
    "<<": lambda a, b: a << b,
}
_UNSIGNED: dict[str, Callable[[Any, Any], Any]] = {"/": z3.UDiv, "%": z3.URem, ">>": z3.LShR}
_ON_WORDS = {(name, signed): act for name, act in _EITHER.items() for signed in (False, True)}
_ON_WORDS |= {(name, False): act for name, act in _UNSIGNED.items()}
_ON_WORDS |= {("/", True): z3.UDiv, ("%", True): z3.URem, (">>", True): lambda a, b: a >> b}
_COMPARED: dict[str, Callable[[Any, Any], Any]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}
_WORDS_COMPARED = {(name, signed): act for name, act in _COMPARED.items() for signed in (False, True)}
_WORDS_COMPARED |= {
    ("<", False): z3.ULT,
    ("<=", False): z3.ULE,
    (">", False): z3.UGT,
    (">=", False): z3.UGE,
}


class Integers:
    """Integers as whole numbers, brought into their type's range where an operator might leave it."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim

    def constant(self, value: int, type_: Type) -> Number:
        return Number(z3.IntVal(value), type_)

    def unknown(self, name: str, type_: Type) -> tuple[Number, Any]:
        term = z3.Int(name)
        return Number(term, type_), z3.And(type_.least <= term, term <= type_.most)

    def convert(self, number: Number, type_: Type) -> Number:
        if number.type.least >= type_.least and number.type.most <= type_.most:
            return Number(number.term, type_)
        assert not type_.signed, "whole numbers cannot be made signed"
        return Number(number.term % (type_.most + 1), type_)

    def binary(self, operator: str, left: Number, right: Number) -> Number:
        exact = _ON_INTEGERS[operator](left, right, self.claim)
        if left.type.signed:
            fits = z3.And(left.type.least <= exact, exact <= left.type.most)
            self.claim(fits, f"overflow of {operator}")
            return Number(exact, left.type)
        grows = operator in ("+", "-", "*", "<<")
        return Number(exact % (left.type.most + 1) if grows else exact, left.type)

    def compare(self, operator: str, left: Number, right: Number) -> Any:
        return _COMPARED[operator](left.term, right.term)


def known(term: Any) -> int:
    """The value of a term that is a constant."""
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
    """``|`` of numbers whose bits are in different places, which is their sum."""
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
