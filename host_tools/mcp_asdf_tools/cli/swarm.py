"""``mcp-asdf swarm``: emulate a swarm of robots on a CAN bus."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
from rich.console import Console

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.bus.slcan_server import HOST, SlcanServer
from mcp_asdf_tools.cli import view
from mcp_asdf_tools.cli.again import print_again
from mcp_asdf_tools.cli.recordings import exit_code, recording_for
from mcp_asdf_tools.cli.swarm_options import add_arguments, settings_of, wiring_of
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import FileSet, results_beside
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from mcp_asdf_tools.recording.input_log import InputLogHeader
from mcp_asdf_tools.recording.recording import LogOutputs
from mcp_asdf_tools.robots.lockstep import LockstepError
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.processes import NodeProcesses, node_processes
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.live_view import LiveView
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings
from mcp_asdf_tools.swarm.summary import (
    Rows,
    comparison,
    load_warning,
    one_line,
    summary,
    summary_table,
)
from mcp_asdf_tools.swarm.swarm import Companion, Swarm, SwarmHook, SwarmRun, run_swarm

if TYPE_CHECKING:
    from mcp_asdf_tools.view.films import SwarmCamera

__all__ = ["EPILOG", "add_arguments", "run", "settings_of"]

EPILOG = """\
examples:
  mcp-asdf swarm                                    # the paper's swarm on a bus inside this process
  mcp-asdf swarm --filter none --plot off.png       # the same without the filter, as a picture
  mcp-asdf swarm --topology dynamic --filter asdf-minus --flawed 50% --compare   # and without it
  mcp-asdf swarm --topology dynamic --view          # in a browser, as it goes
  mcp-asdf swarm --flawed 0.5 --seed 7 --log run.log --json
  mcp-asdf swarm --interface socketcan --channel vcan0 --robots 5
  mcp-asdf swarm --slcan 20000                      # others join at socket://127.0.0.1:20000
  mcp-asdf swarm --topology dynamic                 # robots move and hear those within 0.7 m
  mcp-asdf swarm --fault loss=0.5 --fault liar,robots=3,x=1,alpha=1e6
  mcp-asdf swarm --channel 'vcan{robot}' --fault babble=0.1,robots=0,frames=30 --log run.log
  mcp-asdf swarm --clock real-time --steps 100
  mcp-asdf swarm --interface udp_multicast --processes --robots 4 --steps 100
  mcp-asdf swarm --channel 'vcan{robot}' --device 3=slcan:socket://127.0.0.1:20001
With {robot} in the channel each robot has a bus of its own, and frames are carried between them. The
same settings give the same run and, on the bus inside this process, the same log to the byte. More about
media, faults and clocks is in docs/swarm.md.
The bus inside this process is left out where nothing else can listen (no --slcan,
--processes, --device or {robot}), which makes runs twice as fast; frames, logs and
states stay the same to the bit.
exit code: 0 done, 1 the bus lost a frame or a robot elsewhere did not answer, 2 bad usage, 128 + signal
if interrupted (what was done is saved)"""

_STARTING_TIMEOUT = 60.0
"""Seconds that robots elsewhere have to say that they are there."""


@dataclass
class _Attached:
    """Companions of a swarm's run.

    Attributes:
        camera: Takes a film of it, if one is wanted.
        companion: The same swarm without the filter, if they are to be compared.
    """

    camera: SwarmCamera | None = None
    companion: Companion | None = None

    @property
    def hooks(self) -> list[SwarmHook]:
        """Those there are, in the order in which they have to act."""
        return [each for each in (self.companion, self.camera) if each is not None]

    @property
    def seconds(self) -> float:
        """Time spent on the other swarm."""
        return 0.0 if self.companion is None else self.companion.seconds


def run(args: argparse.Namespace) -> int:
    """Run the swarm, save and print what came out."""
    settings = settings_of(args)
    choice = interfaces.choose_bus(args)
    wiring = wiring_of(args, settings, choice)
    _check_comparison(args, settings, wiring)
    if args.plot is not None:
        from mcp_asdf_tools.common.figures import check_plot_path  # noqa: PLC0415

        check_plot_path(args.plot)
    beside = [results_beside(path) for path in (args.log, args.plot) if path is not None]
    header = InputLogHeader(settings.records(), settings.seed, settings.frames, settings.plain())
    recording = recording_for("swarm", args.log, header, choice)
    began = time.monotonic()
    try:
        with ExitStack() as ending:
            attached = _attach(args, settings, ending)
            with recording as outputs:
                outcome, report = _emulate(args, (settings, choice, wiring), outputs, attached)
                seconds = time.monotonic() - began - attached.seconds
                # Printed even if a file cannot be completed.
                rows = summary(outcome, str(choice), seconds)
                ending.callback(_print, args, outcome, report, rows)
            with FileSet() as files:
                if args.plot is not None:
                    files.write(args.plot, _picture(outcome, args.plot))
                for path in beside:
                    files.write(path, json.dumps(report, indent=2) + "\n")
    except (LockstepError, can.CanError) as error:
        print(f"mcp-asdf swarm: {error}", file=sys.stderr)
        return 1
    return exit_code(recording, _exit_code(outcome))


def _picture(outcome: SwarmRun, path: Path) -> bytes:
    """The plot of a run that is over."""
    from mcp_asdf_tools.common.figures import image_of  # noqa: PLC0415
    from mcp_asdf_tools.swarm.plot import draw  # noqa: PLC0415

    return image_of(draw(outcome), path)


def _attach(args: argparse.Namespace, settings: SwarmSettings, ending: ExitStack) -> _Attached:
    camera = _camera(args, settings, ending)
    if not args.compare:
        return _Attached(camera)
    companion = Companion(settings)
    ending.enter_context(companion.swarm)
    return _Attached(camera, companion)


def _emulate(
    args: argparse.Namespace,
    chosen: tuple[SwarmSettings, interfaces.BusChoice, Wiring],
    outputs: LogOutputs,
    attached: _Attached,
) -> tuple[SwarmRun, dict[str, Any]]:
    """Run the swarm; returns what came out, and all of it with all settings as plain values.

    Raises LockstepError if robots elsewhere do not start, can.CanError if their bus fails before they have.
    """
    settings, choice, wiring = chosen
    with ExitStack() as stack:
        port = _admit(args, settings, choice, stack)
        swarm = stack.enter_context(Swarm(settings, wiring, *outputs))
        nodes = stack.enter_context(_start(args, settings, choice))
        with _console(args).status("waiting for robots elsewhere"):
            swarm.wait_until_up(_STARTING_TIMEOUT, nodes.check)
        outcome = _watched(args, swarm, attached)
    report = outcome.report({"interface": choice.interface, "channel": choice.channel, "slcan": port})
    report["processes"] = {str(robot): each for robot, each in sorted(nodes.reports.items())}
    if attached.companion is not None and outcome.failure is None:
        report["without_filter"] = attached.companion.results()
    return outcome, report


def _check_comparison(args: argparse.Namespace, settings: SwarmSettings, wiring: Wiring) -> None:
    if args.compare and (wiring.remote or settings.filter == "none"):
        reason = "robots elsewhere run once" if wiring.remote else "filter is none"
        raise UsageError(f"--compare runs the swarm again without the filter, but {reason}; leave it out")


def _watched(args: argparse.Namespace, swarm: Swarm, attached: _Attached) -> SwarmRun:
    """Run a swarm to its end or Ctrl-C, and show it meanwhile."""
    with LiveView(_console(args), attached.companion) as live, _interruptible() as stop:
        return run_swarm(swarm, [*attached.hooks, live, stop])


def _camera(args: argparse.Namespace, settings: SwarmSettings, ending: ExitStack) -> SwarmCamera | None:
    """A film of the run, if one is wanted, shown as it goes in a browser until ``ending``."""
    if not args.view:
        return None
    from mcp_asdf_tools.view.films import SwarmCamera  # noqa: PLC0415
    from mcp_asdf_tools.view.server import serving  # noqa: PLC0415

    camera = SwarmCamera(settings)
    view.announce(args, ending.enter_context(serving(camera.film, args.port)))
    ending.push(lambda kind, error, trace: _let_look(args, camera, kind is None))
    return camera


def _let_look(args: argparse.Namespace, camera: SwarmCamera, is_regular: bool) -> None:
    """The run is over; its page stays until Ctrl-C, unless an error ended it."""
    camera.film.has_ended = True
    sys.stdout.flush()
    if is_regular:
        with stopping() as should_stop:
            view.wait(should_stop)


def _console(args: argparse.Namespace) -> Console:
    return Console(quiet=args.quiet or args.json)


def _admit(
    args: argparse.Namespace, settings: SwarmSettings, choice: interfaces.BusChoice, stack: ExitStack
) -> int | None:
    """Let other programs join the bus, if asked to, until ``stack`` ends; returns the TCP port."""
    if args.slcan is None:
        return None
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
    # On standard error: with port 0 the user needs the number, and standard output may be JSON.
    print(f"the bus is an slcan adapter, too: socket://{HOST}:{server.port}", file=sys.stderr, flush=True)
    return server.port


def _start(args: argparse.Namespace, settings: SwarmSettings, choice: interfaces.BusChoice) -> NodeProcesses:
    """The robots' processes; none unless asked for."""
    if not args.processes:
        return NodeProcesses({})
    subjects = Subjects(estimates=settings.frames)
    return node_processes(settings.records(), choice.of_robot, subjects, settings.steps_per_second)


@contextmanager
def _interruptible() -> Iterator[SwarmHook]:
    """Turn a signal into a KeyboardInterrupt between two ticks, so that log and results end on a whole one.

    Ctrl-C after that, if a tick does not end, acts at once.
    """
    with stopping() as is_asked:

        def obey(swarm: Swarm) -> None:
            if is_asked():
                raise KeyboardInterrupt

        yield obey


def _print(args: argparse.Namespace, outcome: SwarmRun, report: dict[str, Any], rows: Rows) -> None:
    """Print results: as JSON, in a line, as a table on a terminal, else in lines with tabs."""
    console = Console()
    if args.json:
        print(json.dumps(report, indent=2))
        return
    if args.quiet:
        print(one_line(outcome))
    elif console.is_terminal:
        console.print(summary_table(rows))
    else:
        print("\n".join("\t".join(row) for row in rows))
    if not args.quiet:
        warning = load_warning(outcome.results)
        if warning is not None:
            print(f"mcp-asdf swarm: {warning}", file=sys.stderr)
        print_again(args, seed=outcome.settings.seed)
    if "without_filter" in report:
        sentence = comparison(report["results"], report["without_filter"])
        console.print(sentence, soft_wrap=not console.is_terminal, markup=False, highlight=False)


def _exit_code(outcome: SwarmRun) -> int:
    if outcome.failure is not None:
        print(f"mcp-asdf swarm: failed in {outcome.failure}", file=sys.stderr)
        return 1
    return INTERRUPTED if outcome.interrupted else 0
