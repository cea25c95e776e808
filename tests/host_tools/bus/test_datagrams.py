"""Datagrams of a multicast group: one classic data frame each, or nothing, in little memory."""

from __future__ import annotations

import os
import random
import tracemalloc
from pathlib import Path

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message

from datagrams import odd_datagrams, packed
from mcp_asdf_tools.bus.datagrams import LONGEST_DATAGRAM, unpack_data_frame


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0x106BB82A, data=b"\0\0\x40\0\0\x80\x3f\xe0", timestamp=1.8e9),
        can.Message(arbitration_id=0x7FF, is_extended_id=False, channel="can0"),
        can.Message(arbitration_id=5, is_extended_id=False, data=b"1", channel=3, timestamp=300),
    ],
)
def test_what_python_can_packs_is_unpacked(frame: can.Message) -> None:
    unpacked = unpack_data_frame(pack_message(frame))
    assert unpacked is not None
    assert unpacked.equals(frame, timestamp_delta=None, check_channel=False)


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame", "is_fd"])
def test_only_classic_data_frames_are_unpacked(kind: str) -> None:
    frame = can.Message(arbitration_id=5, **{kind: True})
    assert unpack_data_frame(pack_message(frame)) is None


def test_a_datagram_with_a_number_as_its_data_does_not_fill_the_memory() -> None:
    """Python makes a buffer of as many zeros of a number, so these 159 bytes could fill a memory."""
    datagram = packed(data=2**30)
    assert len(datagram) == 159
    tracemalloc.start()
    try:
        assert unpack_data_frame(datagram) is None
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak < 10_000


def test_a_datagram_of_more_than_400_bytes_is_refused() -> None:
    """The name of a channel fills the datagrams up to 400 and 401 bytes.

    A name of more than 31 bytes takes two bytes besides its own; the field without a name takes one.
    """
    further_bytes_of_a_name = 2 - 1
    longest_name = LONGEST_DATAGRAM - len(packed()) - further_bytes_of_a_name
    longest, too_long = packed(channel="c" * longest_name), packed(channel="c" * (longest_name + 1))

    assert [len(longest), len(too_long)] == [400, 401]
    assert unpack_data_frame(longest) is not None
    assert unpack_data_frame(too_long) is None


def test_most_odd_datagrams_are_refused() -> None:
    datagrams = odd_datagrams()
    refused = [datagram for datagram in datagrams if unpack_data_frame(datagram) is None]
    assert len(datagrams) > 800
    assert 700 < len(refused) < len(datagrams) - 50


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_garbage_leaves_the_memory_flat() -> None:
    draw, datagrams = random.Random(4), odd_datagrams()
    for datagram in datagrams:
        unpack_data_frame(datagram)
    before = resident_bytes()
    for _ in range(30_000):
        unpack_data_frame(draw.choice(datagrams))

    assert resident_bytes() - before < 4_000_000


def resident_bytes() -> int:
    """Return the memory of this process that is in use."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
