"""Parser of a command line: its errors offer what was probably meant, and its usage line is short."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from mcp_asdf_tools.common.errors import UsageError, did_you_mean


def option_of(parameter_name: str) -> str:
    """Return the option that sets a parameter, such as ``--filter-period`` for ``filter_period``."""
    return f"--{parameter_name.replace('_', '-')}"


def describe_unknown_value(value: str, known_values: Iterable[str]) -> str:
    """Return a text on a value that is none of the known ones, which lists these and offers a similar one.

    It is such as ``'mirors' is none of native, mirror; did you mean mirror?``.
    """
    known_values = list(known_values)
    return f"{value!r} is none of {', '.join(known_values)}{did_you_mean(value, known_values)}"


class Parser(argparse.ArgumentParser):
    """ArgumentParser of one command, which raises UsageError where argparse's own ends the program."""

    def __init__(self, prog: str, description: str, epilog: str | None = None) -> None:
        """Create a parser without options but ``--help``; options cannot be abbreviated."""
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=_HelpFormatter,
            allow_abbrev=False,
        )
        self._typed_options: set[str] = set()

    def parse_all(self, typed_arguments: Sequence[str]) -> argparse.Namespace:
        """Parse what the user typed behind the command's name, and return the values of all options.

        Two more attributes of the result say what was typed: ``command_line`` is all of it, with the
        program's name in front, and ``typed_options`` the options in it by their long names, such as
        ``--seed``. Raises UsageError, with the nearest option's name, for an argument that belongs to no
        option.
        """
        self._typed_options = set()  # _get_values adds to it
        args, unknown_arguments = self.parse_known_args(typed_arguments)
        if unknown_arguments:
            self._refuse_unknown(unknown_arguments)
        args.command_line = [self.prog, *typed_arguments]
        args.typed_options = self._typed_options
        return args

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Return the value of an argument from what was typed for it. If it is an option, note its long name.

        argparse calls this for every option that it finds, whether it is typed as ``-c can0``, ``-ccan0`` or
        ``--channel=can0``. So argparse alone decides what is an option and what is a value.
        """
        if action.option_strings:
            long_name = action.option_strings[-1]  # the short one is declared first
            self._typed_options.add(long_name)
        return super()._get_values(action, arg_strings)

    def _refuse_unknown(self, unknown_arguments: Sequence[str]) -> NoReturn:
        """Raise UsageError for the first unknown option or, if there is none, the first unknown argument.

        The message asks whether a known option with a similar name was meant. An unknown option explains the
        arguments that follow it, so it is the one to report.
        """
        unknown_options = [argument for argument in unknown_arguments if argument.startswith("-")]
        if unknown_options:
            kind, unknown = "option", unknown_options[0]
        else:
            kind, unknown = "argument", unknown_arguments[0]
        known_options: list[str] = []
        for action in self._actions:
            known_options += action.option_strings
        option_name, _, _ = unknown.partition("=")  # --robot of --robot=3, which may be --robots misspelt
        self.error(f"no such {kind}: {unknown}{did_you_mean(option_name, known_options)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise ArgumentError, with the nearest choice, for a value that is none of an option's choices."""
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, describe_unknown_value(value, action.choices))

    def error(self, message: str) -> NoReturn:
        """Raise UsageError, which ends the program as any other does."""
        raise UsageError(message)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Formatter whose usage line names only what a command cannot do without.

    All other options are ``[OPTION ...]`` there: swarm has so many that they would fill a screen.
    """

    def add_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Iterable[argparse._MutuallyExclusiveGroup],
        prefix: str | None = None,
    ) -> None:
        """Add the usage line of a parser, in which all options that may be left out are one [OPTION ...].

        Of ``actions``, argparse's declarations of arguments, the line shows positional arguments, required
        options, and the options of each required group in ``groups``. Such a group needs one of its mutually
        exclusive options, although argparse marks no option as required.
        """
        alternatives: list[argparse.Action] = []  # the options of required groups
        for group in groups:
            if group.required:
                alternatives += group._group_actions
        shown_actions = []
        for action in actions:
            is_positional = not action.option_strings  # such as FILE
            if action.required or is_positional or action in alternatives:
                shown_actions.append(action)
        # An action that no parser has: argparse shows its metavar, and no more, in its place.
        other_options = argparse.Action([], "options", metavar="[OPTION ...]")
        super().add_usage(usage, [other_options, *shown_actions], groups, prefix)
