"""The progress of a running swarm."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.run import Baselines, mean_error
from mcp_asdf_tools.swarm.swarm import Swarm

_SECONDS_BETWEEN_REFRESHES = 0.25


@contextmanager
def live_view(
    console: Console, steps: int, baselines: Baselines | None = None
) -> Iterator[Callable[[Swarm], None]]:
    """Show in this context how far a run of ``steps`` is, and yield a hook for the end of each tick.

    A terminal that can move its cursor gets a bar with the mean errors, also those of ``baselines`` if there
    are any, and keeps it at the end. Otherwise the count of ticks goes to standard error, as that of any long
    command. If the console is quiet, nothing is shown at all.
    """
    if console.is_terminal and not console.is_dumb_terminal and not console.quiet:
        with _empty_bar(console) as bar:
            yield _SwarmBar(bar, steps, baselines)
    else:
        with progress("ticks", steps, quiet=console.quiet) as count_ticks:
            yield lambda _swarm: count_ticks(1)


def _empty_bar(console: Console) -> Progress:
    """Return a bar that has no task yet.

    It is drawn only when the run itself tells it to, since a second thread could draw a half-done tick.
    """
    return Progress(
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        BarColumn(10),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
        console=console,
        auto_refresh=False,
    )


class _SwarmBar:
    """Hook that draws a bar with the mean errors at the end of ticks."""

    def __init__(self, bar: Progress, steps: int, baselines: Baselines | None) -> None:
        """Prepare ``bar`` for a run of ``steps``. It stays invisible until the first tick."""
        self._bar = bar
        self._task = bar.add_task("", visible=False, total=steps)
        self._steps = steps
        self._baselines = baselines
        self._next_refresh = 0.0

    def __call__(self, swarm: Swarm) -> None:
        """Draw the bar anew after a tick, unless that was done a moment ago. O(robots)."""
        # The last tick is always drawn, so that the bar ends with the final state.
        if time.monotonic() >= self._next_refresh or swarm.ticks == self._steps:
            self._refresh(swarm)
            self._next_refresh = time.monotonic() + _SECONDS_BETWEEN_REFRESHES

    def _refresh(self, swarm: Swarm) -> None:
        """Draw the bar anew, with the present mean errors beside it."""
        mean_errors = f"mean error {mean_error(swarm):.4f}"
        if self._baselines is not None:
            for baseline_filter, error in self._baselines.mean_errors().items():
                mean_errors += f", {FILTERS[baseline_filter].term} {error:.4f}"
        self._bar.update(
            self._task, completed=swarm.ticks, description=mean_errors, visible=True, refresh=True
        )
