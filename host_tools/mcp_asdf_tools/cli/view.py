"""``mcp-asdf view``: see a run in a browser."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import can

from mcp_asdf_tools.bus import interfaces
from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.cli.experiment_options import add_where, chosen
from mcp_asdf_tools.cli.failures import report_failure
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, write_atomically
from mcp_asdf_tools.common.signals import stopping
from mcp_asdf_tools.recording.events import events_path

if TYPE_CHECKING:
    from mcp_asdf_tools.view.film import History

EPILOG = """\
examples:
  mcp-asdf view run.parquet                         # trial 0 of what simulate has kept
  mcp-asdf view grid.parquet --where filter=none --trial 3
  mcp-asdf view run.log                             # a log of swarm, beside run.log.events
  mcp-asdf view run.log --export run.html           # one file that needs nothing else
  mcp-asdf view candump.log --channel can0          # a log of real robots: what their frames say
  mcp-asdf view --interface socketcan --channel vcan0       # robots elsewhere that send telemetry
mcp-asdf swarm --view shows a swarm as it runs.
The page is for browsers of this computer alone; Ctrl-C ends it. A recording need not hold positions and
floor: they follow from its seed and parameters.
exit code: 0 done, 1 the bus failed, 2 bad usage, 130 interrupted"""

_WAKING_INTERVAL = 0.2
"""Seconds between two checks whether Ctrl-C was pressed."""
_NO_TELEMETRY = "no robot sent telemetry, which has x and b_hat: see mcp-asdf swarm --telemetry-period 1"
_RESULTS = (".parquet", ".pq")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of the command."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, nargs="?", help="results (.parquet) or a log; without one, a bus"
    )
    recording = parser.add_argument_group("recordings")
    recording.add_argument(
        "--trial", metavar="N", type=int, default=0, help="which one (default %(default)s)"
    )
    add_where(recording)
    recording.add_argument("--export", metavar="FILE", type=Path, help="write the page as one file: .html")
    truth = parser.add_argument_group("truth of a bus, or of a log of real robots, drawn if known")
    truth.add_argument("--fill-ratio", metavar="F", type=float, help="f, share of black tiles")
    truth.add_argument("--true-accuracy", metavar="B", type=float, help="b of every sensor")
    add_server_options(parser)
    parser.add_argument(
        "--subject", type=int, help=f"of estimates on a bus (default {FrameFormat().subject})"
    )
    interfaces.add_arguments(parser)


def add_server_options(parser: argparse._ActionsContainer) -> None:
    """Add the options of commands that serve a page."""
    parser.add_argument("--port", type=int, help="TCP port of the page (default: any free one)")


def run(args: argparse.Namespace) -> int:
    """Serve the page of a recording or of a bus, or write it with --export; return the exit code."""
    if args.file is None:
        return _watch(args)
    _check_recording_options(args)
    if args.export is None:
        return _serve(args, _read_recording(args))
    if args.export.suffix.lower() != ".html":
        raise UsageError(f"cannot export to {args.export.name}: choose a name that ends in .html")
    check_target(args.export)
    return _export(args, _read_recording(args))


def _check_recording_options(args: argparse.Namespace) -> None:
    """Raise UsageError for an option that does nothing where a recording is shown."""
    unused_options = ["interface", "bitrate", "bus_kwargs"]
    has_parameters = args.file.suffix.lower() in _RESULTS or events_path(args.file).exists()
    if has_parameters:  # what the frames of any other log mean is for the user to say
        unused_options += ["fill_ratio", "true_accuracy", "subject", "channel"]
    for name in unused_options:
        if getattr(args, name, None) is not None:
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"{option} is for a bus, but {args.file} is a recording; leave one of them out")
    if args.export is not None and args.port is not None:
        raise UsageError("--port is for a page that is served, but --export writes a file; leave it out")


def _read_recording(args: argparse.Namespace) -> History:
    """Return the history of the recording ``args.file``: a trial of results, or a log.

    Raises UsageError if there is none, or for options that do not go with it.
    """
    from mcp_asdf_tools.experiments.results import single_experiment  # noqa: PLC0415
    from mcp_asdf_tools.view.films import recompute_swarm_history, recompute_trial_history  # noqa: PLC0415

    if args.file.suffix.lower() in _RESULTS:
        return recompute_trial_history(single_experiment(chosen(args)), args.trial)
    if args.trial or args.where:
        raise UsageError(f"--trial and --where choose from results (.parquet), but {args.file} is a log")
    if not args.file.exists():
        raise UsageError(f"there is no log {args.file}; give one that swarm --log wrote")
    if not events_path(args.file).exists():
        return _read_frame_history(args)
    return recompute_swarm_history(args.file)


def _read_frame_history(args: argparse.Namespace) -> History:
    """Return the history of a log without events, and print what it lacks to standard error."""
    from mcp_asdf_tools.view.frame_film import read_frame_history  # noqa: PLC0415

    channel = getattr(args, "channel", None)
    frame_history = read_frame_history(
        args.file, _frame_format(args), channel, args.fill_ratio, args.true_accuracy
    )
    notes = [
        f"there is no {events_path(args.file)}, which swarm, radio and node write beside their "
        "logs: the page shows what the frames say"
    ]
    summary = frame_history.summary
    if channel is None and len(summary.channels) > 1:
        notes.append(f"{args.file} has frames of {summary.channel_names}; choose one by --channel")
    if summary.warning is not None:
        notes.append(f"of {args.file} {summary.warning}")
    if not frame_history.has_telemetry:
        notes.append(_NO_TELEMETRY)
    for note in notes:
        print(f"mcp-asdf view: {note}", file=sys.stderr)
    return frame_history.history


def _frame_format(args: argparse.Namespace) -> FrameFormat:
    """Return the format of estimates. Raises UsageError if --subject is none."""
    try:
        return FrameFormat() if args.subject is None else FrameFormat(args.subject)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _export(args: argparse.Namespace, history: History) -> int:
    """Write the page of a history as one file, and print its name; return exit code 0."""
    from mcp_asdf_tools.view.page import page  # noqa: PLC0415

    content = page(history).encode()
    write_atomically(args.export, content)
    report = {"export": str(args.export), "bytes": len(content), "states": len(history.states_since().states)}
    print(json.dumps(report) if args.json else args.export)
    return 0


def _serve(args: argparse.Namespace, history: History) -> int:
    """Serve the page of a history until Ctrl-C; return exit code 0."""
    from mcp_asdf_tools.view.server import serving  # noqa: PLC0415

    with stopping() as should_stop, serving(history, args.port) as url:
        announce(args, url)
        wait(should_stop)
    return 0


def announce(args: argparse.Namespace, url: str) -> None:
    """Print the address of the page: to standard error, or with --json as JSON to standard output."""
    if args.json:
        print(json.dumps({"url": url}), flush=True)
    else:
        print(f"the page is at {url} (Ctrl-C ends it)", file=sys.stderr, flush=True)


def wait(should_stop: Callable[[], bool]) -> None:
    """Sleep until ``should_stop`` returns True."""
    while not should_stop():
        time.sleep(_WAKING_INTERVAL)


def _watch(args: argparse.Namespace) -> int:
    """Serve the page of a bus that robots elsewhere are on until Ctrl-C; return the exit code."""
    from mcp_asdf_tools.view.films import BusRecorder  # noqa: PLC0415
    from mcp_asdf_tools.view.server import serving  # noqa: PLC0415

    choice = interfaces.choose_bus(args)
    if choice.interface == interfaces.DEFAULT_INTERFACE:
        raise UsageError(
            "give a recording, or with --interface the bus of robots elsewhere: the bus "
            f"{choice} is inside this process, where nothing else is (mcp-asdf swarm --view shows a swarm)"
        )
    for option in ("export", "where", "trial"):
        if getattr(args, option):
            raise UsageError(f"--{option} is for recordings, and there is none; leave it out")
    frames = _frame_format(args)
    try:
        with choice.open() as bus, stopping() as should_stop:
            recorder = BusRecorder(bus, frames, f"robots on {choice}", args.fill_ratio, args.true_accuracy)
            with serving(recorder.history, args.port) as url:
                announce(args, url)
                recorder.record(should_stop)
    except can.CanError as error:
        return report_failure("mcp-asdf view", f"the bus failed: {error}", args.json)
    if not recorder.has_telemetry:
        print(f"mcp-asdf view: {_NO_TELEMETRY}", file=sys.stderr)
    return 0
