"""Lines that candump writes: to a log (``-L``, ``-l``) or to a console, with any of its time stamps."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import can

LONGEST_LINE = 4096
"""Characters; a CAN FD frame with all of candump's additions has a tenth of that."""

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_TIME = r"(?:\((?P<time>[^()]*)\)\s+)?"
_LOG_LINE = re.compile(
    rf"{_TIME}(?P<channel>\S+)\s+(?P<id>[0-9A-F]{{3}}|[0-9A-F]{{8}})#"
    r"(?:(?P<remote>R)(?P<remote_length>[0-8])?|#(?P<flags>[0-9A-F])(?P<fd_data>[0-9A-F.]*)|(?P<data>[0-9A-F.]*))"
    r"(?:_[9A-F])?(?:\s+(?P<direction>[RT]))?",
    re.IGNORECASE | re.ASCII,
)
_CONSOLE_LINE = re.compile(
    rf"{_TIME}(?P<channel>\S+)\s+(?:(?P<direction>[RT])X\s+(?P<flags>\S\s\S)\s+)?"
    r"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})\s+(?:\[(?P<length>[0-9]{1,2})\]|\{[9A-F]\})"
    r"(?:\s+(?P<remote>remote request)|(?P<data>(?:\s+[0-9A-F]{2})*))"
    r"(?:\s+(?:'.*'|ERRORFRAME))?",
    re.IGNORECASE | re.ASCII,
)
_ERROR_FLAG = 0x20000000
_BIT_RATE_SWITCH, _ERROR_STATE = 1, 2
_MAX_DATA_BYTES = {False: 8, True: 64}
"""Of a classic frame and of one of CAN FD."""


def parse_line(line: str) -> can.Message | None:
    """Return the frame of a line of candump, or None if the line is none.

    Its time is 0 if the line has none, and counts from 1970 in UTC if the line has a date. A raw length
    beyond 8 (``_B``) says nothing about the content, so it is dropped.
    """
    if len(line) > LONGEST_LINE:
        return None
    text = _COLOURS.sub("", line).strip()
    match = _LOG_LINE.fullmatch(text)
    if match is not None:
        return _frame_of_log_line(match)
    match = _CONSOLE_LINE.fullmatch(text)
    return None if match is None else _frame_of_console_line(match)


def _frame_of_log_line(match: re.Match[str]) -> can.Message | None:
    """Return the frame of a match of _LOG_LINE, such as ``vcan0 123#AB``; None as ``_frame``."""
    flags = None if match["flags"] is None else int(match["flags"], 16)
    data = match["data"] if flags is None else match["fd_data"]
    remote_length = None if match["remote"] is None else int(match["remote_length"] or 0)
    return _frame(match, flags, data or "", remote_length)


def _frame_of_console_line(match: re.Match[str]) -> can.Message | None:
    """Return the frame of a match of _CONSOLE_LINE, such as ``vcan0 123 [1] AB``.

    None as ``_frame``, and if the line has not as many bytes as it states.
    """
    # Two digits mark CAN FD. Its bit-rate switch and error state are told by -x only, as B and E.
    length_text = match["length"] or ""
    flags = None
    if len(length_text) == 2:
        flags = 0
        if "B" in (match["flags"] or ""):
            flags |= _BIT_RATE_SWITCH
        if "E" in (match["flags"] or ""):
            flags |= _ERROR_STATE
    data = "".join((match["data"] or "").split())
    if match["remote"] is not None:
        return _frame(match, None, "", int(length_text or 0))
    if length_text and int(length_text) != len(data) // 2:
        return None  # a line that was cut
    return _frame(match, flags, data, None)


def _frame(
    match: re.Match[str], fd_flags: int | None, data_text: str, remote_length: int | None
) -> can.Message | None:
    """Return the frame of a matched line; None if its data, its time or its id is none.

    ``fd_flags`` is None for a classic frame, ``remote_length`` for one that is no remote frame.
    """
    timestamp = _seconds(match["time"])
    arbitration_id = int(match["id"], 16)
    is_extended_id = len(match["id"]) == 8
    is_fd = fd_flags is not None
    digits = data_text.replace(".", "")
    if timestamp is None or len(digits) % 2 or len(digits) // 2 > _MAX_DATA_BYTES[is_fd]:
        return None
    if is_extended_id and arbitration_id & _ERROR_FLAG:
        return can.Message(timestamp=timestamp, channel=match["channel"], is_error_frame=True)
    if arbitration_id >= (2**29 if is_extended_id else 2**11):
        return None
    return can.Message(
        timestamp=timestamp,
        channel=match["channel"],
        arbitration_id=arbitration_id,
        is_extended_id=is_extended_id,
        is_remote_frame=remote_length is not None,
        dlc=len(digits) // 2 if remote_length is None else remote_length,
        data=bytes.fromhex(digits),
        is_fd=is_fd,
        bitrate_switch=bool((fd_flags or 0) & _BIT_RATE_SWITCH),
        error_state_indicator=bool((fd_flags or 0) & _ERROR_STATE),
        is_rx=(match["direction"] or "R").upper() == "R",
    )


def _seconds(text: str | None) -> float | None:
    """Return a time stamp in seconds, 0 where there is none; None if it is neither a number nor a date."""
    if text is None:
        return 0.0
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text.strip()).replace(tzinfo=UTC).timestamp()
    except (ValueError, OverflowError):
        return None
