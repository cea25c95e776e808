"""Ending on Ctrl-C, a polite kill or a closed terminal without losing what is done."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from mcp_asdf_tools.common.errors import UsageError

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a program to end: Ctrl-C, a kill or service manager, a terminal that closes."""

INTERRUPTED = 130
"""Exit code of interrupted work; ``interruptible`` turns it into 128 + the signal that came."""

_came: list[int] = []
"""Signals since the program began, so that one piece of code can count what another has handled."""


@contextmanager
def interruptible() -> Iterator[Callable[[int], int]]:
    """Let every signal that asks to end raise KeyboardInterrupt, as Ctrl-C does.

    Yields a function that makes the program's exit code of that of its work. Modules written in C may drop an
    exception that is raised while they are loaded, so what loads them does it under ``stopping``.
    """

    def interrupt(signum: int, frame: FrameType | None) -> None:
        _came.append(signum)
        # Terminals and service managers may send two signals: the second must not disturb the saving.
        if len(_came) == 1 or signum == signal.SIGINT:
            raise KeyboardInterrupt

    _came.clear()
    with _handled_by(interrupt):
        yield lambda code: 128 + _came[0] if code == INTERRUPTED and _came else code


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether a signal has asked to end, for use between steps of work.

    Ctrl-C after another signal raises KeyboardInterrupt at once, in case a step does not end.
    Outside the main thread, where Python delivers no signals, the answer is always no.
    """
    asked = False

    def note(signum: int, frame: FrameType | None) -> None:
        nonlocal asked
        _came.append(signum)
        if asked and signum == signal.SIGINT:
            raise KeyboardInterrupt
        asked = True

    with _handled_by(note):
        yield lambda: asked


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle the signals that ask to end, but for those that this process was started to ignore (nohup)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ignored_handlers = (signal.SIG_IGN, None)
    previous_handlers = {
        signum: signal.signal(signum, handler)
        for signum in ENDING_SIGNALS
        if signal.getsignal(signum) not in ignored_handlers
    }
    try:
        yield
    finally:
        for signum, previous_handler in previous_handlers.items():
            signal.signal(signum, previous_handler)


def standard_input() -> int:
    """Return the file descriptor of standard input. Raises UsageError if there is none."""
    try:
        if sys.stdin is not None:
            return sys.stdin.fileno()
    except (OSError, ValueError):  # closed, or not a file at all
        pass
    raise UsageError("there is no standard input; give one, or leave out what reads it")


def has_ended(fd: int) -> bool:
    """Return whether the input from ``fd`` has ended, without waiting; input that is there is discarded."""
    is_readable = bool(select.select([fd], [], [], 0)[0])
    return is_readable and not os.read(fd, 1 << 16)
