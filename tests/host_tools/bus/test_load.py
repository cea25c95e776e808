"""The longest time that frames may take on a real bus, against frames that are put together bit by bit."""

from __future__ import annotations

import can
import pytest

from mcp_asdf_tools.bus.load import bus_load, worst_case_bits


def insert_stuffed_bits(bits: str) -> str:
    """Return bits as on the wire: after five equal bits comes a bit of the other value. It begins a run."""
    wire = ""
    for bit in bits:
        wire += bit
        if len(wire) >= 5 and len(set(wire[-5:])) == 1:
            wire += "1" if bit == "0" else "0"
    return wire


@pytest.mark.parametrize("is_extended_id", [False, True])
@pytest.mark.parametrize("length", range(9))
def test_the_worst_length_of_a_frame_is_that_with_the_most_stuffed_bits(
    length: int, is_extended_id: bool
) -> None:
    """After five equal bits CAN sends a bit of the other value, so the length depends on the data.

    An identifier has 29 bits and three flags, or 11 bits and one flag.
    """
    frame = can.Message(arbitration_id=1, is_extended_id=is_extended_id, data=bytes(length))
    identifier = 29 + 3 if is_extended_id else 11 + 1
    start, length_field, checksum = 1, 6, 15  # in bits
    stuffable_bits = start + identifier + length_field + 8 * length + checksum

    # A stuffed bit begins the next run: with the four equal bits behind it, it makes five again.
    worst_bits = ("00000" + "11110000" * 20)[:stuffable_bits]
    bits_on_the_wire = insert_stuffed_bits(worst_bits)
    acknowledgement, end, gap = 3, 7, 3  # which are never stuffed
    assert worst_case_bits(frame) == len(bits_on_the_wire) + acknowledgement + end + gap


def test_a_frame_of_a_robot_takes_160_bits_at_most() -> None:
    """It has an identifier of 29 bits and 8 bytes of data. Up to 29 bits are stuffed into the first 118."""
    stuffable_bits, stuffed_bits, other_bits = 118, 29, 13
    assert stuffable_bits + stuffed_bits + other_bits == 160
    assert worst_case_bits(can.Message(arbitration_id=0x106BB82A, data=bytes(8))) == 160


def test_an_error_frame_is_two_flags_a_delimiter_and_the_gap() -> None:
    """These have 12, 8 and 3 bits. The data, in which python-can describes the error, are not on the bus."""
    error_frame = can.Message(is_error_frame=True, dlc=8, data=bytes(8))
    flags, delimiter, gap = 12, 8, 3
    assert worst_case_bits(error_frame) == flags + delimiter + gap


def test_the_load_of_a_bus_is_the_share_of_its_time_that_the_bits_take() -> None:
    """In two seconds 40,000 of the bus's 1,000,000 bits are of frames."""
    assert bus_load(40_000, seconds=2.0, bit_rate=500_000) == 0.04
