"""Strict decoder of the datagrams with which python-can's udp_multicast sends frames.

A datagram is a msgpack map from the names of a frame's fields to their values. Anybody in the network can
send one, and python-can hands it to a general decoder, and allocates as many bytes as an integer in the place
of the data says. This decoder reads the one map that python-can writes, field by field in its order, and
nothing else. ``multicast_unpack()`` in ``c_ref/ports/linux`` accepts and refuses the same datagrams.
"""

from __future__ import annotations

from functools import cache

import can

LONGEST_DATAGRAM = 400
"""Bytes; a longer datagram is refused unread. python-can's have at most 164, and the name of a channel."""

_MAX_DATA_BYTES = 8
_LARGEST_IDENTIFIER = {False: 0x7FF, True: 0x1FFF_FFFF}
"""By whether the identifier is an extended one."""

# Bytes of msgpack that begin a value. Those "with size" are followed by the number of bytes, in one byte.
_MAP_WITH_11_FIELDS = b"\x8b"
_NIL, _FALSE, _TRUE = 0xC0, 0xC2, 0xC3
_BYTES_WITH_SIZE = b"\xc4"
_TEXT_WITH_SIZE = 0xD9
_SHORT_TEXT, _SHORT_TEXT_MAX = 0xA0, 0xBF
"""The lower 5 bits of such a byte are the length of the text."""
_SHORT_NUMBER_MAX = 0x7F
"""A byte up to this is a number itself."""
_NUMBER_SIZES = {0xCC: 1, 0xCD: 2, 0xCE: 4}
"""Bytes of the unsigned number that follows."""
_FLOAT_SIZES = {0xCA: 4, 0xCB: 8}
"""Bytes of the floating-point number that follows."""


def unpack_data_frame(datagram: bytes) -> can.Message | None:
    """Return the classic data frame in ``datagram``, without its time and channel; None if it holds none.

    Error frames, remote frames and CAN FD frames are none, either. O(1). Any program in the network can send
    a datagram, so one that no frame needs is refused before a byte is read.
    """
    if len(datagram) > LONGEST_DATAGRAM:
        return None
    try:
        return _read_data_frame(_Reader(datagram))
    except _MalformedError:
        return None


def _read_data_frame(reader: _Reader) -> can.Message:
    """Read the fields of a msgpack map in python-can's order, and return the frame that they describe.

    Raises _MalformedError if a field is not as it should be, if the frame is no classic data frame, or if
    bytes are left behind the last field. The time and the channel are those of the sender and mean nothing
    here, so any scalars will do.
    """
    reader.skip_exactly(_MAP_WITH_11_FIELDS + _packed_name("timestamp"))
    reader.skip_scalar()
    reader.skip_exactly(_packed_name("arbitration_id"))
    identifier = reader.take_number()
    is_extended = reader.take_flag("is_extended_id")
    is_remote = reader.take_flag("is_remote_frame")
    is_error = reader.take_flag("is_error_frame")
    reader.skip_exactly(_packed_name("channel"))
    reader.skip_scalar()
    reader.skip_exactly(_packed_name("dlc"))
    length = reader.take_number()
    reader.skip_exactly(_packed_name("data") + _BYTES_WITH_SIZE)
    # The length is one byte, so that no datagram can ask for more than 255 bytes of memory.
    data_size = reader.take_byte()
    data = reader.take(data_size)
    is_fd = reader.take_flag("is_fd")
    has_bit_rate_switch = reader.take_flag("bitrate_switch")
    has_error_state = reader.take_flag("error_state_indicator")

    # The datagram has been read to its last field; only now its values are compared with each other.
    is_special = is_remote or is_error or is_fd or has_bit_rate_switch or has_error_state
    has_valid_length = length == len(data) and length <= _MAX_DATA_BYTES
    has_valid_identifier = identifier <= _LARGEST_IDENTIFIER[is_extended]
    is_valid = has_valid_length and has_valid_identifier and reader.is_at_end
    if is_special or not is_valid:
        raise _MalformedError
    return can.Message(arbitration_id=identifier, is_extended_id=is_extended, dlc=length, data=data)


@cache
def _packed_name(name: str) -> bytes:
    """Return a field's name, of less than 32 letters, as msgpack packs it, behind a byte with its length."""
    first_byte = _SHORT_TEXT | len(name)
    return bytes([first_byte]) + name.encode("ascii")


class _MalformedError(Exception):
    """The datagram is not what python-can writes."""


class _Reader:
    """Reader of a datagram from its first byte on; its methods raise _MalformedError if it ends too early."""

    def __init__(self, datagram: bytes) -> None:
        """Begin at the first byte."""
        self._datagram = datagram
        self._position = 0

    @property
    def is_at_end(self) -> bool:
        """True once the last byte has been read."""
        return self._position == len(self._datagram)

    def take(self, size: int) -> bytes:
        """Return the next ``size`` bytes, and go on behind them.

        Raises _MalformedError, and takes none, if fewer are left.
        """
        end = self._position + size
        if end > len(self._datagram):
            raise _MalformedError
        # Past the end a slice would be shorter in silence: the length has been checked above.
        next_bytes = self._datagram[self._position : end]
        self._position = end
        return next_bytes

    def take_byte(self) -> int:
        """Return the next byte."""
        return self.take(1)[0]

    def skip_exactly(self, expected: bytes) -> None:
        """Skip the next bytes. Raises _MalformedError if they are not ``expected``."""
        if self.take(len(expected)) != expected:
            raise _MalformedError

    def take_flag(self, name: str) -> bool:
        """Return the boolean value of the field ``name``, which comes next.

        Raises _MalformedError if another field comes next, or one that is not boolean.
        """
        self.skip_exactly(_packed_name(name))
        flag = self.take_byte()
        if flag not in (_FALSE, _TRUE):
            raise _MalformedError
        return flag == _TRUE

    def take_number(self) -> int:
        """Return the next value, a whole number from 0 to 2^32 - 1 in 1, 2, 3 or 5 bytes.

        Raises _MalformedError if it is something else.
        """
        first_byte = self.take_byte()
        return self._take_number_after(first_byte)

    def skip_scalar(self) -> None:
        """Skip the next value: nil, a number or a text of less than 256 bytes, which need not be UTF-8.

        Raises _MalformedError if it is something else.
        """
        first_byte = self.take_byte()
        if _SHORT_TEXT <= first_byte <= _SHORT_TEXT_MAX:
            # The length of a short text is in the lower 5 bits of its first byte.
            self.take(first_byte - _SHORT_TEXT)
        elif first_byte == _TEXT_WITH_SIZE:
            text_size = self.take_byte()
            self.take(text_size)
        elif first_byte in _FLOAT_SIZES:
            self.take(_FLOAT_SIZES[first_byte])
        elif first_byte != _NIL:
            # Whatever is left must be a whole number; a list or a map, for example, is refused there.
            self._take_number_after(first_byte)

    def _take_number_after(self, first_byte: int) -> int:
        """Return the whole number whose first byte has been read already.

        Raises _MalformedError if no whole number begins with this byte.
        """
        if first_byte <= _SHORT_NUMBER_MAX:
            return first_byte
        if first_byte not in _NUMBER_SIZES:
            raise _MalformedError
        number_bytes = self.take(_NUMBER_SIZES[first_byte])
        return int.from_bytes(number_bytes, "big")
