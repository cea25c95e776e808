"""What a person at a terminal sees of a swarm: a table while it runs, a summary at the end."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from host_tools.frames import ONE, Telemetry
from host_tools.swarm import Node, Swarm
from host_tools.swarm_run import Run

_SECONDS_BETWEEN_PICTURES = 0.15
_FLAWED_STYLE, _OTHER_STYLE = "dark_orange", ""


class LiveTable:
    """A hook that shows the swarm on ``console`` while it runs; silent if that is no terminal.

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

    Robots of other processes on the bus have a row, too, with what their telemetry tells.
    """
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for name in ("robot", "t", "n/t", "b_hat", "x_hat", "alpha", "x", "heard", "updates", "rejected"):
        table.add_column(name, justify="right")
    for node in swarm.nodes:
        table.add_row(*_cells(node), style=_FLAWED_STYLE if node.is_flawed else _OTHER_STYLE)
    own = {node.id for node in swarm.nodes}
    for sender, telemetry in sorted(swarm.traffic.telemetry.items()):
        if sender not in own:
            table.add_row(*_cells_of_telemetry(telemetry))
    return Group(_headline(swarm), table)


def _cells(node: Node) -> list[str]:
    robot, counters = node.robot, node.robot.counters
    share = robot.n / robot.t if robot.t else 0.0
    return [
        f"{node.id}{'*' if node.is_flawed else ' '}",
        str(robot.t),
        f"{share:.4f}",
        f"{robot.b_hat:.4f}",
        f"{robot.x_hat:.4f}",
        f"{robot.alpha:.4g}",
        f"{robot.x:.4f}",
        str(node.heard),
        str(counters.updates),
        str(counters.rejected),
    ]


def _cells_of_telemetry(telemetry: Telemetry) -> list[str]:
    b_hat, x = f"{telemetry.b_hat / 2**24:.4f}", f"{telemetry.x / ONE:.4f}"
    return [f"other {telemetry.sender} ", "", "", b_hat, "", "", x, "", str(telemetry.updates), ""]


def _headline(swarm: Swarm) -> Text:
    x = np.array([node.robot.x for node in swarm.nodes])
    f = swarm.world.fill_ratio
    return Text(
        f"tick {swarm.ticks} of {swarm.settings.ticks}   f {f:g}   mean x {x.mean():.4f}   "
        f"spread {np.ptp(x):.4f}   error {np.abs(x - f).mean():.4f}   frames {swarm.traffic.sent}   "
        f"seed {swarm.settings.seed}   (* flawed at the start)"
    )


def summary(run: Run, bus: str, seconds: float) -> Table:
    """What came out of ``run`` on the ``bus`` so named, as a table of two columns."""
    results, settings = run.results, run.settings
    table = Table(box=None, padding=(0, 1), show_header=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row("run", f"{results['ticks']} of {settings.ticks} ticks in {seconds:.1f} s{_ending(run)}")
    table.add_row("estimate", _estimate(run))
    for name in ("flawed", "other"):
        table.add_row(f"b_hat, {name}", _change(results["b_hat"][name], settings.true_accuracy))
    table.add_row("filter", f"{results['tests']} tests, {results['updates']} updates")
    table.add_row("frames", _frames(run, bus))
    for robot_id, count in results["frames"]["collisions"].items():
        table.add_row(
            "id collision", f"another node sent {count} messages as robot {robot_id}; give it a free id"
        )
    table.add_row("parameters", parameters(run))
    return table


def one_line(run: Run) -> str:
    """The outcome in one line, for quiet runs."""
    results = run.results
    return (
        f"seed {run.settings.seed}: {run.settings.robots} robots, {results['ticks']} ticks, "
        f"mean error {results['mean_error']:.5f}, spread {results['spread_x']:.5f}{_ending(run)}"
    )


def parameters(run: Run) -> str:
    """Every parameter as the option that sets it, in a form that can be typed again."""
    plain = run.settings.parameters()
    plain |= plain.pop("frames")
    return " ".join(f"--{name.replace('_', '-')} {value}" for name, value in plain.items())


def _ending(run: Run) -> str:
    if run.failure is not None:
        return f"; failed in {run.failure}"
    return "; interrupted" if run.interrupted else ""


def _estimate(run: Run) -> str:
    results, f = run.results, run.settings.fill_ratio
    return (
        f"mean x {results['mean_x']:.5f}, f {f:g}, mean error {results['mean_error']:.5f}, "
        f"spread of x {results['spread_x']:.5f}, of x_hat {results['spread_x_hat']:.5f}"
    )


def _change(group: dict[str, float] | None, truth: float) -> str:
    if group is None:
        return "no such robots"
    return (
        f"{group['before']:.4f} -> {group['after']:.4f} ({group['after_least']:.4f} to "
        f"{group['after_most']:.4f}, {group['robots']} robots; b {truth:g})"
    )


def _frames(run: Run, bus: str) -> str:
    frames = run.results["frames"]
    rejected = sum(frames["rejected"].values())
    return (
        f"{frames['sent']} messages and {frames['heartbeats_sent']} heartbeats sent on {bus}, "
        f"{frames['delivered']} messages delivered, {rejected} frames rejected, {frames['refused']} "
        f"messages refused, {frames['strays']} strays"
    )
