"""A bar that shows how far a long task has come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def progress(unit: str, total: float, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A bar on standard error, in terminals and notebooks; yields a function that adds to its count."""
    console = Console(stderr=True)
    is_shown = console.is_terminal or console.is_jupyter
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=quiet or not is_shown, transient=True) as bar:
        task = bar.add_task(unit, total=total)
        yield lambda count: bar.advance(task, count)
