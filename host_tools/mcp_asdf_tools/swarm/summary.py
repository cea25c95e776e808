"""Summary of a swarm's run in text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from mcp_asdf_tools.bus.load import HIGH_LOAD
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import SwarmRun

Rows = Sequence[tuple[str, str]]
"""A name and a text each."""


def summary(run: SwarmRun, bus: str, seconds: float) -> Rows:
    """Summary of ``run``, which took so many seconds on ``bus``."""
    results, settings, frames = run.results, run.settings, run.results["frames"]
    tests = "an unknown number of" if results["tests"] is None else results["tests"]
    return [
        ("run", f"{results['steps']} of {settings.steps} steps in {seconds:.1f} s{_ending(run)}"),
        (
            "estimate",
            f"mean x {results['mean_x']:.5f}, f {settings.fill_ratio:g}, mean error "
            f"{results['mean_error']:.5f}, spread of x {results['spread_x']:.5f}, of x_hat "
            f"{results['spread_x_hat']:.5f}",
        ),
        *(
            (f"b_hat, {name}", _change(results["b_hat"][name], settings.true_accuracy))
            for name in ("flawed", "other")
        ),
        ("filter", f"{settings.filter_description}; {tests} tests, {results['updates']} updates"),
        (
            "frames",
            f"{frames['sent']} messages and {frames['heartbeats_sent']} heartbeats sent on {bus}, "
            f"{frames['delivered']} messages delivered, {sum(frames['rejected'].values())} frames rejected, "
            f"{frames['refused']} messages refused, {frames['strays']} strays",
        ),
        *_troubles(results),
        ("bus load", _loads(results)),
    ]


def summary_table(rows: Rows) -> Table:
    """A summary as a table of two columns, the second as wide as there is room."""
    table = Table(box=None, show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*(Text(each) for each in row))
    return table


def one_line(run: SwarmRun) -> str:
    """Summary in one line, for quiet runs."""
    results = run.results
    return (
        f"seed {run.settings.seed}: {run.settings.robots} robots, {run.settings.swarm_filter.term}, "
        f"{results['steps']} steps, mean error {results['mean_error']:.5f}, "
        f"spread {results['spread_x']:.5f}{_ending(run)}"
    )


def comparison(by_filter: dict[str, dict[str, Any]], settings: SwarmSettings) -> str:
    """The difference that filters made on the same seed, from their results, in two sentences; a third if the
    swarm is one that needs none."""
    compared_filters = [swarm_filter for swarm_filter in FILTERS.values() if swarm_filter.name in by_filter]
    errors = ", ".join(
        f"{swarm_filter.term} {by_filter[swarm_filter.name]['mean_error']:.3f}"
        for swarm_filter in compared_filters
    )
    said = f"Mean error on the same seed: {errors}."
    changes = [
        (swarm_filter.term, by_filter[swarm_filter.name]["b_hat"]["flawed"])
        for swarm_filter in compared_filters
        if swarm_filter.is_on
    ]
    if not changes[0][1]:
        return said
    before = f"{changes[0][1]['before']:.2f}"
    after = ", ".join(f"{term} {change['after']:.2f}" for term, change in changes)
    said += f" The flawed robots took their sensors for {before} accurate, now: {after}."
    is_underconfident = abs(settings.flawed_accuracy - 0.5) < abs(settings.true_accuracy - 0.5)
    if settings.topology == "fully-connected" and is_underconfident:
        said += (
            " This swarm needs no filter: where all hear all, robots that trust their sensors too little are "
            "outvoted anyway; with --topology dynamic they do harm (docs/advice.md)."
        )
    return said


def load_warning(results: dict[str, Any]) -> str | None:
    """Warning about bit rates at which a real bus would be too busy; None if there are none."""
    busy = [int(rate) for rate, share in results["bus_load"].items() if share["mean"] > HIGH_LOAD]
    if not busy:
        return None
    return (
        f"a real bus at {_rate(max(busy))}bit/s or less would be busy for more than {HIGH_LOAD:.0%} of the "
        "time; use a faster one, a longer comms-period, or fewer ticks per second"
    )


def _ending(run: SwarmRun) -> str:
    if run.failure is not None:
        return f"; failed in {run.failure}"
    return "; interrupted" if run.interrupted else ""


def _change(group: dict[str, float] | None, truth: float) -> str:
    if group is None:
        return "no such robots"
    return (
        f"{group['before']:.4f} -> {group['after']:.4f} ({group['after_min']:.4f} to "
        f"{group['after_max']:.4f}, {group['robots']} robots; b {truth:g})"
    )


def _troubles(results: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Faults, what robots rejected, conflicts of ids, and how late ticks were, as far as there is any."""
    frames, clock = results["frames"], results["clock"]
    if results["faults"]:
        arrived, in_range = frames["arrived"], frames["in_range"]
        share = arrived / in_range if in_range else 0.0
        yield "arrived", f"{arrived} of {in_range} frames, {share:.1%}; {frames['on_the_bus']} on the bus"
    for fault in results["faults"]:
        yield "fault", f"{fault['fault']}: {fault['injected']} injected"
    for robot in results["robots"]:
        reasons = [f"{count} {reason}" for reason, count in robot["rejected"].items()]
        reasons += [f"{robot['refused']} refused"] if robot["refused"] else []
        if reasons:
            yield f"robot {robot['id']}", f"{robot['delivered']} messages delivered; {', '.join(reasons)}"
    for robot, number in frames["id_conflicts"].items():
        yield "node-id conflict", f"another node sent {number} messages as robot {robot}; give it a free id"
    if clock is not None:
        mean, most, drift = (1e3 * clock[name] for name in ("mean_lateness", "max_lateness", "drift"))
        yield (
            "clock",
            f"ticks began {mean:.3f} ms late on average, {most:.3f} ms at most, {clock['late_ticks']} of "
            f"them by more than half a tick; drift {drift:.3f} ms; {frames['missed']} frames late or lost",
        )


def _loads(results: dict[str, Any]) -> str:
    return ", ".join(
        f"{_rate(int(rate))}bit/s {share['mean']:.1%} (peak {share['peak']:.0%})"
        for rate, share in results["bus_load"].items()
    )


def _rate(bit_rate: int) -> str:
    return f"{bit_rate // 10**6} M" if bit_rate % 10**6 == 0 else f"{bit_rate // 1000} k"
