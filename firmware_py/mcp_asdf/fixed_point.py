"""The firmware's number formats, and what its two fixed-point robots, mirror and native, share.

Formats:

- x_hat, x_bar and x (the local, the social and the informed estimate of the share of black tiles) are
  integers in units of 2**-23, so 1.0 is 2**23.
- b_hat, the accuracy that a robot assumes of its sensor, is an integer in units of 2**-32.
- alpha, the confidence of x_hat, is an *alpha word* of 32 bits: a mantissa (bits 8 to 31) and a shift (bits 0
  to 4), together worth mantissa * 2**shift units of 2**-24. Bits 5 to 7 are ignored on input and 0 on output.
- alpha is an integer in units of 2**-24 where it is summed up.

A *round* is what a robot receives from one ``settle`` to the next; ``mcp_asdf.robot`` defines more words.
"""

from __future__ import annotations

import math
import operator
from abc import abstractmethod
from typing import TYPE_CHECKING

from mcp_asdf.robot import (
    MAX_ROUND_SIZE,
    FixedPointRobot,
    Status,
    Sums,
    check_alpha,
    create_rejection,
    describe_robot,
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
"""Smallest b_hat, 2**-20."""
B_HAT_MAX = (1 << 32) - (1 << 12)
"""Largest b_hat, 1 - 2**-20."""

UNITS_PER_ALPHA = 1 << 24
"""alpha = 1.0 in the units of 2**-24 in which confidences are summed up."""
MANTISSA_BITS = 24
MANTISSA_POSITION = 8
"""Bit of an alpha word at which its mantissa begins."""
MANTISSA_MAX = 0xFFFFFF
SHIFT_MAX = 31
"""Largest shift of an alpha word, which is also the mask of the shift's bits."""
ALPHA_MAX = (MANTISSA_MAX << MANTISSA_POSITION) | SHIFT_MAX
"""The alpha word of the largest confidence, 2**31 - 2**7."""
LARGEST_ALPHA_UNITS = MANTISSA_MAX << SHIFT_MAX
"""The largest confidence in units of 2**-24: a number of 55 bits."""


def b_hat_to_raw(b_hat: float) -> int:
    """Convert a sensor's assumed accuracy to units of 2**-32, rounded to nearest, ties to even.

    It is not checked, and should be in [2**-20, 1 - 2**-20].
    """
    return round(float(b_hat) * 2**32)


def x_hat_to_raw(x_hat: float) -> int:
    """Convert a local estimate to units of 2**-23, rounded down.

    For NaN and outside [0, 1] the result is 2**32 - 1, which the firmware rejects as ERR_X_HAT.
    """
    if not 0.0 <= x_hat <= 1.0:
        return MAX_WORD
    return math.floor(float(x_hat) * ONE)


def alpha_units(word: int) -> int:
    """Convert an alpha word, the firmware's 32 bits of a confidence, to units of 2**-24.

    The result is mantissa * 2**shift, with the mantissa from bits 8 to 31 and the shift from bits 0 to 4. It
    is below 2**55.
    """
    mantissa = word >> MANTISSA_POSITION
    shift = word & SHIFT_MAX
    return mantissa << shift


def alpha_from_word(word: int) -> float:
    """Convert an alpha word, the firmware's 32 bits of a confidence, to that confidence as a float. Exact."""
    return alpha_units(word) / UNITS_PER_ALPHA


def alpha_word_from_units(units: int) -> int:
    """Convert a confidence in units of 2**-24 to an alpha word, rounded down to a confidence that fits.

    An alpha word has a mantissa in bits 8 to 31 and a shift in bits 0 to 4, and stands for mantissa *
    2**shift units. Where several words stand for the same confidence, the result is the one with the smallest
    shift. It is ALPHA_MAX for all confidences above the largest that a word can stand for.
    """
    bits_too_many = units.bit_length() - MANTISSA_BITS
    shift = max(bits_too_many, 0)
    if shift > SHIFT_MAX:
        return ALPHA_MAX
    # The lowest bits are lost, so that the others fit the mantissa.
    mantissa = units >> shift
    return (mantissa << MANTISSA_POSITION) | shift


def alpha_word_from_float(alpha: float) -> int:
    """Convert a confidence to an alpha word, the firmware's 32 bits for it, rounded down.

    The word has a mantissa in bits 8 to 31 and a shift in bits 0 to 4, and stands for mantissa * 2**shift *
    2**-24. A confidence above 2**31 - 2**7 becomes ALPHA_MAX, which stands for that number. Raises ValueError
    for an ``alpha`` that is no confidence: a negative number, -0.0, infinity or NaN.
    """
    check_alpha(alpha)
    # A huge float would overflow below. The limit is above 2**31 - 2**7, so it does not change the result.
    limited_alpha = min(alpha, 2.0**31)
    units = math.ldexp(limited_alpha, 24)  # in units of 2**-24: times 2**24, without rounding
    return alpha_word_from_units(math.floor(units))


def add_estimate(sums: Sums, x_hat: int, alpha: int) -> None:
    """Add a received estimate to the sums of a round, which change, and count it there.

    These are the sums of alpha, alpha x_hat, x_hat and x_hat**2.

    ``x_hat`` is the estimated share of black tiles in units of 2**-23. ``alpha`` is its confidence as an
    alpha word: a mantissa in bits 8 to 31 and a shift in bits 0 to 4. An estimate without confidence, whose
    mantissa is 0, changes nothing and is not counted.
    """
    units = alpha_units(alpha)
    if units == 0:
        return
    sums.alpha += units
    # alpha has up to 55 bits and x_hat 24, so their product is too long for a 64-bit number of the C. The
    # lower 32 bits of alpha and the rest are multiplied and summed up on their own.
    low_half = units & MAX_WORD
    high_half = units >> 32
    sums.alpha_x_low += low_half * x_hat
    sums.alpha_x_high += high_half * x_hat
    sums.x_squared += x_hat * x_hat
    sums.x += x_hat
    sums.count += 1


def is_valid_mean(alpha: int, alpha_x_low: int, alpha_x_high: int) -> bool:
    """Return whether a round of up to 127 estimates can have these sums, from which its mean is computed.

    ``alpha`` is the sum of the confidences alpha, in units of 2**-24. The sum of alpha x_hat, the numerator
    of the mean, comes in two numbers, as one would be too long for the C: ``alpha_x_low`` is the sum of
    (lower 32 bits of alpha) * x_hat, and ``alpha_x_high`` the sum of (the bits of alpha above) * x_hat, with
    x_hat in units of 2**-23. No sum may be negative. The bounds are

    - ``alpha`` is at most 127 times the largest confidence that a robot can send;
    - ``alpha_x_low`` is less than 2**62;
    - the mean of x_hat, which is the sum of alpha x_hat divided by ``alpha``, is at most 1. If ``alpha`` is
      0, the sum of alpha x_hat must be 0, too.
    """
    is_alpha_possible = alpha <= MAX_ROUND_SIZE * LARGEST_ALPHA_UNITS
    # Lower 32 bits times an x_hat of up to 2**23 are below 2**55, and 127 of these products are below 2**62.
    is_lower_sum_possible = alpha_x_low < 1 << 62
    # This bounds ``alpha_x_high``, too. x_hat has the unit 2**-23, in which 1 is ONE.
    alpha_x = (alpha_x_high << 32) + alpha_x_low
    is_mean_possible = alpha_x <= alpha * ONE
    return is_alpha_possible and is_lower_sum_possible and is_mean_possible


def are_valid_sums(sums: Sums) -> bool:
    """Return whether the sums of a round keep all bounds that the estimates of a round give them.

    With m = ``sums.count`` estimates, each with x_hat in [0, 1] and a confidence alpha > 0, the bounds are

    - m is at most 127;
    - the sum of x_hat is at most m, and the sum of x_hat**2 at most the sum of x_hat;
    - the variance of x_hat is not negative;
    - the sum of alpha is at least m times the smallest confidence above 0, and at most m times the largest;
    - the sum of (lower 32 bits of alpha) * x_hat is at most the sum of x_hat times the largest number of 32
      bits;
    - the sum of (the bits of alpha above) * x_hat is at most the sum of x_hat times the largest number that
      these bits can be;
    - the sums of alpha and alpha x_hat pass `is_valid_mean`.

    No sum may be negative. Sums that keep the bounds need not be those of a round.
    """
    m, sum_x, sum_x_squared = sums.count, sums.x, sums.x_squared
    is_count_possible = m <= MAX_ROUND_SIZE
    is_sum_x_possible = sum_x <= m * ONE
    # No x_hat is above 1, so none is below its square. ONE brings sum_x to the squares' unit of 2**-46.
    are_squares_possible = sum_x_squared <= sum_x * ONE
    # No sample has a negative variance (Cauchy and Schwarz).
    is_variance_possible = m * sum_x_squared >= sum_x * sum_x
    # The smallest confidence above 0 is one unit.
    is_alpha_possible = m <= sums.alpha <= m * LARGEST_ALPHA_UNITS
    # Either sum of products is largest if every x_hat has the largest factor.
    largest_low_factor = MAX_WORD
    largest_high_factor = LARGEST_ALPHA_UNITS >> 32
    are_products_possible = (
        sums.alpha_x_low <= sum_x * largest_low_factor and sums.alpha_x_high <= sum_x * largest_high_factor
    )
    return (
        is_count_possible
        and is_sum_x_possible
        and are_squares_possible
        and is_variance_possible
        and is_alpha_possible
        and are_products_possible
        and is_valid_mean(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
    )


class FixedPointView(FixedPointRobot):
    """The float interface of a robot that computes in integers: the part that mirror and native share.

    A subclass has the integers (``*_raw``) and the calls that change them. All values but ``beta``, which may
    have more digits than a float, are exact.
    """

    @abstractmethod
    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Do what ``receive_raw`` does, after its checks: add an estimate to the open round.

        The arguments are Python's own ``int``, and ``alpha`` has 32 bits. Returns OK, REPEATED, ERR_SENDER or
        ERR_X_HAT.
        """

    def _receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Receive messages whose array was checked, and return how many of them were accepted.

        A row of the array is a message, with the columns sender, x_hat and alpha.
        """
        accepted_count = 0
        for sender, x_hat, alpha in messages.tolist():
            if self._receive(sender, x_hat, alpha) is Status.OK:
                accepted_count += 1
        return accepted_count

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Add a neighbour's estimate to the open round: what was received since the last ``settle``.

        ``x_hat`` is in units of 2**-23. ``alpha`` is an alpha word: 32 bits, with a mantissa in bits 8 to 31
        and a shift in bits 0 to 4. Returns OK if the estimate was accepted, and REPEATED, which ignores it,
        if the round already has one of this sender. Returns ERR_SENDER or ERR_X_HAT, and counts the message
        as rejected, if ``sender`` or ``x_hat`` is out of range. Raises ValueError, and changes nothing, for
        an ``alpha`` that does not fit 32 bits.
        """
        if not 0 <= alpha <= MAX_WORD:
            raise ValueError(f"alpha is {alpha}; the firmware's word has 32 bits")
        # Integers of NumPy would overflow in the sums, so they become Python's.
        return self._receive(operator.index(sender), operator.index(x_hat), operator.index(alpha))

    def receive_all(self, messages: NDArray[np.uint32]) -> int:
        """Add messages to the open round, in order, and return how many of them were accepted.

        A row of the array is a message, with the columns sender, x_hat and alpha as ``receive_raw`` takes
        them. Repeated messages are ignored, and invalid ones rejected and counted. Raises ValueError, and
        changes nothing, for an array that is not C-contiguous, of uint32 and of shape (messages, 3).
        """
        has_three_columns = messages.shape[1:] == (3,)  # for two axes, the second of length 3
        if messages.dtype != "uint32" or not has_three_columns or not messages.flags.c_contiguous:
            raise ValueError(
                f"messages are an array of {messages.dtype} of shape {messages.shape}; "
                "give a C-contiguous one of uint32 of shape (messages, 3)"
            )
        return self._receive_all(messages)

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Add a neighbour's estimate to the open round: what was received since the last ``settle``.

        The firmware's numbers are coarser than floats, so x_hat and alpha are rounded down. Returns OK if the
        estimate was accepted, and REPEATED, which ignores it, if the round already has one of this sender.
        Raises FirmwareError, and counts the message as rejected, if ``sender`` is not in 0 .. 127 or is the
        robot's own id (ERR_SENDER), or if ``x_hat`` is not in [0, 1] (ERR_X_HAT). Raises ValueError, and
        changes nothing, for an ``alpha`` that is no confidence: negative (also -0.0), infinite or NaN.
        """
        status = self.receive_raw(sender, x_hat_to_raw(x_hat), alpha_word_from_float(alpha))
        if status in (Status.ERR_SENDER, Status.ERR_X_HAT):
            raise create_rejection(status, sender, x_hat)
        return status

    def __repr__(self) -> str:
        """Return class, id, observations and estimates in one line."""
        return describe_robot(self)

    @property
    def b_hat(self) -> float:
        """Accuracy that this robot assumes of its sensor, in [2**-20, 1 - 2**-20]."""
        return self.b_hat_raw / 2**32

    @property
    def x_hat(self) -> float:
        """Local estimate of the share of black tiles (eq. 3), in [0, 1]."""
        return self.x_hat_raw / ONE

    @property
    def alpha(self) -> float:
        """Confidence of the local estimate x_hat (eq. 4), >= 0."""
        return alpha_from_word(self.alpha_raw)

    @property
    def x_bar(self) -> float:
        """Social estimate: mean of the last closed round's x_hat, weighted by alpha (eq. 5)."""
        return self.x_bar_raw / ONE

    @property
    def beta(self) -> float:
        """Social confidence: sum of the last closed round's alpha (eq. 6), rounded to float64."""
        return self.beta_raw / UNITS_PER_ALPHA

    @property
    def x(self) -> float:
        """Informed estimate: mean of x_hat and x_bar, weighted by alpha and beta (eq. 7)."""
        return self.x_raw / ONE
