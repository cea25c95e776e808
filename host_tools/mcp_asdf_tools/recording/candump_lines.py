"""Parser of the lines that candump writes, with any of its time stamps.

A line of a log (``candump -L`` or ``-l``) is ``(1.5) vcan0 123#AB``, the same on a console
``(1.5)  vcan0  123   [1]  AB``.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime

import can

LONGEST_LINE = 4096
"""Maximum length of a line in characters. A CAN FD frame with all that candump adds has a tenth of that."""

_COLOUR_CODE = re.compile(r"\x1b\[[0-9;]*m")
_TIME = r"(?:\((?P<time>[^()]*)\)\s+)?"
_ID = r"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})"
_LOG_LINE = re.compile(
    rf"""
    {_TIME}
    (?P<channel>\S+)\s+
    {_ID}\#
    (?:
        (?P<remote>R)(?P<remote_length>[0-8])?              # a remote frame: 123#R5
        | (?P<fd>\#[0-9A-F])(?P<fd_data>[0-9A-F.]*)         # a frame of CAN FD, with flags: 123##1AB
        | (?P<data>[0-9A-F.]*)                              # a classic frame: 123#AB or 123#AB.CD
    )
    (?:_[9A-F])?                                            # a raw length beyond 8
    (?:\s+[RT])?                                            # received or sent
    """,
    re.VERBOSE | re.IGNORECASE | re.ASCII,
)
_CONSOLE_LINE = re.compile(
    rf"""
    {_TIME}
    (?P<channel>\S+)\s+
    (?:[RT]X\s+\S\s\S\s+)?                                  # only with candump -x: RX B E
    {_ID}\s+
    (?:\[(?P<length>[0-9]{{1,2}})\]|\{{[9A-F]\}})           # a length, or a raw length beyond 8
    (?:\s+(?P<remote>remote\ request)|(?P<data>(?:\s+[0-9A-F]{{2}})*))
    (?:\s+(?:'.*'|ERRORFRAME))?
    """,
    re.VERBOSE | re.IGNORECASE | re.ASCII,
)
_ERROR_FLAG = 0x20000000
"""Bit of the identifier that marks an error frame."""
_MAX_CLASSIC_BYTES = 8
_MAX_FD_BYTES = 64


def parse_line(line: str) -> can.Message | None:
    """Return the frame in a line of candump, or None if the line holds no complete and possible frame.

    The frame's time is 0 if the line has none, and counts from 1970 in UTC if the line has a date. Three
    things are ignored: the flags of a CAN FD frame, whether this computer has sent the frame, and a raw
    length beyond 8 (``_B``), since a frame with such a length has 8 bytes of data.
    """
    if len(line) > LONGEST_LINE:
        return None
    plain_line = _COLOUR_CODE.sub("", line).strip()
    log_match = _LOG_LINE.fullmatch(plain_line)
    if log_match is not None:
        return _frame_of_log_line(log_match)
    console_match = _CONSOLE_LINE.fullmatch(plain_line)
    if console_match is not None:
        return _frame_of_console_line(console_match)
    return None


def _frame_of_log_line(match: re.Match[str]) -> can.Message | None:
    """Return the frame in a line of a log, given its match of _LOG_LINE.

    Returns None if it has an impossible time, identifier or amount of data.
    """
    if match["remote"] is not None:
        return _make_frame(match, remote_length=int(match["remote_length"] or 0))
    if match["fd"] is not None:
        return _make_frame(match, match["fd_data"], is_fd=True)
    return _make_frame(match, match["data"])


def _frame_of_console_line(match: re.Match[str]) -> can.Message | None:
    """Return the frame in a line of a console, given its match of _CONSOLE_LINE.

    Returns None if it has an impossible time, identifier or amount of data, or other bytes of data than the
    length in the line says.
    """
    length_text = match["length"] or ""
    if match["remote"] is not None:
        # A remote frame asks for so many bytes, and has none itself.
        return _make_frame(match, remote_length=int(length_text or 0))
    hex_digits = "".join((match["data"] or "").split())
    byte_count = len(hex_digits) // 2
    if length_text and int(length_text) != byte_count:
        return None  # the line was cut
    is_fd = len(length_text) == 2  # candump writes [8] for a classic frame, [08] for one of CAN FD
    return _make_frame(match, hex_digits, is_fd)


def _make_frame(
    match: re.Match[str], data_text: str = "", is_fd: bool = False, remote_length: int | None = None
) -> can.Message | None:
    """Return the frame of a line, or None if it has an impossible time, identifier or amount of data.

    A frame whose identifier says that it is an error frame becomes one without data.

    Args:
        match: The groups time, channel and id of the line.
        data_text: Hexadecimal digits of the data; points between bytes are ignored.
        is_fd: Whether it is a frame of CAN FD.
        remote_length: Length that a remote frame asks for; None for any other frame.
    """
    timestamp = _parse_time(match["time"])
    data = _parse_data(data_text, max_bytes=_MAX_FD_BYTES if is_fd else _MAX_CLASSIC_BYTES)
    if timestamp is None or data is None:
        return None
    arbitration_id = int(match["id"], 16)
    is_extended_id = len(match["id"]) == 8  # candump writes the 11 bits of a standard one in 3 digits
    if is_extended_id and arbitration_id & _ERROR_FLAG:
        return can.Message(timestamp=timestamp, channel=match["channel"], is_error_frame=True)
    id_bits = 29 if is_extended_id else 11
    if arbitration_id.bit_length() > id_bits:
        return None
    return can.Message(
        timestamp=timestamp,
        channel=match["channel"],
        arbitration_id=arbitration_id,
        is_extended_id=is_extended_id,
        is_remote_frame=remote_length is not None,
        dlc=len(data) if remote_length is None else remote_length,
        data=data,
        is_fd=is_fd,
    )


def _parse_data(data_text: str, max_bytes: int) -> bytes | None:
    """Return the bytes in hexadecimal digits; None if there is half a byte or more than ``max_bytes``.

    Points between the digits are ignored.
    """
    hex_digits = data_text.replace(".", "")
    byte_count, left_over_digits = divmod(len(hex_digits), 2)
    if left_over_digits > 0 or byte_count > max_bytes:
        return None
    return bytes.fromhex(hex_digits)


def _parse_time(text: str | None) -> float | None:
    """Return a time stamp in seconds: 0 if there is none, None if it is neither a number nor a date.

    A date with its time of day is taken for UTC, even if it names another offset; candump writes none.
    """
    if text is None:
        return 0.0
    try:
        return float(text)
    except ValueError:
        pass  # it may be a date
    try:
        date_and_time = datetime.fromisoformat(text.strip())
        return date_and_time.replace(tzinfo=UTC).timestamp()
    except (ValueError, OverflowError):
        return None
