"""Logs of frames: complete ones in any of python-can's formats, and parts that a run left."""

from __future__ import annotations

import argparse
import gzip
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.candump_lines import LONGEST_LINE, parse_line

_LATEST = 1e11
"""Seconds; the times of frames are below. No number is no time, either."""
_TEXT_READERS: dict[str, Any] = {".asc": can.ASCReader, ".csv": can.CSVReader, ".trc": can.TRCReader}
_SUFFIXES = ".log (candump), .asc, .blf, .csv, .mf4 or .trc"
_LONGEST_QUOTE = 60

PART = ".part"
"""Suffix, behind all others, of a file that is not complete."""


def add_log_option(output: argparse._ArgumentGroup, beside: str) -> None:
    """Declare ``--log``; ``beside`` names the contents of the files beside the log."""
    text = f"keep all frames as candump does, in a file that ends in .log; {beside}"
    output.add_argument("--log", metavar="FILE", type=Path, help=text)


def check_log(path: Path | str) -> None:
    """Raise UsageError if a log is missing, cannot be read or is empty.

    The message names the log's part, ``NAME.log.part``, if there is one: then the run was cut off.
    """
    try:
        with Path(path).open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        part = Path(f"{path}{PART}")
        hint = f"; its run was cut off, partial data is in {part}" if part.exists() else ""
        raise UsageError(f"cannot read the log {path}: {error.strerror}{hint}") from error
    if is_empty:
        raise UsageError(f"the log {path} is empty: the disk was full, or nothing was sent yet; run it again")


@dataclass
class LogSummary:
    """What was met while a log was read, complete once its last frame is read.

    Attributes:
        channels: Number of frames by channel, in the order in which the channels come; without those frames
            whose format names none.
        skipped_lines: Number of lines that were left out since they are no frames.
        first_skipped: Number and text of the first such line; None if there is none.
    """

    channels: Counter[str] = field(default_factory=Counter)
    skipped_lines: int = 0
    first_skipped: str | None = None

    def skip_line(self, number: int, text: str) -> None:
        """Count a line that is no frame."""
        self.skipped_lines += 1
        if self.first_skipped is None:
            self.first_skipped = f"line {number}, {_quote(text)}"

    @property
    def channel_names(self) -> str:
        """The channels in words, such as ``vcan0 and vcan1``."""
        *first_names, last_name = self.channels or ["no channel"]
        return f"{', '.join(first_names)} and {last_name}" if first_names else last_name

    @property
    def warning(self) -> str | None:
        """How many lines were left out, and which is the first; None if all are frames."""
        if self.first_skipped is None:
            return None
        if self.skipped_lines == 1:
            return f"{self.first_skipped}, is no frame and was left out"
        return (
            f"{self.skipped_lines} lines are no frames and were left out; the first is {self.first_skipped}"
        )


def read_log(
    path: Path | str, channel: str | None = None, summary: LogSummary | None = None
) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order: all, or those of one channel. The suffix gives the format.

    Lines of candump that are no frames are left out. ``summary`` counts them, and the frames of each channel.
    Of a part (``NAME.log.part``) it reads the frames that are complete. Raises UsageError, naming the place,
    if the log cannot be read, is malformed in another format, or holds no frame.
    """
    check_log(path)  # some readers would create a missing file
    summary = LogSummary() if summary is None else summary
    frame_count = yielded_count = 0
    for frame in _read_frames(Path(path), summary):
        frame_count += 1
        if frame.channel is not None:
            summary.channels[str(frame.channel)] += 1
        if channel is None or str(frame.channel) == channel:
            yielded_count += 1
            yield frame
    if not frame_count:
        first_line = f": {summary.first_skipped}, is none of candump's" if summary.first_skipped else ""
        raise UsageError(f"the log {path} holds no frame{first_line}; does its suffix match its format?")
    if not yielded_count:
        raise UsageError(
            f"the log {path} has no frame of {channel}, but of {summary.channel_names}; choose one of them"
        )


def _read_frames(path: Path, summary: LogSummary) -> Iterator[can.Message]:
    """Yield all frames of a log; lines of candump that are none go to ``summary``.

    Raises UsageError if the log cannot be read or is malformed.
    """
    name = path.name.lower().removesuffix(".gz")
    suffix = Path(name.removesuffix(PART)).suffix
    try:
        if suffix == ".log":
            with _open_text(path) as lines:
                yield from _read_candump(lines, summary, is_part=name.endswith(PART))
        elif suffix in _TEXT_READERS:
            with _open_text(path) as lines:
                yield from _checked(_TEXT_READERS[suffix](lines), path, lines)
        else:
            with _open_binary(path, suffix) as reader:
                yield from _checked(reader, path)
    except (
        OSError,
        EOFError,
        zlib.error,
    ) as error:  # the last two: a compressed file that was cut or damaged
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"cannot read the log {path}: {reason}") from error


class _CountedLines:
    """Iterator over the lines of a text file, each cut at LONGEST_LINE.

    Attributes:
        number: Number of the latest line, from 1.
        text: The latest line, with its end.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self.number = 0
        self.text = ""

    def __iter__(self) -> _CountedLines:
        return self

    def __next__(self) -> str:
        self.text = self._file.readline(LONGEST_LINE + 1)
        if not self.text:
            raise StopIteration
        self.number += 1
        rest = self.text
        while rest and not rest.endswith("\n"):  # a line without an end must not fill the memory
            rest = self._file.readline(LONGEST_LINE + 1)
        return self.text

    def close(self) -> None:
        """Close the file, as readers do at its end."""
        self._file.close()


@contextmanager
def _open_text(path: Path) -> Iterator[_CountedLines]:
    """Open a text that may be compressed and may begin with a byte order mark; any bytes can be read."""
    encoding: dict[str, Any] = {"encoding": "utf-8-sig", "errors": "backslashreplace"}
    is_compressed = path.suffix.lower() == ".gz"
    with gzip.open(path, "rt", **encoding) if is_compressed else path.open(**encoding) as file:
        yield _CountedLines(file)


def _open_binary(path: Path, suffix: str) -> Any:
    """Return python-can's reader of a binary log. Raises UsageError if there is none for this suffix."""
    if suffix == ".mf4" and find_spec("asammdf") is None:
        raise UsageError(
            f"to read {path} the package asammdf is needed, which is not installed; run: pip install asammdf "
            "(or convert the log where it is installed: can_logconvert FILE.mf4 FILE.log)"
        )
    try:
        return can.LogReader(path)
    except OSError:
        raise
    except Exception as error:  # readers raise errors of any kind
        raise UsageError(
            f"the log {path} cannot be opened, or its suffix is wrong: it must be {_SUFFIXES}"
        ) from error


def _read_candump(lines: _CountedLines, summary: LogSummary, is_part: bool) -> Iterator[can.Message]:
    """Yield the frames of candump's lines; of a part without the last line if that has no end."""
    for line in lines:
        if is_part and not line.endswith("\n") and len(line) <= LONGEST_LINE:
            return
        frame = parse_line(line)
        if frame is not None and abs(frame.timestamp) < _LATEST:
            yield frame
        elif line.strip():
            summary.skip_line(lines.number, line)


def _checked(
    frames: Iterable[can.Message], path: Path, lines: _CountedLines | None = None
) -> Iterator[can.Message]:
    """Yield frames of a reader of python-can.

    Raises UsageError at the first that is malformed. It names the line if ``lines`` are those of a text.
    """
    frame_count = 0
    try:
        for frame in frames:
            if not abs(frame.timestamp) < _LATEST:
                raise ValueError(f"its time is {frame.timestamp:g} s")
            frame_count += 1
            yield frame
    except OSError:
        raise
    except Exception as error:  # readers raise errors of any kind
        position = f"after frame {frame_count}"
        if lines is not None:
            position = f"in line {lines.number}, {_quote(lines.text)}"
        raise UsageError(
            f"the log {path} is malformed {position}, or its suffix is wrong: it must be {_SUFFIXES}"
        ) from error


def _quote(text: str) -> str:
    """Return a line in quotes, cut to _LONGEST_QUOTE characters and dots if it is longer."""
    shown = text.strip()
    return repr(shown if len(shown) <= _LONGEST_QUOTE else f"{shown[:_LONGEST_QUOTE]}...")
