"""Reader of the frames in a log, in any format of candump or python-can, complete or cut off."""

from __future__ import annotations

import gzip
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.candump_lines import LONGEST_LINE, parse_line

_MAX_TIME = 1e11
"""Seconds, more than 3000 years. A frame with a later time is damaged or hostile."""
_TEXT_READERS: dict[str, Any] = {".asc": can.ASCReader, ".csv": can.CSVReader, ".trc": can.TRCReader}
_SUFFIXES = ".log (candump), .asc, .blf, .csv, .mf4 or .trc"
_LONGEST_QUOTE = 60
"""Characters of a line that an error message shows."""

PART_SUFFIX = ".part"
"""Suffix, behind all others, of a file that is not complete."""


def check_log(path: Path | str) -> None:
    """Raise UsageError if a log is missing, cannot be read or is empty.

    If it is missing but ``NAME.log.part`` is there, a run was cut off, and the message says so.
    """
    try:
        with Path(path).open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        part = Path(f"{path}{PART_SUFFIX}")
        hint = f"; its run was cut off, partial data is in {part}" if part.exists() else ""
        raise UsageError(f"cannot read the log {path}: {error.strerror}{hint}") from error
    if is_empty:
        raise UsageError(f"the log {path} is empty: the disk was full, or nothing was sent yet; run it again")


@dataclass
class LogSummary:
    """Counts of frames and of other lines in a log; complete when its last frame has been read.

    Attributes:
        channels: Number of frames by channel, in the order in which the channels appear. Frames of a format
            without channels are not counted.
        skipped_lines: Number of lines that are no frames.
        first_skipped: Number and text of the first such line; None if there is none.
    """

    channels: Counter[str] = field(default_factory=Counter)
    skipped_lines: int = 0
    first_skipped: str | None = None

    def skip_line(self, number: int, line: str) -> None:
        """Count a line that is no frame, and keep its number and text if it is the first one."""
        self.skipped_lines += 1
        if self.first_skipped is None:
            self.first_skipped = f"line {number}, {_quote(line)}"

    @property
    def channel_names(self) -> str:
        """The channels in words, such as ``vcan0 and vcan1``."""
        if not self.channels:
            return "no channel"
        *first_names, last_name = self.channels
        if not first_names:
            return last_name
        return f"{', '.join(first_names)} and {last_name}"

    @property
    def warning(self) -> str | None:
        """A sentence on how many lines were skipped, and which is the first; None if none was."""
        if self.first_skipped is None:
            return None
        # ``first_skipped`` is a text such as: line 3, 'words'
        if self.skipped_lines == 1:
            return f"{self.first_skipped}, is no frame and was left out"
        return (
            f"{self.skipped_lines} lines are no frames and were left out; the first is {self.first_skipped}"
        )


def read_log(
    path: Path | str, channel: str | None = None, summary: LogSummary | None = None
) -> Iterator[can.Message]:
    """Yield the frames of a log in its order: all of them, or those of one channel.

    The suffix gives the format, such as ``.log`` for candump's. Behind it ``.part`` may stand for a run that
    was cut off, and ``.gz`` for a compressed log. A run that was cut off yields its complete frames. In
    candump's format lines that are no frames are skipped, in all other formats they are errors.

    Args:
        path: The log.
        channel: Only frames of this channel are yielded; None stands for all channels.
        summary: Counts the frames of all channels and the skipped lines.

    Raises UsageError, naming the line if there are lines, if the log cannot be read, is malformed in a
    format other than candump's, or has no frame.
    """
    check_log(path)  # some readers of python-can would create a missing file
    if summary is None:
        summary = LogSummary()
    has_frame = False
    has_frame_of_channel = False
    for frame in _read_frames(Path(path), summary):
        has_frame = True
        if frame.channel is not None:
            summary.channels[str(frame.channel)] += 1
        if channel is None or str(frame.channel) == channel:
            has_frame_of_channel = True
            yield frame
    if not has_frame:
        first_line = f": {summary.first_skipped}, is none of candump's" if summary.first_skipped else ""
        raise UsageError(f"the log {path} holds no frame{first_line}; does its suffix match its format?")
    if not has_frame_of_channel:
        raise UsageError(
            f"the log {path} has no frame of {channel}, but of {summary.channel_names}; choose one of them"
        )


def _read_frames(path: Path, summary: LogSummary) -> Iterator[can.Message]:
    """Yield the frames of all channels in a log, whose suffix, as .log in run.log.part.gz, gives the format.

    In candump's format, ``.log``, lines that are no frames are skipped, and ``summary`` counts them. Raises
    UsageError if the log cannot be read, if its suffix is of no format, or if it is in another format than
    candump's and has a malformed frame.
    """
    format_suffix, is_cut_off = _parse_suffixes(path)
    try:
        if format_suffix == ".log":
            with _open_text(path) as lines:
                yield from _parse_candump_lines(lines, summary, is_cut_off)
        elif format_suffix in _TEXT_READERS:
            with _open_text(path) as lines:
                frames = _TEXT_READERS[format_suffix](lines)
                yield from _explain_errors(frames, path, lines)
        else:
            with _open_binary(path, format_suffix) as frames:
                yield from _explain_errors(frames, path)
    except OSError as error:
        raise UsageError(f"cannot read the log {path}: {error.strerror or error}") from error
    except (EOFError, zlib.error) as error:  # a compressed file was cut or is damaged
        raise UsageError(f"cannot read the log {path}: {error}") from error


def _parse_suffixes(path: Path) -> tuple[str, bool]:
    """Return the suffix that gives the format of a log, such as ".log", and whether its run was cut off.

    Of ``run.log.part.gz`` they are ".log" and True.
    """
    name = path.name.lower().removesuffix(".gz")
    is_cut_off = name.endswith(PART_SUFFIX)
    return Path(name.removesuffix(PART_SUFFIX)).suffix, is_cut_off


class _NumberedLines:
    """Iterator over the lines of a text file. Of a longer one it yields LONGEST_LINE + 1 characters.

    Attributes:
        number: Number of the line read last, from 1.
        line: The line read last, with its end if that was not cut.
    """

    def __init__(self, file: IO[str]) -> None:
        """Iterate over the lines of ``file`` from where it stands."""
        self._file = file
        self.number = 0
        self.line = ""

    def __iter__(self) -> _NumberedLines:
        """Return this object: it is its own iterator."""
        return self

    def __next__(self) -> str:
        """Return the next line, or its first LONGEST_LINE + 1 characters if it is longer."""
        self.line = self._file.readline(LONGEST_LINE + 1)
        if not self.line:
            raise StopIteration
        self.number += 1
        # The rest of a longer line is read in pieces: a line without an end must not fill the memory.
        piece = self.line
        while piece and not piece.endswith("\n"):
            piece = self._file.readline(LONGEST_LINE + 1)
        return self.line

    def close(self) -> None:
        """Close the file; readers of python-can do it when they have read all lines."""
        self._file.close()


@contextmanager
def _open_text(path: Path) -> Iterator[_NumberedLines]:
    """Context manager that opens a log of lines, which may be compressed or have a byte order mark.

    Bytes that are no UTF-8 become escapes, so any file can be read. Raises OSError if it cannot be opened.
    """
    is_compressed = path.suffix.lower() == ".gz"
    open_file: Callable[..., IO[str]] = gzip.open if is_compressed else open
    # This encoding is UTF-8, and skips a byte order mark.
    with open_file(path, "rt", encoding="utf-8-sig", errors="backslashreplace") as file:
        yield _NumberedLines(file)


def _open_binary(path: Path, format_suffix: str) -> Any:
    """Return python-can's reader of a binary log, which yields the frames and is a context manager.

    Raises UsageError if there is none for this suffix, if it needs a package that is not installed, or if the
    log does not begin as its format must; OSError if the log cannot be read.
    """
    if format_suffix == ".mf4" and find_spec("asammdf") is None:
        raise UsageError(
            f"to read {path} the package asammdf is needed, which is not installed; run: pip install asammdf "
            "(or convert the log where it is installed: can_logconvert FILE.mf4 FILE.log)"
        )
    try:
        return can.LogReader(path)
    except OSError:
        raise  # the caller explains it
    except Exception as error:  # readers raise errors of any kind
        raise UsageError(
            f"the log {path} cannot be opened, or its suffix is wrong: it must be {_SUFFIXES}"
        ) from error


def _parse_candump_lines(
    lines: _NumberedLines, summary: LogSummary, is_cut_off: bool
) -> Iterator[can.Message]:
    """Yield the frames in candump's lines, and count other lines that are not empty as skipped.

    If the run was cut off, a last line without a line break is ignored, since its frame may lack digits.
    """
    for line in lines:
        # A line that is too long has no line break either: it was cut when it was read.
        is_unfinished = not line.endswith("\n") and len(line) <= LONGEST_LINE
        if is_cut_off and is_unfinished:
            return
        frame = parse_line(line)
        if frame is not None and _has_possible_time(frame):
            yield frame
        elif line.strip():
            summary.skip_line(lines.number, line)


def _explain_errors(
    frames: Iterable[can.Message], path: Path, lines: _NumberedLines | None = None
) -> Iterator[can.Message]:
    """Yield the frames of a reader of python-can until one is malformed; that raises UsageError.

    The message names the line if the reader reads ``lines``, and the number of frames before it otherwise. An
    OSError of the reader passes unchanged.
    """
    frame_count = 0
    try:
        for frame in frames:
            if not _has_possible_time(frame):
                raise ValueError(f"its time is {frame.timestamp:g} s")  # which is caught below
            frame_count += 1
            yield frame
    except OSError:
        raise  # the caller explains it
    except Exception as error:  # readers raise errors of any kind
        position = f"after frame {frame_count}"
        if lines is not None:
            position = f"in line {lines.number}, {_quote(lines.line)}"
        raise UsageError(
            f"the log {path} is malformed {position}, or its suffix is wrong: it must be {_SUFFIXES}"
        ) from error


def _has_possible_time(frame: can.Message) -> bool:
    """Return whether a frame's time is a number of at most _MAX_TIME seconds, before or after 0."""
    return abs(frame.timestamp) < _MAX_TIME  # false for NaN, too


def _quote(line: str) -> str:
    """Return a line in quotes; a long one is cut after _LONGEST_QUOTE characters, and dots follow."""
    text = line.strip()
    if len(text) > _LONGEST_QUOTE:
        text = f"{text[:_LONGEST_QUOTE]}..."
    return repr(text)
