"""Datagrams of a multicast group: one classic data frame each, or nothing, in little memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence

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
        can.Message(arbitration_id=5, is_extended_id=False, channel=""),
    ],
)
def test_a_data_frame_that_python_can_packs_is_unpacked_as_it_was(frame: can.Message) -> None:
    """Python-can packs a frame into a datagram of msgpack; ours is unpacked by our own code."""
    unpacked = unpack_data_frame(pack_message(frame))
    assert unpacked is not None
    assert unpacked.equals(frame, timestamp_delta=None, check_channel=False)


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame", "is_fd"])
def test_a_remote_frame_an_error_frame_and_a_frame_of_can_fd_are_refused(kind: str) -> None:
    """Robots send classic data frames alone, so only these are unpacked."""
    frame = can.Message(arbitration_id=5, **{kind: True})
    assert unpack_data_frame(pack_message(frame)) is None


def test_a_datagram_with_a_number_as_its_data_does_not_fill_the_memory() -> None:
    """A short datagram has 2**30 in place of data; ``bytes`` would make 1 GiB of zeros of that number."""
    datagram = packed(data=2**30)
    tracemalloc.start()
    try:
        assert unpack_data_frame(datagram) is None
        _, peak_in_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak_in_bytes < 10_000


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
    """Some 850 datagrams have a field of another type, size or order. Only a few of them are legal frames."""
    datagrams = odd_datagrams()
    refused = [datagram for datagram in datagrams if unpack_data_frame(datagram) is None]
    assert len(datagrams) > 800
    assert 700 < len(refused) < len(datagrams) - 50


def test_odd_datagrams_leave_nothing_in_memory() -> None:
    """A hostile program could send them without end. Some are unpacked before, so that caches are filled."""
    datagrams = odd_datagrams()
    tracemalloc.start()
    try:
        unpack_all(datagrams)
        bytes_before, _ = tracemalloc.get_traced_memory()
        unpack_all(datagrams)
        bytes_after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    byte_for_each_datagram = len(datagrams)
    assert bytes_after - bytes_before < byte_for_each_datagram


def unpack_all(datagrams: Sequence[bytes]) -> None:
    """Unpack datagrams, and forget the frames."""
    for datagram in datagrams:
        unpack_data_frame(datagram)
