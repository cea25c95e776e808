"""Standard output and standard error of a command, either of which may be closed, full or a broken pipe."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from typing import IO, Any, cast


class OutputError(Exception):
    """Standard output could not be written; the cause is the OSError.

    It is no OSError itself: rich ends the program with exit code 1 when a write raises BrokenPipeError, and
    argparse ignores an OSError.
    """

    def __init__(self, cause: OSError) -> None:
        super().__init__(f"cannot write to standard output: {cause.strerror}; send it elsewhere")
        self.is_broken_pipe = isinstance(cause, BrokenPipeError)


class _CheckedStream:
    """Text stream that passes everything to another one, and handles the OSErrors of its writes."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write ``text``; returns the number of its characters."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._handle(error)
            return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write each of ``lines``, which have their own line ends."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Write what is buffered."""
        try:
            self._stream.flush()
        except OSError as error:
            self._handle(error)

    def _handle(self, error: OSError) -> None:
        raise NotImplementedError


class _CheckedOutput(_CheckedStream):
    """Standard output: a failed write raises OutputError."""

    def _handle(self, error: OSError) -> None:
        _discard_output(self._stream)
        raise OutputError(error) from error


class _CheckedErrors(_CheckedStream):
    """Standard error: a failed write is ignored, since there is nowhere to report it."""

    def _handle(self, error: OSError) -> None:
        _discard_output(self._stream)


@contextmanager
def checked_streams() -> Iterator[None]:
    """Let writes to standard output raise OutputError if they fail, and ignore those to standard error.

    A stream that was closed when the program was started (``>&-``) is replaced by the null device, as if the
    user had asked for that.
    """
    with ExitStack() as stack:
        # sys.stdout is None if it was closed. Without a replacement, the next file that is opened would get
        # its descriptor, and print(file=sys.stderr) would print to standard output.
        output = sys.stdout or stack.enter_context(open(os.devnull, "w"))
        errors = sys.stderr or stack.enter_context(open(os.devnull, "w"))
        stack.enter_context(redirect_stdout(cast(IO[str], _CheckedOutput(output))))
        stack.enter_context(redirect_stderr(cast(IO[str], _CheckedErrors(errors))))
        yield


def _discard_output(stream: IO[str]) -> None:
    """Send what is buffered in ``stream``, and all that follows, to the null device.

    The interpreter flushes its streams at its end, and would report the same failure once more.
    """
    with suppress(OSError, ValueError), open(os.devnull, "w") as null_device:
        os.dup2(null_device.fileno(), stream.fileno())
