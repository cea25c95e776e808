"""A running swarm on a terminal, and as lines in a pipe."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from statistics import fmean
from types import TracebackType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.box import ASCII, ROUNDED
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from mcp_asdf_tools.bus.frames import ONE
from mcp_asdf_tools.bus.load import bus_load
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.swarm import Companion, Swarm
from mcp_asdf_tools.swarm.text_charts import TextMap, bar, sparkline

_MOST_ERRORS = 400
"""About as many as a terminal can show."""
_NOTABLE = 0.002
"""Change of b_hat below which nothing is said: a robot that is right and tests again."""
_SECONDS_BETWEEN_PICTURES = 0.3
_SHARE_OF_PICTURES = 0.03
"""Of the time of a run, at most."""
_LINES_OF_A_RUN = 20
_BIT_RATE = 125_000
"""Bit rate of the bus whose load is shown: the slowest usual one, whose figures are large enough to read."""
_RIGHT, _WRONG, _DEAD, _SOFT = "blue", "dark_orange", "strike", "bright_black"
_WRONG_BY = 0.1
"""|b_hat - b| from which on a robot is wrong about its sensor."""
_MOST_ROWS, _FEWEST_ROWS = 26, 8
"""Of the map."""
_OTHER_ROWS = 6
"""Lines around the map."""
_EVENTS = 4
"""Recalibrations that have a place in any case."""
_CIRCLE = 2.3
"""Side of the map of robots that do not move; they stand on a circle of radius 1."""


class LiveView:
    """Hook that shows a run while it goes on: pictures on a terminal, lines in a pipe, nothing if quiet.

    The last picture stays.
    """

    def __init__(self, console: Console, companion: Companion | None = None) -> None:
        """Show on ``console`` a swarm, and beside it the one without the filter that runs along, if any."""
        # Refreshed from the run itself: no second thread, no half-done tick on the screen.
        self._live = Live(console=console, auto_refresh=False)
        self._console = console
        self._has_pictures = console.is_terminal and not console.is_dumb_terminal and not console.quiet
        self._has_lines = not self._has_pictures and not console.quiet
        self._companion = companion
        self._watch = Watch(companion)
        self._began = self._next = time.monotonic()
        self._printed = 0
        self._swarm: Swarm | None = None

    def __enter__(self) -> LiveView:
        if self._has_pictures:
            self._live.start()
        self._began = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._has_pictures and self._swarm is not None:
            self._show(self._swarm)
        self._live.stop()

    def __call__(self, swarm: Swarm) -> None:
        """Show the present state if there is a screen and the last picture is old enough."""
        self._swarm = swarm
        if self._has_pictures:
            self._watch(swarm)
            if time.monotonic() >= self._next:
                self._show(swarm)
        elif self._has_lines:
            self._watch(swarm)
            self._print_lines(swarm)

    def _show(self, swarm: Swarm) -> None:
        now = time.monotonic()
        picture = SwarmPicture(swarm, self._watch, self._companion, now - self._began)
        self._live.update(picture, refresh=True)
        # On a slow terminal or a busy machine there are fewer pictures, so that the run is not slowed down.
        took = time.monotonic() - now
        self._next = now + max(_SECONDS_BETWEEN_PICTURES, took / _SHARE_OF_PICTURES)

    def _print_lines(self, swarm: Swarm) -> None:
        for event in self._watch.recalibrations[self._printed :]:
            values = (f"{each:.4f}" for each in (event.before, event.after))
            self._print("robot", event.robot, "step", event.tick, "b_hat", *values)
        self._printed = len(self._watch.recalibrations)
        if swarm.ticks % -(-swarm.settings.steps // _LINES_OF_A_RUN) == 0:
            fields = ["step", swarm.ticks, "mean_error", f"{mean_error(swarm):.5f}"]
            if self._companion is not None:
                fields += ["without_filter", f"{mean_error(self._companion.swarm):.5f}"]
            self._print(*fields)

    def _print(self, *fields: object) -> None:
        """One line with tabs between its fields, which is passed on at once."""
        self._console.file.write("\t".join(map(str, fields)) + "\n")
        self._console.file.flush()


class SwarmPicture:
    """A picture of a running swarm, as wide as there is room."""

    def __init__(self, swarm: Swarm, watch: Watch, companion: Companion | None, seconds: float) -> None:
        self._swarm = swarm
        self._settings = swarm.settings
        self._watch = watch
        self._companion = companion
        self._seconds = seconds

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw it for rich."""
        columns, rows = self._size_of_map(options.max_width, console.height)
        self._ascii = options.ascii_only
        box = ASCII if self._ascii else ROUNDED
        arena = Panel(self._map(columns, rows), box=box, padding=0, width=columns + 2, border_style=_SOFT)
        right = options.max_width - columns - 4
        layout = Table.grid(padding=(0, 2, 0, 0))
        layout.add_column(width=columns + 2)
        layout.add_column(width=right)
        layout.add_row(arena, Group(*self._lines(right, rows + 2)))
        yield Group(self._progress(options.max_width), layout, self._legend(), self._bus())

    def _size_of_map(self, width: int, height: int) -> tuple[int, int]:
        """Columns and rows of the map, which are half as wide as high; the other half is for figures."""
        across, down = self._settings.sides if self._settings.is_dynamic else (1.0, 1.0)
        rows = min(height - _OTHER_ROWS, _MOST_ROWS, int((width / 2 - 4) / 2 * down / across))
        rows = max(rows, _FEWEST_ROWS)
        return min(max(round(2 * rows * across / down), 8), max(width // 2 - 3, 8)), rows

    # --- The map -----------------------------------------------------------------------------------------

    def _map(self, columns: int, rows: int) -> Text:
        swarm = self._swarm
        places, sides = _places(swarm)
        drawn = TextMap(columns, rows, sides)
        if self._settings.is_dynamic and swarm.ticks:
            for receiver, sender in np.argwhere(np.triu(swarm.world.hears)).tolist():
                drawn.connect(places[receiver], places[sender], "." if self._ascii else "·", _SOFT)
        for node in swarm.nodes:
            drawn.put(places[node.id], *self._glyph(node))
        return drawn.text()

    def _glyph(self, node: BusRobot) -> tuple[str, str]:
        """The sign of a robot, which can be told from others without colour."""
        if not node.is_alive:
            return "+" if self._ascii else "†", _SOFT
        if self._is_wrong(node):
            return "x" if self._ascii else "▲", f"bold {_WRONG}"
        return "o" if self._ascii else "●", _RIGHT

    def _is_wrong(self, node: BusRobot) -> bool:
        return abs(node.robot.b_hat - _accuracy(self._swarm, node)) > _WRONG_BY

    def _legend(self) -> Text:
        right, wrong, dead = ("o", "x", "+") if self._ascii else ("●", "▲", "†")
        wrong_robots = sum(map(self._is_wrong, self._swarm.nodes))
        text = Text.assemble((right, _RIGHT), " knows its sensor  ", (wrong, f"bold {_WRONG}"))
        text.append(f" does not ({wrong_robots})")
        if not all(node.is_alive for node in self._swarm.nodes):
            text.append(f"  {dead} dead")
        if self._settings.is_dynamic:
            text.append("  . hear each other" if self._ascii else "  · hear each other")
        return text

    # --- The lines beside it -----------------------------------------------------------------------------

    def _lines(self, width: int, rows: int) -> list[Text]:
        """At most ``rows`` lines that fit ``width``."""
        lines = [Text("mean error", style="bold"), *self._errors(width), Text()]
        shown = [node for node in self._swarm.nodes if self._settings.is_flawed(node.id)] or self._swarm.nodes
        room = rows - len(lines) - 3 - _EVENTS
        title = "b_hat of flawed robots" if shown is not self._swarm.nodes else "b_hat"
        lines.append(Text(f"{title} (line: b = {self._settings.true_accuracy:g})", style="bold"))
        lines += self._bars(shown, width, max(room, 1))
        lines += [Text(), Text("recalibrations", style="bold")]
        lines += self._events(width, rows - len(lines))
        for line in lines:
            line.truncate(width)
        return lines[:rows]

    def _errors(self, width: int) -> Iterator[Text]:
        watch = self._watch
        settled = [each[len(each) // 25 :] for each in (watch.errors, watch.errors_without)]
        top = max((error for each in settled for error in each), default=0.0)
        has_filter = any(self._settings.filters(node.id) for node in self._swarm.nodes)
        names = ("with filter" if has_filter else "no filter", "without")
        series = (watch.errors, watch.errors_without)[: 1 if self._companion is None else 2]
        # A run that has just begun fills as much of the width as it has done of its steps.
        done = self._swarm.ticks / self._settings.steps
        for name, errors, style in zip(names, series, (_RIGHT, _WRONG), strict=False):
            room = max(round((width - 20) * done), 1)
            now = f"{errors[-1]:.4f}" if errors else "      "
            line = sparkline(errors, room, top, self._ascii)
            yield Text.assemble(f"{name:11} {now}  ", (line, style))

    def _bars(self, nodes: list[BusRobot], width: int, rows: int) -> Iterator[Text]:
        is_cut = len(nodes) > rows
        for node in nodes[: rows - is_cut]:
            b_hat = node.robot.b_hat
            style = _WRONG if self._is_wrong(node) else _RIGHT
            name = Text(f"{node.id:4} {b_hat:.3f} ", style="" if node.is_alive else _DEAD)
            truth = _accuracy(self._swarm, node)
            yield name + bar(b_hat, truth, max(min(width - 12, 40), 4), style, self._ascii)
        if is_cut:
            yield Text(f"     and {len(nodes) - rows + 1} more", style=_SOFT)

    def _events(self, width: int, rows: int) -> Iterator[Text]:
        """The last recalibrations, the latest first."""
        events = self._watch.recalibrations
        if not events:
            yield Text("  none yet", style=_SOFT)
        for event in reversed(events[-rows:] if rows > 0 else []):
            yield self._event(event)

    def _event(self, event: Recalibration) -> Text:
        truth = _accuracy(self._swarm, self._swarm.nodes[event.robot])
        style = _RIGHT if abs(event.after - truth) <= _WRONG_BY else _WRONG
        told = f"{event.tick:6}  robot {event.robot}: {event.before:.2f} -> "
        return Text.assemble(told, (f"{event.after:.2f}", style))

    # --- The lines above and below -----------------------------------------------------------------------

    def _progress(self, width: int) -> Text:
        done, steps = self._swarm.ticks, self._settings.steps
        left = self._seconds / done * (steps - done) if done else 0.0
        start, end = f"step {done} of {steps} ", f" {done / steps:4.0%}  {_time(left)} left"
        if done == steps:
            end = f" 100%  {self._seconds:.1f} s   "
        room = max(width - len(start) - len(end) - 1, 4)
        full, empty = "=-" if self._ascii else "━─"
        filled = round(room * done / steps)
        return Text.assemble((start, "bold"), (full * filled, "green"), (empty * (room - filled), _SOFT), end)

    def _bus(self) -> Group:
        """Figures of the bus, and robots of other processes on it, known by their telemetry."""
        swarm = self._swarm
        x = np.array([node.robot.x for node in swarm.nodes])
        seconds = max(swarm.ticks, 1) / self._settings.steps_per_second
        load = bus_load(swarm.traffic.bits, seconds, _BIT_RATE)
        lines = [
            f"f {self._settings.fill_ratio:g}  mean x {x.mean():.4f}  spread {np.ptp(x):.4f}  "
            f"{swarm.traffic.on_the_bus} frames, {load:.1%} of {_BIT_RATE // 1000} kbit/s"
        ]
        own = {node.id for node in swarm.nodes}
        for sender, telemetry in sorted(swarm.traffic.telemetry.items()):
            if sender not in own:
                values = f"b_hat {telemetry.b_hat / 2**24:.4f}, x {telemetry.x / ONE:.4f}"
                lines.append(f"other robot {sender}: {values}, {telemetry.updates} updates")
        return Group(*(Text(line, style=_SOFT, no_wrap=True, overflow="ellipsis") for line in lines))


def _accuracy(swarm: Swarm, node: BusRobot) -> float:
    """True accuracy of a robot's sensor at present."""
    return float(swarm.world.accuracy[node.id]) if swarm.ticks else swarm.settings.true_accuracy


def _places(swarm: Swarm) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Where the robots are, and the sides of the map; those that do not move stand on a circle."""
    positions = swarm.world.positions
    if positions is not None:
        return positions, swarm.settings.sides
    angles = 2 * math.pi * np.arange(len(swarm.nodes)) / len(swarm.nodes)
    return np.column_stack([np.sin(angles), np.cos(angles)]), (_CIRCLE, _CIRCLE)


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


# --- The course of a run in figures ---


class Recalibration(NamedTuple):
    """Change of a robot's b_hat.

    Attributes:
        tick: Ticks done when it was seen.
        robot: Id.
        before: b_hat until then.
        after: b_hat from then on.
    """

    tick: int
    robot: int
    before: float
    after: float


class Watch:
    """Hook that notes the course of a run.

    Attributes:
        errors: Mean |x - f| over the robots, every few ticks.
        errors_without: The same of the swarm without the filter, if one is run along.
        recalibrations: In order.
    """

    def __init__(self, companion: Companion | None = None) -> None:
        self.errors: list[float] = []
        self.errors_without: list[float] = []
        self.recalibrations: list[Recalibration] = []
        self._companion = companion
        self._b_hat: list[float] = []

    def __call__(self, swarm: Swarm) -> None:
        """Note the present state. O(robots), in most ticks O(1)."""
        settings = swarm.settings
        is_due = swarm.ticks % -(-settings.steps // _MOST_ERRORS) == 0
        # Robots that never crash test together, so that nothing is to be seen in between.
        if is_due or settings.faults or swarm.ticks % settings.filter_period == 0:
            self.recalibrations += self._changes(swarm)
        if is_due:
            self.errors.append(mean_error(swarm))
            if self._companion is not None:
                self.errors_without.append(mean_error(self._companion.swarm))

    def _changes(self, swarm: Swarm) -> Iterator[Recalibration]:
        now = [node.robot.b_hat for node in swarm.nodes]
        before = self._b_hat or [swarm.settings.b_hat(node.id) for node in swarm.nodes]
        self._b_hat = now
        if now != before:
            for robot, (old, new) in enumerate(zip(before, now, strict=True)):
                if abs(new - old) > _NOTABLE:
                    yield Recalibration(swarm.ticks, robot, old, new)


def mean_error(swarm: Swarm) -> float:
    """Mean |x - f| over the robots at present."""
    return fmean(abs(node.robot.x - swarm.settings.fill_ratio) for node in swarm.nodes)
