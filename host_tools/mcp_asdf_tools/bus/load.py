"""Load of a real CAN bus, at worst."""

from __future__ import annotations

import can

BIT_RATES = (125_000, 250_000, 500_000, 1_000_000)
"""Usual rates of classic CAN, bit/s."""

LIMIT = 0.7
"""Share of a bus's time above which frames of low priority wait long."""

_ERROR_BITS = 23
"""An error frame at its longest, two superposed flags and the delimiter, with the gap to the next frame."""

_TRAILER = 13
"""Bits that are never stuffed: delimiters, acknowledgement, end of frame and the gap to the next."""


def worst_bits(frame: can.Message) -> int:
    """Bits of a classic frame on the wire at worst, when a bit is stuffed after each run of the others.

    A frame of 8 bytes with a 29-bit identifier takes 160; on average it is 137.
    """
    if frame.is_error_frame:
        return _ERROR_BITS
    stuffable = (54 if frame.is_extended_id else 34) + 8 * len(frame.data)
    return stuffable + (stuffable - 1) // 4 + _TRAILER


def bus_load(bits: float, seconds: float, bit_rate: float) -> float:
    """Share of a bus's time that ``bits`` take in ``seconds``; above 1 they do not fit."""
    return bits / (seconds * bit_rate)
