"""Conversions of the confidence alpha between the firmware's word, IEEE binary32 bits and Python's float.

A word is 32 bits: a mantissa of 24 bits above a shift of 5 bits, worth mantissa * 2**shift * 2**-24
(``mcp_asdf.fixed_point``). A frame carries the same number as binary32, so that other tools can read it.
"""

from __future__ import annotations

import struct

from mcp_asdf.fixed_point import ALPHA_MAX, SHIFT_MAX

FRACTION_BITS = 23
FRACTION_MASK = (1 << FRACTION_BITS) - 1
IMPLICIT_BIT = 1 << FRACTION_BITS
"""Highest bit of a normal binary32 number's significand, which its bits leave out."""
MANTISSA_BITS = 24
UNIT_EXPONENT = 126
"""Biased exponent of the binary32 numbers whose last bit is worth 2**-24, the unit of a word with shift 0."""


def alpha_word_to_bits(word: int) -> int:
    """Return the binary32 bits of an alpha word, any 32 bits. The value is the same, exactly."""
    mantissa, shift = word >> 8, word & SHIFT_MAX
    if mantissa == 0:
        return 0
    # A normal number has its highest bit at the place of the implicit one.
    normalizing_shift = MANTISSA_BITS - mantissa.bit_length()
    biased_exponent = UNIT_EXPONENT + shift - normalizing_shift
    return (biased_exponent << FRACTION_BITS) + (mantissa << normalizing_shift) - IMPLICIT_BIT


def alpha_word_from_bits(bits: int) -> int:
    """Return the word of the largest confidence not above a finite number >= 0 of these binary32 bits.

    The inverse of ``alpha_word_to_bits``, except that the word has the smallest possible shift.
    Parts smaller than 2**-24 are lost; numbers above the largest confidence, 2**31 - 2**7, become that.
    """
    mantissa = bits & FRACTION_MASK | IMPLICIT_BIT
    shift = (bits >> FRACTION_BITS) - UNIT_EXPONENT
    if shift < 0:  # a subnormal number has no implicit bit, but none of its bits is left here
        return mantissa >> -shift << 8
    return mantissa << 8 | shift if shift <= SHIFT_MAX else ALPHA_MAX


def float32_value(bits: int) -> float:
    """Return the number of binary32 ``bits``, exactly. Not a number in, not a number out."""
    value: float = struct.unpack("<f", struct.pack("<I", bits))[0]
    return value


def float32_bits(value: float) -> int:
    """Return the binary32 bits nearest to a number.

    Raises OverflowError if there is none near, that is from about 2**128 on.
    """
    return int.from_bytes(struct.pack("<f", value), "little")
