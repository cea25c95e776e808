"""Command-line options made from parameters, so that an option means the same in every command."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from typing import Any, TypeVar

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import Parameter, ParameterError, parameters_of
from mcp_asdf_tools.robots.population import Population

Settings = TypeVar("Settings", bound=Population)


def option_of(name: str) -> str:
    """The option of a parameter."""
    return f"--{name.replace('_', '-')}"


def add_parameters(
    parser: argparse.ArgumentParser, kind: Any, title: str, only: Collection[str] | None = None
) -> None:
    """An option for every parameter of ``kind``, or for those in ``only``; those not given are None."""
    group = parser.add_argument_group(title)
    for name, each in parameters_of(kind).items():
        if only is None or name in only:
            _add(group, each)


def _add(group: argparse._ArgumentGroup, each: Parameter) -> None:
    choices = each.choices or None
    shown = f" (default {each.default})" if each.default != "" else ""
    group.add_argument(
        option_of(each.name),
        type=each.kind if each.kind in (int, float) else str,
        choices=choices,
        metavar=None if choices else each.name.split("_")[-1].upper(),
        help=(each.text + shown).replace("%", "%%"),
    )


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
        option, message = option_of(error.key), str(error)
        is_first = message.startswith(f"{error.key} ")
        raise UsageError(
            option + (message.removeprefix(error.key) if is_first else f": {message}")
        ) from error
    for name, reason in settings.unused_parameters().items():
        if name in given:
            raise UsageError(f"{option_of(name)} would do nothing: {reason}; leave it out")
    return settings
