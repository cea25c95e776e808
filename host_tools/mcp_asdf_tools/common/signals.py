"""Ending on Ctrl-C or a polite kill without losing what is done."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from mcp_asdf_tools.common.errors import UsageError

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def stopping(signals: Sequence[signal.Signals] = _SIGNALS) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether one of ``signals`` has arrived, for use between steps of work.

    A second signal raises KeyboardInterrupt at once, in case a step does not end.
    Outside the main thread, where Python delivers no signals, the answer is always no.
    """
    asked = False

    def note(signum: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    previous = [signal.signal(each, note) for each in signals]
    try:
        yield lambda: asked
    finally:
        for each, handler in zip(signals, previous, strict=True):
            signal.signal(each, handler)


def standard_input() -> int:
    """The file descriptor of standard input. Raises UsageError if there is none."""
    try:
        if sys.stdin is not None:
            return sys.stdin.fileno()
    except (OSError, ValueError):  # closed, or not a file at all
        pass
    raise UsageError("there is no standard input; give one, or leave out what reads it")


def has_ended(fd: int) -> bool:
    """True at the end of the input from ``fd``; input that is there is read and dropped. Does not wait."""
    return bool(select.select([fd], [], [], 0)[0]) and not os.read(fd, 1 << 16)
