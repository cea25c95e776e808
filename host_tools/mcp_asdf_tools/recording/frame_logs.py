"""Logs of frames in python-can's formats, which appear under their name only when complete."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import TracebackType

import can
from can.io.generic import FileIOMessageWriter

from mcp_asdf_tools.common import FileSet, UsageError, explaining, refusal
from mcp_asdf_tools.recording.sidecar import SidecarHeader, SidecarWriter, sidecar_path

_LOSSY = ".db"
_FORMATS = ".log (candump), .asc, .blf, .csv, .trc or .txt"

LogOutputs = tuple[Callable[[can.Message], None] | None, SidecarWriter | None]
"""Takers of frames and of events, None where there is no log."""


def add_log_option(output: argparse._ArgumentGroup, beside: str) -> None:
    """Declare ``--log``; ``beside`` names the contents of the files beside the log."""
    help_ = f"keep all frames: {_FORMATS}; {beside}"
    output.add_argument("--log", metavar="FILE", type=Path, help=help_)


class FrameLog:
    """A log whose format is chosen by the suffix, as by python-can's own logger.

    A context manager: at its end the log is complete, and one of the files that appear together.
    """

    def __init__(self, path: Path | str, files: FileSet) -> None:
        """Begin a log, one of ``files``. Raises UsageError if its format or place is unusable."""
        self._path = path
        suffix = _suffix_of(Path(path))
        # python-can finds the format by the name, so the temporary name ends in the same way.
        temporary = files.begin(path, suffix)
        try:
            with explaining(path):
                self._writer = can.Logger(temporary)
        except UsageError:
            raise
        except (can.CanError, NotImplementedError, ValueError) as error:
            raise UsageError(
                f"cannot write the log {path}: {error}; choose {_FORMATS} (add .gz to compress; not .blf)"
            ) from error

    def write(self, frame: can.Message) -> None:
        """Append ``frame``. Raises UsageError if that is impossible."""
        try:
            self._writer.on_message_received(frame)
        except OSError as error:
            raise refusal(self._path, error) from error

    def __enter__(self) -> FrameLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with explaining(self._path), ExitStack() as stack:
            if isinstance(self._writer, FileIOMessageWriter):
                stack.enter_context(closing(self._writer.file))  # a stop that fails leaves it open
            self._writer.stop()


@contextmanager
def logging_to(path: Path | None, header: SidecarHeader | None) -> Iterator[LogOutputs]:
    """Keep the log ``path``, if there is one, and with a ``header`` its sidecar, too.

    Both appear on a regular end, or neither. Raises UsageError if one of them cannot be written.
    """
    if path is None:
        yield None, None
        return
    with FileSet() as files, FrameLog(path, files) as log, ExitStack() as stack:
        events = None
        if header is not None:
            events = stack.enter_context(SidecarWriter(sidecar_path(path), header, files))
        yield log.write, events


def _suffix_of(path: Path) -> str:
    """The suffix of the format, with that of the compression."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    telling = suffixes[-2:] if suffixes[-1:] == [".gz"] else suffixes[-1:]
    if _LOSSY in telling:
        raise UsageError(
            f"cannot log to {path.name}: python-can's SQLite writer drops the frames that wait when it "
            "stops, nine in ten of a short run; use .blf or .log"
        )
    return "".join(telling)


_FORMATS = ".log (candump), .asc, .blf, .csv, .mf4 or .trc, each but .blf and .mf4 also with .gz"


def read_log(path: Path | str) -> Iterator[can.Message]:
    """Yield the frames of a log, in its order. The suffix gives the format.

    Raises UsageError, naming the place, if it cannot be read, is malformed or holds no frame.
    """
    number = 0
    try:
        Path(path).open("rb").close()  # some readers would create a missing file
        with can.LogReader(Path(path)) as reader:
            for frame in reader:
                number += 1
                yield frame
    except OSError as error:
        raise UsageError(f"cannot read the log {path}: {error.strerror or error}") from error
    except Exception as error:  # readers raise errors of any kind
        raise UsageError(
            f"the log {path} is malformed after frame {number} ({type(error).__name__}: {error}), "
            f"or its suffix is wrong: {_FORMATS}"
        ) from error
    if not number:
        raise UsageError(f"the log {path} holds no frame; does its suffix match its format?")
