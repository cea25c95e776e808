"""Datagrams of a multicast group: one classic data frame each, or nothing, in little memory."""

from __future__ import annotations

import tracemalloc
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message

from datagrams import odd_datagrams, packed
from mcp_asdf_tools.bus.datagrams import unpack_data_frame


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
    """Python-can packs a frame into a datagram of msgpack, which our own code unpacks.

    Time and channel are not compared, as they are those of the sender and mean nothing to a receiver.
    """
    unpacked_frame = unpack_data_frame(pack_message(frame))
    assert unpacked_frame is not None
    assert unpacked_frame.equals(frame, timestamp_delta=None, check_channel=False)


@pytest.mark.parametrize("kind", ["is_remote_frame", "is_error_frame", "is_fd"])
def test_a_remote_frame_an_error_frame_and_a_frame_of_can_fd_are_refused(kind: str) -> None:
    """Robots send classic data frames alone, so only these are unpacked."""
    frame = can.Message(arbitration_id=5, **{kind: True})
    assert unpack_data_frame(pack_message(frame)) is None


def test_a_datagram_with_a_flag_as_its_identifier_is_refused() -> None:
    """To Python, True is the number 1, too."""
    assert unpack_data_frame(packed(arbitration_id=1)) is not None
    assert unpack_data_frame(packed(arbitration_id=True)) is None


def test_the_name_of_the_sender_s_channel_may_be_no_text() -> None:
    """It means nothing to a receiver. The byte 0xff is in no text in UTF-8."""
    assert unpack_data_frame(packed(channel="can0").replace(b"can0", b"can\xff")) is not None


@pytest.mark.parametrize("field", ["timestamp", "channel"])
@pytest.mark.parametrize("value", [True, b"can0", [0], {"a": 1}])
def test_a_datagram_whose_time_or_channel_is_neither_a_number_nor_a_text_is_refused(
    field: str, value: Any
) -> None:
    """No frame of python-can has such a time or channel, so somebody has made up the datagram."""
    assert unpack_data_frame(packed(**{field: value})) is None


def test_a_datagram_with_a_number_as_its_data_does_not_fill_the_memory() -> None:
    """A short datagram has 2**30 in place of data; ``bytes`` would make 1 GiB of zeros of that number.

    It is refused, and takes less than 10,000 bytes of memory meanwhile.
    """
    datagram = packed(data=2**30)
    tracemalloc.start()
    try:
        unpacked_frame = unpack_data_frame(datagram)
        _, peak_in_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert unpacked_frame is None
    assert peak_in_bytes < 10_000


def test_a_datagram_of_more_than_400_bytes_is_refused() -> None:
    """A long name of the channel, which means nothing to a receiver, fills them up to 400 and 401 bytes.

    Msgpack writes two bytes before so long a name, and one byte in place of no name.
    """
    datagram_without_name = packed(channel=None)
    bytes_of_all_but_the_name = len(datagram_without_name) - 1 + 2
    longest_name = "c" * (400 - bytes_of_all_but_the_name)
    datagram_of_400_bytes = packed(channel=longest_name)
    datagram_of_401_bytes = packed(channel=longest_name + "c")

    assert len(datagram_of_400_bytes) == 400
    assert unpack_data_frame(datagram_of_400_bytes) is not None
    assert len(datagram_of_401_bytes) == 401
    assert unpack_data_frame(datagram_of_401_bytes) is None


def test_most_odd_datagrams_are_refused() -> None:
    """Some 850 datagrams have a field of another type, size or order.

    More than 700 are refused, and more than 50 are legal frames nevertheless.
    """
    datagrams = odd_datagrams()
    is_refused = [unpack_data_frame(datagram) is None for datagram in datagrams]
    assert len(datagrams) > 800
    assert is_refused.count(True) > 700
    assert is_refused.count(False) > 50
