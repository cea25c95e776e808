"""The progress of a running swarm."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.run import Baselines, mean_error
from mcp_asdf_tools.swarm.swarm import Swarm

_SECONDS_BETWEEN_REFRESHES = 0.25


class LiveView:
    """Hook that shows how far a run is: as a bar with mean errors on a terminal, else on standard error."""

    def __init__(self, console: Console, steps: int, baselines: Baselines | None = None) -> None:
        """Show a run of ``steps`` on ``console``, and the mean errors of ``baselines`` if there are any.

        The bar is for a terminal that can move its cursor. Otherwise the count of ticks goes to standard
        error, as that of any long command. If the console is quiet, nothing is shown at all.
        """
        self._steps = steps
        self._baselines = baselines
        self._is_quiet = console.quiet
        self._has_bar = console.is_terminal and not console.is_dumb_terminal and not console.quiet
        # Refreshed by the run itself: there is no second thread, and no half-done tick on the screen.
        self._progress = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(10),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console,
            auto_refresh=False,
        )
        self._task = self._progress.add_task("", visible=False)
        self._next_refresh = 0.0
        self._count_ticks: Callable[[float], None] | None = None
        self._open_progress = ExitStack()

    def __enter__(self) -> LiveView:
        """Start the bar, which stays invisible until the first tick, or the count on standard error."""
        if self._has_bar:
            self._open_progress.enter_context(self._progress)
        else:
            self._count_ticks = self._open_progress.enter_context(
                progress("ticks", self._steps, quiet=self._is_quiet)
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the bar, and leave it on the screen as it is; end the count on standard error."""
        self._open_progress.close()

    def __call__(self, swarm: Swarm) -> None:
        """Draw the bar anew after a tick, unless that was done a moment ago. O(robots)."""
        if self._count_ticks is not None:
            self._count_ticks(1)
            return
        # The last tick is always drawn, so that the bar ends with the final state.
        if time.monotonic() >= self._next_refresh or swarm.ticks == self._steps:
            self._refresh_bar(swarm)
            self._next_refresh = time.monotonic() + _SECONDS_BETWEEN_REFRESHES

    def _refresh_bar(self, swarm: Swarm) -> None:
        """Draw the bar anew, with the present mean errors beside it."""
        mean_errors = f"mean error {mean_error(swarm):.4f}"
        if self._baselines is not None:
            for baseline_filter, error in self._baselines.mean_errors().items():
                mean_errors += f", {FILTERS[baseline_filter].term} {error:.4f}"
        # The bar is invisible until its first numbers are there.
        self._progress.update(
            self._task,
            total=self._steps,
            completed=swarm.ticks,
            description=mean_errors,
            visible=True,
            refresh=True,
        )
