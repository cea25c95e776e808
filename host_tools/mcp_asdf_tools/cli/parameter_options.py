"""Command-line options made from parameters, so that an option means the same in every command."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable
from typing import Any, TypeVar

from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.parameters import Parameter, ParameterError, parameters_of
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.robots.population import Population

Settings = TypeVar("Settings", bound=Population)


_FILTERS = "What --filter may be:\n" + "\n".join(
    f"  {swarm_filter.name:11} {swarm_filter.meaning}" for swarm_filter in FILTERS.values()
)


def option_of(name: str) -> str:
    """The option of a parameter."""
    return f"--{name.replace('_', '-')}"


def add_parameters(
    parser: argparse.ArgumentParser, kind: Any, title: str, only: Collection[str] | None = None
) -> None:
    """An option for every parameter of ``kind``, or for those in ``only``; those not given are None."""
    names = parameters_of(kind) if only is None else only
    group = parser.add_argument_group(title, _FILTERS if "filter" in names else None)
    for name, each in parameters_of(kind).items():
        if only is None or name in only:
            _add(group, each)


def _add(group: argparse._ArgumentGroup, each: Parameter) -> None:
    choices = each.choices or None
    group.add_argument(
        option_of(each.name),
        type=each.kind if each.kind in (int, float) else str,
        choices=choices,
        metavar=None if choices else each.name.split("_")[-1].upper(),
        help=_meaning(each).replace("%", "%%"),
    )


def _meaning(each: Parameter) -> str:
    return each.text + (f" (default {each.default})" if each.default != "" else "")


class _SetParameter(argparse.Action):
    """``NAME=VALUE``, as if the parameter had an option of its own; ``help`` lists the names."""

    def __init__(self, option_strings: list[str], dest: str, parameters: Iterable[Parameter]) -> None:
        text = "any other parameter; repeatable, and --set help lists them"
        super().__init__(option_strings, dest, metavar="NAME=VALUE", help=text)
        self._parameters = {each.name.replace("_", "-"): each for each in parameters}

    def __call__(
        self, parser: argparse.ArgumentParser, args: argparse.Namespace, values: Any, option: Any = None
    ) -> None:
        """Set the attribute of the parameter's name."""
        name, equals, text = values.partition("=")
        name = name.replace("_", "-")
        if values == "help":
            for name, each in self._parameters.items():
                print(f"{name}={','.join(each.choices)}\t{_meaning(each)}")
            parser.exit()
        if name not in self._parameters or not equals:
            problem = (
                f"no parameter is called {name!r}{offer(name, self._parameters)}" if equals else "no value"
            )
            raise argparse.ArgumentError(self, f"{values!r}: {problem}; --set help lists all names")
        each = self._parameters[name]
        try:
            value = each.kind(text) if each.kind in (int, float) else text
        except ValueError:
            number = "a whole number" if each.kind is int else "a number"
            raise argparse.ArgumentError(self, f"{values!r}: give {number}") from None
        setattr(args, each.name, value)


def add_set(parser: argparse.ArgumentParser, parameters: Collection[Parameter]) -> None:
    """The option ``--set`` for all of these parameters, which then have no option of their own."""
    parser.add_argument("--set", action=_SetParameter, parameters=parameters)
    parser.set_defaults(set=[each.name for each in parameters])


def settings_from(
    args: argparse.Namespace, kind: type[Settings], base: dict[str, Any] | None = None, **more: Any
) -> Settings:
    """Settings of ``base`` with the options that were given.

    Raises UsageError, naming the option, for a value out of range or an option that would do nothing.
    """
    names = parameters_of(kind)
    given = {name: value for name in names if (value := getattr(args, name, None)) is not None}
    values = (base or {}) | given | more
    try:
        settings = kind(**values)
    except ParameterError as error:
        option, message = _named(args, error.key), str(error)
        is_first = message.startswith(f"{error.key} ")
        raise UsageError(
            option + (message.removeprefix(error.key) if is_first else f": {message}")
        ) from error
    for name, reason in settings.unused_parameters().items():
        if name in given:
            raise UsageError(f"{_named(args, name)} would do nothing: {reason}; leave it out")
    return settings


def _named(args: argparse.Namespace, name: str) -> str:
    """What the user types for a parameter."""
    is_set = name in (getattr(args, "set", None) or ())
    return f"--set {name.replace('_', '-')}" if is_set else option_of(name)
