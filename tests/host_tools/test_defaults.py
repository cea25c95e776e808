"""What --help says, and the defaults of commands and library, stand in texts: a change of one is seen there.

A number that a page states and a default that nobody compares with it could otherwise change in silence.
The texts are in the folder ``defaults``; ``.venv/bin/python tests/host_tools/test_defaults.py`` writes them
again. They are not the output of ``--help``, which looks different in each version of Python.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

import mcp_asdf
import mcp_asdf_tools
from mcp_asdf_tools.cli import main as cli

FOLDER = Path(__file__).with_name("defaults")
RENEW = "if this is on purpose, run .venv/bin/python tests/host_tools/test_defaults.py and review the change"


def describe_command(name: str) -> str:
    """Return what a command's --help says, and the default of each option as the program gets it."""
    parser = cli._parser_for(name, cli._load(name))
    lines = [f"{parser.prog}: {parser.description}"]
    for group in parser._action_groups:
        if group._group_actions:
            lines += ["", f"== {group.title} ==", *(group.description or "").splitlines()]
            lines += [line for action in group._group_actions for line in describe_option(parser, action)]
    return "\n".join([*lines, "", *(parser.epilog or "").splitlines(), ""])


def describe_option(parser: argparse.ArgumentParser, action: argparse.Action) -> Iterator[str]:
    """Yield the lines about an option, or an argument: its names, its values, its default, its help."""
    names = ", ".join(action.option_strings) or action.dest
    metavar = action.metavar or (action.choices and list(action.choices))
    values = f" {metavar}" if metavar and action.nargs != 0 else ""
    count = f" (number of values: {action.nargs})" if action.nargs not in (None, 0) else ""
    required = " required" if action.required and action.option_strings else ""
    yield f"{names}{values}{count}{required}"
    if action.help is argparse.SUPPRESS:
        yield "    hidden"
        return
    help_text = (action.help or "") % {**vars(action), "prog": parser.prog}
    default = repr(action.default)
    if help_text.endswith("one per processor)"):  # the number depends on this machine
        help_text, default = help_text.replace(default, "N"), "N"
    yield f"    {help_text}"
    if action.default not in (None, argparse.SUPPRESS):
        yield f"    default: {default}"


def describe_overview() -> str:
    """Return the groups of commands, with the line on each."""
    lines = []
    for title, commands in cli.GROUPS.items():
        lines += [title, *(f"    {name}: {text}" for name, text in commands.items())]
    return "\n".join([*lines, ""])


def describe_library(module: ModuleType) -> str:
    """Return the parameters of all functions and classes that a module offers, with their defaults."""
    lines = []
    for name in sorted(module.__all__):
        thing = getattr(module, name)
        lines.append(name)
        if callable(thing) and not is_without_parameters(thing):
            parameters = inspect.signature(thing).parameters.values()
            factories = default_factories(thing)
            lines += [f"    {describe_parameter(parameter, factories)}" for parameter in parameters]
    return "\n".join([*lines, ""])


def is_without_parameters(thing: object) -> bool:
    """Return whether something is an enumeration, an exception or a protocol, which nobody calls by names."""
    if not isinstance(thing, type):
        return False
    return issubclass(thing, Enum | Exception) or getattr(thing, "_is_protocol", False)


def default_factories(thing: object) -> dict[str, Callable[[], object]]:
    """Return the default factories of a dataclass by parameter; none for anything else."""
    if not dataclasses.is_dataclass(thing):
        return {}
    factories = {field.name: field.default_factory for field in dataclasses.fields(thing)}
    return {name: make for name, make in factories.items() if make is not dataclasses.MISSING}


def describe_parameter(parameter: inspect.Parameter, factories: dict[str, Callable[[], object]]) -> str:
    """Return the name of a parameter and its default, such as "robots = 20"."""
    if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
        return f"*{parameter.name}"
    if parameter.name in factories:
        return f"{parameter.name} = {factories[parameter.name]()!r}"
    if parameter.default is parameter.empty:
        return parameter.name
    return f"{parameter.name} = {parameter.default!r}"


DESCRIPTIONS: dict[str, Callable[[], str]] = {
    "overview.txt": describe_overview,
    "library_mcp_asdf.txt": lambda: describe_library(mcp_asdf),
    "library_mcp_asdf_tools.txt": lambda: describe_library(mcp_asdf_tools),
    **{f"command_{name}.txt": partial(describe_command, name) for name in cli.COMMANDS},
}
"""What makes the text of each file."""


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_description_of_options_and_defaults_is_that_of_its_file(name: str) -> None:
    """For example command_swarm.txt, with the help and the default of each option of ``mcp-asdf swarm``.

    Whoever changes a default sees it in the file, and looks for pages that state it.
    """
    path = FOLDER / name
    text_in_file = path.read_text(encoding="utf-8") if path.exists() else ""
    assert DESCRIPTIONS[name]() == text_in_file, RENEW


def test_no_file_describes_a_command_that_no_longer_exists() -> None:
    """The folder ``defaults`` has a file for each command, such as command_swarm.txt."""
    assert {path.name for path in FOLDER.iterdir()} <= set(DESCRIPTIONS), RENEW


def defaults_stated_in_help(command: str) -> Iterator[tuple[str, str, str]]:
    """Yield options whose help states a default: the name, the default in the help, and the real one.

    A help ends with "(default 20)", for example, or with "(default %(default)s)", which argparse replaces.
    """
    for option in cli._parser_for(command, cli._load(command))._actions:
        statement = re.search(r"\(default ([^():,;]+)\)$", option.help or "")
        if statement is not None and option.default is not None:
            real_default = str(option.default)
            yield option.dest, statement[1].replace("%(default)s", real_default), real_default


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_the_default_in_the_help_of_an_option_is_the_option_s_default(command: str) -> None:
    """For example, the help of ``swarm --robots`` ends with "(default 20)"."""
    for option, default_in_help, real_default in defaults_stated_in_help(command):
        assert default_in_help == real_default, option


def renew() -> None:
    """Write all texts as they are now, and remove the texts of removed commands."""
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.iterdir():
        path.unlink()
    for name, describe in DESCRIPTIONS.items():
        (FOLDER / name).write_text(describe(), encoding="utf-8")


if __name__ == "__main__":
    renew()
