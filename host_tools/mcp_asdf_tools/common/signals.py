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
"""The signals that came since the last ``stopping(interrupt=True)`` began, in their order."""


@contextmanager
def stopping(interrupt: bool = False) -> Iterator[Callable[[], bool]]:
    """Context manager that handles ENDING_SIGNALS, and yields a function: has one of them come?

    Work that is done in steps calls the function between them, and ends by itself. With ``interrupt`` the
    first signal raises KeyboardInterrupt instead, wherever the program is. (Modules written in C may drop an
    exception that is raised while they are imported. So imports are such steps, and use the function.)

    After the first signal, Ctrl-C raises KeyboardInterrupt in either case, since a step may not end; other
    signals do nothing then. Signals that this process was started to ignore, as by nohup, stay ignored.
    Outside the main thread, where Python delivers no signals, the function always returns False.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    # The context with ``interrupt`` is the outermost one of a program, whose exit code depends on the record.
    if interrupt:
        _received_signals.clear()
    count_at_start = len(_received_signals)

    def has_signal_come() -> bool:
        """Return whether a signal has come since the context began."""
        return len(_received_signals) > count_at_start

    def handle_signal(signal_number: int, frame: FrameType | None) -> None:
        """Note that a signal has come, and raise KeyboardInterrupt where ``stopping`` says so."""
        is_first = not has_signal_come()
        _received_signals.append(signal_number)
        if is_first and interrupt:
            raise KeyboardInterrupt
        # Terminals and service managers may send two signals: the second must not disturb the saving.
        if not is_first and signal_number == signal.SIGINT:
            raise KeyboardInterrupt

    previous_handlers = _replace_handlers(handle_signal)
    try:
        yield has_signal_come
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
        if interrupt:
            _let_python_forget_interrupt()


def _let_python_forget_interrupt() -> None:
    """Let the program end with its exit code, even if it runs by "python -m" and was interrupted.

    Python remembers a KeyboardInterrupt that has passed through the exec() of a text, which dataclasses use,
    until the next exec(). It would end such a program by SIGINT, whatever the exit code.
    """
    exec("")


def _replace_handlers(new_handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Let ``new_handler`` handle ENDING_SIGNALS, and return the handlers that it has replaced, by signal.

    Signals that are ignored stay so, and those whose handler was not set by Python keep it.
    """
    previous_handlers = {}
    for number in ENDING_SIGNALS:
        handler = signal.getsignal(number)
        # The handler is None if it was not set by Python.
        if handler is not None and handler != signal.SIG_IGN:
            previous_handlers[number] = handler
            signal.signal(number, new_handler)
    return previous_handlers


def exit_code_of_signal(code: int) -> int:
    """Return an exit code with INTERRUPTED replaced by 128 + the first signal that came, if one did."""
    if code == INTERRUPTED and _received_signals:
        return 128 + _received_signals[0]
    return code
