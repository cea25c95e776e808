"""The longest time that frames may take on a real bus, against frames that are put together bit by bit."""

from __future__ import annotations

import can
import pytest

from mcp_asdf_tools.bus.load import bus_load, worst_case_bits

UNSTUFFED_BITS = 13
"""Bits at the end of a frame that are never stuffed."""


def stuff(bits: str) -> str:
    """Return bits as they are on the wire: behind five alike one of the other value, which begins a run."""
    wire = ""
    for bit in bits:
        wire += bit
        if len(wire) >= 5 and len(set(wire[-5:])) == 1:
            wire += "1" if bit == "0" else "0"
    return wire


MOST_STUFFED_BITS = "00000" + "11110000" * 20
"""Bits of which as many as possible are followed by a stuffed one: each of these begins a new run."""


@pytest.mark.parametrize("length", range(9))
def test_the_worst_length_of_a_frame_with_a_29_bit_identifier_has_the_most_stuffed_bits(length: int) -> None:
    """Behind five bits alike CAN sends one of the other value, so the length depends on the data.

    It does so in the start, the identifier with its flags, the length, the data and the checksum.
    """
    stuffable_bits = 1 + 32 + 6 + 8 * length + 15
    frame = can.Message(arbitration_id=1, data=bytes(length))
    assert worst_case_bits(frame) == len(stuff(MOST_STUFFED_BITS[:stuffable_bits])) + UNSTUFFED_BITS


@pytest.mark.parametrize("length", range(9))
def test_the_worst_length_of_a_frame_with_an_11_bit_identifier_has_the_most_stuffed_bits(length: int) -> None:
    """Behind five bits alike CAN sends one of the other value, so the length depends on the data.

    It does so in the start, the identifier with its flags, the length, the data and the checksum.
    """
    stuffable_bits = 1 + 12 + 6 + 8 * length + 15
    frame = can.Message(arbitration_id=1, is_extended_id=False, data=bytes(length))
    assert worst_case_bits(frame) == len(stuff(MOST_STUFFED_BITS[:stuffable_bits])) + UNSTUFFED_BITS


def test_a_frame_of_a_robot_takes_160_bits_at_most() -> None:
    assert worst_case_bits(can.Message(arbitration_id=0x106BB82A, data=bytes(8))) == 160


def test_an_error_frame_is_two_flags_a_delimiter_and_the_gap() -> None:
    error_frame = can.Message(is_error_frame=True, dlc=8, data=bytes(8))
    flags, delimiter, gap = 12, 8, 3
    assert worst_case_bits(error_frame) == flags + delimiter + gap


def test_the_load_of_a_bus_is_the_share_of_its_time_that_the_bits_take() -> None:
    assert bus_load(160 * 250, seconds=2.0, bit_rate=500_000) == 0.04
