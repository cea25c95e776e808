"""A running swarm on a terminal, and as lines in a pipe."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.swarm import Companions, Swarm, mean_error

_NOTABLE = 0.002
"""Change of b_hat below which nothing is said: a robot that is right and tests again."""
_SECONDS_BETWEEN_PICTURES = 0.25
_LINES_OF_A_RUN = 20


class LiveView:
    """Hook that shows a run while it goes on: a bar on a terminal, lines in a pipe, nothing if quiet."""

    def __init__(self, console: Console, companions: Companions | None = None) -> None:
        """Show on ``console`` a swarm, and beside it those with other filters that run along, if any."""
        self._console = console
        self._companions = companions
        self._has_bar = console.is_terminal and not console.is_dumb_terminal and not console.quiet
        # Refreshed from the run itself: no second thread, no half-done tick on the screen.
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
        self._next = 0.0
        self._b_hat: list[float] = []

    def __enter__(self) -> LiveView:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def __call__(self, swarm: Swarm) -> None:
        """Show the present state, if it is due. O(robots)."""
        if self._has_bar:
            self._show(swarm)
        elif not self._console.quiet:
            self._print_lines(swarm)

    def _show(self, swarm: Swarm) -> None:
        steps = swarm.settings.steps
        if time.monotonic() >= self._next or swarm.ticks == steps:
            figures = f"mean error {mean_error(swarm):.4f}"
            if self._companions is not None:
                for other, error in self._companions.errors().items():
                    figures += f", {FILTERS[other].term} {error:.4f}"
            self._progress.update(
                self._task,
                total=steps,
                completed=swarm.ticks,
                description=figures,
                visible=True,
                refresh=True,
            )
            self._next = time.monotonic() + _SECONDS_BETWEEN_PICTURES

    def _print_lines(self, swarm: Swarm) -> None:
        """A line for each robot that has recalibrated, and now and then one with the mean error."""
        before = self._b_hat or swarm.b_hat_at_start
        self._b_hat = [node.robot.b_hat for node in swarm.nodes]
        for robot, (old, new) in enumerate(zip(before, self._b_hat, strict=True)):
            if abs(new - old) > _NOTABLE:
                self._print("robot", robot, "step", swarm.ticks, "b_hat", f"{old:.4f}", f"{new:.4f}")
        if swarm.ticks % -(-swarm.settings.steps // _LINES_OF_A_RUN) == 0:
            fields = ["step", swarm.ticks, "mean_error", f"{mean_error(swarm):.5f}"]
            if self._companions is not None:
                for other, error in self._companions.errors().items():
                    fields += [other, f"{error:.5f}"]
            self._print(*fields)

    def _print(self, *fields: object) -> None:
        """One line with tabs between its fields, which is passed on at once."""
        self._console.file.write("\t".join(map(str, fields)) + "\n")
        self._console.file.flush()
