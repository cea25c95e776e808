"""``mcp-asdf view``: see a run in a browser."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import announce_page, report_failure, sleep_until, warn
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import stopping

if TYPE_CHECKING:
    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.recording.frame_logs import LogSummary
    from mcp_asdf_tools.view.history import History

EPILOG = """\
examples:
  mcp-asdf swarm --robots 8 --steps 300 --quiet --log run.log
  mcp-asdf view run.log --export run.html           # one file, to send to a colleague
      run.html
  mcp-asdf view run.parquet                         # results of simulate: serve trial 0 until Ctrl-C
  mcp-asdf view grid.parquet --where filter=none --trial 3
  mcp-asdf view candump.log --channel can0          # a log of real robots: what their frames contain
  mcp-asdf view --interface socketcan --channel vcan0       # robots that send telemetry, live
Only browsers of this computer can open the page. A recording needs no positions: they follow from its seed
and parameters. mcp-asdf swarm --view shows a swarm while it runs.
exit code: 0 done, 1 the bus failed, 2 bad usage, 130 interrupted"""
LIBRARIES = ("numpy", "can")

_NO_TELEMETRY = "no robot sent telemetry, which has x and b_hat: see mcp-asdf swarm --telemetry-period 1"
_OPTIONS_OF_RECORDINGS = ("--export", "--where", "--trial")
_OPTIONS_OF_A_BUS = ("--interface", "--bitrate", "--bus-kwargs")
_OPTIONS_OF_FRAMES = ("--fill-ratio", "--true-accuracy", "--subject", "--channel")
"""Options that say what the frames of a bus mean, or of a log that has no events beside it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, the recording to be shown, and the options of a bus, which is shown without a FILE.

    Further options choose a trial, write the page to a file, draw the truth beside the estimates, and set the
    page's port.
    """
    from mcp_asdf_tools.bus.frames import FrameFormat

    parser.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        nargs="?",
        help="recording to show: results (.parquet) or a log; without one a bus is shown",
    )
    recording = parser.add_argument_group("recordings")
    recording.add_argument(
        "--trial", metavar="N", type=int, default=0, help="show this trial, from 0 (default %(default)s)"
    )
    options.add_where_option(recording)
    recording.add_argument(
        "--export",
        metavar="FILE",
        type=Path,
        help="write the page to this file (.html) instead of serving it",
    )
    truth = parser.add_argument_group("truth to draw beside a bus or a log of real robots, if you know it")
    truth.add_argument("--fill-ratio", metavar="F", type=float, help="share of black tiles, 0 to 1 (f)")
    truth.add_argument(
        "--true-accuracy", metavar="B", type=float, help="share of right readings of every sensor, 0 to 1 (b)"
    )
    options.add_port_option(parser)
    parser.add_argument(
        "--subject",
        type=int,
        default=FrameFormat().subject,
        help="Cyphal subject of estimates on a bus (default %(default)s)",
    )
    options.add_bus_options(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the page of a recording or of a bus, or write it with --export; return the exit code.

    Raises UsageError for options that would do nothing, for a recording that cannot be shown, and if the page
    cannot be written or served.
    """
    from mcp_asdf_tools.common.files import check_target

    if args.file is None:
        return _serve_bus(args)
    _check_recording_options(args)
    if args.export is None:
        return _serve_recording(args, _read_recording(args))
    # The file to be written is checked before the recording is read, which may take long.
    if args.export.suffix.lower() != ".html":
        raise UsageError(f"cannot export to {args.export.name}: choose a name that ends in .html")
    check_target(args.export)
    return _export_recording(args, _read_recording(args))


# --- Recordings ------------------------------------------------------------------------------------------


def _check_recording_options(args: argparse.Namespace) -> None:
    """Raise UsageError for an option that does nothing where a recording is shown.

    These are the options of a bus and, if the recording states its parameters, those that say what frames
    mean. With ``--export`` there is no port, either.
    """
    from mcp_asdf_tools.experiments.results import is_results_path
    from mcp_asdf_tools.recording.events import events_path

    unused_options = [*_OPTIONS_OF_A_BUS]
    has_parameters = is_results_path(args.file) or events_path(args.file).exists()
    if has_parameters:  # what the frames of any other log mean is for the user to say
        unused_options += _OPTIONS_OF_FRAMES
    for option in unused_options:
        if option in args.typed_options:
            raise UsageError(f"{option} is for a bus, but {args.file} is a recording; leave one of them out")
    if args.export is not None and args.port is not None:
        raise UsageError("--port is for a page that is served, but --export writes a file; leave it out")


def _read_recording(args: argparse.Namespace) -> History:
    """Return the history of the recording ``args.file``: a trial of results, or a log.

    A trial of another program has only what it recorded; any other is run again. So are the robots of a log,
    if it has events beside it; without them the frames are shown. Raises UsageError if there is no recording,
    or for options that do not go with it.
    """
    from mcp_asdf_tools.experiments.results import is_results_path, single_experiment
    from mcp_asdf_tools.recording.events import events_path
    from mcp_asdf_tools.view.run_histories import (
        recompute_swarm_history,
        recompute_trial_history,
        recorded_trial_history,
    )

    # No file holds all that the page draws: the rest is computed again from seed and parameters, unless
    # another program has run the trial.
    if is_results_path(args.file):
        trials = single_experiment(options.read_selected_experiments(args))
        if trials.source:
            return recorded_trial_history(trials, args.trial)
        return recompute_trial_history(trials, args.trial)
    if args.typed_options & {"--trial", "--where"}:
        raise UsageError(f"--trial and --where choose from results (.parquet), but {args.file} is a log")
    if not args.file.exists():
        raise UsageError(f"there is no log {args.file}; give one that swarm --log wrote")
    if not events_path(args.file).exists():
        return _read_frame_history(args)
    return recompute_swarm_history(args.file)


def _read_frame_history(args: argparse.Namespace) -> History:
    """Return the history of a log without events; warn on standard error of what the page cannot show."""
    from mcp_asdf_tools.bus.frames import FrameFormat
    from mcp_asdf_tools.recording.frame_logs import LogSummary
    from mcp_asdf_tools.view.frame_history import KnownTruth, read_frame_log

    # An option of the bus that was left out is no attribute.
    channel = getattr(args, "channel", None)
    truth = KnownTruth(args.fill_ratio, args.true_accuracy)
    summary = LogSummary()
    recorder = read_frame_log(args.file, FrameFormat(args.subject), truth, summary, channel)
    _warn_of_frame_log(args.file, channel, summary)
    if not recorder.roster.has_telemetry:
        warn("view", _NO_TELEMETRY)
    return recorder.history


def _warn_of_frame_log(log: Path, channel: str | None, summary: LogSummary) -> None:
    """Warn on standard error of what the page of a log without events may lack or mix up.

    One warning always comes: the page shows only what frames hold. Others follow for a log of several
    channels if none was chosen, and for lines that are no frames.
    """
    from mcp_asdf_tools.recording.events import events_path

    warn(
        "view",
        f"there is no {events_path(log)}, which swarm, radio and node write beside their logs: the "
        "page shows what the frames say",
    )
    # Each channel may be a bus of its own, with other robots of the same ids.
    if channel is None and len(summary.channels) > 1:
        warn("view", f"{log} has frames of {summary.channel_names}; choose one by --channel")
    if summary.warning is not None:
        warn("view", f"of {log} {summary.warning}")


def _export_recording(args: argparse.Namespace, history: History) -> int:
    """Write the page of a history as one file, and print its name; return exit code 0.

    With --json its size in bytes and its number of states are printed, too.
    """
    from mcp_asdf_tools.common.files import write_atomically
    from mcp_asdf_tools.view.page import make_page

    page_bytes = make_page(history).encode()
    write_atomically(args.export, page_bytes)
    if args.json:
        state_count = len(history.states_since().states)
        print(json.dumps({"export": str(args.export), "bytes": len(page_bytes), "states": state_count}))
    else:
        print(args.export)
    return 0


def _serve_recording(args: argparse.Namespace, history: History) -> int:
    """Print the address of the page of a history, and serve it until Ctrl-C; return exit code 0."""
    from mcp_asdf_tools.view.server import serve_page

    with stopping() as should_stop, serve_page(history, args.port) as url:
        announce_page(url, args.json)
        sleep_until(should_stop)
    return 0


# --- A bus -----------------------------------------------------------------------------------------------


def _serve_bus(args: argparse.Namespace) -> int:
    """Serve a page that shows what happens on a bus, until Ctrl-C, and return the exit code.

    The robots on the bus are real ones, or run in other programs. The exit code is 0, or 1 if the bus failed.
    Raises UsageError if no bus is named, for options that are for recordings, and if the bus cannot be opened
    or the page not served.
    """
    from can import CanError

    from mcp_asdf_tools.bus.frames import FrameFormat
    from mcp_asdf_tools.view.frame_history import FrameRecorder, KnownTruth, record_bus
    from mcp_asdf_tools.view.server import serve_page

    bus_choice = _bus_to_show(args)
    frame_format = FrameFormat(args.subject)
    truth = KnownTruth(args.fill_ratio, args.true_accuracy)
    recorder = FrameRecorder(f"robots on {bus_choice}", frame_format, truth)
    try:
        with (
            bus_choice.open() as bus,
            stopping() as should_stop,
            serve_page(recorder.history, args.port) as url,
        ):
            announce_page(url, args.json)
            record_bus(bus, recorder, should_stop)
    except CanError as error:
        return report_failure("mcp-asdf view", f"the bus failed: {error}", args.json)
    if not recorder.roster.has_telemetry:
        warn("view", _NO_TELEMETRY)
    return 0


def _bus_to_show(args: argparse.Namespace) -> BusChoice:
    """Return the bus that the options name. Raises UsageError without one, and for options of recordings."""
    from mcp_asdf_tools.bus.interfaces import DEFAULT_INTERFACE

    bus_choice = options.bus_of(args)
    if bus_choice.interface == DEFAULT_INTERFACE:
        raise UsageError(
            "there is no recording and no bus; give a file (mcp-asdf view run.log) or the bus of real robots "
            "(--interface socketcan --channel can0); mcp-asdf swarm --view shows an emulated swarm"
        )
    for option in _OPTIONS_OF_RECORDINGS:
        if option in args.typed_options:
            raise UsageError(f"{option} is for recordings, and there is none; leave it out")
    return bus_choice
