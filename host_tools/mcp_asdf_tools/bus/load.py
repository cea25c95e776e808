"""The load that frames put on a real CAN bus, in the worst case."""

from __future__ import annotations

import can

BIT_RATES = (125_000, 250_000, 500_000, 1_000_000)
"""Usual rates of classic CAN, bit/s."""

HIGH_LOAD = 0.7
"""Share of a bus's time above which frames of low priority wait long."""

_ERROR_FRAME_BITS = 12 + 8 + 3
"""An error frame at its longest: two superposed flags, the delimiter and the gap to the next frame."""

_UNSTUFFED_BITS = 1 + 2 + 7 + 3
"""Bits at the end of a frame that are never stuffed: the checksum's delimiter, the acknowledgement with its
own, the end of the frame and the gap to the next one."""

_HEADER_AND_CHECKSUM_BITS = 1 + 11 + 3 + 4 + 15
"""Bits of a frame with an 11-bit identifier from its start to the end of its checksum, without data: the
start, the identifier, three flags, the length and the checksum."""

_EXTENSION_BITS = 18 + 2
"""Bits more of a frame with a 29-bit identifier: 18 of the identifier, and two flags."""


def worst_case_bits(frame: can.Message) -> int:
    """Return how many bits a classic frame takes on the wire at most.

    CAN stuffs a bit after five equal ones. The stuffed bit counts towards the next five, so that in the worst
    case one is stuffed after every four. A frame of 8 bytes with a 29-bit identifier takes 160 bits at most
    and 137 on average, and any error frame 23 at most.
    """
    if frame.is_error_frame:
        return _ERROR_FRAME_BITS
    stuffable_bits = _HEADER_AND_CHECKSUM_BITS + 8 * len(frame.data)
    if frame.is_extended_id:
        stuffable_bits += _EXTENSION_BITS
    # After the first bit, one is stuffed after every four.
    stuffed_bits = (stuffable_bits - 1) // 4
    return stuffable_bits + stuffed_bits + _UNSTUFFED_BITS


def bus_load(bits: float, seconds: float, bit_rate: float) -> float:
    """Return the share of a bus's time that ``bits`` take in ``seconds``; above 1 they do not fit."""
    return bits / (seconds * bit_rate)
