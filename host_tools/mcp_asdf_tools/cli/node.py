"""``mcp-asdf node``: one robot on a bus."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict
from typing import Any

from can.typechecking import CanFilters
from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.cli.again import print_again
from mcp_asdf_tools.cli.recordings import exit_code, recording_for
from mcp_asdf_tools.common import (
    INTERRUPTED,
    UsageError,
    has_ended,
    results_beside,
    software_versions,
    standard_input,
    stopping,
    write_atomically,
)
from mcp_asdf_tools.recording import InputLogHeader, add_log_option
from mcp_asdf_tools.robots import (
    BusLink,
    FrameTaker,
    LineSource,
    NodeRun,
    NodeSettings,
    ObservationSource,
    RobotNode,
    RobotRecord,
    WorldSource,
    add_robot_options,
    add_subject_options,
    filters_for,
    robot_of,
    state_of,
    subjects_of,
)

EPILOG = """\
examples:
  mcp-asdf node --id 3 --interface udp_multicast   # with others on this machine, until Ctrl-C
  mcp-asdf node --id 3 --interface socketcan --channel can0 --b-hat 0.8 --log run.log
  tile_sensor | mcp-asdf node --id 3 --interface socketcan --channel can0 --observations -
  mcp-asdf node --id 3 --interface socketcan --channel vcan0 --lockstep   # obeys command frames
Observations come from the emulated world (robot ID of seed N sees what it sees in "swarm --seed N"), or are
lines 0 (white), 1 (black), - (nothing). In real time a tick lasts until the next one begins.
exit code: 0 done, 1 the bus failed, 2 bad usage, 128 + signal if one came before --steps were done"""

_SECONDS_BETWEEN_PICTURES = 0.15
_MAX_RATE = 10_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_robot_options(parser, "native", "robot id and node id, 0 to 127, unique on the bus")
    _add_clock(parser)
    _add_observations(parser)
    interfaces.add_arguments(parser)
    add_subject_options(parser)
    output = parser.add_argument_group("output")
    add_log_option(output, "FILE.events gets what a replay needs, FILE.json parameters and results")
    output.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(args: argparse.Namespace) -> int:
    """Run the node until it ends; save and print what came out."""
    if args.lockstep and args.observations is not None:
        raise UsageError("with --lockstep commands bring the observations; leave out --observations")
    if args.until_eof and args.observations == "-":
        raise UsageError("observations from standard input end with it anyway; leave out --until-eof")
    record, settings, choice = robot_of(args), settings_of(args), interfaces.choose_bus(args)
    results = None if args.log is None else results_beside(args.log)
    header = InputLogHeader([record], args.seed, settings.subjects.estimates, _parameters(args))
    recording = recording_for("node", args.log, header, choice)
    with ExitStack() as ending:
        with recording as (log, events):
            recorder = None if events is None else events.robots[record.id]
            run = _go(args, RobotNode(record.make(), settings, recorder), choice, log)
            report = _report(args, run, record, choice)
            ending.callback(_print, args, run, report, choice)  # even if a file cannot be completed
        if results is not None:
            write_atomically(results, json.dumps(report, indent=2) + "\n")
    return exit_code(recording, _exit_code(run))


def _go(
    args: argparse.Namespace, node: RobotNode, choice: interfaces.BusChoice, log: FrameTaker | None
) -> NodeRun:
    """Run the node until it ends."""
    console = Console(stderr=True, quiet=args.quiet)
    with ExitStack() as stack:
        source = None if args.lockstep else stack.enter_context(closing(_source_of(args)))
        bus = stack.enter_context(choice.open())
        bus.set_filters(_filters(node.settings, args.lockstep))
        should_stop = _ending(stack.enter_context(stopping()), args.until_eof)
        link = BusLink(bus, should_stop, endures=not args.lockstep, log=log)
        run = NodeRun(node, link, args.steps, stack.enter_context(_Watch(console, node, link)))
        if source is None:
            run.in_lockstep()
        else:
            run.in_real_time(source)
    return run


def _add_clock(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("clock")
    group.add_argument(
        "--steps-per-second",
        type=int,
        metavar="HZ",
        default=10,
        help="steps per second, in lockstep of simulated time; a heartbeat is sent every second "
        "(default %(default)s)",
    )
    group.add_argument(
        "--lockstep", action="store_true", help="tick by command frames, with the observations they bring"
    )
    group.add_argument("--steps", type=int, metavar="N", help="end after N steps (default: at Ctrl-C)")
    group.add_argument("--until-eof", action="store_true", help="also stop at end of input")
    group.add_argument(
        "--telemetry-period",
        type=int,
        metavar="STEPS",
        default=0,
        help="steps between telemetry frames, 0 for none; in lockstep it is 1 (default %(default)s)",
    )


def _add_observations(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("observations")
    group.add_argument(
        "--observations", metavar="FILE", help="read them from FILE or, if -, from standard input"
    )
    for name, kind, value, text in (
        ("fill-ratio", float, 0.55, "share of black tiles of the emulated world"),
        ("true-accuracy", float, 0.95, "of the emulated sensor"),
        ("seed", int, 1, "of the emulated world"),
    ):
        group.add_argument(f"--{name}", type=kind, default=value, help=f"{text} (default {value})")


def settings_of(args: argparse.Namespace) -> NodeSettings:
    """Node settings from parsed arguments. Raises UsageError for a value out of range."""
    if not 1 <= args.steps_per_second <= _MAX_RATE:
        raise UsageError(f"steps-per-second is {args.steps_per_second}; it must be 1 to {_MAX_RATE}")
    if args.steps is not None and args.steps < 1:
        raise UsageError(f"steps is {args.steps}; it must be 1 or more")
    period = 1 if args.lockstep else args.telemetry_period
    return NodeSettings(args.id, subjects_of(args), args.steps_per_second, period)


def _ending(is_asked: Callable[[], bool], until_eof: bool) -> Callable[[], bool]:
    """Condition that ends the node."""
    if not until_eof:
        return is_asked
    fd = standard_input()
    return lambda: is_asked() or has_ended(fd)


def _filters(settings: NodeSettings, lockstep: bool) -> CanFilters:
    subjects = settings.subjects
    return filters_for(subjects.estimates, *([subjects.commands] if lockstep else []))


def _source_of(args: argparse.Namespace) -> ObservationSource:
    if args.observations is not None:
        return LineSource(args.observations)
    return WorldSource(args.id, args.fill_ratio, args.true_accuracy, args.seed)


class _Watch:
    """Shows the node's state on a terminal, and reports at once what needs attention."""

    def __init__(self, console: Console, node: RobotNode, link: BusLink) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal and not console.quiet else None
        self._node = node
        self._link = link
        self._warned: set[int | str] = set()
        self._next = 0.0

    def __enter__(self) -> _Watch:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self) -> None:
        for sender, what in self._node.traffic.id_conflicts.items():
            self._warn(sender, f"{what.value}: {sender}; give one of them another")
        if self._link.last_failure is not None:
            self._warn(self._link.last_failure, f"the bus fails: {self._link.last_failure}; going on")
        if self._status is not None and time.monotonic() >= self._next:
            self._next = time.monotonic() + _SECONDS_BETWEEN_PICTURES
            self._status.update(_line(self._node))

    def _warn(self, key: int | str, text: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            self._console.print(f"mcp-asdf node: robot {self._node.settings.id}: {text}", soft_wrap=True)


def _line(node: RobotNode) -> str:
    robot, reception = node.robot, node.reception
    return (
        f"robot {node.settings.id}   t {robot.t}   n {robot.n}   b_hat {robot.b_hat:.4f}   "
        f"x_hat {robot.x_hat:.4f}   x {robot.x:.4f}   updates {node.counters.updates}   "
        f"sent {node.sent.estimates}   heard {reception.delivered}"
    )


def _parameters(args: argparse.Namespace) -> dict[str, Any]:
    own = (
        "steps_per_second",
        "lockstep",
        "steps",
        "telemetry_period",
        "observations",
        "fill_ratio",
        "true_accuracy",
    )
    return {name: getattr(args, name) for name in (*own, "seed")}


def _report(
    args: argparse.Namespace, run: NodeRun, record: RobotRecord, choice: interfaces.BusChoice
) -> dict[str, Any]:
    """Everything needed to repeat the run, and its results, as plain values."""
    subjects = {name: asdict(each) for name, each in vars(run.node.settings.subjects).items()}
    return {
        "parameters": _parameters(args) | {"robot": record.plain(), "subjects": subjects},
        "bus": {"interface": choice.interface, "channel": choice.channel},
        "versions": software_versions(),
        "results": {
            "steps": run.node.ticks,
            **vars(run.outcome),
            "robot": state_of(run.node),
            "frames": run.node.figures(),
            "bus_failures": run.link.failures,
        },
    }


def _print(
    args: argparse.Namespace,
    run: NodeRun,
    report: dict[str, Any],
    choice: interfaces.BusChoice,
) -> None:
    if args.json:
        print(json.dumps(report, indent=2))
    elif not args.quiet:
        Console(soft_wrap=True).print(_summary(run, report["results"], f"on {choice}"))
        print_again(args, seed=args.seed)


def _summary(run: NodeRun, results: dict[str, Any], where: str) -> Table:
    """Results as a table of two columns."""
    robot, frames, lateness = run.node.robot, results["frames"], run.outcome.lateness
    table = Table(box=None, padding=(0, 1), show_header=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row("run", f"{run.node.ticks} ticks as robot {run.node.settings.id}; {run.outcome.ending}")
    table.add_row("estimate", f"x {robot.x:.5f}, x_hat {robot.x_hat:.5f}, alpha {robot.alpha:.5g}")
    counters = run.node.counters
    table.add_row("filter", f"b_hat {robot.b_hat:.4f}, {counters.tests} tests, {counters.updates} updates")
    table.add_row(
        "frames",
        f"{frames['estimates_sent']} estimates, {frames['heartbeats_sent']} heartbeats and "
        f"{frames['telemetry_sent']} telemetry sent {where}; {frames['delivered']} estimates heard, "
        f"{frames['refused']} of them refused, {sum(frames['rejected'].values())} other frames rejected",
    )
    for sender, what in frames["id_conflicts"].items():
        table.add_row("node-id conflict", f"{what}: {sender}; give one of them another")
    if run.link.failures:
        table.add_row("bus", f"failed {run.link.failures} times, the last: {run.link.last_failure}")
    if lateness is not None:
        table.add_row(
            "lateness",
            f"mean {_ms(lateness['mean_lateness'])}, at most {_ms(lateness['max_lateness'])}, "
            f"{lateness['late_ticks']} late ticks, drift {_ms(lateness['drift'])}",
        )
    return table


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms"


def _exit_code(run: NodeRun) -> int:
    if run.outcome.has_failed:
        print(f"mcp-asdf node: {run.outcome.ending}", file=sys.stderr)
        return 1
    return INTERRUPTED if run.outcome.is_interrupted else 0
