"""Formulas of words as formulas of integers, in which the solver soon settles products and quotients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import z3

from proofs.numbers import constant_value

_COMPARISONS: dict[int, Any] = {
    z3.Z3_OP_ULT: lambda a, b: a < b,
    z3.Z3_OP_ULEQ: lambda a, b: a <= b,
    z3.Z3_OP_UGT: lambda a, b: a > b,
    z3.Z3_OP_UGEQ: lambda a, b: a >= b,
    z3.Z3_OP_EQ: lambda a, b: a == b,
    z3.Z3_OP_DISTINCT: lambda a, b: a != b,
}


@dataclass(frozen=True)
class Integer:
    """The integer of a word: its term, and the largest one that it can be by the form of the term."""

    term: Any
    largest: int


class IntegerTranslator:
    """Translates formulas of words, and collects the ranges of the unknown numbers in them.

    A result is reduced modulo 2^bits, as a word is, only where it might be longer.

    Attributes:
        ranges: Formulas that each unknown number is in the range of its word.
    """

    def __init__(self) -> None:
        self.ranges: list[Any] = []
        self._integers: dict[int, Integer] = {}

    def formula(self, formula: Any) -> Any:
        """Return a formula of integers that means the same.

        Raises NotImplementedError if something in it is no arithmetic.
        """
        children, kind = formula.children(), formula.decl().kind()
        if not children:
            return formula
        if z3.is_bv(children[-1]):
            if kind not in _COMPARISONS:
                raise _no_translation(formula)
            left, right = (self._integer(child).term for child in children)
            return _COMPARISONS[kind](left, right)
        return formula.decl()(*(self.formula(child) for child in children))

    def _integer(self, word: Any) -> Integer:
        """Return the integer of a word. Each is translated once."""
        if word.get_id() not in self._integers:
            integer, limit = self._translate(word), 2 ** word.size()
            if integer.largest >= limit:
                integer = Integer(integer.term % limit, limit - 1)
            self._integers[word.get_id()] = integer
        return self._integers[word.get_id()]

    def _translate(self, word: Any) -> Integer:
        """Return the integer of a word before it is reduced."""
        kind, children = word.decl().kind(), word.children()
        if z3.is_bv_value(word):
            return Integer(z3.IntVal(word.as_long()), word.as_long())
        if kind == z3.Z3_OP_UNINTERPRETED:
            return self._unknown_integer(word)
        if kind == z3.Z3_OP_ITE:
            condition, first, second = self.formula(children[0]), *map(self._integer, children[1:])
            return Integer(z3.If(condition, first.term, second.term), max(first.largest, second.largest))
        if not all(map(z3.is_bv, children)):
            raise _no_translation(word)
        if len(children) == 1:
            return self._resize(word, children[0])
        integer = self._integer(children[0])
        for operand in children[1:]:
            integer = self._apply_operator(word, integer, operand)
        return integer

    def _resize(self, word: Any, part: Any) -> Integer:
        """Return the integer of a word that extends another one, ``part``, or is cut out of it."""
        kind, integer = word.decl().kind(), self._integer(part)
        is_positive = integer.largest < 2 ** (part.size() - 1)
        if kind == z3.Z3_OP_ZERO_EXT or (kind == z3.Z3_OP_SIGN_EXT and is_positive):
            return integer
        if kind == z3.Z3_OP_EXTRACT:
            _highest_bit, lowest_bit = word.params()
            return Integer(integer.term / 2**lowest_bit, integer.largest >> lowest_bit)
        raise _no_translation(word)

    def _unknown_integer(self, word: Any) -> Integer:
        """Return an unknown number, or the result of an unknown function, within the range of its word."""
        arguments, largest = [self._integer(child).term for child in word.children()], 2 ** word.size() - 1
        sorts = [z3.IntSort()] * (len(arguments) + 1)
        # Two words with the same name but different sizes are different unknowns. Integers have no size, so
        # their names have to differ.
        sizes = [part.size() for part in (*word.children(), word)]
        name = f"{word.decl().name()} {sizes}"
        term = z3.Function(name, *sorts)(*arguments) if arguments else z3.Int(name)
        self.ranges.append(z3.And(term >= 0, term <= largest))
        return Integer(term, largest)

    def _apply_operator(self, word: Any, left: Integer, operand: Any) -> Integer:
        """Return the result of a word's operator on the integers of its operands."""
        kind, right = word.decl().kind(), self._integer(operand)
        if kind == z3.Z3_OP_BMUL:
            return Integer(left.term * right.term, left.largest * right.largest)
        if kind == z3.Z3_OP_BSUB:  # it may be negative, and so has to be reduced in any case
            return Integer(left.term - right.term, 2 ** word.size())
        if kind == z3.Z3_OP_BUDIV:  # by 0, the solver gives the largest word
            quotient = z3.If(right.term == 0, 2 ** word.size() - 1, left.term / right.term)
            return Integer(quotient, 2 ** word.size() - 1)
        if kind == z3.Z3_OP_CONCAT:
            factor = 2 ** operand.size()
            return Integer(left.term * factor + right.term, left.largest * factor + right.largest)
        # Where no bit is set in both, | is the sum.
        is_join = kind == z3.Z3_OP_BOR and word.num_args() == 2
        is_join = is_join and right.largest < 2 ** _trailing_zeros(word.arg(0))
        if kind == z3.Z3_OP_BADD or is_join:
            return Integer(left.term + right.term, left.largest + right.largest)
        return _shift_or_mask(word, left, constant_value(operand))


def _shift_or_mask(word: Any, integer: Integer, constant: int | None) -> Integer:
    """Return the result of a word's operator: a shift by a constant, or & with a mask of lowest bits.

    Raises NotImplementedError for any other operator.
    """
    kind = word.decl().kind()
    if constant is not None and kind == z3.Z3_OP_BSHL:
        return Integer(integer.term * 2**constant, integer.largest << constant)
    if constant is not None and kind == z3.Z3_OP_BLSHR:
        return Integer(integer.term / 2**constant, integer.largest >> constant)
    if constant is not None and kind == z3.Z3_OP_BAND and constant & (constant + 1) == 0:
        return Integer(integer.term % (constant + 1), constant)
    raise _no_translation(word)


def _no_translation(term: Any) -> NotImplementedError:
    """Return the error about an operator that has no translation here, by the solver's name of it."""
    return NotImplementedError(f"no translation to integers of {term.decl().name()}")


def _trailing_zeros(word: Any) -> int:
    """Return how many of a word's lowest bits are 0 by the form of its term."""
    kind, children = word.decl().kind(), word.children()
    if kind in (z3.Z3_OP_ZERO_EXT, z3.Z3_OP_SIGN_EXT) or (kind == z3.Z3_OP_EXTRACT and word.params()[1] == 0):
        return _trailing_zeros(children[0])
    if kind == z3.Z3_OP_BOR:
        return min(map(_trailing_zeros, children))
    return (constant_value(children[1]) or 0) if kind == z3.Z3_OP_BSHL else 0


def as_integers(formulas: Any) -> list[Any]:
    """Return formulas of integers that can hold if and only if these formulas of words can."""
    translator = IntegerTranslator()
    translated = [translator.formula(formula) for formula in formulas]
    return [*translated, *translator.ranges]
