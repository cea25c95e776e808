"""The lemmas of ``mcp_asdf_arithmetic.h``: one contract for each of its functions, by the function's name.

A contract holds for every argument of the function's C type that it requires; most require nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cache, partial
from typing import Any

import z3

from proofs.machine import Machine
from proofs.numbers import IntegerArithmetic, IntegerType, constant_value
from proofs.prove import Contract, Formula
from proofs.source import BITS, HARDWARE, LANES, TABLE, Variant

RECIPROCAL_LIMITS = {TABLE: (2**30, Fraction(710, 1000)), LANES: (2**29, Fraction(252, 1000))}
"""The least divisor that prepare() is given, and how much of it 2^46 / d may be too small, in units of 2^-13;
the solver takes this for granted, and ``every_divisor.c`` tries all divisors."""


def zero_extend(word: Any, bits: int = 64) -> Any:
    """Return a word with zeros in front, so that it has so many bits."""
    return z3.ZeroExt(bits - word.size(), word)


def _extract_word(highest_bit: int, value: Any) -> Any:
    """Return the 32 bits of a value that end at this one."""
    return z3.Extract(highest_bit, highest_bit - 31, value)


# --- Results to the bit -----------------------------------------------------------------------------------

EXACT_RESULTS: dict[str, Callable[..., Any]] = {
    "join": z3.Concat,
    "high_word": partial(_extract_word, 63),
    "low_word": partial(_extract_word, 31),
    "add": lambda sum_, term: sum_ + term,
    "one_minus": lambda share: _extract_word(31, 2**32 - zero_extend(share)),
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
    "shifted_high_word": lambda value, count: _extract_word(63, value << zero_extend(count)),
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
    has_highest_bit = _extract_word(31, shifted) >> 31 == -1  # a signed shift copies the bit to all others
    return z3.And(z3.ULE(result, 31), has_highest_bit, z3.LShR(shifted, result) == positive)


WORD_CONTRACTS = {name: Contract(_equals(exact_result)) for name, exact_result in EXACT_RESULTS.items()}
WORD_CONTRACTS["leading_zeros"] = Contract(are_leading_zeros)
SHIFT_CONTRACTS = {
    name: Contract(_equals(exact_result), requires=_is_shift_count)
    for name, exact_result in SHIFT_RESULTS.items()
}
SHIFT_CONTRACTS["shift_left_wide"] = Contract(_is_shifted_wide)

# --- Products: in mathematical integers -------------------------------------------------------------------


def _split_halves(word: Any) -> tuple[Any, Any]:
    """Return the upper and the lower half of a word."""
    return word / 2**16, word % 2**16


def _products_of_halves_fit(_result: Any, a: Any, b: Any) -> Any:
    """Return that each product of halves is (2^16 - 1)^2 at most."""
    products = [x * y for x in _split_halves(a) for y in _split_halves(b)]
    return z3.And([z3.And(product >= 0, product <= (2**16 - 1) ** 2) for product in products])


def _is_product_of_halves(_result: Any, a: Any, b: Any) -> Any:
    """Return that a b is (2^16 a1 + a0) (2^16 b1 + b0), multiplied out."""
    (a1, a0), (b1, b0) = _split_halves(a), _split_halves(b)
    return a * b == 2**32 * (a1 * b1) + 2**16 * (a1 * b0 + a0 * b1) + a0 * b0


def _is_floor(result: Any, dividend: Any, divisor: Any) -> Any:
    """Return that the result is the quotient of two integers, rounded down."""
    return z3.And(result >= 0, result * divisor <= dividend, dividend < result * divisor + divisor)


def is_upper_product(result: Any, a: Any, b: Any) -> Any:
    """Return that the result is a b / 2^32, rounded down."""
    return _is_floor(result, a * b, 2**32)


def _product_contract(ensures: Formula) -> Contract:
    """Return a contract whose proof goes by the products of halves of words."""
    proof_steps = (_products_of_halves_fit, _is_product_of_halves)
    return Contract(ensures, IntegerArithmetic, proof_steps=proof_steps)


PRODUCT_CONTRACTS = {
    "multiply": _product_contract(lambda result, a, b: result == a * b),
    "multiply_high": _product_contract(is_upper_product),
}

# --- Quotients: in mathematical integers ------------------------------------------------------------------


def _is_divisible(least_divisor: int) -> Formula:
    """Return the formula that a quotient a / d is below 2, and that d is a divisor from the least to 2^31."""
    return lambda a, d, *_: z3.And(a < 2 * d, least_divisor <= d, d <= 2**31)


class DivisionInvariant:
    """The loop invariant of divide_by_bits().

    After i turns, with the quotient q so far and the present a < 2 d: 2^i dividend = 2 d q + a.
    """

    def __init__(self) -> None:
        self.turns = self.turns_in_byte = 0
        self.facts_before_loop: list[Any] | None = None

    def after_turn(self, machine: Machine) -> None:
        """Claim the invariant, and let the code after a turn rely on nothing else that the turn did."""
        if self.facts_before_loop is None:
            self.facts_before_loop = list(machine.facts)
        self.turns, self.turns_in_byte = self.turns + 1, self.turns_in_byte + 1
        machine.require(self._formula(machine), f"turn {self.turns}")
        # Forget what the turn did: the variables may hold anything that fulfils the invariant. So the
        # formulas stay as short as for one turn.
        for name in ("a", "byte", "quotient"):
            variable = machine.local_variable(name)
            machine.store(variable, machine.fresh_number(name, machine.load(variable).type))
        machine.facts[:] = [*self.facts_before_loop, self._formula(machine)]
        if constant_value(machine.load(machine.local_variable("turns")).term) == 1:
            self.turns_in_byte = 0  # the inner loop ends here, and its byte joins the quotient

    def _formula(self, machine: Machine) -> Any:
        """Return the invariant, with the present values of the loop's variables."""
        a, byte, full_bytes = (
            machine.load(machine.local_variable(name)).term for name in ("a", "byte", "quotient")
        )
        # The quotient so far: complete bytes, and the bits of the byte that is being filled.
        quotient = full_bytes * 2**self.turns_in_byte + byte
        dividend, d = machine.argument_terms["a"], machine.argument_terms["d"]
        ranges = [a >= 0, a < 2 * d, byte >= 0, byte < 2**self.turns_in_byte]
        ranges += [full_bytes >= 0, full_bytes < 2 ** (self.turns - self.turns_in_byte)]
        return z3.And(*ranges, 2**self.turns * dividend == 2 * (d * quotient) + a)


def _is_prepared(divide: int) -> Formula:
    """Return the formula for what prepare(d) gives: a divisor of 16 bits or a reciprocal."""
    if divide == HARDWARE:
        # d / 2^15, rounded down, and 1: always above d / 2^15, so that no digit is too large.
        return lambda prepared, d: z3.And(d < prepared * 2**15, prepared * 2**15 <= d + 2**15)
    # 2^46 / d, less a share of it: at most lost_share in units of 2^-13.
    _, lost_share = RECIPROCAL_LIMITS[divide]
    return lambda prepared, d: z3.And(
        prepared > 0,
        prepared * d <= 2**46,
        (2**46 - prepared * d) * lost_share.denominator <= lost_share.numerator * 2**33,
    )


def _estimate_contract(divide: int) -> Contract:
    """Promise a quotient of upper bits; with a reciprocal, their product must not be longer than a word."""

    def is_quotient_by_hardware(digit: Any, rest: Any, prepared: Any, bits: Any) -> Any:
        return _is_floor(digit, rest / 2 ** (15 - constant_value(bits)), prepared)

    def is_product_with_reciprocal(digit: Any, rest: Any, prepared: Any, bits: Any) -> Any:
        return _is_floor(digit, rest / 2**15 * prepared, 2 ** (31 - constant_value(bits)))

    def has_divisor(_rest: Any, prepared: Any, _bits: Any) -> Any:
        return prepared > 0

    def product_fits(rest: Any, prepared: Any, _bits: Any) -> Any:
        return rest / 2**15 * prepared < 2**32

    divides_in_hardware = divide == HARDWARE
    return Contract(
        is_quotient_by_hardware if divides_in_hardware else is_product_with_reciprocal,
        IntegerArithmetic,
        requires=has_divisor if divides_in_hardware else product_fits,
        constant_parameter="bits",
        constant_values=(7, 12),
    )


def _digit_contract(divide: int, least_divisor: int) -> Contract:
    """Promise that a digit is never too large and less than 2 too small, so the rest stays below 2 d."""

    def is_digit(digit: Any, new_rest: Any, rest: Any, d: Any, _prepared: Any, bits: Any) -> Any:
        is_exact = digit * d + new_rest == rest * 2 ** constant_value(bits)
        return z3.And(digit >= 0, is_exact, new_rest >= 0, new_rest < 2 * d)

    def is_not_too_large(digit: Any, _new_rest: Any, rest: Any, d: Any, _prepared: Any, bits: Any) -> Any:
        return digit * d <= rest * 2 ** constant_value(bits)

    def is_not_too_small(digit: Any, _new_rest: Any, rest: Any, d: Any, _prepared: Any, bits: Any) -> Any:
        return rest * 2 ** constant_value(bits) < digit * d + 2 * d

    def requires(rest: Any, d: Any, prepared: Any, _bits: Any) -> Any:
        return z3.And(_is_divisible(least_divisor)(rest, d), _is_prepared(divide)(prepared, d))

    return Contract(
        is_digit,
        IntegerArithmetic,
        requires=requires,
        proof_steps=(is_not_too_large, is_not_too_small),
        constant_parameter="bits",
        constant_values=(7, 12),
        used_lemmas=("estimate_digit",),
    )


def is_quotient_24(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is 2^24 a / d, rounded down."""
    return _is_floor(result, 2**24 * a, d)


def is_quotient_31(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is 2^31 a / d, rounded down."""
    return _is_floor(result, 2**31 * a, d)


def _division_contracts(*used_lemmas: str) -> dict[str, Contract]:
    """Return the contracts of the two divisions, which call these functions for digits or bits."""
    return {
        "divide_24": Contract(
            is_quotient_24, IntegerArithmetic, _is_divisible(2**29), used_lemmas=used_lemmas
        ),
        "divide_31": Contract(
            is_quotient_31, IntegerArithmetic, _is_divisible(2**30), used_lemmas=used_lemmas
        ),
    }


def _digit_division_contracts(divide: int) -> dict[str, Contract]:
    """Return the contracts of a division that takes several bits of the quotient at once."""
    least_divisor = 2**29 if divide == HARDWARE else RECIPROCAL_LIMITS[divide][0]

    def is_divisor(d: Any) -> Any:
        return z3.And(least_divisor <= d, d <= 2**31)

    return {
        "prepare": Contract(_is_prepared(divide), IntegerArithmetic, requires=is_divisor),
        "estimate_digit": _estimate_contract(divide),
        "take_digit": _digit_contract(divide, least_divisor),
        **_division_contracts("prepare", "take_digit"),
    }


def _bit_division_contracts() -> dict[str, Contract]:
    """Return the contracts of a division that takes one bit of the quotient after the other."""

    def is_quotient(result: Any, a: Any, d: Any, bits: Any) -> Any:
        return _is_floor(result, 2 ** constant_value(bits) * a, d)

    def requires(a: Any, d: Any, _bits: Any) -> Any:
        return z3.And(a < 2 * d, d <= 2**31)

    divide_by_bits = Contract(
        is_quotient,
        IntegerArithmetic,
        requires=requires,
        constant_parameter="bits",
        constant_values=(24, 31),
        make_loop_invariant=lambda: DivisionInvariant().after_turn,
    )
    return {"divide_by_bits": divide_by_bits, **_division_contracts("divide_by_bits")}


# --- Quotients of long words ------------------------------------------------------------------------------


def normalise(value: Any) -> tuple[Any, Any]:
    """Return a long word shifted until its highest bit is set, and by how much."""
    # A binary search: shift by 32 if the upper 32 bits are 0, then by 16 if the upper 16 are, and so on.
    shift = z3.BitVecVal(0, 64)
    for step in (32, 16, 8, 4, 2, 1):
        are_upper_bits_clear = z3.LShR(value, 64 - step) == 0
        added_shift = z3.If(are_upper_bits_clear, z3.BitVecVal(step, 64), z3.BitVecVal(0, 64))
        value, shift = value << added_shift, shift + added_shift
    return value, shift


def _loses_no_bit(_result: Any, a: Any, d: Any) -> Any:
    """Return that no bit is lost if both are shifted until d has its highest bit set."""
    divisor, shift = normalise(d)
    return z3.And(z3.LShR(a << shift, shift) == a, z3.LShR(divisor, shift) == d)


def _has_upper_bits(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is the upper word of the shifted a, and half of that of the shifted d.

    The half is rounded up.
    """
    divisor, shift = normalise(d)
    half_of_upper_word = _extract_word(31, z3.LShR(divisor, 33)) + 1
    upper_word = _extract_word(63, a << shift)
    return z3.And(result["high"] == upper_word, result["low"] == half_of_upper_word)


def ratio_requires(a: Any, d: Any) -> Any:
    """Return what a ratio a / d requires, for integers and for words wide enough to be like them."""
    return z3.And(d > 0, a <= d)


def is_ratio(upper_a: Any, half_d: Any, long_a: Any, long_d: Any) -> Any:
    """Return that the result of ratio() is the upper parts of a and d, both times a power of two."""
    ranges = [long_a < 2**64, long_d >= 2**63, long_d < 2**64]
    is_upper_a = [2**32 * upper_a <= long_a, long_a < 2**32 * (upper_a + 1)]
    is_half_d = [2**33 * (half_d - 1) <= long_d, long_d < 2**33 * half_d]
    return z3.And(*ranges, *is_upper_a, *is_half_d)


def _like_integer(word: Any) -> Any:
    """Return the word with so many bits that nothing in these formulas wraps, nor in a shift by 63."""
    return zero_extend(word, 128)


def _words_are_ratio(result: Any, a: Any, d: Any) -> Any:
    """Return ``is_ratio`` of words, with the shift that sets the highest bit of d."""
    _, shift = normalise(d)
    wide_shift = _like_integer(shift)
    upper_a, half_d = _like_integer(result["high"]), _like_integer(result["low"])
    return is_ratio(upper_a, half_d, _like_integer(a) << wide_shift, _like_integer(d) << wide_shift)


RATIO = Contract(
    _words_are_ratio,
    requires=lambda a, d: ratio_requires(_like_integer(a), _like_integer(d)),
    proof_steps=(_loses_no_bit, _has_upper_bits),
    used_lemmas=("leading_zeros", "shifted_high_word"),
)


def _ratio_of_integers(machine: Machine, a: Any, d: Any) -> Any:
    """Stand in for ratio() by its lemma, which is proved with words, in the proof of quotient()."""
    machine.require(ratio_requires(a.term, d.term), "what ratio requires")
    # ratio() shifts both by a power of two, which may be any scale from 1 on in this proof.
    upper_a, half_d, scale = (machine.fresh_number("ratio", IntegerType(bits)) for bits in (32, 32, 64))
    long_a, long_d = a.term * scale.term, d.term * scale.term
    machine.assume(z3.And(scale.term >= 1, is_ratio(upper_a.term, half_d.term, long_a, long_d)))
    return {"high": upper_a, "low": half_d}


def is_near_quotient(result: Any, a: Any, d: Any) -> Any:
    """Return that the result is a / d in units of 2^-32, at most 7 units too small and never too large."""
    return z3.And(result * d <= 2**32 * a, 2**32 * a <= (result + 7) * d, result < 2**32)


QUOTIENT = Contract(
    is_near_quotient,
    IntegerArithmetic,
    requires=ratio_requires,
    used_lemmas=("divide_31",),
    stand_ins={"ratio": _ratio_of_integers},
)


def is_tried(variant: Variant, name: str) -> bool:
    """Return whether every argument of a function is tried instead of a proof."""
    return name == "prepare" and variant.divide in RECIPROCAL_LIMITS


@cache
def _contracts(divide: int) -> dict[str, Contract]:
    divisions = _bit_division_contracts() if divide == BITS else _digit_division_contracts(divide)
    return {
        **WORD_CONTRACTS,
        **SHIFT_CONTRACTS,
        **PRODUCT_CONTRACTS,
        **divisions,
        "ratio": RATIO,
        "quotient": QUOTIENT,
    }


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions of one variant of the header."""
    return _contracts(variant.divide)
