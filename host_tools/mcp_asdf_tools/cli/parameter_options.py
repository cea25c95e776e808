"""Command-line options made from parameters, so that an option means the same in every command."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable
from dataclasses import Field, fields
from enum import Enum
from typing import Any, TypeVar

from mcp_asdf_tools.common import Meaning, ParameterError, UsageError, extensions, meaning_of, plain_value
from mcp_asdf_tools.robots import Population, firmware_names, parameter_names
from mcp_asdf_tools.world import Topology, WorldSettings

Settings = TypeVar("Settings", bound=WorldSettings)


def add_parameters(
    parser: argparse.ArgumentParser,
    kind: type[WorldSettings],
    title: str,
    only: Collection[str] | None = None,
) -> None:
    """An option for every parameter of ``kind``, or for those in ``only``; those not given are None."""
    group = parser.add_argument_group(title)
    for declared in fields(kind):
        meaning = meaning_of(declared)
        if meaning is not None and (only is None or declared.name in only):
            _add(group, declared, meaning)


def _add(group: argparse._ArgumentGroup, declared: Field[Any], meaning: Meaning) -> None:
    choices, default = _choices(declared), plain_value(declared.default)
    is_text = choices is not None or meaning.is_checked_by_class
    group.add_argument(
        f"--{declared.name.replace('_', '-')}",
        type=str if is_text else type(declared.default),
        choices=choices,
        metavar=None if choices else declared.name.split("_")[-1].upper(),
        help=meaning.text.replace("%", "%%") + _shown(str(default)),
    )


def _shown(default: str) -> str:
    return f" (default {default.replace('%', '%%')})" if default else ""


def _choices(declared: Field[Any]) -> Iterable[str] | None:
    if declared.name == "firmware":
        return firmware_names()
    if declared.name == "topology":
        return extensions.Names((member.value for member in Topology), extensions.TOPOLOGIES)
    if isinstance(declared.default, Enum):
        return [member.value for member in type(declared.default)]
    return None


def given_parameters(args: argparse.Namespace, kind: type[WorldSettings]) -> dict[str, Any]:
    """The parameters that were given, by name."""
    given = {name: getattr(args, name, None) for name in parameter_names(kind)}
    return {name: value for name, value in given.items() if value is not None}


def _with_option(error: ParameterError) -> str:
    """The message, with the option in place of the parameter."""
    option, message = f"--{error.key.replace('_', '-')}", str(error)
    is_first = message.startswith(f"{error.key} ")
    return f"{option}{message.removeprefix(error.key)}" if is_first else f"{option}: {message}"


def settings_from(
    args: argparse.Namespace, kind: type[Settings], base: dict[str, Any] | None = None, **more: Any
) -> Settings:
    """Settings of ``base`` with the options that were given.

    Raises UsageError, naming the option, for a value out of range or an option that would do nothing.
    """
    given = given_parameters(args, kind)
    values = (base or {}) | given | more
    try:
        settings = kind(**values)
    except ParameterError as error:
        raise UsageError(_with_option(error)) from error
    if isinstance(settings, Population):
        for name, reason in settings.unused_parameters().items():
            if name in given:
                raise UsageError(f"--{name.replace('_', '-')} would do nothing: {reason}; leave it out")
    return settings
