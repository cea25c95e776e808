"""Logs of frames in python-can's formats, complete ones and parts that a run left."""

from __future__ import annotations

import argparse
import gzip
import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from copy import copy
from pathlib import Path
from typing import Any, BinaryIO

import can
from can.io.blf import BLFParseError
from can.io.generic import MessageReader
from can.io.logger import MESSAGE_WRITERS
from can.io.player import MESSAGE_READERS

from mcp_asdf_tools.common import PART, UsageError

_WRITABLE = (".log", ".asc", ".blf", ".csv", ".trc", ".txt")
_CUT = (EOFError, struct.error, zlib.error, BLFParseError)
"""Errors of readers at the end of a file that was cut."""


def add_log_option(output: argparse._ArgumentGroup, beside: str) -> None:
    """Declare ``--log``; ``beside`` names the contents of the files beside the log."""
    text = f"keep all frames: {', '.join(_WRITABLE)} (candump's is .log); {beside}"
    output.add_argument("--log", metavar="FILE", type=Path, help=text)


# --- Writing ---------------------------------------------------------------------------------------------


def check_format(path: Path) -> None:
    """Raises UsageError if no log can be written under this name."""
    kind, is_compressed = _format_of(path)
    if kind == ".db":
        raise UsageError(
            f"cannot log to {path.name}: python-can's SQLite writer drops the frames that wait when it "
            "stops, nine in ten of a short run; use .blf or .log"
        )
    if kind not in _WRITABLE or (is_compressed and kind == ".blf"):
        raise UsageError(
            f"cannot log to {path.name}: choose {', '.join(_WRITABLE)} (add .gz to compress; not .blf)"
        )


class FrameLog:
    """Writer of a log in the format of its suffix, as by python-can's own logger.

    What is on disk after ``flush`` can be read, also if nothing comes after it.
    """

    def __init__(self, path: Path, file: BinaryIO, channel: str) -> None:
        """Begin the log ``path``, of a format that ``check_format`` accepts, in ``file``.

        ``channel`` is that of frames that do not name theirs, in formats where channels have names.
        """
        kind, is_compressed = _format_of(path)
        self._file = file
        content: Any = gzip.GzipFile(fileobj=file, mode="wb") if is_compressed else file
        if kind != ".blf":
            content = io.TextIOWrapper(content, encoding="utf-8")
        self._channel = channel if kind == ".log" else None
        self._writer: Any = MESSAGE_WRITERS[kind](content)

    def write(self, frame: can.Message) -> None:
        """Append ``frame``. Raises OSError."""
        if self._channel is not None and not _is_word(frame.channel):
            frame = copy(frame)
            frame.channel = "_".join(str(frame.channel or self._channel).split())
        self._writer.on_message_received(frame)

    def flush(self) -> None:
        """Let the disk have all that was written. Raises OSError."""
        if isinstance(self._writer, can.BLFWriter):
            _complete(self._writer)
        self._writer.file.flush()
        self._file.flush()

    def close(self) -> None:
        """Complete the log and close its file. Raises OSError; the file is closed all the same."""
        if not self._file.closed:
            with closing(self._file), closing(self._writer.file):
                self._writer.stop()


def _is_word(channel: object) -> bool:
    """True if candump's format can hold the name of a channel."""
    return isinstance(channel, str) and channel.split() == [channel]


def _complete(writer: can.BLFWriter) -> None:
    """Bring the header and the last container of a BLF file up to date, as its writer does at the end."""
    writer._flush()
    end = writer.file.tell()
    writer.file.seek(0)
    writer._write_header(end)
    writer.file.seek(end)


def _format_of(path: Path) -> tuple[str, bool]:
    """The suffix of the format, and whether the file is compressed."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    is_compressed = suffixes[-1:] == [".gz"]
    return "".join(suffixes[-2:-1] if is_compressed else suffixes[-1:]), is_compressed


# --- Reading ---------------------------------------------------------------------------------------------

_FORMATS = ".log (candump), .asc, .blf, .csv, .mf4 or .trc, each but .blf and .mf4 also with .gz"


def read_log(path: Path | str) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order. The suffix gives the format.

    Of a part (``NAME.part``) it reads the frames that are complete. Raises UsageError, naming the place, if
    the log cannot be read, is malformed or holds no frame.
    """
    log = Path(path)
    number = 0
    try:
        log.open("rb").close()  # some readers would create a missing file
        with _opened(log) as reader:
            for frame in reader:
                number += 1
                yield frame
    except FileNotFoundError as error:
        part = log.with_name(log.name + PART)
        hint = f"; its run was cut off: {part} has what there is" if part.exists() else ""
        raise UsageError(f"cannot read the log {path}: {error.strerror}{hint}") from error
    except OSError as error:
        raise UsageError(f"cannot read the log {path}: {error.strerror or error}") from error
    except Exception as error:  # readers raise errors of any kind
        if log.suffix != PART or not isinstance(error, _CUT):
            raise UsageError(
                f"the log {path} is malformed after frame {number} ({type(error).__name__}: {error}), "
                f"or its suffix is wrong: {_FORMATS}"
            ) from error
    if not number:
        raise UsageError(f"the log {path} holds no frame; does its suffix match its format?")


@contextmanager
def _opened(path: Path) -> Iterator[MessageReader]:
    if path.suffix != PART:
        with can.LogReader(path) as reader:
            yield reader
        return
    kind, is_compressed = _format_of(path.with_suffix(""))
    with (gzip.open if is_compressed else open)(path, "rb") as file:
        content: Any = file if kind == ".blf" else _WholeLines(file)
        yield MESSAGE_READERS[kind](content)


class _WholeLines:
    """Text file without a last line that has no end."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self._file = file

    def __iter__(self) -> _WholeLines:
        return self

    def __next__(self) -> str:
        line = self._file.readline()
        if not line.endswith(b"\n"):
            raise StopIteration
        return line.decode()

    def close(self) -> None:
        self._file.close()
