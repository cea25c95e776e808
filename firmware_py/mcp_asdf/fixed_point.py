"""The firmware's number formats, and what its two fixed-point robots, mirror and native, share.

Formats:

- x_hat, x_bar and x are integers in units of 2**-23, so 1.0 is 2**23.
- b_hat is an integer in units of 2**-32.
- alpha is an *alpha word* of 32 bits: a mantissa (bits 8 to 31) and a shift (bits 0 to 4), together worth
  mantissa * 2**shift units of 2**-24. Bits 5 to 7 are ignored on input and 0 on output.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from operator import index
from typing import TYPE_CHECKING

from mcp_asdf.robot import (
    MAX_ID,
    FixedPointRobot,
    Status,
    Sums,
    check_alpha,
    describe_robot,
    raise_if_rejected,
)
from mcp_asdf.table import MAX_WORD

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ONE = 1 << 23
"""1.0 as x_hat, x_bar or x."""
HALF = 1 << 22
"""1/2 as x_hat, x_bar or x."""

B_HAT_MIN = 1 << 12
B_HAT_MAX = (1 << 32) - (1 << 12)

UNITS_PER_ALPHA = 1 << 24
MANTISSA_MAX = 0xFFFFFF
SHIFT_MAX = 31
ALPHA_MAX = MANTISSA_MAX << 8 | SHIFT_MAX
"""The alpha word of the largest confidence, 2**31 - 2**7."""


def b_hat_to_raw(b_hat: float) -> int:
    """Convert an accuracy in [2**-20, 1 - 2**-20] to units of 2**-32, rounded to nearest, ties to even."""
    return round(float(b_hat) * 2**32)


def x_hat_to_raw(x_hat: float) -> int:
    """Convert an estimate to units of 2**-23, rounded down.

    Outside [0, 1] the result is 2**32 - 1, which the firmware rejects.
    """
    return math.floor(float(x_hat) * ONE) if 0.0 <= x_hat <= 1.0 else MAX_WORD


def alpha_units(word: int) -> int:
    """Return the value of an alpha word in units of 2**-24, which is below 2**55."""
    mantissa = word >> 8
    return mantissa << (word & SHIFT_MAX)


def alpha_from_word(word: int) -> float:
    """Return the value of an alpha word, which is exact as a float."""
    return alpha_units(word) / UNITS_PER_ALPHA


def alpha_word_from_units(units: int) -> int:
    """Return the alpha word of the largest confidence not above ``units`` units of 2**-24.

    Of the words with that value it is the one with the smallest shift.
    """
    shift = max(units.bit_length() - 24, 0)
    if shift > SHIFT_MAX:
        return ALPHA_MAX
    return (units >> shift) << 8 | shift


def alpha_word_from_float(alpha: float) -> int:
    """Return the alpha word of the largest confidence not above ``alpha``.

    Raises ValueError for an ``alpha`` that is no confidence: a negative number, -0.0, infinity or NaN.
    """
    check_alpha(alpha)
    limited_alpha = min(alpha, 2.0**31)  # above ALPHA_MAX, so that it becomes that
    return alpha_word_from_units(math.floor(math.ldexp(limited_alpha, 24)))


def add_estimate(sums: Sums, x_hat: int, alpha: int) -> None:
    """Add an estimate to the sums of a round; x_hat in units of 2**-23, alpha as an alpha word.

    An estimate without confidence, alpha = 0, adds nothing and is not counted.
    """
    units = alpha_units(alpha)
    if units == 0:
        return
    # The products have 78 bits, so the C sums up those of both halves of the units.
    sums.alpha += units
    sums.alpha_x_low += (units & MAX_WORD) * x_hat
    sums.alpha_x_high += (units >> 32) * x_hat
    sums.x_squared += x_hat * x_hat
    sums.x += x_hat
    sums.count += 1


def is_valid_mean(alpha: int, alpha_x_low: int, alpha_x_high: int) -> bool:
    """Return whether the sums of alpha and of alpha x_hat are in range, and their quotient is at most 1.

    None of the three is negative.
    """
    alpha_x = (alpha_x_high << 32) + alpha_x_low
    largest_alpha = MAX_ID * MANTISSA_MAX << SHIFT_MAX
    return alpha <= largest_alpha and alpha_x_low < 1 << 62 and alpha_x <= alpha * ONE


def are_valid_sums(sums: Sums) -> bool:
    """Return whether ``sums.count`` messages can have these sums, none of which is negative."""
    return (
        sums.count <= MAX_ID
        and sums.x <= sums.count * ONE
        and sums.x_squared <= sums.x * ONE
        # No sample has a negative variance (Cauchy and Schwarz).
        and sums.count * sums.x_squared >= sums.x * sums.x
        # Messages have an alpha of at least one unit.
        and sums.count <= sums.alpha <= sums.count * MANTISSA_MAX << SHIFT_MAX
        # The halves of an alpha are at most MAX_WORD and MANTISSA_MAX >> 1.
        and sums.alpha_x_low <= sums.x * MAX_WORD
        and sums.alpha_x_high <= sums.x * (MANTISSA_MAX >> 1)
        and is_valid_mean(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
    )


class FixedPointView(FixedPointRobot):
    """The interface in floats of a robot that computes in integers. Every value but ``beta`` is exact."""

    @abstractmethod
    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Receive a message as ``receive_raw``; the arguments are of Python's own ``int``."""

    def _receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Receive the rows of a valid array in order, and return how many were accepted."""
        return sum(self._receive(*message) is Status.OK for message in messages.tolist())

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Add a neighbour's estimate to the open round; x_hat in units of 2**-23, alpha as an alpha word.

        Raises ValueError, and changes nothing, for an ``alpha`` that has not 32 bits.
        """
        if not 0 <= alpha <= MAX_WORD:
            raise ValueError(f"alpha is {alpha}; the firmware's word has 32 bits")
        # Integers of NumPy would overflow in the sums, so they become Python's.
        return self._receive(index(sender), index(x_hat), index(alpha))

    def receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Receive messages as ``receive_raw`` in order, and return how many were accepted."""
        if messages.dtype != "uint32" or messages.shape[1:] != (3,) or not messages.flags.c_contiguous:
            raise ValueError(
                f"messages are an array of {messages.dtype} of shape {messages.shape}; "
                "give a C-contiguous one of uint32 of shape (messages, 3)"
            )
        return self._receive_all(messages)

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Add a neighbour's estimate to the open round; values between the firmware's are rounded down.

        Raises FirmwareError if the message is invalid, and counts it as rejected.
        """
        status = self.receive_raw(sender, x_hat_to_raw(x_hat), alpha_word_from_float(alpha))
        raise_if_rejected(status, sender, x_hat)
        return status

    def __repr__(self) -> str:
        return describe_robot(self)

    @property
    def b_hat(self) -> float:
        """Assumed accuracy of this robot's sensor."""
        return self.b_hat_raw / 2**32

    @property
    def x_hat(self) -> float:
        """Local estimate (eq. 3)."""
        return self.x_hat_raw / ONE

    @property
    def alpha(self) -> float:
        """Local confidence (eq. 4)."""
        return alpha_from_word(self.alpha_raw)

    @property
    def x_bar(self) -> float:
        """Social estimate (eq. 5) of the last closed round."""
        return self.x_bar_raw / ONE

    @property
    def beta(self) -> float:
        """Social confidence (eq. 6) of the last closed round, rounded to float64."""
        return self.beta_raw / UNITS_PER_ALPHA

    @property
    def x(self) -> float:
        """Informed estimate (eq. 7)."""
        return self.x_raw / ONE
