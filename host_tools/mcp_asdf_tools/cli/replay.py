"""``mcp-asdf replay``: run the robots of a log again, or its frames over a bus."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.bus.frames import MAX_NODE_ID
from mcp_asdf_tools.cli.again import print_again
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import INTERRUPTED, stopping
from mcp_asdf_tools.recording.frame_logs import PART, check_log, read_log
from mcp_asdf_tools.recording.input_log import InputLogReader, input_log_of
from mcp_asdf_tools.recording.replay import Playback, Player, ReplayVerdict, verify

EPILOG = """\
examples:
  mcp-asdf replay run.log                       # is every broadcast what the firmware makes of it?
  mcp-asdf replay run.log --interface socketcan --channel can0 --onto-bus --leave-out 3
  mcp-asdf replay run.log --interface socketcan --channel vcan0 --onto-bus --speed 0   # flat out
Checking needs the file FILE.events that swarm and node write beside their logs. Without it the log is played
onto the bus: --leave-out keeps back the frames of the robot that is there itself.
exit code: 0 done, 1 a broadcast is not reproduced or the bus refused frames, 2 bad usage, 128 + signal
if interrupted"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "log", metavar="LOG", type=Path, help=".log (candump), .asc, .blf, .csv, .mf4 or .trc"
    )
    parser.add_argument(
        "--events", metavar="FILE", type=Path, help="what happened to the robots (default: LOG.events)"
    )
    group = parser.add_argument_group("playing onto a bus")
    group.add_argument("--onto-bus", action="store_true", help="play even if LOG.events is there")
    group.add_argument(
        "--speed",
        type=float,
        metavar="FACTOR",
        default=1.0,
        help="recorded seconds per second, 0 for as fast as possible (default %(default)s)",
    )
    group.add_argument(
        "--leave-out", type=int, metavar="ID", nargs="+", default=[], help="nodes whose frames are not sent"
    )
    interfaces.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Check the log or play it."""
    _check(args)
    if args.log.suffix == PART:
        print(f"mcp-asdf replay: {args.log} is incomplete: its run was cut off", file=sys.stderr)
    events = args.events or input_log_of(args.log)
    if args.onto_bus or (args.events is None and not events.exists()):
        return _play(args)
    if args.leave_out or args.speed != 1:
        raise UsageError(f"--speed and --leave-out are for playing, and {events} is there; add --onto-bus")
    console = Console(stderr=True)
    with (
        InputLogReader(events) as input_log,
        Progress(console=console, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task("running the robots again", total=input_log.bytes)
        verdict = verify(
            read_log(args.log), input_log, lambda: bar.update(task, completed=input_log.bytes_read)
        )
    report = {
        "log": str(args.log),
        "events": str(events),
        "incomplete": args.log.suffix == PART,
        "verdict": verdict.plain(),
    }
    _print(args, report, _table_of(verdict))
    if verdict.difference is not None:
        print(f"mcp-asdf replay: not reproduced: {verdict.difference}", file=sys.stderr)
    elif not verdict.reproduced + verdict.falsified:
        raise UsageError(f"{args.log} holds no estimate of the robots in {events}; do they belong together?")
    return 0 if verdict.difference is None else 1


def _check(args: argparse.Namespace) -> None:
    if not 0 <= args.speed < float("inf"):
        raise UsageError(f"speed is {args.speed}; it must be 0 (flat out) or a positive factor")
    check_log(args.log)
    for robot in args.leave_out:
        if not 0 <= robot <= MAX_NODE_ID:
            raise UsageError(f"leave-out is {robot}; ids are 0 to {MAX_NODE_ID}")


def _play(args: argparse.Namespace) -> int:
    choice = interfaces.choose_bus(args)
    if choice.interface == interfaces.DEFAULT_INTERFACE:
        raise UsageError(
            f"the bus {choice} is inside this process, where no other program hears {args.log}: choose "
            f"another with --interface; or, to check the log, give {input_log_of(args.log)} or --events"
        )
    with ExitStack() as stack:
        bus = stack.enter_context(choice.open())
        player = Player(bus, args.speed, args.leave_out, stack.enter_context(stopping()))
        playback, console = player.playback, Console(stderr=True)
        if console.is_terminal:
            status = stack.enter_context(console.status(""))
            player.progress = lambda: status.update(f"{playback.sent} frames sent")
        player.play(read_log(args.log))
    report = {"log": str(args.log), "bus": str(choice), "playback": playback.plain()}
    _print(args, report, _line_of(playback))
    if playback.is_stopped:
        return INTERRUPTED
    if playback.failures:
        print(f"mcp-asdf replay: the bus refused frames: {playback.last_failure}", file=sys.stderr)
    return 1 if playback.failures else 0


def _print(args: argparse.Namespace, report: dict[str, Any], text: str | Table) -> None:
    if args.json:
        print(json.dumps(report, indent=2))
    else:
        Console(soft_wrap=True).print(text)
        print_again(args)


def _table_of(verdict: ReplayVerdict) -> Table:
    table = Table(box=None, padding=(0, 1), show_header=False)
    table.add_column(justify="right", style="bold")
    table.add_column()
    for count, text in (
        (verdict.reproduced, "broadcasts reproduced bit for bit"),
        (verdict.falsified, "broadcasts that a fault had given other values"),
        (verdict.foreign, "frames under a robot's id that it did not send"),
        (verdict.not_logged, "broadcasts that the log lacks"),
        (verdict.beyond, "broadcasts after the events were cut off"),
        (verdict.other, "other frames"),
    ):
        table.add_row(str(count), text)
    return table


def _line_of(playback: Playback) -> str:
    return (
        f"{playback.sent} frames sent in {playback.seconds:.1f} s, {playback.skipped} skipped, "
        f"{playback.failures} refused by the bus; at most {1e3 * playback.lateness:.1f} ms late"
    )
