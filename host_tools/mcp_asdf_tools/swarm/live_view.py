"""A running swarm on a terminal, and as lines in a pipe."""

from __future__ import annotations

import math
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.run import Baselines, mean_error
from mcp_asdf_tools.swarm.swarm import Swarm

_MIN_CHANGE_SHOWN = 0.002
"""Change of b_hat from which on it is shown; a robot whose b_hat is right changes it by less."""
_SECONDS_BETWEEN_REFRESHES = 0.25
_LINES_PER_RUN = 20
"""About how many lines with the mean error a run prints."""


class LiveView:
    """Hook that shows a run while it goes on: a bar on a terminal, lines in a pipe, nothing if quiet."""

    def __init__(self, console: Console, baselines: Baselines | None = None) -> None:
        """Show a swarm on ``console``, and the mean errors of ``baselines`` if there are any.

        A terminal gets a bar, unless it cannot move its cursor or is to be quiet. A pipe gets lines.
        """
        self._console = console
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
        self._last_b_hat: list[float] = []

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
        """Show the state of the swarm after a tick. O(robots).

        On a terminal the bar is drawn anew, unless that was done a moment ago. In a pipe a line is printed
        for each robot that has re-estimated b_hat, and a line with the mean errors some twenty times in a
        run. A quiet console shows nothing.
        """
        if self._has_bar:
            # The last tick is always drawn, so that the bar ends with the final state.
            if time.monotonic() >= self._next_refresh or swarm.ticks == swarm.settings.steps:
                self._refresh_bar(swarm)
                self._next_refresh = time.monotonic() + _SECONDS_BETWEEN_REFRESHES
        elif not self._console.quiet:
            self._print_updates(swarm)
            ticks_between_lines = math.ceil(swarm.settings.steps / _LINES_PER_RUN)
            if swarm.ticks % ticks_between_lines == 0:
                self._print_mean_errors(swarm)

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

    def _print_updates(self, swarm: Swarm) -> None:
        """Print a line for each robot that has re-estimated b_hat, its assumed accuracy, in this tick.

        The line, with tabs, is such as ``robot 3 step 50 b_hat 0.9000 0.8123``: the value before and after.
        Changes of at most _MIN_CHANGE_SHOWN are left out.
        """
        present_b_hat = [node.robot.b_hat for node in swarm.nodes]
        # After the first tick there are no last values: the values at the start take their place.
        last_b_hat = self._last_b_hat or swarm.b_hat_at_start
        self._last_b_hat = present_b_hat
        for robot, (old_b_hat, new_b_hat) in enumerate(zip(last_b_hat, present_b_hat, strict=True)):
            if abs(new_b_hat - old_b_hat) > _MIN_CHANGE_SHOWN:
                b_hat_change = (f"{old_b_hat:.4f}", f"{new_b_hat:.4f}")
                self._print("robot", robot, "step", swarm.ticks, "b_hat", *b_hat_change)

    def _print_mean_errors(self, swarm: Swarm) -> None:
        """Print a line such as ``step 50 mean_error 0.01234 none 0.04321``, with tabs in place of spaces.

        The error of each baseline, the same swarm run with another filter, follows the filter's name. Without
        baselines the line ends after the swarm's own error.
        """
        fields = ["step", swarm.ticks, "mean_error", f"{mean_error(swarm):.5f}"]
        if self._baselines is not None:
            for baseline_filter, error in self._baselines.mean_errors().items():
                fields += [baseline_filter, f"{error:.5f}"]
        self._print(*fields)

    def _print(self, *fields: object) -> None:
        """Print a line with tabs between its fields, and pass it on at once."""
        self._console.file.write("\t".join(map(str, fields)) + "\n")
        self._console.file.flush()
