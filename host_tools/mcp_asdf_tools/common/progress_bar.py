"""A bar that shows how far a long task has come."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class Advance(Protocol):
    """Adds to a bar's count, and to its total."""

    def __call__(self, count: float, more: float = 0) -> None:
        """``count`` more are done, ``more`` more are to be done."""


@contextmanager
def progress(unit: str, total: float, quiet: bool = False) -> Iterator[Advance]:
    """A bar on standard error, in terminals and notebooks; yields a function that adds to its count."""
    console = Console(stderr=True)
    is_shown = console.is_terminal or console.is_jupyter
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=quiet or not is_shown, transient=True) as bar:
        task = bar.add_task(unit, total=total)

        def advance(count: float, more: float = 0) -> None:
            bar.update(task, advance=count, total=(bar.tasks[0].total or 0) + more)

        yield advance
