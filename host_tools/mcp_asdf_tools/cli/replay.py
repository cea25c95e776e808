"""``mcp-asdf replay``: run the robots of a log again."""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli.output import json_report, print_again, warn
from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from mcp_asdf_tools.recording.events import EventsReader
    from mcp_asdf_tools.recording.frame_logs import LogSummary
    from mcp_asdf_tools.recording.replay import ReplayVerdict

EPILOG = """\
examples:
  mcp-asdf swarm --robots 6 --steps 60 --quiet --log run.log
  mcp-asdf replay run.log
      360  broadcasts reproduced bit for bit
  mcp-asdf replay all.log --channel vcan0 --events run.log.events     # of a log of several buses
The events are in the file FILE.events that swarm, radio and node write beside their logs. To play a log onto
a bus, use python-can's can_player.
exit code: 0 done, 1 a broadcast is not reproduced, 2 bad usage, 128 + signal if interrupted"""
LIBRARIES = ("numpy", "can", "rich.console")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare LOG, the log to check, ``--events``, its file of events, and ``--channel``, one bus of it."""
    parser.add_argument(
        "log", metavar="LOG", type=Path, help="log to check: .log (candump), .asc, .blf, .csv, .mf4 or .trc"
    )
    parser.add_argument(
        "--events",
        metavar="FILE",
        type=Path,
        help="read here what each robot saw and heard (default: LOG.events)",
    )
    parser.add_argument("--channel", metavar="NAME", help="check only the frames of this bus (default: all)")


def run(args: argparse.Namespace) -> int:
    """Run the robots of a log again, and print how many of their broadcasts come out as logged.

    That is a table, or JSON with --json. The first broadcast that differs, and lines of the log that are no
    frames, are reported on standard error. Returns exit code 1 if a broadcast differs, and otherwise 0.
    Raises UsageError if there is nothing to compare.
    """
    from mcp_asdf_tools.recording.events import EventsReader
    from mcp_asdf_tools.recording.frame_logs import LogSummary
    from mcp_asdf_tools.robots.filters import describe_filters

    events_path = _find_events(args)
    summary = LogSummary()
    with EventsReader(events_path) as events_reader:
        verdict = _verify(args, events_reader, summary)
    filter_description = describe_filters(robot.config.filter for robot in events_reader.header.robots)
    if args.json:
        print(json_report(_report(args, events_path, summary, verdict, filter_description)))
    else:
        print(_format_counts(verdict))
        print(filter_description)
        print_again(args)
    _warn_of_differences(args, summary, verdict)
    if verdict.difference is not None:
        return 1
    # No broadcast differs, but perhaps none was compared.
    compared_broadcasts = verdict.reproduced + verdict.falsified
    if compared_broadcasts == 0:
        raise UsageError(
            f"{args.log} holds no estimate of the robots in {events_path}; do they belong together?"
        )
    return 0


def _verify(args: argparse.Namespace, events_reader: EventsReader, summary: LogSummary) -> ReplayVerdict:
    """Run the robots again, showing that on a terminal, and return the verdict on the log.

    ``summary`` counts the frames of the whole log. Raises UsageError if the log or the events cannot be read.
    """
    from rich.console import Console

    from mcp_asdf_tools.recording.frame_logs import read_log
    from mcp_asdf_tools.recording.replay import verify

    # Frames are read one by one, and the summary counts them then.
    frames = read_log(args.log, args.channel, summary)
    with Console(stderr=True).status("running the robots again"):
        verdict = verify(frames, events_reader)
        # After a difference the rest of the log is read for the summary alone, which counts frames by
        # channel. An error in the rest changes nothing about the verdict.
        with suppress(UsageError):
            for _frame in frames:
                pass
    return verdict


def _find_events(args: argparse.Namespace) -> Path:
    """Return the path of the file of events: that of ``--events``, or else the one beside the log.

    Warns if the log is incomplete. Raises UsageError if the log cannot be read, or if ``--events`` was not
    given and there is no file beside the log.
    """
    from mcp_asdf_tools.recording.events import events_path
    from mcp_asdf_tools.recording.frame_logs import PART_SUFFIX, check_log

    events_file: Path = args.events or events_path(args.log)
    check_log(args.log)
    # A log keeps this suffix if its run did not end.
    if args.log.suffix == PART_SUFFIX:
        warn("replay", f"{args.log} is incomplete: its run was cut off")
    if args.events is None and not events_file.exists():
        raise UsageError(
            f"there is no {events_file}, without which nothing can be checked: swarm, radio and node write "
            "it beside their logs; give it as --events, or see what the frames say with mcp-asdf view"
        )
    return events_file


def _warn_of_differences(args: argparse.Namespace, summary: LogSummary, verdict: ReplayVerdict) -> None:
    """Print to standard error what is no frame in the log, and what is not reproduced.

    If frames of several buses may be the reason for a difference, that is said, too. Nothing is printed if
    all is well.
    """
    if summary.warning is not None:
        warn("replay", f"of {args.log} {summary.warning}")
    if verdict.difference is None:
        return
    warn("replay", f"not reproduced: {verdict.difference}")
    if args.channel is None and len(summary.channels) > 1:
        warn(
            "replay",
            f"{args.log} has frames of {summary.channel_names}: if it has the same frames of each, "
            "choose one by --channel",
        )


def _report(
    args: argparse.Namespace,
    events_file: Path,
    summary: LogSummary,
    verdict: ReplayVerdict,
    filter_description: str,
) -> dict[str, object]:
    """Return the result as plain values for JSON: the files, the frames by channel, and the verdict."""
    from mcp_asdf_tools.recording.frame_logs import PART_SUFFIX

    return {
        "log": str(args.log),
        "events": str(events_file),
        "incomplete": args.log.suffix == PART_SUFFIX,
        "filter": filter_description,
        "channel": args.channel,
        "channels": summary.channels,
        "skipped_lines": summary.skipped_lines,
        "verdict": vars(verdict),
    }


def _format_counts(verdict: ReplayVerdict) -> str:
    """Return one line per kind of frame, with the number of frames and a description of the kind."""
    counts = (
        (verdict.reproduced, "broadcasts reproduced bit for bit"),
        (verdict.falsified, "broadcasts that a fault had given other values"),
        (verdict.foreign, "frames under a robot's id that it did not send"),
        (verdict.not_logged, "broadcasts that the log lacks"),
        (verdict.beyond, "broadcasts after the events were cut off"),
        (verdict.other, "other frames"),
    )
    width = max(len(str(count)) for count, _ in counts)
    return "\n".join(f" {count:{width}}  {meaning}" for count, meaning in counts)
