"""Conversions of the confidence alpha between alpha words, IEEE binary32 bits and Python's float.

An alpha word is the firmware's 32 bits of a confidence (``mcp_asdf.fixed_point``). A frame carries the same
number as binary32, so that other tools can read it.
"""

from __future__ import annotations

import struct

from mcp_asdf.fixed_point import alpha_from_word, alpha_word_from_float


def float32_bits_from_alpha_word(alpha_word: int) -> int:
    """Return the binary32 bits of the number that an alpha word, any 32 bits, stands for.

    Nothing is rounded: an alpha word has a mantissa of 24 bits, as binary32 has, and no exponent beyond those
    of binary32.
    """
    return float32_bits(alpha_from_word(alpha_word))


def alpha_word_from_float32_bits(bits: int) -> int:
    """Convert the binary32 bits of a finite number >= 0 to an alpha word, rounded down.

    Parts smaller than 2**-24 are lost; numbers above the largest confidence, 2**31 - 2**7, become that. Of
    the words with the same value the result is the one with the smallest shift.
    """
    return alpha_word_from_float(float32_value(bits))


def float32_value(bits: int) -> float:
    """Return the number that binary32 bits stand for, exactly. It may be infinite or NaN."""
    value: float = struct.unpack("<f", struct.pack("<I", bits))[0]
    return value


def float32_bits(value: float) -> int:
    """Return the binary32 bits of the number nearest to ``value``.

    Raises OverflowError if ``value`` is beyond the largest such number, which is almost 2**128.
    """
    return int.from_bytes(struct.pack("<f", value), "little")
