"""The command line: ``mcp-asdf COMMAND ...``; each command is a module in ``mcp_asdf_tools.cli``.

Exit codes: 0 done, 1 a check or the bus failed, 2 bad usage, or a file or bus that cannot be opened or
written, 128 + signal if one interrupted it (130 Ctrl-C, 143 SIGTERM, 129 SIGHUP), 141 output pipe closed.
"""

from __future__ import annotations

import argparse
import logging
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Protocol, cast

from mcp_asdf_tools.cli.output import log_to_standard_error, report_failure
from mcp_asdf_tools.cli.parsing import Parser
from mcp_asdf_tools.common.errors import UsageError, did_you_mean
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.signals import INTERRUPTED, exit_code_of_signal, raising_on_signals, stopping
from mcp_asdf_tools.common.standard_streams import OutputError, checked_streams

_logger = logging.getLogger("mcp_asdf_tools.cli")

PROGRAM = "mcp-asdf"
_BROKEN_PIPE = 128 + 13
"""Exit code of a program whose output pipe was closed, which a shell reports as 128 + SIGPIPE."""

GROUPS = {
    "See a swarm calibrate itself": {
        "swarm": "emulate a swarm on a CAN bus and watch it calibrate itself",
        "view": "show a run in a browser: a recording, a live bus, or one file to send to a colleague",
        "replay": "check a log by running its robots again",
    },
    "Put the firmware into robots": {
        "firmware": "write the C firmware with a t-table and build files into a project",
        "calibrate": "find a ground sensor's threshold and accuracy from readings over tiles of known colour",
        "table": "make t-tables, and check their files",
        "radio": "surround a real controller with emulated robots on a CAN bus, and check its firmware",
        "node": "run one robot on a CAN bus",
        "dbc": "write a DBC file, with which CAN tools show the content of frames",
        "crosscheck": "check the C code against its Python mirror, exact arithmetic and the claims about it",
    },
    "Experiments": {
        "simulate": "run one experiment: a swarm, many trials, the paper's scores",
        "sweep": "run a grid of experiments on all processors; goes on where it was interrupted",
        "convert": "convert trial files of the paper's authors into results",
        "score": "score results: K, e, h_K, h_e and H",
        "plot": "draw results: scores, curves over any parameter, a trial over time",
        "export": "write the values of robots over time as a table, for pandas, R and the like",
        "reproduce": "run the paper's whole study and report which of its claims hold",
    },
}
"""Commands by purpose, with a line on each. ``NAME`` is the module ``mcp_asdf_tools.cli.NAME``; the lines
stand here, since the overview would take three times as long if it imported the modules of all commands."""
COMMANDS = {name: text for group in GROUPS.values() for name, text in group.items()}


class Command(Protocol):
    """Module of a command.

    ``EPILOG`` holds the examples that ``--help`` ends with, one a line, indented, starting with the
    program's name, explained behind a ``#`` if need be. The options ``--json`` and ``--verbose`` are added
    to every command here, and ``run`` finds ``--json`` as ``args.json``.

    What takes long to import, the module imports within functions, so that ``--help`` is quick. ``LIBRARIES``
    names such modules of others that ``run`` cannot do without; they are imported before it is called.
    """

    EPILOG: str
    LIBRARIES: tuple[str, ...]

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's options."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the job; returns the exit code. Raises UsageError for what the user can mend."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program on ``argv`` (default: the process's own arguments); returns the exit code.

    Wrong usage and failures that the user can mend are printed, and raise nothing. If standard output cannot
    be written to its end, the exit code says so, whatever the command has returned.
    """
    arguments = sys.argv[1:] if argv is None else list(argv)
    # Before anything is parsed, since an error of parsing is printed as JSON, too.
    as_json = "--json" in arguments
    if arguments and arguments[0] in COMMANDS:
        command_name, *command_arguments = arguments
        command_title = f"{PROGRAM} {command_name}"
        work = partial(_run_command, command_name, command_arguments)
    else:
        command_title = PROGRAM
        work = partial(_show_overview, arguments)
    # In this context a signal raises KeyboardInterrupt, and a failing print raises OutputError.
    with checked_streams(), raising_on_signals():
        exit_code = _attempt(command_title, work, as_json)
        # Flushed here and not at exit, where a closed pipe or a full disk could not change the exit code. It
        # gives 0 if all went well, and otherwise a code that counts more, since the result has not arrived.
        flush_exit_code = _attempt(command_title, _flush, as_json)
    return flush_exit_code or exit_code_of_signal(exit_code)


def _attempt(command_title: str, work: Callable[[], int], as_json: bool) -> int:
    """Call ``work`` and return its exit code.

    Errors are printed under ``command_title``. A UsageError, OutputError or OSError is bad usage, as JSON
    with ``as_json``, and gives exit code 2; Ctrl-C is an interruption, and gives INTERRUPTED. A reader of the
    output that has gone away gives _BROKEN_PIPE without a message, and argparse its own exit code. Other
    exceptions are mistakes of the program and pass.
    """
    try:
        with naming_extras():  # which turns the failed import of an optional package into a UsageError
            return work()
    except SystemExit as stop:  # argparse has printed its help or its error
        return stop.code if isinstance(stop.code, int) else 0
    except KeyboardInterrupt:
        print(f"{command_title}: interrupted", file=sys.stderr, flush=True)
        return INTERRUPTED
    except (UsageError, OutputError, OSError) as error:
        if isinstance(error, OutputError) and error.is_broken_pipe:
            return _BROKEN_PIPE  # the reader has enough, and expects no message
        return _report_bad_usage(command_title, _explain(error), as_json)


def _report_bad_usage(command_title: str, error_message: str, as_json: bool) -> int:
    """Print an error and where help is, in two lines, or the error as one line of JSON; return code 2."""
    if as_json:
        return report_failure(command_title, error_message, as_json, exit_code=2)
    print(
        f"{command_title}: error: {error_message}\nSee '{command_title} --help'.", file=sys.stderr, flush=True
    )
    return 2


def _explain(error: UsageError | OutputError | OSError) -> str:
    """Return the message for an error: what failed, and what to do about it."""
    if not isinstance(error, OSError):
        return str(error)
    if error.filename is None:  # it is about no file, but about memory, processes or a connection
        reason = error.strerror or error
        return f"the operating system reports: {reason}; resolve that and run the command again"
    return f"cannot use {error.filename}: {error.strerror}; give another"


def _flush() -> int:
    """Write what is buffered for standard output, and return exit code 0. Raises OutputError if it fails."""
    print(end="", flush=True)
    return 0


def _run_command(command_name: str, arguments: Sequence[str]) -> int:
    """Import and run one command only, so that the others' libraries stay unloaded; return its exit code.

    With --verbose its versions, its options, how it ends and how long it takes are logged.
    """
    command = _load(command_name)
    args = _parser_for(command_name, command).parse_all(arguments)
    # After parsing, so that help and mistakes in options need not wait for large libraries.
    _import_all(command.LIBRARIES)
    with log_to_standard_error(args.verbose):
        if args.verbose:
            _log_start(args)
        return _run_and_log_end(command, args)


def _run_and_log_end(command: Command, args: argparse.Namespace) -> int:
    """Run a command, return its exit code, and log that with the seconds; log and raise what it raises."""
    start_time = time.monotonic()
    try:
        exit_code = command.run(args)
    except BaseException as error:
        # The error itself is printed later in one line; a bug report needs the place that raised it.
        _logger.debug("ended by %s", type(error).__name__, exc_info=True)
        raise
    _logger.info("exit code %d after %.1f s", exit_code, time.monotonic() - start_time)
    return exit_code


def _log_start(args: argparse.Namespace) -> None:
    """Log versions and command line, and in detail the value of every option."""
    from mcp_asdf_tools.common.versions import software_versions

    versions = ", ".join(f"{software} {version}" for software, version in software_versions().items())
    _logger.info("%s, on %s", versions, sys.platform)
    program, *typed_arguments = args.command_line
    # The program's name has a space in it, as "mcp-asdf swarm", which must not be quoted.
    _logger.info("command line: %s %s", program, shlex.join(typed_arguments))
    _logger.debug("options: %s", vars(args))


def _load(command_name: str) -> Command:
    """Import the module of a command. Raises KeyboardInterrupt afterwards if a signal came meanwhile."""
    module_name = f"{__package__}.{command_name}"
    (command,) = _import_all([module_name])
    return cast(Command, command)


def _import_all(module_names: Iterable[str]) -> list[ModuleType]:
    """Import modules, and return them. Raises KeyboardInterrupt afterwards if a signal came meanwhile.

    Inside the import of a library an interruption may be turned into any other error.
    """
    with stopping() as was_interrupted:
        modules = [import_module(name) for name in module_names]
    if was_interrupted():
        raise KeyboardInterrupt
    return modules


def _parser_for(command_name: str, command: Command) -> Parser:
    """Return the parser of a command, with the options that all commands have and with its own."""
    parser = Parser(f"{PROGRAM} {command_name}", COMMANDS[command_name], command.EPILOG)
    # Added first, so that the help of every command begins with them.
    parser.add_argument("--json", action="store_true", help="print the result as JSON, for machines")
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="log on standard error what is opened, run and written; -vv: details, too, for a bug report",
    )
    command.add_arguments(parser)
    return parser


def _show_overview(arguments: Sequence[str]) -> int:
    """Print the version if ``--version`` is among the arguments, which begin with no known command; return 0.

    Without any arguments print the overview to standard error, and return exit code 2. Raises UsageError for
    an unknown command or option, and SystemExit once ``--help`` has printed the overview.
    """
    parser = Parser(PROGRAM, "Collective perception with self-calibrating robots.", _list_commands())
    parser.add_argument("--version", action="store_true", help="show program's version number and exit")
    parser.add_argument("command", metavar="COMMAND", nargs="?", help="one of these; each has its own --help")
    args, _unknown_arguments = parser.parse_known_args(arguments)
    if args.version:
        from mcp_asdf_tools.common.versions import own_version

        print(f"{PROGRAM} {own_version()}")
        return 0
    if args.command is not None:
        # Some type help or version as if it were a command.
        nearest_command = did_you_mean(args.command, [*COMMANDS, "--help", "--version"])
        parser.error(f"no command is called {args.command!r}{nearest_command}")
    # No command is there, so that what is left can only be an unknown option.
    parser.parse_all(arguments)
    parser.print_help(sys.stderr)
    return 2


def _list_commands() -> str:
    """Return the list of all commands by purpose, with a line on each."""
    name_width = max(len(command_name) for command_name in COMMANDS)
    paragraphs = []
    for group_title, commands in GROUPS.items():
        command_lines = [
            f"  {command_name:{name_width}}  {purpose}" for command_name, purpose in commands.items()
        ]
        paragraphs.append("\n".join([f"{group_title}:", *command_lines]))
    return "\n\n".join(paragraphs)


if __name__ == "__main__":
    sys.exit(main())
