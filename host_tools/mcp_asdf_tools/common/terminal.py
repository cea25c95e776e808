"""Standard output and errors that fail in a way that people can understand."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from typing import Any, TextIO, cast

from mcp_asdf_tools.common.errors import UsageError


class ReaderLeft(Exception):  # noqa: N818 (no error)
    """The reader of standard output has closed it."""


class _Stream:
    """A text stream whose failures are handled in one place; in all else the stream itself."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._fail(error)
            return 0

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        """Drop what cannot be written, as the interpreter, which flushes once more at its end, must too."""
        with suppress(OSError, ValueError), open(os.devnull, "w") as null:  # a StringIO has no descriptor
            os.dup2(null.fileno(), self._stream.fileno())


class _Output(_Stream):
    """Standard output: what cannot be written ends the program."""

    def _fail(self, error: OSError) -> None:
        super()._fail(error)
        if isinstance(error, BrokenPipeError):
            raise ReaderLeft from error
        raise UsageError(
            f"cannot write to standard output: {error.strerror or error}; send it elsewhere"
        ) from error


@contextmanager
def screen() -> Iterator[None]:
    """Let printing raise UsageError if standard output cannot be written, ReaderLeft if its reader left.

    Text that cannot be written to standard error is dropped. Only the main thread's
    calls count, since threads share their streams.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with ExitStack() as stack:
        output = _Output(sys.stdout or stack.enter_context(_unwritable()))
        errors = _Stream(sys.stderr or stack.enter_context(_unwritable()))
        stack.enter_context(redirect_stdout(cast(TextIO, output)))
        stack.enter_context(redirect_stderr(cast(TextIO, errors)))
        yield


def _unwritable() -> TextIO:
    """Stand-in for a stream that the program was started without: writing to it fails."""
    return open(os.open(os.devnull, os.O_RDONLY), "w", encoding="utf-8", buffering=1)
