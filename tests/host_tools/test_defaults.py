"""All defaults of commands and library stand in golden_files/defaults.txt, where a change of one is seen.

A page may state the same number, and nobody compares the two. After a change on purpose, look for pages that
state the old default.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from types import ModuleType

import pytest

import mcp_asdf
import mcp_asdf_tools
from golden import assert_equals_golden_file
from mcp_asdf_tools.cli import main as cli


def defaults_stated_in_help(command: str) -> Iterator[tuple[str, str, str | None]]:
    """Yield options whose help states a default: the option, the default in the help, and the parser's.

    A help ends with "(default 20)", for example, or with "(default %(default)s)", which argparse replaces.
    The parser's is None where the command itself puts a default in the place of a missing value.
    """
    for option in cli._parser_for(command, cli._load(command))._actions:
        help_text = (option.help or "") % {**vars(option), "prog": command}
        statement = re.search(r"\(default:? ([^():,; ]+)\)$", help_text)
        if statement is not None:
            parsers_default = None if option.default is None else str(option.default)
            yield option.option_strings[-1], statement[1], parsers_default


def describe_options() -> list[str]:
    """Return the lines of the file about options, such as "--b-hat 0.95: radio node".

    A line has an option, its default, and the commands that have this option with this default.
    """
    commands_by_default: dict[str, list[str]] = {}
    for command in cli.COMMANDS:
        for option, default, _ in defaults_stated_in_help(command):
            commands_by_default.setdefault(f"{option} {default}", []).append(command)
    return sorted(f"{default}: {' '.join(commands)}" for default, commands in commands_by_default.items())


def describe_library(module: ModuleType) -> list[str]:
    """Return one line per default of a module's functions and classes, such as "Config.memory 2147483648".

    Those of Experiment and SwarmSettings are left out: options with the same defaults are made of them.
    """
    lines = []
    for name in sorted(set(module.__all__) - {"Experiment", "SwarmSettings"}):
        thing = getattr(module, name)
        is_dataclass = isinstance(thing, type) and dataclasses.is_dataclass(thing)
        has_parameters = is_dataclass or inspect.isfunction(thing)
        parameters = inspect.signature(thing).parameters.values() if has_parameters else []
        for parameter in parameters:
            if parameter.default not in (parameter.empty, None):
                lines.append(f"{name}.{parameter.name} {parameter.default}")
    return lines


def test_the_defaults_of_options_and_of_the_library_are_those_of_the_file() -> None:
    """The file has lines such as "--b-hat 0.95: radio node" and "Config.filter_period 1000"."""
    lines = [*describe_options(), *describe_library(mcp_asdf), *describe_library(mcp_asdf_tools)]
    assert_equals_golden_file("defaults.txt", lines)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_the_default_in_the_help_of_an_option_is_the_option_s_default(command: str) -> None:
    """For example, the help of ``node --b-hat`` ends with "(default 0.95)"."""
    for option, default_in_help, parsers_default in defaults_stated_in_help(command):
        assert parsers_default in (None, default_in_help), option
