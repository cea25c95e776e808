"""Standard input, output and error of a command, each of which may be closed, full or a broken pipe."""

from __future__ import annotations

import os
import select
import sys
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


class _CheckedStream:
    """Text stream that passes everything on to another one, and after a failed write discards all output."""

    def __init__(self, stream: IO[str], raises: bool) -> None:
        """Take the stream to which all texts are passed on, and whether a failed write raises OutputError.

        Otherwise it counts as done.
        """
        self._stream = stream
        self._raises = raises

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the other stream; Python calls this for attributes that the class lacks."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, and return the number of its characters, as streams do."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._discard_output_after(error)
            return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after the other, without adding line ends."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Write all text that is buffered."""
        try:
            self._stream.flush()
        except OSError as error:
            self._discard_output_after(error)

    def _discard_output_after(self, error: OSError) -> None:
        """Connect the stream to the null device, and raise OutputError unless errors are ignored.

        A stream without a file descriptor stays as it is.
        """
        # Otherwise the interpreter, which flushes its streams at its end, would report the failure again.
        with suppress(OSError, ValueError), open(os.devnull, "w") as null_device:
            os.dup2(null_device.fileno(), self._stream.fileno())
        if self._raises:
            raise OutputError(error) from error


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
        stack.enter_context(redirect_stdout(cast(IO[str], _CheckedStream(output, raises=True))))
        # There is nowhere to report that standard error fails.
        stack.enter_context(redirect_stderr(cast(IO[str], _CheckedStream(errors, raises=False))))
        yield


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
