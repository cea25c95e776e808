"""Progress of a long task on standard error: its count, its rate, and the time left at that rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

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
    prints_lines = not can_show_bar and not quiet
    # A disabled bar is made, too, but never shown.
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), _Rate())
    start_time = time.monotonic()
    last_line_time = start_time
    done_count = 0.0
    with Progress(*columns, console=console, disable=quiet or not can_show_bar, transient=True) as bar:
        task = bar.add_task(unit, total=total)

        def add(count: float) -> None:
            """Add units that have been done, and show the progress."""
            nonlocal done_count, last_line_time
            done_count += count
            bar.advance(task, count)
            now = time.monotonic()
            if prints_lines and now - last_line_time >= _SECONDS_BETWEEN_LINES:
                last_line_time = now
                rate = format_rate(done_count, total, now - start_time)
                console.print(f"{unit}: {done_count:g} of {total:g}, {rate}")

        yield add


class _Rate(ProgressColumn):
    """Column of a progress bar with the rate and the time left, such as ``2.5/s, 0:01:20 left``."""

    def render(self, task: Task) -> Text:
        """Return the present text of the column; rich calls this."""
        return Text(format_rate(task.completed, task.total or 0.0, task.elapsed or 0.0))


def format_rate(done_count: float, total: float, seconds: float) -> str:
    """Return the rate so far and the time left at that rate, such as ``2.5/s, 0:01:20 left``.

    The text is empty as long as nothing is done, or no time has passed.
    """
    if done_count == 0 or seconds == 0:
        return ""
    seconds_left = round((total - done_count) * seconds / done_count)
    minutes, remaining_seconds = divmod(seconds_left, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{done_count / seconds:.3g}/s, {hours}:{minutes:02}:{remaining_seconds:02} left"
