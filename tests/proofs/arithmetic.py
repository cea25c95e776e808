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
from proofs.numbers import Integers, Type, known
from proofs.prove import Contract
from proofs.source import BITS, HARDWARE, LANES, TABLE, Variant

PREPARED = {TABLE: (2**30, Fraction(710, 1000)), LANES: (2**29, Fraction(252, 1000))}
"""The least divisor that prepare() is given, and how much of it 2^46 / d may be too small, in units of 2^-13;
the solver takes this for granted, and ``every_divisor.c`` tries all divisors."""


def _counts(_: Any, count: Any) -> Any:
    return z3.ULE(count, 31)


def widen(word: Any, bits: int = 64) -> Any:
    """Return a word with zeros in front, so that it has so many bits."""
    return z3.ZeroExt(bits - word.size(), word)


def _word(high: int, value: Any) -> Any:
    return z3.Extract(high, high - 31, value)


EXACT: dict[str, Callable[..., Any]] = {
    "join": z3.Concat,
    "high_word": partial(_word, 63),
    "low_word": partial(_word, 31),
    "add": lambda sum_, term: sum_ + term,
    "one_minus": lambda share: _word(31, 2**32 - widen(share)),
    "hash_word": lambda hash_, word: (hash_ ^ word) * 0x01000193,
    "shift_right_64": lambda value, count: z3.LShR(value, widen(count & 63)),
}
"""What these functions give for any arguments, to the bit."""


def _gives(exact: Callable[..., Any]) -> Contract:
    return Contract(lambda found, *given: found == exact(*given))


WORDS = {name: _gives(exact) for name, exact in EXACT.items()}


def _is_shifted_wide(found: Any, value: Any, count: Any) -> Any:
    return z3.Concat(found["high"], found["low"]) == widen(value) << widen(count & 31)


SHIFTED: dict[str, Callable[..., Any]] = {
    "shift_left_by": lambda value, count: value << widen(count, 32),
    "shift_right_by": lambda value, count: z3.LShR(value, widen(count, 32)),
    "shift_left": lambda value, count: value << count,
    "shift_right": z3.LShR,
    "lowest_bits_to_top": lambda value, count: value << (32 - count),
    "highest_bits_to_bottom": lambda value, count: z3.LShR(value, 32 - count),
    "shifted_high_word": lambda value, count: _word(63, value << widen(count)),
}
"""What shifts by a count of 0 to 31 give."""


def _shifts(shifted: Callable[..., Any]) -> Contract:
    return Contract(lambda found, value, count: found == shifted(value, count), requires=_counts)


SHIFTS = {name: _shifts(shifted) for name, shifted in SHIFTED.items()}
SHIFTS["shift_left_wide"] = Contract(_is_shifted_wide)


def are_leading_zeros(found: Any, value: Any) -> Any:
    """The value, or 1 for 0, has its highest bit in front after a shift by them, and lost none."""
    positive = z3.If(value == 0, z3.BitVecVal(1, 32), value)
    shifted = positive << found
    return z3.And(z3.ULE(found, 31), _word(31, shifted) >> 31 == -1, z3.LShR(shifted, found) == positive)


WORDS["leading_zeros"] = Contract(are_leading_zeros)


def _halves(number: Any) -> tuple[Any, Any]:
    """Return the upper and the lower half of a word."""
    return number / 2**16, number % 2**16


def _halves_fit(_: Any, a: Any, b: Any) -> Any:
    """Each product of halves is (2^16 - 1)^2 at most."""
    products = [x * y for x in _halves(a) for y in _halves(b)]
    return z3.And([z3.And(each >= 0, each <= (2**16 - 1) ** 2) for each in products])


def _multiplied_out(_: Any, a: Any, b: Any) -> Any:
    """(2^16 a1 + a0) (2^16 b1 + b0)."""
    (a1, a0), (b1, b0) = _halves(a), _halves(b)
    return a * b == 2**32 * (a1 * b1) + 2**16 * (a1 * b0 + a0 * b1) + a0 * b0


def _product(ensures: Callable[..., Any]) -> Contract:
    return Contract(ensures, Integers, steps=(_halves_fit, _multiplied_out))


def multiply_high(found: Any, a: Any, b: Any) -> Any:
    return _is_floor(found, a * b, 2**32)


PRODUCTS = {
    "multiply": _product(lambda found, a, b: found == a * b),
    "multiply_high": _product(multiply_high),
}

# --- Quotients: in whole numbers ------------------------------------------------------------------------


def _is_floor(found: Any, dividend: Any, divisor: Any) -> Any:
    return z3.And(found >= 0, found * divisor <= dividend, dividend < found * divisor + divisor)


def _divisible(least: int) -> Callable[..., Any]:
    return lambda a, d, *_: z3.And(a < 2 * d, least <= d, d <= 2**31)


class Remainder:
    """Invariant of divide_by_bits() after i turns, with the quotient q so far and the present a < 2 d:
    2^i dividend = 2 d q + a."""

    def __init__(self) -> None:
        self.turns = self.turns_in_byte = 0
        self.facts: list[Any] = []

    def after_turn(self, machine: Machine) -> None:
        """The code after a turn may rely on nothing else that the turn did."""
        self.facts = self.facts or list(machine.facts)
        self.turns, self.turns_in_byte = self.turns + 1, self.turns_in_byte + 1
        machine.claim(self._holds(machine), f"turn {self.turns}")
        for name in ("a", "byte", "quotient"):
            place = machine.variable(name)
            machine.store(place, machine.unknown(name, machine.load(place).type))
        machine.facts[:] = [*self.facts, self._holds(machine)]
        if known(machine.load(machine.variable("turns")).term) == 1:
            self.turns_in_byte = 0

    def _holds(self, machine: Machine) -> Any:
        a, byte, bytes_ = (machine.load(machine.variable(name)).term for name in ("a", "byte", "quotient"))
        quotient, d = bytes_ * 2**self.turns_in_byte + byte, machine.given["d"]
        return z3.And(
            *(a >= 0, a < 2 * d, byte >= 0, byte < 2**self.turns_in_byte),
            *(bytes_ >= 0, bytes_ < 2 ** (self.turns - self.turns_in_byte)),
            2**self.turns * machine.given["a"] == 2 * (d * quotient) + a,
        )


def _is_prepared(divide: int) -> Callable[[Any, Any], Any]:
    """The properties of prepare(d)."""
    if divide == HARDWARE:
        return lambda prepared, d: z3.And(d < prepared * 2**15, prepared * 2**15 <= d + 2**15)
    _, lost = PREPARED[divide]
    return lambda prepared, d: z3.And(
        prepared > 0,
        prepared * d <= 2**46,
        (2**46 - prepared * d) * lost.denominator <= lost.numerator * 2**33,
    )


def _estimate(divide: int) -> Contract:
    """Return a quotient of upper bits, and that its product is no longer than a word."""

    def by_hardware(digit: Any, rest: Any, prepared: Any, bits: Any) -> Any:
        return _is_floor(digit, rest / 2 ** (15 - known(bits)), prepared)

    def by_reciprocal(digit: Any, rest: Any, prepared: Any, bits: Any) -> Any:
        return _is_floor(digit, rest / 2**15 * prepared, 2 ** (31 - known(bits)))

    divides = divide == HARDWARE
    return Contract(
        by_hardware if divides else by_reciprocal,
        Integers,
        requires=lambda rest, prepared, _: prepared > 0 if divides else rest / 2**15 * prepared < 2**32,
        cases=("bits", (7, 12)),
    )


def _digit(divide: int, least: int) -> Contract:
    """A digit is never too large and less than 2 too small, so the rest stays below 2 d."""
    return Contract(
        lambda digit, after, rest, d, prepared, bits: z3.And(
            digit >= 0, digit * d + after == rest * 2 ** known(bits), after >= 0, after < 2 * d
        ),
        Integers,
        requires=lambda rest, d, prepared, bits: z3.And(
            _divisible(least)(rest, d), _is_prepared(divide)(prepared, d)
        ),
        steps=(
            lambda digit, after, rest, d, prepared, bits: digit * d <= rest * 2 ** known(bits),
            lambda digit, after, rest, d, prepared, bits: rest * 2 ** known(bits) < digit * d + 2 * d,
        ),
        cases=("bits", (7, 12)),
        uses=("estimate_digit",),
    )


def _by_digits(divide: int) -> dict[str, Contract]:
    least = 2**29 if divide == HARDWARE else PREPARED[divide][0]
    prepare = Contract(_is_prepared(divide), Integers, requires=lambda d: z3.And(least <= d, d <= 2**31))
    digit = _digit(divide, least)
    return {
        "prepare": prepare,
        "estimate_digit": _estimate(divide),
        "take_digit": digit,
        **_quotients("prepare", "take_digit"),
    }


def _quotients(*uses: str) -> dict[str, Contract]:
    """The callers of digits or bits."""

    return {
        "divide_24": Contract(divide_24, Integers, _divisible(2**29), uses=uses),
        "divide_31": Contract(divide_31, Integers, _divisible(2**30), uses=uses),
    }


def divide_24(found: Any, a: Any, d: Any) -> Any:
    return _is_floor(found, 2**24 * a, d)


def divide_31(found: Any, a: Any, d: Any) -> Any:
    return _is_floor(found, 2**31 * a, d)


def _by_bits() -> dict[str, Contract]:
    one_by_one = Contract(
        lambda found, a, d, bits: _is_floor(found, 2 ** known(bits) * a, d),
        Integers,
        requires=lambda a, d, bits: z3.And(a < 2 * d, d <= 2**31),
        cases=("bits", (24, 31)),
        invariant=lambda: Remainder().after_turn,
    )
    return {"divide_by_bits": one_by_one, **_quotients("divide_by_bits")}


def normalised(value: Any) -> tuple[Any, Any]:
    """Return a long word shifted until its highest bit is set, and by how much."""
    shift = z3.BitVecVal(0, 64)
    for step in (32, 16, 8, 4, 2, 1):
        more = z3.If(z3.LShR(value, 64 - step) == 0, z3.BitVecVal(step, 64), z3.BitVecVal(0, 64))
        value, shift = value << more, shift + more
    return value, shift


def _no_bit_is_lost(_: Any, a: Any, d: Any) -> Any:
    """Claim that no bit is lost if both are shifted until d has its highest bit set."""
    divisor, shift = normalised(d)
    return z3.And(z3.LShR(a << shift, shift) == a, z3.LShR(divisor, shift) == d)


def _upper_bits(found: Any, a: Any, d: Any) -> Any:
    """Return the upper word of the shifted dividend, and half of that of the divisor, rounded up."""
    divisor, shift = normalised(d)
    half = _word(31, z3.LShR(divisor, 33)) + 1
    return z3.And(found["high"] == _word(63, a << shift), found["low"] == half)


def ratio_requires(a: Any, d: Any) -> Any:
    """Return what a ratio a / d requires, for whole numbers and for words wide enough to be like them."""
    return z3.And(d > 0, a <= d)


def is_ratio(upper_a: Any, half_d: Any, long_a: Any, long_d: Any) -> Any:
    """Return what is known of the result of ratio(): the upper parts of a and d, times a power of two."""
    return z3.And(
        *(long_a < 2**64, long_d >= 2**63, long_d < 2**64),
        *(2**32 * upper_a <= long_a, long_a < 2**32 * (upper_a + 1)),
        *(2**33 * (half_d - 1) <= long_d, long_d < 2**33 * half_d),
    )


def _whole(word: Any) -> Any:
    """Return the word with so many bits that nothing in these formulas wraps, nor in a shift by 63."""
    return widen(word, 128)


def _is_ratio_of_words(found: Any, a: Any, d: Any) -> Any:
    shift = _whole(normalised(d)[1])
    return is_ratio(_whole(found["high"]), _whole(found["low"]), _whole(a) << shift, _whole(d) << shift)


RATIO = Contract(
    _is_ratio_of_words,
    requires=lambda a, d: ratio_requires(_whole(a), _whole(d)),
    steps=(_no_bit_is_lost, _upper_bits),
    uses=("leading_zeros", "shifted_high_word"),
)


def _ratio_in_integers(machine: Machine, a: Any, d: Any) -> Any:
    """ratio() for quotient()."""
    machine.claim(ratio_requires(a.term, d.term), "what ratio requires")
    upper_a, half_d, scale = (machine.unknown("ratio", Type(bits)) for bits in (32, 32, 64))
    long_a, long_d = a.term * scale.term, d.term * scale.term
    machine.know(z3.And(scale.term >= 1, is_ratio(upper_a.term, half_d.term, long_a, long_d)))
    return {"high": upper_a, "low": half_d}


def quotient_ensures(found: Any, a: Any, d: Any) -> Any:
    """At most 7 units of 2^-32 too small, never too large."""
    return z3.And(found * d <= 2**32 * a, 2**32 * a <= (found + 7) * d, found < 2**32)


QUOTIENT = Contract(
    quotient_ensures,
    Integers,
    requires=ratio_requires,
    uses=("divide_31",),
    instead={"ratio": _ratio_in_integers},
)


def is_tried(variant: Variant, name: str) -> bool:
    """Return whether every argument of a function is tried instead of a proof."""
    return name == "prepare" and variant.divide in PREPARED


@cache
def _contracts(divide: int) -> dict[str, Contract]:
    quotients = _by_bits() if divide == BITS else _by_digits(divide)
    return {**WORDS, **SHIFTS, **PRODUCTS, **quotients, "ratio": RATIO, "quotient": QUOTIENT}


def contracts(variant: Variant) -> dict[str, Contract]:
    """Return the contracts of all functions of one variant of the header."""
    return _contracts(variant.divide)
