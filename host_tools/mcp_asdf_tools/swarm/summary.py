"""Summary of a swarm's run in text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from mcp_asdf_tools.bus.load import HIGH_LOAD
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.swarm.run import SwarmRun
from mcp_asdf_tools.swarm.settings import SwarmSettings

Row = tuple[str, str]
"""The name of a line of a summary, and its text."""


def summary(run: SwarmRun, bus: str) -> list[Row]:
    """Return a summary of a run as lines, each a pair of its name and its text.

    They are about the run, the robots' estimates and b_hat, the filter, the frames, faults, robots that
    rejected frames, the clock and the load of the bus. ``bus`` is a description of the bus.
    """
    settings = run.settings
    results = run.results
    frames = results["frames"]
    b_hat = results["b_hat"]
    # Remote robots do not report their tests.
    tests = "an unknown number of" if results["tests"] is None else results["tests"]
    return [
        ("run", f"{results['steps']} of {settings.steps} steps in {run.seconds:.1f} s{_ending(run)}"),
        (
            "estimate",
            f"mean x {results['mean_x']:.5f}, f {settings.fill_ratio:g}, mean error "
            f"{results['mean_error']:.5f}, spread of x {results['spread_x']:.5f}, of x_hat "
            f"{results['spread_x_hat']:.5f}",
        ),
        ("b_hat, flawed", _b_hat_text(b_hat["flawed"], settings.true_accuracy)),
        ("b_hat, other", _b_hat_text(b_hat["other"], settings.true_accuracy)),
        ("filter", f"{settings.filter_description}; {tests} tests, {results['updates']} updates"),
        (
            "frames",
            f"{frames['sent']} messages and {frames['heartbeats_sent']} heartbeats sent on {bus}, "
            f"{frames['delivered']} messages delivered, {sum(frames['rejected'].values())} frames rejected, "
            f"{frames['refused']} messages refused, {frames['strays']} strays",
        ),
        *_fault_lines(results),
        *_reception_lines(results),
        *_clock_lines(results),
        ("bus load", _bus_load_text(results)),
    ]


def summary_table(rows: Sequence[Row]) -> Table:
    """Return a summary as a table of two columns, the second as wide as there is room."""
    table = Table(box=None, show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for row_name, row_text in rows:
        # rich would take brackets in a plain string for its markup.
        table.add_row(Text(row_name), Text(row_text))
    return table


def one_line(run: SwarmRun) -> str:
    """Return a summary in one line, for quiet runs: seed, robots, filter, steps, errors, any early end."""
    results = run.results
    return (
        f"seed {run.settings.seed}: {run.settings.robots} robots, {run.settings.swarm_filter.term}, "
        f"{results['steps']} steps, mean error {results['mean_error']:.5f}, "
        f"spread {results['spread_x']:.5f}{_ending(run)}"
    )


def comparison(results_by_filter: dict[str, dict[str, Any]], settings: SwarmSettings) -> str:
    """Return in two sentences what difference filters made on the same seed.

    The first has the mean error with each filter, the second what the flawed robots assumed of their sensors
    at first, and assume now with each filter; without flawed robots there is none. A third sentence follows
    if the swarm needs no filter, as all hear all and the flawed robots trust their sensors too little.
    """
    compared_filters = [item for item in FILTERS.values() if item.name in results_by_filter]
    errors = [
        f"{swarm_filter.term} {results_by_filter[swarm_filter.name]['mean_error']:.3f}"
        for swarm_filter in compared_filters
    ]
    sentences = [f"Mean error on the same seed: {', '.join(errors)}."]
    if settings.flawed > 0:
        b_hat_changes = {
            swarm_filter.term: results_by_filter[swarm_filter.name]["b_hat"]["flawed"]
            for swarm_filter in compared_filters
            if swarm_filter.is_on
        }
        sentences.append(_sentence_on_flawed_robots(b_hat_changes, settings))
    if _needs_no_filter(settings):
        sentences.append(
            "This swarm needs no filter: where all hear all, robots that trust their sensors too little are "
            "outvoted anyway; with --topology dynamic they do harm (docs/advice.md)."
        )
    return " ".join(sentences)


def _needs_no_filter(settings: SwarmSettings) -> bool:
    """Return whether there are flawed robots that trust their sensors too little, and all robots hear all."""
    # The nearer an assumed accuracy is to 1/2, the smaller is the confidence that the robot broadcasts.
    is_underconfident = abs(settings.flawed_accuracy - 0.5) < abs(settings.true_accuracy - 0.5)
    return settings.flawed > 0 and settings.topology == "fully-connected" and is_underconfident


def _sentence_on_flawed_robots(changes: dict[str, dict[str, float]], settings: SwarmSettings) -> str:
    """Return the sentence on what flawed robots assumed of their sensors at first, and assume now.

    ``changes`` has their mean b_hat before and after, by the term of each filter that recalibrates.
    """
    # The swarms of all filters begin with the same robots, so any of them has the same mean b_hat before.
    any_change, *_ = changes.values()
    present_b_hats = [f"{term} {change['after']:.2f}" for term, change in changes.items()]
    # Sensors that age have no one true accuracy.
    truth = f" (true: {settings.true_accuracy:.2f})" if settings.drift == "none" else ""
    return (
        f"The flawed robots first assumed an accuracy of {any_change['before']:.2f}{truth}, now: "
        f"{', '.join(present_b_hats)}."
    )


def load_warning(results: dict[str, Any]) -> str | None:
    """Return a warning that names the highest bit rate at which a real bus would be too busy on average.

    Returns None if it would be so at no usual bit rate.
    """
    bus_loads = results["bus_load"].items()
    busy_bit_rates = [int(bit_rate) for bit_rate, load in bus_loads if load["mean"] > HIGH_LOAD]
    if not busy_bit_rates:
        return None
    # The fastest of the busy ones: at all slower rates the load is even higher.
    return (
        f"a real bus at {_bit_rate_text(max(busy_bit_rates))}bit/s or less would be busy for more than "
        f"{HIGH_LOAD:.0%} of the time; use a faster one, a longer comms-period, or fewer ticks per second"
    )


def _ending(run: SwarmRun) -> str:
    """Return what ended the run early, to be appended to a sentence; empty if it was complete."""
    if run.failure is not None:
        return f"; failed in {run.failure}"
    return "; interrupted" if run.interrupted else ""


def _b_hat_text(change: dict[str, float] | None, true_accuracy: float) -> str:
    """Return the text about b_hat, the assumed accuracy, of a group of robots at the start and at the end.

    A ``change`` of None stands for a group without robots.
    """
    if change is None:
        return "no such robots"
    return (
        f"{change['before']:.4f} -> {change['after']:.4f} ({change['after_min']:.4f} to "
        f"{change['after_max']:.4f}, {change['robots']} robots; b {true_accuracy:g})"
    )


def _fault_lines(results: dict[str, Any]) -> Iterator[Row]:
    """Yield lines, pairs of name and text: how much of the traffic arrived, and how often each fault hit.

    Yields nothing without faults.
    """
    if not results["faults"]:
        return
    frames = results["frames"]
    arrived = frames["arrived"]
    in_range = frames["in_range"]
    # Faults may have kept every robot off the bus, so that there was no frame to arrive.
    share = arrived / in_range if in_range else 0.0
    yield "arrived", f"{arrived} of {in_range} frames, {share:.1%}; {frames['on_the_bus']} on the bus"
    for fault in results["faults"]:
        yield "fault", f"{fault['fault']}: {fault['injected']} injected"


def _reception_lines(results: dict[str, Any]) -> Iterator[Row]:
    """Yield lines, pairs of name and text, for robots that rejected or refused frames, and for id conflicts.

    Yields nothing if robots accepted all frames, and no other node sent under their ids.
    """
    for robot in results["robots"]:
        reasons = [f"{count} {reason}" for reason, count in robot["rejected"].items()]
        if robot["refused"]:
            reasons.append(f"{robot['refused']} refused")
        if reasons:
            yield f"robot {robot['id']}", f"{robot['delivered']} messages delivered; {', '.join(reasons)}"
    for robot_id, count in results["frames"]["id_conflicts"].items():
        advice = f"another node sent {count} messages as robot {robot_id}; give it a free id"
        yield "node-id conflict", advice


def _clock_lines(results: dict[str, Any]) -> Iterator[Row]:
    """Yield one line, a pair of name and text: how late ticks and frames were; nothing in lockstep."""
    clock = results["clock"]
    if clock is None:
        return
    mean_ms = 1e3 * clock["mean_lateness"]
    maximum_ms = 1e3 * clock["max_lateness"]
    drift_ms = 1e3 * clock["drift"]
    yield (
        "clock",
        f"ticks began {mean_ms:.3f} ms late on average, {maximum_ms:.3f} ms at most, {clock['late_ticks']} "
        f"of them by more than half a tick; drift {drift_ms:.3f} ms; {results['frames']['missed']} frames "
        "late or lost",
    )


def _bus_load_text(results: dict[str, Any]) -> str:
    """Return the text about the load of a real bus at each bit rate."""
    loads = [
        f"{_bit_rate_text(int(bit_rate))}bit/s {load['mean']:.1%} (peak {load['peak']:.0%})"
        for bit_rate, load in results["bus_load"].items()
    ]
    return ", ".join(loads)


def _bit_rate_text(bit_rate: int) -> str:
    """Return a bit rate with the prefix of its unit, such as ``500 k``."""
    if bit_rate % 1_000_000 == 0:
        return f"{bit_rate // 1_000_000} M"
    return f"{bit_rate // 1_000} k"
