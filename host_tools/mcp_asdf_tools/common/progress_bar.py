"""Progress of a long task on standard error: its count, and the time left at its rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

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
    can_show_bar = console.is_terminal or console.is_jupyter
    shows_bar = can_show_bar and not quiet
    prints_lines = not can_show_bar and not quiet
    # A disabled bar is made, too, but never shown.
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    start_time = time.monotonic()
    last_line_time = start_time
    done_count = 0.0
    bar = Progress(
        *columns,
        console=console,
        disable=not shows_bar,
        transient=True,
        # By default the rate is that of the last 30 s, in which no unit may have been done.
        speed_estimate_period=math.inf,
    )
    with bar:
        task = bar.add_task(unit, total=total)

        def add(count: float) -> None:
            """Add units that have been done, and show the progress."""
            nonlocal done_count, last_line_time
            done_count += count
            bar.advance(task, count)
            now = time.monotonic()
            if prints_lines and now - last_line_time >= _SECONDS_BETWEEN_LINES:
                last_line_time = now
                seconds_so_far = now - start_time
                seconds_left = (total - done_count) * seconds_so_far / done_count
                time_left = timedelta(seconds=round(seconds_left))
                console.print(f"{unit}: {done_count:g} of {total:g}, {time_left} left")

        yield add
