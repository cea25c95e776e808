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

_EXPONENT_BITS = 5
_EXPONENTS = 1 << _EXPONENT_BITS
_LINEAR_UNITS = 1 << 20
"""Confidences below this, which is 2**-4, have the exponent 0 and a fraction in equal steps."""


def encode_x_hat(x_hat: int, bits: int) -> int:
    """Return x_hat, 0 .. 2**23, as a code of ``bits`` bits, 1 .. MAX_X_HAT_BITS, rounded to nearest.

    Code 0 is 0.0 and the largest code 1.0. An x_hat of 1/2 lies between two codes, and gets the larger one.
    """
    largest_code = (1 << bits) - 1
    return (x_hat * largest_code + HALF) // ONE


def decode_x_hat(code: int, bits: int) -> int:
    """Return the x_hat, in units of 2**-23, nearest to what a code of ``bits`` bits stands for."""
    largest_code = (1 << bits) - 1
    # Doubled, so that 1/2 can be added for rounding: there are no ties, as the divisor is odd.
    return (2 * code * ONE + largest_code) // (2 * largest_code)


def encode_alpha(alpha: int, bits: int) -> int:
    """Return an alpha word, any 32 bits, as a code of ``bits`` bits, 1 .. MAX_ALPHA_BITS, rounded down.

    Code 0 is no confidence; every other confidence has at least code 1, and at most the largest one.
    """
    units = alpha_units(alpha)
    # The exponent is 0 below 2**20 units, and then one more with each doubling.
    exponent = max(units.bit_length() - _LINEAR_UNITS.bit_length() + 1, 0)
    if exponent >= _EXPONENTS:
        return (1 << bits) - 1
    # Behind the binary point is the fraction; in normal numbers the 1 before it adds 1 to the exponent.
    linear_exponent = max(exponent - 1, 0)
    long_code = linear_exponent * _LINEAR_UNITS + (units >> linear_exponent)
    # The long code's fraction has 20 bits, of which a code has fewer, or not even all of the exponent.
    code = long_code >> (MAX_ALPHA_BITS - bits)
    return max(code, 1) if units else 0


def decode_alpha(code: int, bits: int) -> int:
    """Return the alpha word, with the smallest shift, that a code of ``bits`` bits stands for."""
    long_code = code << (MAX_ALPHA_BITS - bits)
    exponent, fraction = divmod(long_code, _LINEAR_UNITS)
    if exponent == 0:
        return alpha_word_from_units(fraction)
    return alpha_word_from_units((_LINEAR_UNITS + fraction) << (exponent - 1))


def encode_message(sender: int, x_hat: int, alpha: int) -> bytes:
    """Return the 4 bytes of a message. Raises ValueError for a sender above 127 or an x_hat above 2**23."""
    if not 0 <= sender <= MAX_ID:
        raise ValueError(f"sender is {sender}; give an id from 0 to {MAX_ID}")
    if not 0 <= x_hat <= ONE:
        raise ValueError(f"x_hat is {x_hat}; give 0 to {ONE}, in units of 2**-23")
    codes = (sender << X_HAT_BITS) | encode_x_hat(x_hat, X_HAT_BITS)
    word = (codes << ALPHA_BITS) | encode_alpha(alpha, ALPHA_BITS)
    return word.to_bytes(MESSAGE_BYTES, "little")


def decode_message(message: bytes) -> tuple[int, int, int]:
    """Return sender, x_hat and alpha of a message, which may be any 4 bytes.

    Raises ValueError for another number of bytes.
    """
    if len(message) != MESSAGE_BYTES:
        raise ValueError(f"the message has {len(message)} bytes; a small message has {MESSAGE_BYTES}")
    codes, alpha_code = divmod(int.from_bytes(message, "little"), 1 << ALPHA_BITS)
    sender, x_hat_code = divmod(codes, 1 << X_HAT_BITS)
    return sender, decode_x_hat(x_hat_code, X_HAT_BITS), decode_alpha(alpha_code, ALPHA_BITS)
