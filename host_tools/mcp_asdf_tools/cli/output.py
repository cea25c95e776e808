"""What commands print: results as JSON, failures, the line for the same run again, and logs with ``-v``."""

from __future__ import annotations

import argparse
import json
import logging
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli.parsing import option_of
from mcp_asdf_tools.common.signals import INTERRUPTED

if TYPE_CHECKING:
    from mcp_asdf_tools.bus.interfaces import BusChoice
    from mcp_asdf_tools.experiments.store import Store
    from mcp_asdf_tools.recording.events import EventsHeader
    from mcp_asdf_tools.recording.recording import NoRecording, Recording

_logger = logging.getLogger(__name__)

_LOGGED_PACKAGES = ("mcp_asdf_tools", "can")
"""Packages whose logs help to find the cause of a failure."""

_SECONDS_BETWEEN_CHECKS = 0.2
"""Seconds between two checks whether Ctrl-C was pressed."""

# --- Results and failures --------------------------------------------------------------------------------


def json_report(report: object) -> str:
    """Return a report of plain values as indented JSON."""
    return json.dumps(report, indent=2)


def print_again(args: argparse.Namespace, **used_parameters: object) -> None:
    """Print the command line that makes the same run again.

    It is the command, then options for those ``used_parameters``, such as the seed, that the user has not
    typed, and then all arguments as typed. The options are there as a later version may have other defaults.
    """
    program, *typed_arguments = args.command_line
    added_options = [
        f"{option_of(name)}={value}"
        for name, value in used_parameters.items()
        if option_of(name) not in args.typed_options
    ]
    # The program's name has a space in it, as "mcp-asdf swarm", which must not be quoted.
    print(f"again: {program} {shlex.join([*added_options, *typed_arguments])}".rstrip())


def report_failure(command_title: str, message: str, as_json: bool, exit_code: int = 1) -> int:
    """Print that a command failed to standard error, as a line of text or of JSON; return ``exit_code``.

    ``command_title`` names the command as the user typed it, such as "mcp-asdf node".
    """
    if as_json:
        error_line = json.dumps({"command": command_title, "error": message, "exit_code": exit_code})
    else:
        error_line = f"{command_title}: {message}"
    print(error_line, file=sys.stderr, flush=True)
    return exit_code


def warn(command_name: str, message: str) -> None:
    """Print a message to standard error, behind the name of the command, such as "node"."""
    print(f"mcp-asdf {command_name}: {message}", file=sys.stderr)


@contextmanager
def reporting_missing_trials(stores: Sequence[Store]) -> Iterator[None]:
    """Print to standard error how many trials are left if Ctrl-C or a signal ends this context."""
    missing_at_start = sum(store.missing_count for store in stores)
    try:
        yield
    except KeyboardInterrupt:
        still_missing = sum(store.missing_count for store in stores)
        print(f"{still_missing} of {missing_at_start} trials left; the same command goes on", file=sys.stderr)
        raise


# --- Recordings ------------------------------------------------------------------------------------------


def recording_for(
    command_name: str, log_path: Path | None, header: EventsHeader | None, bus_choice: BusChoice
) -> Recording | NoRecording:
    """Return the recording of frames in the log ``log_path``, or one that keeps nothing if that is None.

    With ``header`` it has a file of events beside the log. A failure while it records is printed to standard
    error at once, with the ``command_name`` in front.
    """
    from mcp_asdf_tools.recording.recording import NoRecording, Recording

    if log_path is None:
        return NoRecording()
    _logger.info("recording the frames in %s", log_path)
    # A log names the bus in every line, and some interfaces have no channel.
    bus_name = bus_choice.channel or bus_choice.interface
    return Recording(log_path, header, partial(warn, command_name), bus_name)


def exit_code_of_run(
    args: argparse.Namespace, failure: str | None, is_interrupted: bool, recording: Recording | NoRecording
) -> int:
    """Return the exit code of a run, and print its ``failure`` if there is one.

    It is 1 after a failure, which matters most, 2 if the recording is not complete, INTERRUPTED if a signal
    has ended the run, and otherwise 0.
    """
    if failure is not None:
        command_title = args.command_line[0]
        return report_failure(command_title, failure, args.json)
    if recording.failure is not None:
        return 2
    return INTERRUPTED if is_interrupted else 0


# --- Pages in a browser ----------------------------------------------------------------------------------


def announce_page(url: str, as_json: bool) -> None:
    """Print the address of a page: to standard error, or as JSON to standard output."""
    if as_json:
        print(json.dumps({"url": url}), flush=True)
    else:
        print(f"the page is at {url} (Ctrl-C ends it)", file=sys.stderr, flush=True)


def sleep_until(should_stop: Callable[[], bool]) -> None:
    """Sleep until ``should_stop`` returns True."""
    while not should_stop():
        time.sleep(_SECONDS_BETWEEN_CHECKS)


# --- Logs ------------------------------------------------------------------------------------------------


@contextmanager
def log_to_standard_error(verbosity: int) -> Iterator[None]:
    """Log to standard error inside this context: nothing if ``verbosity`` is 0, at 1 INFO, beyond DEBUG."""
    if verbosity == 0:
        yield
        return
    level = logging.INFO if verbosity == 1 else logging.DEBUG
    handler = _StandardErrorHandler(level)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    loggers = [logging.getLogger(package) for package in _LOGGED_PACKAGES]
    # A notebook or a test may run several commands in one process, so the levels are set back.
    former_levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(level)
    try:
        yield
    finally:
        for logger, former_level in zip(loggers, former_levels, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(former_level)


class _StandardErrorHandler(logging.Handler):
    """Handler that prints to whatever ``sys.stderr`` is at the time.

    While a progress bar is shown, rich replaces that stream, so that lines do not run into the bar.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record as a line. A failure to do so is left to ``logging``, and ends nothing."""
        try:
            print(self.format(record), file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)
