"""Length of frames on a real CAN bus, to the bit, and the load that they cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import can
import numpy as np
from numpy.typing import NDArray

BIT_RATES = (125_000, 250_000, 500_000, 1_000_000)
"""Usual rates of classic CAN, bit/s."""

LIMIT = 0.7
"""Share of a bus's time above which frames of low priority wait long."""

ERROR_BITS = 23
"""An error frame at its longest, two superposed flags and the delimiter, with the gap to the next frame."""

_TRAILER = 13
"""Bits after the checksum, never stuffed: its delimiter, two for acknowledgement, 7 for the end, 3 of gap."""

_CRC_BITS, _CRC_POLYNOMIAL = 15, 0x4599

_BITS = 120
"""Enough whole bytes for the longest frame up to its checksum, 118 bits."""
_ALTERNATING = int("01" * (_BITS // 2), 2)


def wire_bits(frames: Sequence[can.Message]) -> NDArray[np.int64]:
    """Bits of classic frames on the wire: with checksums, stuffed bits, and the gap after each.

    A frame of 8 bytes with a 29-bit identifier takes 131 and 0 to 29 stuffed ones. O(frames).
    """
    whole = [_content(frame) for frame in frames]
    lengths = np.array([length for _, length in whole], np.int64) + _CRC_BITS
    content = _bytes([bits for bits, _ in whole])
    checked = [bits << _CRC_BITS | crc for (bits, _), crc in zip(whole, _crcs(content).tolist(), strict=True)]
    # As if alternating bits had gone before, so that a run begins with the start bit, wherever bytes begin.
    padded = [_ALTERNATING >> n << n | bits for bits, n in zip(checked, lengths.tolist(), strict=True)]
    on_the_wire = lengths + _stuffed(_bytes(padded)) + _TRAILER
    return np.where([frame.is_error_frame for frame in frames], ERROR_BITS, on_the_wire)


def bus_load(bits: float, seconds: float, bit_rate: float) -> float:
    """Share of a bus's time that ``bits`` take in ``seconds``; above 1 they do not fit."""
    return bits / (seconds * bit_rate)


def _content(frame: can.Message) -> tuple[int, int]:
    """The bits under the checksum, as an integer, and their number: from the start bit (0) to the data."""
    identifier, remote = frame.arbitration_id, int(frame.is_remote_frame)
    if frame.is_extended_id:
        # Start, 11 bits, substitute remote and extended bits (1 1), 18 bits, remote, two reserved (0).
        head = (identifier >> 18 << 20 | 3 << 18 | identifier & 0x3FFFF) << 3 | remote << 2
        length = 35
    else:
        head = identifier << 3 | remote << 2
        length = 15
    head, length = head << 4 | frame.dlc, length + 4
    data = b"" if frame.is_remote_frame else bytes(frame.data)
    return head << 8 * len(data) | int.from_bytes(data, "big"), length + 8 * len(data)


def _bytes(numbers: Sequence[int]) -> NDArray[np.uint8]:
    """Integers of up to _BITS bits as bytes, the highest first, shape (bytes, numbers)."""
    whole = b"".join(number.to_bytes(_BITS // 8, "big") for number in numbers)
    return np.frombuffer(whole, np.uint8).reshape(-1, _BITS // 8).T


def _crcs(content: NDArray[np.uint8]) -> NDArray[np.int64]:
    """CAN's checksums. Leading zeros do not change them."""
    table, crc = _crc_table(), np.zeros(content.shape[1], np.int64)
    for byte in content:
        crc = (crc << 8 & 0x7FFF) ^ table[crc >> 7 ^ byte]
    return crc


def _stuffed(content: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Numbers of bits stuffed: one, of the other value, after five alike."""
    more, after = _stuffing_table()
    stuffed = state = np.zeros(content.shape[1], np.int64)
    for byte in content:
        place = state << 8 | byte
        stuffed, state = stuffed + more[place], after[place]
    return stuffed


@cache
def _crc_table() -> NDArray[np.int64]:
    return np.array([_shifted(byte << 7, 8, _CRC_POLYNOMIAL) for byte in range(256)])


def _shifted(register: int, steps: int, polynomial: int) -> int:
    for _ in range(steps):
        register <<= 1
        if register >> _CRC_BITS:
            register ^= 1 << _CRC_BITS | polynomial
    return register


@cache
def _stuffing_table() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each state and byte: bits stuffed into it, and the state after it, both of shape (16 * 256,).

    A state is the last bit on the wire, times 8, and the number of equal ones in a row, 1 .. 4; 0 at the
    start.
    """
    pairs = np.array([_through(state, byte) for state in range(16) for byte in range(256)])
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def _through(state: int, byte: int) -> tuple[int, int]:
    last, run = divmod(state, 8)
    stuffed = 0
    for bit in _bits_of(byte):
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed, last, run = stuffed + 1, 1 - bit, 1
    return stuffed, last << 3 | run


def _bits_of(byte: int) -> Iterator[int]:
    return (byte >> place & 1 for place in range(7, -1, -1))
