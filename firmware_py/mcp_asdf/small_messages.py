"""The codec of small messages: a robot's broadcast (sender, x_hat, alpha) in 4 bytes, and in other lengths.

Units are the firmware's (``mcp_asdf.fixed_point``): x_hat in units of 2**-23, alpha as an alpha word. In a
message each of them is a *code* of some bits. ``c_ref/src/mcp_asdf_small.h`` is the same codec in C, bit for
bit; docs/design.md has the layout and the rounding.
"""

from __future__ import annotations

from mcp_asdf.fixed_point import HALF, ONE, alpha_units, alpha_word_from_units
from mcp_asdf.robot import MAX_ID

MESSAGE_BYTES = 4
X_HAT_BITS, ALPHA_BITS = 16, 9
"""Bits of the two codes in a message of 4 bytes, which leave 7 for the sender."""

MAX_X_HAT_BITS, MAX_ALPHA_BITS = 23, 25
"""The most bits for which different codes stand for different numbers of the firmware."""

# The longest code of a confidence has MAX_ALPHA_BITS = 25 bits: an exponent of 5 above a fraction of 20.
_EXPONENT_MAX = 31
_FRACTION_BITS = 20
_FRACTIONS = 1 << _FRACTION_BITS
"""Number of fractions. A confidence of fewer units of 2**-24 has exponent 0, and is itself the fraction."""


def encode_x_hat(x_hat: int, bits: int) -> int:
    """Return x_hat, 0 .. 2**23, as a code of ``bits`` bits, 1 .. MAX_X_HAT_BITS, rounded to nearest.

    Code 0 is 0.0 and the largest code 1.0. An x_hat of 1/2 lies between two codes, and gets the larger one.
    """
    largest_code = (1 << bits) - 1
    return (x_hat * largest_code + HALF) // ONE


def decode_x_hat(code: int, bits: int) -> int:
    """Return the x_hat nearest to code / largest code of ``bits`` bits, in units of 2**-23."""
    largest_code = (1 << bits) - 1
    # Doubled, so that 1/2 can be added for rounding: there are no ties, as the divisor is odd.
    return (2 * code * ONE + largest_code) // (2 * largest_code)


def encode_alpha(alpha: int, bits: int) -> int:
    """Return an alpha word, any 32 bits, as a code of ``bits`` bits, 1 .. MAX_ALPHA_BITS, rounded down.

    An alpha word has a mantissa in bits 8 to 31 and a shift in bits 0 to 4, and stands for a confidence of
    mantissa * 2**shift units of 2**-24. The code is a small floating-point number, too: an exponent of 5 bits
    above a fraction, or only the upper bits of the exponent. Code 0 is no confidence; every other confidence
    has at least code 1, and at most the largest one.
    """
    units = alpha_units(alpha)
    if units == 0:
        return 0
    # A shorter code has only the upper bits of the long one.
    code = _long_code(units) >> (MAX_ALPHA_BITS - bits)
    return max(code, 1)


def _long_code(units: int) -> int:
    """Return a confidence in units of 2**-24 as a code of 25 bits: exponent * 2**20 + fraction, rounded down.

    Below 2**20 units the exponent is 0, and the fraction is the number of units. From there on the exponent
    is 1 and grows by 1 with each doubling, and the fraction is the 20 bits that follow the highest one. A
    confidence whose exponent would be above 31 has the largest code.
    """
    exponent = max(units.bit_length() - _FRACTION_BITS, 0)
    if exponent == 0:
        return units
    if exponent > _EXPONENT_MAX:
        return (1 << MAX_ALPHA_BITS) - 1  # the largest code of 25 bits
    # With exponent 1 there are 21 bits, and with each higher exponent one bit more, which does not fit.
    bits_too_many = exponent - 1
    significand = units >> bits_too_many  # 21 bits
    fraction = significand - _FRACTIONS  # without the highest bit, which is always set and not stored
    return exponent * _FRACTIONS + fraction  # _FRACTIONS is 2**20


def decode_alpha(code: int, bits: int) -> int:
    """Return the alpha word, with the smallest shift, that a code of ``bits`` bits stands for.

    The code is an exponent of 5 bits above a fraction, or only the upper bits of the exponent. An alpha word
    has a mantissa in bits 8 to 31 and a shift in bits 0 to 4, and stands for a confidence of
    mantissa * 2**shift units of 2**-24.
    """
    long_code = code << (MAX_ALPHA_BITS - bits)  # the bits that a short code lacks are 0
    exponent, fraction = divmod(long_code, _FRACTIONS)
    if exponent == 0:
        return alpha_word_from_units(fraction)
    significand = _FRACTIONS + fraction  # with the highest bit, which is not stored
    return alpha_word_from_units(significand << (exponent - 1))


def encode_message(sender: int, x_hat: int, alpha: int) -> bytes:
    """Return a robot's broadcast as a message of 4 bytes.

    ``x_hat`` is in units of 2**-23. ``alpha``, its confidence, is an alpha word: a mantissa in bits 8 to 31
    and a shift in bits 0 to 4. Raises ValueError for a sender above 127 or an x_hat above 2**23.
    """
    if not 0 <= sender <= MAX_ID:
        raise ValueError(f"sender is {sender}; give an id from 0 to {MAX_ID}")
    if not 0 <= x_hat <= ONE:
        raise ValueError(f"x_hat is {x_hat}; give 0 to {ONE}, in units of 2**-23")
    codes = (sender << X_HAT_BITS) | encode_x_hat(x_hat, X_HAT_BITS)
    word = (codes << ALPHA_BITS) | encode_alpha(alpha, ALPHA_BITS)
    return word.to_bytes(MESSAGE_BYTES, "little")


def decode_message(message: bytes) -> tuple[int, int, int]:
    """Return sender, x_hat and alpha of a message, which may be any 4 bytes.

    x_hat is in units of 2**-23. alpha, its confidence, is an alpha word: a mantissa in bits 8 to 31 and a
    shift in bits 0 to 4. Raises ValueError for another number of bytes.
    """
    if len(message) != MESSAGE_BYTES:
        raise ValueError(f"the message has {len(message)} bytes; a small message has {MESSAGE_BYTES}")
    # From the lowest bits up: the code of alpha, that of x_hat, and the sender.
    sender_and_x_hat, alpha_code = divmod(int.from_bytes(message, "little"), 1 << ALPHA_BITS)
    sender, x_hat_code = divmod(sender_and_x_hat, 1 << X_HAT_BITS)
    return sender, decode_x_hat(x_hat_code, X_HAT_BITS), decode_alpha(alpha_code, ALPHA_BITS)
