"""Strict decoder of the datagrams with which python-can's udp_multicast sends frames.

A datagram is a msgpack map from the names of a frame's fields to their values. Anybody in the network can
send one, and python-can makes a frame of whatever it holds: of an integer in the place of the data it would
make as many bytes. This decoder looks at the names and types of all fields before it makes a frame.
"""

from __future__ import annotations

import can
import msgpack  # type: ignore[import-untyped]

LONGEST_DATAGRAM = 400
"""Bytes; a longer datagram is refused unread. python-can's have at most 164, and the name of a channel."""

_TYPE_BY_FIELD = {"arbitration_id": int, "is_extended_id": bool, "dlc": int, "data": bytes}
"""Types of the fields that make a data frame."""
_FLAGS_OF_OTHER_FRAMES = (
    *("is_remote_frame", "is_error_frame", "is_fd"),
    *("bitrate_switch", "error_state_indicator"),
)
"""Fields that are true in frames that are no classic data frame."""
_IGNORED_FIELDS = ("timestamp", "channel")
"""Fields that are those of the sender, and mean nothing to a receiver."""
_TYPES_OF_IGNORED_FIELDS = (int, float, str, type(None))
"""Types of a time, which is a number, and of a channel, which is a name, a number or nothing.

Either field may have any of them, as the decoder in C does not tell them apart."""
_FIELDS = {*_TYPE_BY_FIELD, *_FLAGS_OF_OTHER_FRAMES, *_IGNORED_FIELDS}


def unpack_data_frame(datagram: bytes) -> can.Message | None:
    """Return the classic data frame in ``datagram``, without its time and channel; None if it holds none.

    Error frames, remote frames and CAN FD frames are none, either. Any program in the network can send a
    datagram, so one that no frame needs is refused before a byte is read.
    """
    if len(datagram) > LONGEST_DATAGRAM:
        return None
    try:
        # The name of a channel is not read, so it need not be UTF-8.
        fields = msgpack.unpackb(datagram, unicode_errors="replace")
        if not _are_fields_of_data_frame(fields):
            return None
        values = {name: fields[name] for name in _TYPE_BY_FIELD}
        # python-can raises ValueError for an identifier or a length out of range.
        return can.Message(**values, check=True)
    except (ValueError, msgpack.UnpackException):
        return None


def _are_fields_of_data_frame(fields: object) -> bool:
    """Return whether an unpacked datagram is a map of all fields, with the types of a classic data frame."""
    if not isinstance(fields, dict) or fields.keys() != _FIELDS:
        return False
    # Types are compared, not asked for by isinstance(), for which a flag is an integer, too.
    for name, kind in _TYPE_BY_FIELD.items():
        if type(fields[name]) is not kind:
            return False
    # Nobody reads these, but a datagram with another type in them is none of python-can's.
    for name in _IGNORED_FIELDS:
        if type(fields[name]) not in _TYPES_OF_IGNORED_FIELDS:
            return False
    return all(fields[name] is False for name in _FLAGS_OF_OTHER_FRAMES)
