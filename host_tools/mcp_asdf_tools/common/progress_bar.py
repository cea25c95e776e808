"""Progress of a long task on standard error: its count, its rate, and the time left at that rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

_SECONDS_BETWEEN_LINES = 60.0
"""Time between lines of progress where there is no terminal."""


@contextmanager
def progress(unit: str, total: float, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """Show progress on standard error: a bar in terminals and notebooks, elsewhere a line a minute.

    Yields a function that adds to the count.
    """
    console = Console(stderr=True)
    is_bar = console.is_terminal or console.is_jupyter
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), _Rate())
    start = last_line = time.monotonic()
    done = 0.0
    with Progress(*columns, console=console, disable=quiet or not is_bar, transient=True) as bar:
        task = bar.add_task(unit, total=total)

        def add(count: float) -> None:
            nonlocal done, last_line
            done += count
            bar.advance(task, count)
            now = time.monotonic()
            if not (is_bar or quiet) and now - last_line >= _SECONDS_BETWEEN_LINES:
                last_line = now
                console.print(f"{unit}: {done:g} of {total:g}, {rate_in_words(done, total, now - start)}")

        yield add


class _Rate(ProgressColumn):
    """Column of a bar that shows ``rate_in_words``."""

    def render(self, task: Task) -> Text:
        """Return the text of the column."""
        return Text(rate_in_words(task.completed, task.total or 0.0, task.elapsed or 0.0))


def rate_in_words(done: float, total: float, seconds: float) -> str:
    """Return the rate so far and the time left at that rate; an empty text before anything is done."""
    if not done or not seconds:
        return ""
    seconds_left = round((total - done) * seconds / done)
    minutes, remaining_seconds = divmod(seconds_left, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{done / seconds:.3g}/s, {hours}:{minutes:02}:{remaining_seconds:02} left"
