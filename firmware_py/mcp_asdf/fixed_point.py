"""The firmware's number formats, and the float view that both fixed-point robots share.

Units: x_hat, x_bar and x 2**-23; b_hat 2**-32. alpha is a word: a mantissa (bits 8..31) times 2**shift (bits
0..4) units of 2**-24; bits 5..7 are ignored on input and 0 on output.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from operator import index
from typing import TYPE_CHECKING

from mcp_asdf.robot import MAX_ID, FixedPointRobot, Status, Sums, accepted, check_alpha, reading, shown
from mcp_asdf.table import MAX_WORD

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ONE = 1 << 23
"""1.0 as x_hat, x_bar or x."""
HALF = 1 << 22
B_HAT_MIN, B_HAT_MAX = 1 << 12, (1 << 32) - (1 << 12)
MANTISSA_MAX, SHIFT_MAX = 0xFFFFFF, 31
ALPHA_MAX = MANTISSA_MAX << 8 | SHIFT_MAX
"""Word of the largest confidence, 2**31 - 2**7."""
UNITS_PER_ALPHA = 1 << 24


def b_hat_to_raw(b_hat: float) -> int:
    """An accuracy in [2**-20, 1 - 2**-20] in units of 2**-32, to nearest, ties to even."""
    return round(float(b_hat) * 2**32)


def x_hat_to_raw(x_hat: float) -> int:
    """An estimate in units of 2**-23, rounded down; outside [0, 1] a value that the firmware rejects."""
    return math.floor(float(x_hat) * ONE) if 0.0 <= x_hat <= 1.0 else MAX_WORD


def alpha_units(word: int) -> int:
    """An alpha word's value in units of 2**-24, below 2**55: every 32-bit word has one."""
    return (word >> 8) << (word & SHIFT_MAX)


def alpha_word(units: int) -> int:
    """The word of the largest confidence not above ``units`` units of 2**-24: with the smallest shift."""
    shift = max(units.bit_length() - 24, 0)
    return (units >> shift) << 8 | shift if shift <= SHIFT_MAX else ALPHA_MAX


def alpha_to_word(alpha: float) -> int:
    """The word of the largest confidence not above ``alpha``.

    Raises ValueError for what is no confidence: a negative number, -0.0, infinity or NaN.
    """
    check_alpha(alpha)
    return alpha_word(math.floor(math.ldexp(min(alpha, 2.0**31), 24)))


def word_to_alpha(word: int) -> float:
    """The value of an alpha word, exactly."""
    return alpha_units(word) / UNITS_PER_ALPHA


def sums_add(sums: Sums, x_hat: int, alpha: int) -> None:
    """Enter a message into the sums, x_hat in units of 2**-23 and alpha as a word; alpha = 0 adds nothing."""
    units = alpha_units(alpha)
    if units == 0:
        return
    sums.alpha += units
    sums.alpha_x_low += (units & MAX_WORD) * x_hat
    sums.alpha_x_high += (units >> 32) * x_hat
    sums.x_squared += x_hat * x_hat
    sums.x += x_hat
    sums.count += 1


def mean_possible(alpha: int, alpha_x_low: int, alpha_x_high: int) -> bool:
    """True if sums of alpha and of alpha x_hat, from 0 on, are in range and give a mean of at most 1."""
    return (
        alpha <= MAX_ID * MANTISSA_MAX << SHIFT_MAX
        and alpha_x_low < 1 << 62
        and (alpha_x_high << 32) + alpha_x_low <= alpha * ONE
    )


def sums_possible(sums: Sums) -> bool:
    """True if ``count`` messages can have given these sums, of which none is below 0."""
    return (
        sums.count <= MAX_ID
        and sums.x <= sums.count * ONE
        and sums.x_squared <= sums.x * ONE
        and sums.count * sums.x_squared >= sums.x * sums.x
        and sums.count <= sums.alpha <= sums.count * MANTISSA_MAX << SHIFT_MAX
        and sums.alpha_x_low <= sums.x * MAX_WORD
        and sums.alpha_x_high <= sums.x * (MANTISSA_MAX >> 1)
        and mean_possible(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
    )


class FixedPointView(FixedPointRobot):
    """Floats in and out of a robot that computes in integers. Every value but ``beta`` is exact.

    What reaches the robot's own ``_receive`` are Python's integers.
    """

    @abstractmethod
    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """``receive_raw``, given integers of Python's own."""

    def _receive_all(self, messages: NDArray[np.uint32]) -> int:
        """``receive_all`` of an array that is as it should be."""
        return sum(self._receive(*each) is Status.OK for each in messages.tolist())

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Take a neighbour's message into the open round; x_hat in 2**-23, alpha as the firmware's word.

        Raises ValueError, and changes nothing, for an ``alpha`` that is no word of 32 bits.
        """
        if not 0 <= alpha <= MAX_WORD:
            raise ValueError(f"alpha is {alpha}; the firmware's word has 32 bits")
        return self._receive(index(sender), index(x_hat), index(alpha))

    def receive_all(self, messages: NDArray[np.uint32]) -> int:
        """``receive_raw`` of several messages in order; returns how many were accepted."""
        if messages.dtype != "uint32" or messages.shape[1:] != (3,) or not messages.flags.c_contiguous:
            raise ValueError(
                f"messages are an array of {messages.dtype} of shape {messages.shape}; "
                "give a C-contiguous one of uint32 of shape (messages, 3)"
            )
        return self._receive_all(messages)

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Take a neighbour's message; values off the firmware's grids are rounded down.

        Raises FirmwareError if it is refused, which counts it as rejected.
        """
        status = self.receive_raw(sender, x_hat_to_raw(x_hat), alpha_to_word(alpha))
        return accepted(status, sender, x_hat)

    def __repr__(self) -> str:
        return shown(self)

    b_hat = reading(lambda robot: robot.b_hat_raw / 2**32, "Assumed accuracy.")
    x_hat = reading(lambda robot: robot.x_hat_raw / ONE, "Local estimate (eq. 3).")
    alpha = reading(lambda robot: word_to_alpha(robot.alpha_raw), "Local confidence (eq. 4).")
    x_bar = reading(lambda robot: robot.x_bar_raw / ONE, "Social estimate (eq. 5) of the last closed round.")
    beta = reading(lambda robot: robot.beta_raw / UNITS_PER_ALPHA, "Social confidence, rounded to float64.")
    x = reading(lambda robot: robot.x_raw / ONE, "Informed estimate (eq. 7).")
