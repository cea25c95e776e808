"""Length of frames on a real bus, at worst: against frames put together bit by bit."""

from __future__ import annotations

import can
import pytest

from mcp_asdf_tools.bus.load import bus_load, worst_case_bits


def stuffed(bits: str) -> str:
    """Bits of ISO 11898-1 on the wire: after five alike one of the other value, which begins a new run."""
    wire = ""
    for bit in bits:
        wire += bit
        if len(wire) >= 5 and len(set(wire[-5:])) == 1:
            wire += "10"[int(bit)]
    return wire


@pytest.mark.parametrize("is_extended", [True, False])
@pytest.mark.parametrize("length", range(9))
def test_a_frame_is_as_long_as_the_most_stuffed_one(is_extended: bool, length: int) -> None:
    """Start, identifier, flags, data and checksum are stuffed; 13 bits after them are not."""
    plain = (1 + 32 + 6 if is_extended else 1 + 12 + 6) + 8 * length + 15
    most = "0" * 5 + "".join(("1111", "0000")[place % 2] for place in range(40))
    frame = can.Message(arbitration_id=1, is_extended_id=is_extended, data=bytes(length))
    assert worst_case_bits(frame) == len(stuffed(most[:plain])) + 13


def test_an_error_frame_and_the_load() -> None:
    """An error frame is two flags, a delimiter and the gap; the load is a share of the time."""
    assert worst_case_bits(can.Message(is_error_frame=True, dlc=8, data=bytes(8))) == 12 + 8 + 3
    assert bus_load(160 * 250, 2.0, 500_000) == 0.04
