"""Progress of a long task on standard error: its count, and the time left at its rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_SECONDS_BETWEEN_LINES = 60.0
"""Shortest time from one line of progress to the next where there is no terminal."""


@contextmanager
def progress(unit: str, total: float, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """Context manager that shows progress on standard error.

    It is a bar in terminals and notebooks, and a line a minute elsewhere. The context manager yields a
    function, to be called with the number of units that have been done since its last call.

    Args:
        unit: Plural noun for what is counted, such as "trials".
        total: Number of units in all.
        quiet: Whether nothing is shown.
    """
    console = Console(stderr=True)
    if quiet:
        yield _show_nothing
    elif console.is_terminal or console.is_jupyter:
        with _empty_bar(console, unit) as bar:
            task = bar.add_task(unit, total=total)
            yield partial(bar.advance, task)
    else:
        yield _ProgressLines(console, unit, total).add


def _show_nothing(count: float) -> None:
    """Take the number of units that have been done, and show nothing."""


def _empty_bar(console: Console, unit: str) -> Progress:
    """Return a bar that shows how many units of a task are done, and the time left; it has no task yet.

    It is shown as long as its context lasts, and removed at the end.
    """
    return Progress(
        TextColumn(unit),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        # By default the rate is that of the last 30 s, in which no unit may have been done.
        speed_estimate_period=math.inf,
    )


class _ProgressLines:
    """Progress of a task as lines of text, one a minute at most."""

    def __init__(self, console: Console, unit: str, total: float) -> None:
        """Start the clock of a task of ``total`` units; nothing is printed yet."""
        self._console = console
        self._unit = unit
        self._total = total
        self._done = 0.0
        self._start_time = time.monotonic()
        self._last_line_time = self._start_time

    def add(self, count: float) -> None:
        """Add units that have been done, and print a line if the last one is a minute old.

        A line says how many units are done and, if any are, the time that the rest takes at their rate.
        """
        self._done += count
        now = time.monotonic()
        if now - self._last_line_time < _SECONDS_BETWEEN_LINES:
            return
        self._last_line_time = now
        line = f"{self._unit}: {self._done:g} of {self._total:g}"
        if self._done > 0:
            seconds_per_unit = (now - self._start_time) / self._done
            seconds_left = (self._total - self._done) * seconds_per_unit
            line += f", {timedelta(seconds=round(seconds_left))} left"
        self._console.print(line)
