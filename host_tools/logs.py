"""Logs of frames in python-can's formats, which appear under their name only when complete."""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from types import TracebackType

import can

from host_tools.errors import UsageError

_LOSSY = ".db"


class FrameLog:
    """A log whose format is chosen by the suffix, as by python-can's own logger.

    A context manager: on a regular end the log takes its name; on an exception it vanishes.
    """

    def __init__(self, path: Path | str) -> None:
        """Begin a log. Raises UsageError if its format or folder will not do."""
        self._target = Path(path).resolve()
        suffix = _suffix_of(self._target)
        if self._target.exists() and not self._target.is_file():
            raise UsageError(f"cannot write the log {path}: it is not a regular file; choose another name")
        # python-can tells the format by the name, so the temporary name ends in the same way.
        self._temporary = self._target.with_name(f".log-{secrets.token_hex(4)}{suffix}")
        try:
            self._writer = can.Logger(self._temporary)
        except (OSError, ValueError, can.CanError, NotImplementedError) as error:
            self._temporary.unlink(missing_ok=True)
            raise UsageError(
                f"cannot write the log {path}: {error}; choose a folder you may write to and "
                ".log, .asc, .blf, .csv, .trc or .txt (add .gz to compress; not .blf)"
            ) from error

    def write(self, frame: can.Message) -> None:
        """Append ``frame``."""
        self._writer.on_message_received(frame)

    def __enter__(self) -> FrameLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.stop()
        if kind is None:
            os.replace(self._temporary, self._target)
        else:
            self._temporary.unlink(missing_ok=True)


def _suffix_of(path: Path) -> str:
    """The suffix that tells the format, with that of the compression."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    telling = suffixes[-2:] if suffixes[-1:] == [".gz"] else suffixes[-1:]
    if _LOSSY in telling:
        raise UsageError(
            f"cannot log to {path.name}: python-can's SQLite writer drops the frames that wait when it "
            "stops, nine in ten of a short run; use .blf or .log"
        )
    return "".join(telling)
