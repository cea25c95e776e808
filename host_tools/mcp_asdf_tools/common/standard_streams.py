"""Standard input, output and error of a command, each of which may be closed, full or a broken pipe."""

from __future__ import annotations

import os
import select
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from typing import IO, Any, cast

from mcp_asdf_tools.common.errors import UsageError

_READ_SIZE = 1 << 16
"""Bytes that are read at once from input whose content does not matter."""


class OutputError(Exception):
    """Standard output could not be written.

    This is not an OSError, as the failure itself is: rich ends the program with exit code 1 when a write
    raises BrokenPipeError, and argparse ignores an OSError.

    Attributes:
        is_broken_pipe: Whether the program that read the output has ended.
    """

    def __init__(self, cause: OSError) -> None:
        """Describe the failure of a write that raised ``cause``."""
        super().__init__(f"cannot write to standard output: {cause.strerror}; send it elsewhere")
        self.is_broken_pipe = isinstance(cause, BrokenPipeError)


class _CheckedStream(ABC):
    """Text stream that passes everything on to another one; a subclass handles the OSErrors of its writes."""

    def __init__(self, stream: IO[str]) -> None:
        """Take the stream to which all texts are passed on."""
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the other stream; Python calls this for attributes that the class lacks."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, and return the number of its characters, as streams do.

        A failed write counts as done if ``_handle`` does not raise.
        """
        try:
            return self._stream.write(text)
        except OSError as error:
            self._handle(error)
            return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after the other, without adding line ends."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Write all text that is buffered. A failure counts as success if ``_handle`` does not raise."""
        try:
            self._stream.flush()
        except OSError as error:
            self._handle(error)

    @abstractmethod
    def _handle(self, error: OSError) -> None:
        """React to the failure of a write, which counts as done if this method returns."""


class _CheckedOutput(_CheckedStream):
    """Standard output: a failed write raises OutputError."""

    def _handle(self, error: OSError) -> None:
        """Discard all further output, and raise OutputError."""
        _discard_output(self._stream)
        raise OutputError(error) from error


class _CheckedErrors(_CheckedStream):
    """Standard error: a failed write is ignored, since there is nowhere to report it."""

    def _handle(self, error: OSError) -> None:
        """Discard all further output."""
        _discard_output(self._stream)


@contextmanager
def checked_streams() -> Iterator[None]:
    """Context manager in which a failing write to standard output raises OutputError.

    A failing write to standard error is ignored. A stream that was closed when the program was started
    (``>&-``) becomes the null device, as if the user had redirected it there.
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
    """Connect a stream's file descriptor to the null device, so that all further output is discarded.

    Without that the interpreter, which flushes its streams at its end, would report the same failure again.
    """
    with suppress(OSError, ValueError), open(os.devnull, "w") as null_device:
        os.dup2(null_device.fileno(), stream.fileno())


def standard_input_descriptor() -> int:
    """Return the file descriptor of standard input. Raises UsageError if it is closed or is not a file."""
    try:
        if sys.stdin is not None:  # it is None if it was closed when the program was started
            return sys.stdin.fileno()
    except (OSError, ValueError):  # it has been closed since, or a test has put a text in its place
        pass
    raise UsageError("there is no standard input; give one, or leave out what reads it")


def has_input_ended(descriptor: int) -> bool:
    """Return whether an input has ended, without waiting. Data that is there is read and discarded."""
    readable_descriptors, _, _ = select.select([descriptor], [], [], 0)
    if not readable_descriptors:
        return False
    # At its end an input counts as readable, but gives no bytes.
    return os.read(descriptor, _READ_SIZE) == b""
