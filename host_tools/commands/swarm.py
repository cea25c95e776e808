"""``mcp-asdf swarm``: emulate a swarm of robots on a CAN bus."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console
from rich.table import Table

from host_tools import buses
from host_tools.errors import UsageError
from host_tools.files import write_atomically
from host_tools.firmwares import FIRMWARES
from host_tools.frames import FrameFormat
from host_tools.live import LiveTable, one_line, summary
from host_tools.logs import FrameLog
from host_tools.slcan import HOST, SlcanServer
from host_tools.swarm import Deployment, Settings, Swarm
from host_tools.swarm_run import Hook, Run, run_swarm
from host_tools.tables import parse_omega

HELP = "emulate a swarm on a CAN bus and watch it calibrate itself"
EPILOG = """\
examples:
  mcp-asdf swarm                                    # the paper's swarm on a bus inside this process
  mcp-asdf swarm --filter off --plot off.png        # the same without the filter, as a picture
  mcp-asdf swarm --flawed 0.5 --seed 7 --log run.blf --json
  mcp-asdf swarm --interface socketcan --channel vcan0 --robots 5
  mcp-asdf swarm --slcan 20000                      # yakut and the like join at socket://127.0.0.1:20000
The same settings give the same run and, on the bus inside this process, the same log to the byte.
Each delivered message costs about 11 us, three quarters of it in python-can's virtual bus, and a tick of N
robots delivers N (N - 1) of them: fewer robots or a longer --comms-period give more ticks in the same time.
exit code: 0 done, 1 the bus lost a frame, 2 bad usage, 130 interrupted (what was done is saved)"""

_DEFAULTS = Settings()
_INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    _add_experiment(parser)
    _add_robots(parser)
    _add_bus_and_output(parser)


def run(args: argparse.Namespace) -> int:
    """Run the swarm, save and print what came out."""
    settings = settings_of(args)
    choice = buses.choose_bus(args)
    save_plot = _plotter(args.plot)
    console = Console(quiet=args.quiet or args.json)
    began = time.monotonic()
    with ExitStack() as stack:
        if args.slcan is not None:
            server = stack.enter_context(SlcanServer(choice.open(), args.slcan))
            console.print(f"the bus is an slcan adapter, too: socket://{HOST}:{server.port}")
        log = None if args.log is None else stack.enter_context(FrameLog(args.log))
        swarm = stack.enter_context(Swarm(settings, choice.open, None if log is None else log.write))
        hooks: list[Hook] = [stack.enter_context(LiveTable(console)), stack.enter_context(_interruptible())]
        outcome = run_swarm(swarm, hooks)
    save_plot(outcome)
    report = outcome.report({"interface": choice.interface, "channel": choice.channel})
    for path in filter(None, (args.log, args.plot)):
        write_atomically(f"{path}.json", json.dumps(report, indent=2) + "\n")
    _print(args, outcome, report, summary(outcome, str(choice), time.monotonic() - began))
    return _exit_code(outcome)


def _add_experiment(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("experiment")
    _add(group, "robots", int, "N", "number of robots, 1 to 126")
    _add(group, "flawed", float, "P", "proportion of robots with a flawed assumed accuracy, 0 to 1")
    _add(group, "fill-ratio", float, "F", "share of black tiles, 0 to 1")
    _add(group, "true-accuracy", float, "B", "true accuracy of every sensor; the other robots assume it")
    _add(group, "flawed-accuracy", float, "B", "accuracy that flawed robots assume at the start")
    _add(group, "ticks", int, "N", "length of the run")
    _add(group, "ticks-per-second", int, "N", "of simulated time; heartbeats are sent once a second")
    _add(group, "seed", int, "N", "of everything random")


def _add_robots(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("robots")
    filters = [deployment.value for deployment in Deployment]
    group.add_argument(
        "--filter",
        choices=filters,
        default=_DEFAULTS.filter.value,
        help="which robots recalibrate: all (ASDF+), only the flawed (ASDF-), none (default %(default)s)",
    )
    _add(group, "comms-period", int, "TICKS", "ticks between broadcasts")
    _add(group, "filter-period", int, "TICKS", "nominal filtering period tau, a multiple of --comms-period")
    _add(group, "omega", str, "W", "type II error probability, above 0 and at most 0.9")
    _add(group, "memory", int, "M", "observations at which t and n are halved, even, at least 64")
    group.add_argument(
        "--firmware",
        choices=list(FIRMWARES),
        default=_DEFAULTS.firmware,
        help="the C itself, the same in Python integers, or the paper's equations (default %(default)s)",
    )


def _add_bus_and_output(parser: argparse.ArgumentParser) -> None:
    buses.add_arguments(parser)
    parser.add_argument(
        "--slcan",
        metavar="PORT",
        type=int,
        help="let other programs join the bus as an slcan adapter at this TCP port (0: any free one)",
    )
    frames = parser.add_argument_group("frames")
    _add(
        frames, "telemetry-period", int, "TICKS", "ticks between two telemetry frames of a robot, 0 for none"
    )
    frame_format = _DEFAULTS.frames
    frames.add_argument(
        "--subject",
        type=int,
        default=frame_format.subject,
        help="Cyphal subject, 0 to 6143 (default %(default)s)",
    )
    frames.add_argument(
        "--priority", type=int, default=frame_format.priority, help="0 (first) to 7 (default %(default)s)"
    )
    output = parser.add_argument_group("output (beside each file, FILE.json gets all parameters and results)")
    output.add_argument("--plot", metavar="FILE", type=Path, help="draw the run: .png, .svg or .pdf")
    output.add_argument(
        "--log",
        metavar="FILE",
        type=Path,
        help="keep all frames: .log (candump), .asc, .blf, .csv, .trc, .txt",
    )
    output.add_argument("--quiet", action="store_true", help="no live table, and one line for a summary")


def _add(
    group: argparse._ArgumentGroup, name: str, kind: Callable[[str], Any], metavar: str, text: str
) -> None:
    default = getattr(_DEFAULTS, name.replace("-", "_"))
    group.add_argument(
        f"--{name}", type=kind, metavar=metavar, default=default, help=f"{text} (default {default})"
    )


def settings_of(args: argparse.Namespace) -> Settings:
    """Read the settings from parsed arguments. Raises UsageError if they will not do."""
    own = {item.name: getattr(args, item.name) for item in fields(Settings) if item.name != "frames"}
    own |= {"filter": Deployment(args.filter), "omega": parse_omega(str(args.omega))}
    try:
        return Settings(frames=FrameFormat(args.subject, args.priority), **own)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _plotter(path: Path | None) -> Callable[[Run], None]:
    """What draws a run into ``path``. Raises UsageError, before the run, if that cannot be done."""
    if path is None:
        return lambda run: None
    # Loading matplotlib takes longer than a short run; only who wants a picture shall wait for it.
    from host_tools.plot_files import check_plot_path, save_figure  # noqa: PLC0415
    from host_tools.swarm_plot import draw  # noqa: PLC0415

    checked = check_plot_path(path)
    return lambda run: save_figure(draw(run), checked)


@contextmanager
def _interruptible() -> Iterator[Hook]:
    """Turn Ctrl-C into a KeyboardInterrupt between two ticks, so that log and results end on a whole one.

    A second Ctrl-C, if the first finds a tick that does not end, acts at once.
    """
    asked = False

    def note(signum: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    def obey(swarm: Swarm) -> None:
        if asked:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield obey
        return
    previous = signal.signal(signal.SIGINT, note)
    try:
        yield obey
    finally:
        signal.signal(signal.SIGINT, previous)


def _print(args: argparse.Namespace, outcome: Run, report: dict[str, Any], table: Table) -> None:
    if args.json:
        print(json.dumps(report, indent=2))
    elif args.quiet:
        print(one_line(outcome))
    else:
        Console(soft_wrap=True).print(table)


def _exit_code(outcome: Run) -> int:
    if outcome.failure is not None:
        print(f"mcp-asdf swarm: failed in {outcome.failure}", file=sys.stderr)
        return 1
    return _INTERRUPTED if outcome.interrupted else 0
