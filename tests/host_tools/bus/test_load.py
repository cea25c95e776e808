"""Lengths on the wire, against the standard's own words: bit by bit, slowly."""

from __future__ import annotations

import random

import can
import pytest

from mcp_asdf_tools.bus.frames import FrameFormat, Message, encode
from mcp_asdf_tools.bus.load import ERROR_BITS, bus_load, wire_bits

SEED = 20241029


def crc_register(bits: str) -> int:
    """Bosch's CAN 2.0 specification, section 3.1.1, as it stands there."""
    register = 0
    for bit in bits:
        next_bit = int(bit) ^ (register >> 14)
        register = (register << 1) & 0x7FFF
        if next_bit:
            register ^= 0x4599
    return register


def on_the_wire(frame: can.Message) -> str:
    """From the start bit to the gap, as a string of bits."""
    identifier, remote = frame.arbitration_id, "1" if frame.is_remote_frame else "0"
    if frame.is_extended_id:
        whole = f"{identifier:029b}"
        head = "0" + whole[:11] + "1" + "1" + whole[11:] + remote + "0" + "0"
    else:
        head = "0" + f"{identifier:011b}" + remote + "0" + "0"
    data = "" if frame.is_remote_frame else "".join(f"{byte:08b}" for byte in frame.data)
    content = head + f"{frame.dlc:04b}" + data
    content += f"{crc_register(content):015b}"
    assert crc_register(content) == 0  # what a receiver checks
    stuffed = ""
    for bit in content:
        stuffed += bit
        if stuffed[-5:] in ("00000", "11111"):
            stuffed += "10"[int(bit)]
    return stuffed + "1" + "11" + "1" * 7 + "1" * 3


def frames(number: int) -> list[can.Message]:
    """All kinds, with long runs in many of them."""
    chance = random.Random(SEED)
    found = []
    for _ in range(number):
        extended = chance.random() < 0.7
        identifier = chance.getrandbits(29 if extended else 11) & chance.choice([-1, chance.getrandbits(29)])
        data = bytes(chance.choice([0, 255, 0xF8, chance.randrange(256)]) for _ in range(chance.randrange(9)))
        remote = chance.random() < 0.1
        found.append(
            can.Message(
                arbitration_id=identifier,
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=len(data),
                data=None if remote else data,
            )
        )
    return found


def test_lengths_are_those_of_the_standard() -> None:
    tried = frames(2000)
    for frame, bits in zip(tried, wire_bits(tried).tolist(), strict=True):
        assert bits == len(on_the_wire(frame)), f"{frame} of seed {SEED}"


def test_no_frames_have_no_lengths() -> None:
    assert wire_bits([]).tolist() == []


def test_estimates_take_137_bits_on_average_and_never_more_than_160() -> None:
    """The figures of the design page."""
    chance = random.Random(SEED)
    lengths = wire_bits(
        [
            encode(
                Message(chance.randrange(126), chance.randrange(2**23), chance.randrange(0x7F800000), k % 32),
                FrameFormat(),
            )
            for k in range(5000)
        ]
    ).tolist()
    assert sum(lengths) / len(lengths) == pytest.approx(137, abs=1)
    assert 131 <= min(lengths) <= max(lengths) <= 160


def test_error_frames() -> None:
    (bits,) = wire_bits([can.Message(is_error_frame=True)])
    assert bits == ERROR_BITS == 6 + 6 + 8 + 3


def test_load() -> None:
    assert bus_load(125_000, 2.0, 125_000) == 0.5
