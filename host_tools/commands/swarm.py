"""``mcp-asdf swarm``: emulate a swarm of robots on a CAN bus."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from host_tools import buses
from host_tools.commands.swarm_options import add_arguments, settings_of, wiring_of
from host_tools.connection import Taker
from host_tools.errors import UsageError
from host_tools.files import write_atomically
from host_tools.live import LiveTable
from host_tools.lockstep import LockstepError
from host_tools.logs import FrameLog
from host_tools.node import Subjects
from host_tools.processes import NodeProcesses, start_nodes
from host_tools.sidecar import Header, SidecarWriter, sidecar_path
from host_tools.slcan import HOST, SlcanServer
from host_tools.stopping import stopping
from host_tools.swarm import Swarm
from host_tools.swarm_run import Hook, Run, run_swarm
from host_tools.swarm_settings import MAX_ROBOTS_AND_TOOLS, Settings, robot_records
from host_tools.swarm_summary import load_warning, one_line, summary

__all__ = ["EPILOG", "HELP", "add_arguments", "run", "settings_of"]

HELP = "emulate a swarm on a CAN bus and watch it calibrate itself"
EPILOG = """\
examples:
  mcp-asdf swarm                                    # the paper's swarm on a bus inside this process
  mcp-asdf swarm --filter off --plot off.png        # the same without the filter, as a picture
  mcp-asdf swarm --flawed 0.5 --seed 7 --log run.blf --json
  mcp-asdf swarm --interface socketcan --channel vcan0 --robots 5
  mcp-asdf swarm --slcan 20000                      # yakut and the like join at socket://127.0.0.1:20000
  mcp-asdf swarm --density 1 --ticks 10000          # robots that move and hear who is within 0.7 m
  mcp-asdf swarm --fault loss=0.5 --fault liar,robots=3,x=1,alpha=1e6
  mcp-asdf swarm --channel 'vcan{robot}' --fault babble=0.1,robots=0,frames=30 --log run.log
  mcp-asdf swarm --clock real-time --ticks 100
  mcp-asdf swarm --interface udp_multicast --processes --robots 4 --ticks 100
  mcp-asdf swarm --channel 'vcan{robot}' --device 3=slcan:socket://127.0.0.1:20001
With {robot} in the channel each robot has a bus of its own, and a medium carries frames between them. The
same settings give the same run and, on the bus inside this process, the same log to the byte. More about
media, faults and clocks is in docs/swarm.md.
Each delivered message costs about 12 us, two thirds of it in python-can's virtual bus, and a tick of N
robots delivers N (N - 1) of them: fewer robots or a longer --comms-period give more ticks in the same time.
exit code: 0 done, 1 the bus lost a frame or a robot elsewhere did not answer, 2 bad usage, 130 interrupted
(what was done is saved)"""

_INTERRUPTED = 130
_STARTING_TIMEOUT = 60.0
"""Seconds that robots elsewhere have to say that they are there."""


def run(args: argparse.Namespace) -> int:
    """Run the swarm, save and print what came out."""
    settings = settings_of(args)
    choice = buses.choose_bus(args)
    wiring = wiring_of(args, settings, choice)
    save_plot = _plotter(args.plot)
    console = Console(quiet=args.quiet or args.json)
    began = time.monotonic()
    try:
        with ExitStack() as stack:
            _admit(args, settings, choice, console, stack)
            swarm = stack.enter_context(Swarm(settings, wiring, *_outputs(args, settings, stack)))
            nodes = stack.enter_context(_start(args, settings, choice))
            with console.status("waiting for robots elsewhere"):
                swarm.wait_until_up(_STARTING_TIMEOUT, nodes.check)
            table, stop = stack.enter_context(LiveTable(console)), stack.enter_context(_interruptible())
            outcome = run_swarm(swarm, [table, stop])
    except LockstepError as error:
        print(f"mcp-asdf swarm: {error}", file=sys.stderr)
        return 1
    save_plot(outcome)
    report = outcome.report({"interface": choice.interface, "channel": choice.channel})
    report["processes"] = {str(robot): each for robot, each in sorted(nodes.reports.items())}
    for path in filter(None, (args.log, args.plot)):
        write_atomically(f"{path}.json", json.dumps(report, indent=2) + "\n")
    _print(args, outcome, report, summary(outcome, str(choice), time.monotonic() - began))
    return _exit_code(outcome)


def _admit(
    args: argparse.Namespace, settings: Settings, choice: buses.BusChoice, console: Console, stack: ExitStack
) -> None:
    """Let other programs join the bus, if asked to; ``stack`` ends that."""
    if args.slcan is None:
        return
    if choice.has_channels:
        raise UsageError(
            f"--slcan needs one bus for all, and {choice} is one for each robot; choose one of them"
        )
    if settings.robots > MAX_ROBOTS_AND_TOOLS:
        raise UsageError(
            f"robots is {settings.robots}; with --slcan take at most {MAX_ROBOTS_AND_TOOLS}, since tools use "
            "the ids 126 and 127"
        )
    server = stack.enter_context(SlcanServer(choice.open(), args.slcan))
    console.print(f"the bus is an slcan adapter, too: socket://{HOST}:{server.port}")


def _outputs(
    args: argparse.Namespace, settings: Settings, stack: ExitStack
) -> tuple[Taker | None, SidecarWriter | None]:
    """Where frames and events go; ``stack`` completes both files."""
    if args.log is None:
        return None, None
    log = stack.enter_context(FrameLog(args.log))
    header = Header(robot_records(settings), settings.seed, settings.frames, settings.parameters())
    return log.write, stack.enter_context(SidecarWriter(sidecar_path(args.log), header))


def _start(args: argparse.Namespace, settings: Settings, choice: buses.BusChoice) -> NodeProcesses:
    """The robots' processes; none unless asked for."""
    if not args.processes:
        return NodeProcesses()
    subjects = Subjects(estimates=settings.frames)
    return start_nodes(robot_records(settings), choice.of_robot, subjects, settings.ticks_per_second)


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
    with stopping((signal.SIGINT,)) as is_asked:

        def obey(swarm: Swarm) -> None:
            if is_asked():
                raise KeyboardInterrupt

        yield obey


def _print(args: argparse.Namespace, outcome: Run, report: dict[str, Any], table: Table) -> None:
    if args.json:
        print(json.dumps(report, indent=2))
    elif args.quiet:
        print(one_line(outcome))
    else:
        Console(soft_wrap=True).print(table)
        warning = load_warning(outcome.results)
        if warning is not None:
            print(f"mcp-asdf swarm: {warning}", file=sys.stderr)


def _exit_code(outcome: Run) -> int:
    if outcome.failure is not None:
        print(f"mcp-asdf swarm: failed in {outcome.failure}", file=sys.stderr)
        return 1
    return _INTERRUPTED if outcome.interrupted else 0
