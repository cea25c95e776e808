"""A running swarm on a terminal."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.run import Baselines, mean_error
from mcp_asdf_tools.swarm.swarm import Swarm

_SECONDS_BETWEEN_REFRESHES = 0.25


class LiveView:
    """Hook that shows a bar and the mean errors while a run goes on, on a terminal that is not quiet."""

    def __init__(self, console: Console, baselines: Baselines | None = None) -> None:
        """Show a swarm on ``console``, and the mean errors of ``baselines`` if there are any.

        Nothing is shown if it is no terminal, cannot move its cursor or is to be quiet.
        """
        self._baselines = baselines
        self._has_bar = console.is_terminal and not console.is_dumb_terminal and not console.quiet
        # Refreshed by the run itself: there is no second thread, and no half-done tick on the screen.
        self._progress = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(10),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console,
            auto_refresh=False,
            disable=not self._has_bar,
        )
        self._task = self._progress.add_task("", visible=False)
        self._next_refresh = 0.0

    def __enter__(self) -> LiveView:
        """Start the bar, which stays invisible until the first tick."""
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the bar, and leave it on the screen as it is."""
        self._progress.stop()

    def __call__(self, swarm: Swarm) -> None:
        """Draw the bar anew after a tick, unless that was done a moment ago. O(robots)."""
        if not self._has_bar:
            return
        # The last tick is always drawn, so that the bar ends with the final state.
        if time.monotonic() >= self._next_refresh or swarm.ticks == swarm.settings.steps:
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
            total=swarm.settings.steps,
            completed=swarm.ticks,
            description=mean_errors,
            visible=True,
            refresh=True,
        )
