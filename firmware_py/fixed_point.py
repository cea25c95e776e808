"""The firmware's number formats, and the float view that both fixed-point robots share.

Units: x_hat, x_bar and x 2**-23; b_hat 2**-32; alpha is IEEE 754 binary32 bits on a grid of 2**-24.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from operator import index

from firmware_py.robot import MAX_ALPHA, Status, Sums, whole_number

ONE = 1 << 23
"""1.0 as x_hat, x_bar or x."""
HALF = 1 << 22
B_HAT_MIN, B_HAT_MAX = 1 << 12, (1 << 32) - (1 << 12)
ALPHA_MAX = 0x4EFFFFFF
"""Bits of the largest confidence, 2**31 - 2**7."""
ALPHA_INFINITE, ALPHA_MINUS_INFINITE = 0x7F800000, 0xFF800000
UNITS_PER_ALPHA = 1 << 24


def b_hat_to_raw(b_hat: float) -> int:
    """An accuracy in [2**-20, 1 - 2**-20] in units of 2**-32, to nearest, ties to even."""
    return round(float(b_hat) * 2**32)


def x_hat_to_raw(x_hat: float) -> int:
    """An estimate in units of 2**-23, rounded down; outside [0, 1] a value that the firmware rejects."""
    return math.floor(float(x_hat) * ONE) if 0.0 <= x_hat <= 1.0 else 0xFFFFFFFF


def alpha_to_bits(alpha: float) -> int:
    """binary32 bits of the largest such number not above ``alpha``; sign, infinity and NaN are kept.

    Beyond MAX_ALPHA, however little, it is infinity: such a number cannot be sent.
    """
    if alpha > MAX_ALPHA or alpha < -MAX_ALPHA:
        return ALPHA_INFINITE if alpha > 0 else ALPHA_MINUS_INFINITE
    bits: int = struct.unpack("<I", struct.pack("<f", alpha))[0]
    return bits - 1 if bits < ALPHA_INFINITE and bits_to_alpha(bits) > alpha else bits


def bits_to_alpha(bits: int) -> float:
    """The value of binary32 bits, exactly."""
    return float(struct.unpack("<f", struct.pack("<I", bits))[0])


class FixedPointView(ABC):
    """Floats in and out of a robot that computes in integers. Every value but ``beta`` is exact.

    What reaches the robot's own methods, ``_receive`` and ``_add_round``, are Python's integers.
    """

    @property
    @abstractmethod
    def b_hat_raw(self) -> int:
        """b_hat in units of 2**-32."""

    @property
    @abstractmethod
    def x_hat_raw(self) -> int:
        """x_hat in units of 2**-23."""

    @property
    @abstractmethod
    def alpha_raw(self) -> int:
        """alpha as binary32 bits."""

    @property
    @abstractmethod
    def x_bar_raw(self) -> int:
        """x_bar in units of 2**-23."""

    @property
    @abstractmethod
    def beta_raw(self) -> int:
        """beta in units of 2**-24."""

    @property
    @abstractmethod
    def x_raw(self) -> int:
        """x in units of 2**-23."""

    @abstractmethod
    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """``receive_raw``, given integers of Python's own."""

    @abstractmethod
    def _add_round(self, sums: Sums, messages: int) -> Status:
        """``add_round``, given integers of Python's own."""

    def receive_raw(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Take a neighbour's message into the open round; x_hat in 2**-23, alpha as binary32 bits."""
        match sender, x_hat, alpha:
            case int(), int(), int():  # as a rule, and quicker than asking one by one
                return self._receive(sender, x_hat, alpha)
        return self._receive(index(sender), index(x_hat), index(alpha))

    def add_round(self, sums: Sums, messages: int) -> Status:
        """Add the exact sums of ``messages`` messages at once to the open round."""
        whole = {name: whole_number(value) for name, value in vars(sums).items()}
        return self._add_round(Sums(**whole), whole_number(messages))

    def receive(self, sender: int, x_hat: float, alpha: float) -> Status:
        """Take a neighbour's message; values off the firmware's grids are rounded down."""
        return self.receive_raw(sender, x_hat_to_raw(x_hat), alpha_to_bits(alpha))

    @property
    def b_hat(self) -> float:
        """Assumed accuracy."""
        return self.b_hat_raw / 2**32

    @property
    def x_hat(self) -> float:
        """Local estimate (eq. 3)."""
        return self.x_hat_raw / ONE

    @property
    def alpha(self) -> float:
        """Local confidence (eq. 4)."""
        return bits_to_alpha(self.alpha_raw)

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
