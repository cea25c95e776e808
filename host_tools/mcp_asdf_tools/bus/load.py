"""Length of frames on a real CAN bus, to the bit, and the load that they cause."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import can

BIT_RATES = (125_000, 250_000, 500_000, 1_000_000)
"""Usual rates of classic CAN, bit/s."""

LIMIT = 0.7
"""Share of a bus's time above which frames of low priority wait long."""

ERROR_BITS = 23
"""An error frame at its longest, two superposed flags and the delimiter, with the gap to the next frame."""

_TRAILER = 13
"""Bits after the checksum, never stuffed: its delimiter, two for acknowledgement, 7 for the end, 3 of gap."""

_CRC_BITS, _CRC_POLYNOMIAL = 15, 0x4599


def wire_bits(frame: can.Message) -> int:
    """Bits of a classic frame on the wire: with its checksum, the bits stuffed into it, and the gap after it.

    A frame of 8 bytes with a 29-bit identifier takes 131 and 0 to 29 stuffed ones. O(bytes).
    """
    if frame.is_error_frame:
        return ERROR_BITS
    content, length = _content(frame)
    protected = content << _CRC_BITS | _crc(content)
    length += _CRC_BITS
    return length + _stuffed(protected, length) + _TRAILER


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


def _crc(content: int) -> int:
    """CAN's checksum. Leading zeros do not change it, so whole bytes are enough."""
    table, crc = _crc_table(), 0
    for byte in content.to_bytes((content.bit_length() + 7) // 8, "big"):
        crc = (crc << 8 & 0x7FFF) ^ table[crc >> 7 ^ byte]
    return crc


def _stuffed(bits: int, length: int) -> int:
    """Number of bits stuffed into ``bits``: one, of the other value, after five alike."""
    table, stuffed = _stuffing_table(), 0
    # As if ones had gone before: the start bit is a 0, so a run begins with it, wherever whole bytes begin.
    padding = -length % 8
    padded = (_ALTERNATING[padding] << length | bits).to_bytes((length + padding) // 8, "big")
    state = 0
    for byte in padded:
        more, state = table[state << 8 | byte]
        stuffed += more
    return stuffed


_ALTERNATING = [int("01" * 4, 2) & (1 << bits) - 1 for bits in range(8)]
"""That many bits, ending with a 1 and without a run."""


@cache
def _crc_table() -> list[int]:
    return [_shifted(byte << 7, 8, _CRC_POLYNOMIAL) for byte in range(256)]


def _shifted(register: int, steps: int, polynomial: int) -> int:
    for _ in range(steps):
        register <<= 1
        if register >> _CRC_BITS:
            register ^= 1 << _CRC_BITS | polynomial
    return register


@cache
def _stuffing_table() -> list[tuple[int, int]]:
    """For each state and byte: bits stuffed into it, and the state after it.

    A state is the last bit on the wire, times 8, and the number of equal ones in a row, 1 .. 4; 0 at the
    start.
    """
    return [_through(state, byte) for state in range(16) for byte in range(256)]


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
