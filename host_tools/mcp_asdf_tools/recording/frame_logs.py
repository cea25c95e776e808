"""Logs of frames in python-can's formats, complete ones and parts that a run left."""

from __future__ import annotations

import argparse
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

from mcp_asdf_tools.common.errors import UsageError

PART = ".part"
"""Suffix, behind all others, of a file that is not complete."""

_WRITABLE = (".log", ".asc", ".blf", ".csv", ".trc")
_CONTAINER = 4096
"""Bytes of a container of a BLF file, some 80 frames: what a kill may lose."""
_CUT = (EOFError, struct.error, zlib.error, BLFParseError)
"""Errors of readers at the end of a file that was cut."""


def add_log_option(output: argparse._ArgumentGroup, beside: str) -> None:
    """Declare ``--log``; ``beside`` names the contents of the files beside the log."""
    text = f"keep all frames: {', '.join(_WRITABLE)} (candump's is .log); {beside}"
    output.add_argument("--log", metavar="FILE", type=Path, help=text)


# --- Writing ---------------------------------------------------------------------------------------------


def check_format(path: Path) -> None:
    """Raises UsageError if no log can be written under this name."""
    if path.suffix.lower() not in _WRITABLE:
        raise UsageError(f"cannot log to {path.name}: choose {', '.join(_WRITABLE)}")


class FrameLog:
    """Writer of a log in the format of its suffix, as by python-can's own logger.

    What is on disk after ``flush`` can be read, also if nothing comes after it; of a BLF file up to the last
    whole container.
    """

    def __init__(self, path: Path, file: BinaryIO, channel: str) -> None:
        """Begin the log ``path``, of a format that ``check_format`` accepts, in ``file``.

        ``channel`` is that of frames that do not name theirs, in formats where channels have names.
        """
        kind = path.suffix.lower()
        self._file = file
        self._channel = channel if kind == ".log" else None
        content: Any = file if kind == ".blf" else io.TextIOWrapper(file, encoding="utf-8")
        make: Any = MESSAGE_WRITERS[kind]
        self._writer = make(content)
        self._writer.max_container_size = _CONTAINER  # which writers of other formats do not look at

    def write(self, frame: can.Message) -> None:
        """Append ``frame``. Raises OSError."""
        if self._channel is not None and not _is_word(frame.channel):
            frame = copy(frame)
            frame.channel = "_".join(str(frame.channel or self._channel).split())
        self._writer.on_message_received(frame)

    def flush(self) -> None:
        """Let the disk have all that was written. Raises OSError."""
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


# --- Reading ---------------------------------------------------------------------------------------------

_FORMATS = ".log (candump), .asc, .blf, .csv, .mf4 or .trc"


def check_log(path: Path | str) -> None:
    """Raises UsageError if there is no log that can be read, and names its part if its run was cut off."""
    log = Path(path)
    try:
        log.open("rb").close()
    except OSError as error:
        part = log.with_name(log.name + PART)
        hint = f"; its run was cut off, partial data is in {part}" if part.exists() else ""
        raise UsageError(f"cannot read the log {path}: {error.strerror}{hint}") from error


def read_log(path: Path | str) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order. The suffix gives the format.

    Of a part (``NAME.part``) it reads the frames that are complete. Raises UsageError, naming the place, if
    the log cannot be read, is malformed or holds no frame.
    """
    check_log(path)  # some readers would create a missing file
    log = Path(path)
    number = 0
    try:
        with _opened(log) as reader:
            for frame in reader:
                number += 1
                yield frame
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
    kind = path.with_suffix("").suffix.lower()
    with path.open("rb") as file:
        content: Any = file if kind == ".blf" else _WholeLines(file)
        yield MESSAGE_READERS[kind](content)


class _WholeLines:
    """Text file without a last line that has no end."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self._file = file
        self.close = file.close

    def __iter__(self) -> Iterator[str]:
        return (line.decode() for line in self._file if line.endswith(b"\n"))

    def __next__(self) -> str:
        return next(iter(self))
