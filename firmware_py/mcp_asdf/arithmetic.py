"""Arithmetic of the mirror: what ``c_ref/src/mcp_asdf_arithmetic.h`` does in words of 32 bits.

A "word" is an integer of 32 bits. Names that begin with Q32 are numbers in units of 2**-32.
"""

from __future__ import annotations

Q32_HALF = 1 << 31
Q32_ONE = 1 << 32
"""1 in units of 2**-32, which no word holds; where a word is needed, MAX_WORD stands for it."""


def leading_zeros(value: int) -> int:
    """Return by how many bits a word of 32 bits can be shifted up until its highest bit is set.

    0, which has no such bit, is treated as 1, with the result 31.
    """
    return 32 - max(value, 1).bit_length()


def multiply_high(a: int, b: int) -> int:
    """Return a * b / 2**32, rounded down: the upper word of the product of two words.

    If both numbers are in units of 2**-32, so is the result.
    """
    return (a * b) >> 32


def divide_24(dividend: int, divisor: int) -> int:
    """Return dividend / divisor in units of 2**-24, rounded down. In C it takes numbers of 31 bits."""
    return (dividend << 24) // divisor


def q32_quotient(numerator: int, denominator: int) -> int:
    """Return numerator / denominator in units of 2**-32, or a little less, with the bits that the C computes.

    In C this is ``quotient``. It shifts the denominator until that has 32 bits, and the numerator by as many.
    It divides by the next even number above the denominator, so that the quotient is never too large.
    """
    # Both first get 32 zeros at their end, so that even a short denominator has as many bits as it loses.
    dropped_bits = denominator.bit_length()
    upper_numerator = (numerator << 32) >> dropped_bits
    upper_denominator = (denominator << 32) >> dropped_bits
    next_even_number = (upper_denominator // 2 + 1) * 2
    return (upper_numerator << 32) // next_even_number  # 32 more bits, for units of 2**-32
