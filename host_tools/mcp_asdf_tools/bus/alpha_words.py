"""Conversions of the confidence alpha between alpha words, IEEE binary32 bits and Python's float.

An alpha word is the firmware's 32 bits of a confidence: a mantissa of 24 bits above a shift of 5 bits, worth
mantissa * 2**shift * 2**-24 (``mcp_asdf.fixed_point``). A frame carries the same number as binary32, so that
other tools can read it. binary32 bits are a sign, a biased exponent of 8 bits and a fraction of 23 bits,
worth (1 + fraction / 2**23) * 2**(biased exponent - 127).
"""

from __future__ import annotations

import struct

from mcp_asdf.fixed_point import ALPHA_MAX, SHIFT_MAX

FRACTION_BITS = 23
"""Length of a binary32 number's fraction, which is the lowest of its bits."""
FRACTION_MASK = (1 << FRACTION_BITS) - 1
IMPLICIT_BIT = 1 << FRACTION_BITS
"""Highest bit of a normal binary32 number's significand, which its bits leave out."""
MANTISSA_BITS = 24
MANTISSA_POSITION = 8
"""Number of bits below the mantissa in an alpha word: 5 bits of shift, and 3 above them that are not used."""
UNIT_EXPONENT = 126
"""Biased exponent of the binary32 numbers whose last bit is worth 2**-24, the unit of a word with shift 0."""


def float32_bits_from_alpha_word(alpha_word: int) -> int:
    """Return the binary32 bits of the number that an alpha word, any 32 bits, stands for. Exact.

    An alpha word is the firmware's form of a confidence: a mantissa of 24 bits above a shift of 5 bits.
    """
    mantissa = alpha_word >> MANTISSA_POSITION
    shift = alpha_word & SHIFT_MAX  # all bits of the largest shift are set, so that it is their mask, too
    if mantissa == 0:
        return 0
    # The mantissa is shifted up until its highest bit is where binary32 has the bit that it leaves out.
    normalizing_shift = MANTISSA_BITS - mantissa.bit_length()
    significand = mantissa << normalizing_shift
    biased_exponent = UNIT_EXPONENT + shift - normalizing_shift
    return (biased_exponent << FRACTION_BITS) + (significand - IMPLICIT_BIT)


def alpha_word_from_float32_bits(bits: int) -> int:
    """Convert the binary32 bits of a finite number >= 0 to an alpha word, rounded down.

    An alpha word is the firmware's form of a confidence: a mantissa of 24 bits above a shift of 5 bits, worth
    mantissa * 2**shift * 2**-24. Parts smaller than 2**-24 are lost; numbers above the largest confidence,
    2**31 - 2**7, become that. Of the words with the same value the result is the one with the smallest shift.
    """
    mantissa = (bits & FRACTION_MASK) | IMPLICIT_BIT
    biased_exponent = bits >> FRACTION_BITS  # the only other bit above the fraction, the sign, is 0
    shift = biased_exponent - UNIT_EXPONENT
    if shift > SHIFT_MAX:
        return ALPHA_MAX
    if shift < 0:
        # Bits below 2**-24 are dropped. A subnormal number has no implicit bit, but it loses all 24 bits.
        return (mantissa >> -shift) << MANTISSA_POSITION
    return (mantissa << MANTISSA_POSITION) | shift


def float32_value(bits: int) -> float:
    """Return the number that binary32 bits stand for, exactly. It may be infinite or NaN."""
    value: float = struct.unpack("<f", struct.pack("<I", bits))[0]
    return value


def float32_bits(value: float) -> int:
    """Return the binary32 bits of the number nearest to ``value``.

    Raises OverflowError if ``value`` is beyond the largest such number, which is almost 2**128.
    """
    return int.from_bytes(struct.pack("<f", value), "little")
