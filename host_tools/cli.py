"""The command line: ``mcp-asdf COMMAND ...``; each command is a module in ``host_tools.commands``.

Exit codes: 0 done, 1 a check failed, 2 bad usage, 130 interrupted, 141 the reader of the output left.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Protocol, cast

from host_tools.errors import UsageError
from host_tools.versions import own_version

PROGRAM = "mcp-asdf"
COMMANDS = (
    "table",
    "crosscheck",
    "swarm",
    "node",
    "radio",
    "replay",
    "dbc",
    "simulate",
    "sweep",
    "score",
    "plot",
    "reproduce",
)
"""Names of the commands; ``NAME`` is the module ``host_tools.commands.NAME``."""


class Command(Protocol):
    """What a command's module offers.

    ``HELP`` is one line for the overview. ``EPILOG`` holds the examples that ``--help`` ends with, one
    a line, indented, starting with the program's name, explained behind a ``#`` if need be. The option
    ``--json`` is added to every command here, and ``run`` finds it as ``args.json``.
    """

    HELP: str
    EPILOG: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's options."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the job; returns the exit code. Raises UsageError for what the user can mend."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program on ``argv`` (default: the process's own arguments); returns the exit code."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    try:
        if arguments and arguments[0] in COMMANDS:
            return _run_command(arguments[0], arguments[1:])
        return _show_overview(arguments)
    except SystemExit as stop:  # argparse has printed its help or its error
        return stop.code if isinstance(stop.code, int) else 0


def _run_command(name: str, arguments: Sequence[str]) -> int:
    """Import and run one command only: the others' libraries stay unloaded."""
    command = _load(name)
    title = f"{PROGRAM} {name}"
    args = _parser_for(command, title).parse_args(arguments)
    try:
        code = command.run(args)
        sys.stdout.flush()
    except UsageError as error:
        print(f"{title}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{title}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The interpreter flushes once more on its way out; that must not fail too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return code


def _load(name: str) -> Command:
    return cast(Command, import_module(f"host_tools.commands.{name}"))


def _parser_for(command: Command, title: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=title,
        description=command.HELP,
        epilog=command.EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, for machines")
    return parser


def _show_overview(arguments: Sequence[str]) -> int:
    """Handle everything but a known command: ``--help``, ``--version``, nothing at all, a typing error."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="Collective perception with self-calibrating robots.", allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {own_version()}")
    listing = parser.add_subparsers(metavar="COMMAND", title="commands (each has its own --help)")
    for name in COMMANDS:
        listing.add_parser(name, help=_load(name).HELP)
    parser.parse_args(arguments)
    parser.print_help(sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
