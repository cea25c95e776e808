"""Rounding of what robots send, to messages of a few bits.

Only messages are rounded, as by the codec for small messages (``mcp_asdf.small_messages``). A robot goes on
with its own exact estimate: the codec stands between its firmware and its radio, and to round the robot's own
numbers, too, would only lose information.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mcp_asdf import small_messages
from mcp_asdf.fixed_point import ONE, alpha_from_word, alpha_word_from_float, x_hat_to_raw
from mcp_asdf_tools.common.errors import UsageError

EXACT = "exact"
"""The text in place of numbers of bits where messages are not rounded."""


@dataclass(frozen=True)
class MessageCode:
    """Number of bits of a message's x_hat, the sender's estimate, and of its alpha, the confidence of x_hat.

    The text of a code is as ``parse_message_bits`` reads it, such as "16+9".

    Attributes:
        x_hat_bits: 1 .. 23.
        alpha_bits: 1 .. 25.
    """

    x_hat_bits: int
    alpha_bits: int

    def __str__(self) -> str:
        return f"{self.x_hat_bits}+{self.alpha_bits}"

    def round_raw(self, x_hat: int, alpha: int) -> tuple[int, int]:
        """Return x_hat and alpha rounded to the code's numbers of bits, as a receiver decodes them.

        They are the firmware's integers: x_hat in units of 2**-23, alpha as 32 bits of mantissa and shift.
        """
        x_hat_code = small_messages.encode_x_hat(x_hat, self.x_hat_bits)
        alpha_code = small_messages.encode_alpha(alpha, self.alpha_bits)
        return (
            small_messages.decode_x_hat(x_hat_code, self.x_hat_bits),
            small_messages.decode_alpha(alpha_code, self.alpha_bits),
        )

    def round_floats(self, x_hat: float, alpha: float) -> tuple[float, float]:
        """Return x_hat, from 0 to 1, and alpha as a receiver decodes them, as floats.

        Both are first rounded down to the firmware's numbers. Raises ValueError for an alpha that is no
        confidence, such as NaN.
        """
        raw_x_hat, alpha_word = self.round_raw(x_hat_to_raw(x_hat), alpha_word_from_float(alpha))
        return raw_x_hat / ONE, alpha_from_word(alpha_word)


def parse_message_bits(text: str) -> MessageCode | None:
    """Return the code that a text such as "16+9" stands for: bits of x_hat and of alpha; None for "exact".

    Raises UsageError for any other text, and for numbers of bits out of range.
    """
    if text == EXACT:
        return None
    match = re.fullmatch("([0-9]{1,2})[+]([0-9]{1,2})", text)
    if match:
        code = MessageCode(x_hat_bits=int(match[1]), alpha_bits=int(match[2]))
        has_legal_x_hat = 1 <= code.x_hat_bits <= small_messages.MAX_X_HAT_BITS
        has_legal_alpha = 1 <= code.alpha_bits <= small_messages.MAX_ALPHA_BITS
        if has_legal_x_hat and has_legal_alpha:
            return code
    x_hat_limits = f"1 to {small_messages.MAX_X_HAT_BITS}"
    alpha_limits = f"1 to {small_messages.MAX_ALPHA_BITS}"
    raise UsageError(
        f"message_bits is {text!r}; give the bits of x_hat, {x_hat_limits}, and of alpha, {alpha_limits}, "
        f"such as 16+9, or {EXACT}"
    )
