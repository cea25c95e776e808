"""Signals that ask the program to end: Ctrl-C, a kill, a terminal that closes. Finished work is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a program to end: Ctrl-C, a kill or service manager, a terminal that closes."""

INTERRUPTED = 130
"""Exit code of work that a signal has ended; ``exit_code_of_signal`` makes it more precise."""

_received_signals: list[int] = []
"""The signals that came since the last ``raising_on_signals`` began, in their order."""


@contextmanager
def raising_on_signals() -> Iterator[None]:
    """Context manager that lets ENDING_SIGNALS raise KeyboardInterrupt; it is for a whole program.

    After the first signal only Ctrl-C raises it again: terminals and service managers may send two, and the
    second one must not disturb the saving. Signals that this process was started to ignore, as by nohup, stay
    ignored. Outside the main thread, where Python delivers no signals, nothing changes.
    """
    if not _is_main_thread():
        yield
        return
    _received_signals.clear()

    def handle_signal(signal_number: int, frame: FrameType | None) -> None:
        """Note that a signal has come, and raise KeyboardInterrupt if it is the first one or Ctrl-C."""
        is_first = not _received_signals
        _received_signals.append(signal_number)
        if is_first or signal_number == signal.SIGINT:
            raise KeyboardInterrupt

    with _handling_signals(handle_signal):
        try:
            yield
        finally:
            # Python remembers a KeyboardInterrupt that has passed through the exec() of a text, which
            # dataclasses use, until the next exec(). It would end a program that runs by "python -m" by
            # SIGINT, whatever its exit code.
            exec("")


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Context manager for work in steps: it yields a function that says whether one of ENDING_SIGNALS came.

    The work calls the function between its steps, and ends by itself. A signal interrupts nothing; only
    Ctrl-C after another signal raises KeyboardInterrupt, since a step may not end. Signals that this process
    was started to ignore, as by nohup, stay ignored. Outside the main thread, where Python delivers no
    signals, the function always returns False.

    Importing modules is such work, too: those written in C may drop an exception that is raised meanwhile.
    """
    if not _is_main_thread():
        yield lambda: False
        return
    signals_before = len(_received_signals)

    def has_signal_come() -> bool:
        """Return whether a signal has come since the context began."""
        return len(_received_signals) > signals_before

    def handle_signal(signal_number: int, frame: FrameType | None) -> None:
        """Note that a signal has come, and raise KeyboardInterrupt if it is Ctrl-C and not the first one."""
        is_first = not has_signal_come()
        _received_signals.append(signal_number)
        if not is_first and signal_number == signal.SIGINT:
            raise KeyboardInterrupt

    with _handling_signals(handle_signal):
        yield has_signal_come


def _is_main_thread() -> bool:
    """Return whether this code runs in the main thread, the only one in which Python handles signals."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def _handling_signals(new_handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Context manager that lets ``new_handler`` handle ENDING_SIGNALS, and then restores their handlers.

    Signals that are ignored stay ignored, and those whose handler was not set by Python keep that handler.
    """
    previous_handlers: dict[signal.Signals, Any] = {}
    for number in ENDING_SIGNALS:
        handler = signal.getsignal(number)
        # The handler is None if it was not set by Python.
        if handler is not None and handler != signal.SIG_IGN:
            previous_handlers[number] = handler
            signal.signal(number, new_handler)
    try:
        yield
    finally:
        for number, previous_handler in previous_handlers.items():
            signal.signal(number, previous_handler)


def exit_code_of_signal(code: int) -> int:
    """Return an exit code with INTERRUPTED replaced by 128 + the first signal that came, if one did."""
    if code == INTERRUPTED and _received_signals:
        return 128 + _received_signals[0]
    return code
