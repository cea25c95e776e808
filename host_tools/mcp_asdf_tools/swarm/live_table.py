"""Live table of a running swarm on a terminal."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mcp_asdf_tools.bus import ONE, Telemetry, bus_load
from mcp_asdf_tools.swarm.swarm import Swarm, SwarmRobot

_SECONDS_BETWEEN_PICTURES = 0.15
_BIT_RATE = 125_000
"""Bit rate of the bus whose load is shown: the slowest usual one, whose figures are large enough to read."""
_FLAWED_STYLE, _OTHER_STYLE, _DEAD_STYLE = "dark_orange", "", "strike"


class LiveTable:
    """Hook that shows the swarm on ``console`` while it runs; silent if that is no terminal.

    The last picture stays.
    """

    def __init__(self, console: Console) -> None:
        # Refreshed from the run itself: no second thread, no half-done tick on the screen.
        self._live = Live(console=console, auto_refresh=False)
        self._is_shown = console.is_terminal and not console.quiet
        self._next = 0.0
        self._swarm: Swarm | None = None

    def __enter__(self) -> LiveTable:
        if self._is_shown:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_shown and self._swarm is not None:
            self._live.update(picture(self._swarm), refresh=True)
        self._live.stop()

    def __call__(self, swarm: Swarm) -> None:
        """Show the present state if there is a screen and the last picture is old enough."""
        self._swarm, now = swarm, time.monotonic()
        if self._is_shown and now >= self._next:
            self._next = now + _SECONDS_BETWEEN_PICTURES
            self._live.update(picture(swarm), refresh=True)


def picture(swarm: Swarm) -> Group:
    """The swarm's present state: a row per robot and a line for all.

    Robots of other processes on the bus have a row, too, filled from their telemetry.
    """
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for name in ("robot", "t", "n/t", "b_hat", "x_hat", "alpha", "x", "heard", "updates", "rejected"):
        table.add_column(name, justify="right")
    for node in swarm.nodes:
        is_flawed = swarm.settings.is_flawed(node.id)
        table.add_row(*_cells(node, is_flawed), style=_style(node, is_flawed))
    own = {node.id for node in swarm.nodes}
    for sender, telemetry in sorted(swarm.traffic.telemetry.items()):
        if sender not in own:
            table.add_row(*_cells_of_telemetry(telemetry))
    return Group(_headline(swarm), table)


def _cells(node: SwarmRobot, is_flawed: bool) -> list[str]:
    robot, counters = node.robot, node.counters
    share = robot.n / robot.t if robot.t else 0.0
    return [
        f"{node.id}{'*' if is_flawed else ' '}",
        str(robot.t),
        f"{share:.4f}",
        f"{robot.b_hat:.4f}",
        f"{robot.x_hat:.4f}",
        f"{robot.alpha:.4g}",
        f"{robot.x:.4f}",
        str(node.heard),
        str(counters.updates),
        str(counters.rejected + sum(node.reception.rejected.values())),
    ]


def _style(node: SwarmRobot, is_flawed: bool) -> str:
    if not node.is_alive:
        return _DEAD_STYLE
    return _FLAWED_STYLE if is_flawed else _OTHER_STYLE


def _cells_of_telemetry(telemetry: Telemetry) -> list[str]:
    b_hat, x = f"{telemetry.b_hat / 2**24:.4f}", f"{telemetry.x / ONE:.4f}"
    return [f"other {telemetry.sender} ", "", "", b_hat, "", "", x, "", str(telemetry.updates), ""]


def _headline(swarm: Swarm) -> Text:
    x = np.array([node.robot.x for node in swarm.nodes])
    f = swarm.settings.fill_ratio
    return Text(
        f"tick {swarm.ticks} of {swarm.settings.steps}   f {f:g}   mean x {x.mean():.4f}   "
        f"spread {np.ptp(x):.4f}   error {np.abs(x - f).mean():.4f}   \n"
        f"frames {swarm.traffic.on_the_bus}, {_load(swarm):.1%} of a bus of {_BIT_RATE // 1000} kbit/s   "
        f"seed {swarm.settings.seed}   (* flawed at the start)"
    )


def _load(swarm: Swarm) -> float:
    """Load of the traffic so far on a bus of _BIT_RATE."""
    seconds = max(swarm.ticks, 1) / swarm.settings.steps_per_second
    return bus_load(swarm.traffic.bits, seconds, _BIT_RATE)
