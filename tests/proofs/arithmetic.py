"""The lemmas of ``mcp_asdf_arithmetic.h``: the contracts of its functions, by the function's name.

A contract holds for every argument of the function's C type that it requires; most require nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cache, partial
from typing import Any

import z3

from proofs.machine import Machine
from proofs.numbers import IntegerType, Number, constant_value
from proofs.prove import Contract, Formula
from proofs.source import BITS, HARDWARE, LANES, TABLE, Variant

RECIPROCAL_LIMITS = {TABLE: (2**30, Fraction(710, 1000)), LANES: (2**29, Fraction(252, 1000))}
"""Limits of prepare() by the way to divide: the least divisor d that it is given, and its largest error.

The result of prepare() may be smaller than 2^46 / d. The error is the missing part of 2^46 / d, in units of
2^-13. The solver takes both limits for granted. ``every_divisor.c`` tries all divisors.
"""


def zero_extend(word: Any, bits: int = 64) -> Any:
    """Return a word with zeros in front, so that it has so many bits."""
    return z3.ZeroExt(bits - word.size(), word)


def wide(word: Any, bits: int = 96) -> Any:
    """Return the word with so many bits that nothing in a formula wraps, as if it were an integer."""
    return zero_extend(word, bits)


def _extract_word(highest_bit: int, value: Any) -> Any:
    """Return the 32 bits of a value that end at this one."""
    return z3.Extract(highest_bit, highest_bit - 31, value)


high_word, low_word = partial(_extract_word, 63), partial(_extract_word, 31)

# --- Results to the bit -----------------------------------------------------------------------------------

EXACT_RESULTS: dict[str, Callable[..., Any]] = {
    "join": z3.Concat,
    "high_word": high_word,
    "low_word": low_word,
    "add": lambda sum_, term: sum_ + term,
    "one_minus": lambda share: low_word(2**32 - zero_extend(share)),
    "hash_word": lambda hash_, word: (hash_ ^ word) * 0x01000193,
    "shift_right_64": lambda value, count: z3.LShR(value, zero_extend(count & 63)),
}
"""What these functions give for any arguments, to the bit."""

SHIFT_RESULTS: dict[str, Callable[..., Any]] = {
    "shift_left_by": lambda value, count: value << zero_extend(count, 32),
    "shift_right_by": lambda value, count: z3.LShR(value, zero_extend(count, 32)),
    "shift_left": lambda value, count: value << count,
    "shift_right": z3.LShR,
    "lowest_bits_to_top": lambda value, count: value << (32 - count),
    "highest_bits_to_bottom": lambda value, count: z3.LShR(value, 32 - count),
    "shifted_high_word": lambda value, count: high_word(value << zero_extend(count)),
}
"""What shifts by a count of 0 to 31 give, to the bit."""


def _equals(exact_result: Callable[..., Any]) -> Formula:
    """Return the formula that a result is the exact one for the arguments."""
    return lambda result, *arguments: result == exact_result(*arguments)


def _is_shift_count(_value: Any, count: Any) -> Any:
    return z3.ULE(count, 31)


def _is_shifted_wide(result: Any, value: Any, count: Any) -> Any:
    """Return that the result is the value shifted left by count modulo 32, as a pair of words."""
    return z3.Concat(result["high"], result["low"]) == zero_extend(value) << zero_extend(count & 31)


def are_leading_zeros(result: Any, value: Any) -> Any:
    """Return that the result is the number of zeros before the highest bit that is set; 31 for 0.

    Shifted left by it, the value, or 1 for 0, has its highest bit in front and has lost none.
    """
    positive = z3.If(value == 0, z3.BitVecVal(1, 32), value)
    shifted = positive << result
    has_highest_bit = z3.Extract(31, 31, shifted) == 1
    return z3.And(z3.ULE(result, 31), has_highest_bit, z3.LShR(shifted, result) == positive)


def _product_contract(exact_result: Formula) -> Contract:
    """Return a contract whose proof goes by the products of halves of words."""

    def ensures(result: Any, a: Any, b: Any) -> list[Any]:
        a1, b1, a0, b0 = (z3.LShR(wide(a), 16), z3.LShR(wide(b), 16), wide(a) & 0xFFFF, wide(b) & 0xFFFF)
        products_fit = z3.And([z3.ULE(x * y, (2**16 - 1) ** 2) for x in (a1, a0) for y in (b1, b0)])
        # (2^16 a1 + a0) (2^16 b1 + b0), multiplied out
        product = (a1 * b1 << 32) + (a1 * b0 + a0 * b1 << 16) + a0 * b0
        return [products_fit, wide(a) * wide(b) == product, result == exact_result(a, b)]

    return Contract(ensures)


WORD_CONTRACTS = {
    "multiply": _product_contract(lambda a, b: zero_extend(a) * zero_extend(b)),
    "multiply_high": _product_contract(lambda a, b: high_word(zero_extend(a) * zero_extend(b))),
    **{name: Contract(_equals(result)) for name, result in EXACT_RESULTS.items()},
    **{name: Contract(_equals(result), _is_shift_count) for name, result in SHIFT_RESULTS.items()},
    "leading_zeros": Contract(are_leading_zeros),
    "shift_left_wide": Contract(_is_shifted_wide),
}

# --- Quotients --------------------------------------------------------------------------------------------


def _is_floor(quotient: Any, dividend: Any, divisor: Any) -> Any:
    """Return that a wide word is the quotient of two, rounded down."""
    product = quotient * divisor
    return z3.And(z3.ULE(product, dividend), z3.ULT(dividend, product + divisor))


def _is_divisible(least_divisor: int) -> Formula:
    """Return the formula that a quotient a / d is below 2, and that d is a divisor from the least to 2^31."""
    return lambda a, d, *_: z3.And(z3.ULT(wide(a), 2 * wide(d)), z3.UGE(d, least_divisor), z3.ULE(d, 2**31))


def is_quotient_24(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is 2^24 a / d, rounded down."""
    return _is_floor(wide(result), wide(a) << 24, wide(d))


def is_quotient_31(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is 2^31 a / d, rounded down."""
    return _is_floor(wide(result), wide(a) << 31, wide(d))


def _division_contracts(*used_lemmas: str) -> dict[str, Contract]:
    """Return the contracts of the two divisions, which call these functions for digits or bits."""
    return {
        "divide_24": Contract(is_quotient_24, _is_divisible(2**29), used_lemmas=used_lemmas),
        "divide_31": Contract(is_quotient_31, _is_divisible(2**30), used_lemmas=used_lemmas),
    }


def _is_prepared(divide: int) -> Formula:
    """Return the formula for what prepare(d) gives: a divisor of 16 bits or a reciprocal."""
    if divide == HARDWARE:
        # d / 2^15, rounded down, and 1: always above d / 2^15, so that no digit is too large.
        return lambda prepared, d: z3.And(
            z3.ULT(wide(d), wide(prepared) << 15), z3.ULE(wide(prepared) << 15, wide(d) + 2**15)
        )
    # 2^46 / d, less a share of it: at most lost_share in units of 2^-13.
    _, lost_share = RECIPROCAL_LIMITS[divide]

    def is_reciprocal(prepared: Any, d: Any) -> Any:
        product = wide(prepared) * wide(d)
        loss = (2**46 - product) * lost_share.denominator
        return z3.And(prepared != 0, z3.ULE(product, 2**46), z3.ULE(loss, lost_share.numerator * 2**33))

    return is_reciprocal


def _digit_division_contracts(divide: int) -> dict[str, Contract]:
    """Return the contracts of a division that takes several bits of the quotient at once."""
    least_divisor = 2**29 if divide == HARDWARE else RECIPROCAL_LIMITS[divide][0]
    is_prepared, is_divisible = _is_prepared(divide), _is_divisible(least_divisor)

    def is_digit(digit: Any, new_rest: Any, rest: Any, d: Any, _prepared: Any, bits: Any) -> list[Any]:
        """Return that a digit is never too large and less than 2 too small, so the rest stays below 2 d."""
        product, dividend = wide(digit) * wide(d), wide(rest) << wide(bits)
        is_not_too_large = z3.ULE(product, dividend)
        is_not_too_small = z3.ULT(dividend, product + 2 * wide(d))
        is_rest = z3.And(product + wide(new_rest) == dividend, z3.ULT(wide(new_rest), 2 * wide(d)))
        return [is_not_too_large, is_not_too_small, is_rest]

    return {
        "prepare": Contract(is_prepared, lambda d: z3.And(z3.UGE(d, least_divisor), z3.ULE(d, 2**31))),
        "take_digit": Contract(
            is_digit,
            lambda rest, d, prepared, _bits: z3.And(is_divisible(rest, d), is_prepared(prepared, d)),
            constant_parameter="bits",
            constant_values=(7, 12),
        ),
        **_division_contracts("prepare", "take_digit"),
    }


def _is_divided_so_far(arguments: dict[str, Any], variables: dict[str, Any]) -> Any:
    """Return the loop invariant of divide_by_bits().

    After i turns, with the quotient q so far and the present a < 2 d: 2^i dividend = 2 d q + a.
    """
    bits, turns_left_in_byte, bytes_left = (
        constant_value(term) for term in (arguments["bits"], variables["turns"], variables["bytes"])
    )
    assert bits is not None and turns_left_in_byte is not None and bytes_left is not None
    # Both counters still include the turn, or the byte, that ends now. All bytes but the first have 8 turns.
    turns = bits + 2 - turns_left_in_byte - 8 * (bytes_left - 1)
    turns_in_byte = min(turns, 9 - turns_left_in_byte)
    a, byte, full_bytes = (wide(variables[name]) for name in ("a", "byte", "quotient"))
    # The quotient so far: complete bytes, and the bits of the byte that is being filled.
    quotient = full_bytes * 2**turns_in_byte + byte
    dividend, d = wide(arguments["a"]), wide(arguments["d"])
    ranges = [
        z3.ULT(a, 2 * d),
        z3.ULT(byte, 2**turns_in_byte),
        z3.ULT(full_bytes, 2 ** (turns - turns_in_byte)),
    ]
    return z3.And(*ranges, dividend * 2**turns == 2 * d * quotient + a)


def _bit_division_contracts() -> dict[str, Contract]:
    """Return the contracts of a division that takes one bit of the quotient after the other."""
    divide_by_bits = Contract(
        lambda result, a, d, bits: _is_floor(wide(result), wide(a) << wide(bits), wide(d)),
        _is_divisible(1),
        constant_parameter="bits",
        constant_values=(24, 31),
        loop_invariant=_is_divided_so_far,
    )
    return {"divide_by_bits": divide_by_bits, **_division_contracts("divide_by_bits")}


# --- Quotients of long words ------------------------------------------------------------------------------


def _leading_zeros_of_long_word(value: Any) -> Any:
    """Return by how much a long word has to be shifted left until its highest bit is set."""
    # A binary search: shift by 32 if the upper 32 bits are 0, then by 16 if the upper 16 are, and so on.
    shift = z3.BitVecVal(0, 64)
    for step in (32, 16, 8, 4, 2, 1):
        are_upper_bits_clear = z3.LShR(value, 64 - step) == 0
        added_shift = z3.If(are_upper_bits_clear, z3.BitVecVal(step, 64), z3.BitVecVal(0, 64))
        value, shift = value << added_shift, shift + added_shift
    return shift


def _ratio_requires(a: Any, d: Any) -> Any:
    return z3.And(d != 0, z3.ULE(a, d))


def _is_ratio(result: Any, long_a: Any, long_d: Any) -> Any:
    """Return that a pair has the upper word of a, and half of the upper word of d, rounded down, and 1.

    Both are wide words here, shifted left until the highest of the 64 bits of d is set.
    """
    upper_a, half_d = wide(result["high"], 160), wide(result["low"], 160)
    ranges = [z3.ULT(long_a, 2**64), z3.UGE(long_d, 2**63), z3.ULT(long_d, 2**64)]
    is_upper_a = _is_floor(upper_a, long_a, 2**32)
    is_half_d = _is_floor(half_d - 1, long_d, 2**33)
    return z3.And(*ranges, z3.UGE(half_d, 1), is_upper_a, is_half_d)


def _is_shifted_ratio(result: Any, a: Any, d: Any) -> Any:
    """Return ``_is_ratio`` of a and d, both shifted left until the highest bit of d is set."""
    shift = wide(_leading_zeros_of_long_word(d), 160)
    return _is_ratio(result, wide(a, 160) << shift, wide(d, 160) << shift)


RATIO = Contract(_is_shifted_ratio, _ratio_requires, used_lemmas=("leading_zeros", "shifted_high_word"))


def _call_ratio(machine: Machine, a: Number, d: Number) -> dict[str, Number]:
    """Stand in for ratio() by its lemma, in which any factor may stand for the power of two."""
    machine.require(_ratio_requires(a.term, d.term), "what ratio requires")
    result = {name: machine.fresh_number(name, IntegerType(32)) for name in ("high", "low")}
    factor = wide(machine.fresh_number("factor", IntegerType(64)).term, 160)
    terms = {name: number.term for name, number in result.items()}
    machine.facts.append(factor != 0)
    machine.facts.append(_is_ratio(terms, wide(a.term, 160) * factor, wide(d.term, 160) * factor))
    return result


def is_near_quotient(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is a / d in units of 2^-32, at most 7 units too small and never too large."""
    quotient, dividend, divisor = wide(result, 160), wide(a, 160) << 32, wide(d, 160)
    return z3.And(z3.ULE(quotient * divisor, dividend), z3.ULE(dividend, (quotient + 7) * divisor))


QUOTIENT = Contract(
    is_near_quotient, _ratio_requires, used_lemmas=("divide_31",), stand_ins={"ratio": _call_ratio}
)


def is_tried(variant: Variant, name: str) -> bool:
    """Return whether every argument of a function is tried instead of a proof."""
    return name == "prepare" and variant.divide in RECIPROCAL_LIMITS


@cache
def _contracts(divide: int) -> dict[str, Contract]:
    divisions = _bit_division_contracts() if divide == BITS else _digit_division_contracts(divide)
    return {**WORD_CONTRACTS, **divisions, "ratio": RATIO, "quotient": QUOTIENT}


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions of one variant of the header."""
    return _contracts(variant.divide)
