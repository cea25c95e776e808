"""Command-line options made from declared parameters, so that an option means the same in every command."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from typing import Any, TypeVar

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import Parameter, ParameterError, parameters_of
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.robots.population import Population

Settings = TypeVar("Settings", bound=Population)

COMMON_PARAMETERS = (
    "robots",
    "topology",
    "graph",
    "fill_ratio",
    "sensor",
    "density",
    "steps_per_second",
    "steps",
    "seed",
    "flawed",
    "filter",
    "filter_period",
    "firmware",
    "trials",
)
"""Parameters that users change most; the help lists them before all others."""

_FILTER_MEANINGS = "What --filter may be:\n" + "\n".join(
    f"  {swarm_filter.name:11} {swarm_filter.meaning}" for swarm_filter in FILTERS.values()
)


def option_of(parameter_name: str) -> str:
    """Return the option that sets a parameter, such as ``--filter-period`` for ``filter_period``."""
    return f"--{parameter_name.replace('_', '-')}"


def add_common_parameters(parser: argparse.ArgumentParser, kind: Any, title: str) -> None:
    """Add a group ``title`` of options for those parameters of the class ``kind`` that are common."""
    names = [name for name in parameters_of(kind) if name in COMMON_PARAMETERS]
    add_parameters(parser, kind, title, names)


def add_further_parameters(parser: argparse.ArgumentParser, kind: Any) -> None:
    """Add a group of options for those parameters of the class ``kind`` that are not common."""
    names = [name for name in parameters_of(kind) if name not in COMMON_PARAMETERS]
    add_parameters(parser, kind, "further parameters", names)


def add_parameters(parser: argparse.ArgumentParser, kind: Any, title: str, names: Collection[str]) -> None:
    """Add a group ``title`` of options for the named parameters of the class ``kind``.

    The options keep the order in which the class declares its parameters. The parsed value of an option that
    the user leaves out is None.
    """
    group = parser.add_argument_group(title, _FILTER_MEANINGS if "filter" in names else None)
    for name, parameter in parameters_of(kind).items():
        if name in names:
            _add_option(group, parameter)


def _add_option(group: argparse._ArgumentGroup, parameter: Parameter) -> None:
    """Add the option of one parameter, with its meaning and default as help."""
    choices = parameter.choices or None
    meaning = parameter.text
    if parameter.default != "":
        meaning += f" (default {parameter.default})"
    group.add_argument(
        option_of(parameter.name),
        # A value of another type, such as a count or share, is parsed by the class of the parameters.
        type=parameter.kind if parameter.kind in (int, float) else str,
        choices=choices,
        metavar=None if choices else parameter.name.split("_")[-1].upper(),
        help=meaning.replace("%", "%%"),
    )


def settings_from(
    args: argparse.Namespace,
    kind: type[Settings],
    base_values: dict[str, Any] | None = None,
    **other_values: Any,
) -> Settings:
    """Return settings of the class ``kind`` with the values of the options that the user gave.

    ``base_values`` hold where an option was left out; ``other_values`` hold in any case. Raises UsageError,
    which names the option, for a value that the class refuses and for an option that would have no effect.
    """
    option_values = {
        name: getattr(args, name) for name in parameters_of(kind) if getattr(args, name, None) is not None
    }
    try:
        settings = kind(**{**(base_values or {}), **option_values, **other_values})
    except ParameterError as error:
        raise UsageError(_name_option(error)) from error
    for name, reason in settings.unused_parameters().items():
        if name in option_values:
            raise UsageError(f"{option_of(name)} would do nothing: {reason}; leave it out")
    return settings


def _name_option(error: ParameterError) -> str:
    """Return the message of ``error`` with the option's name at its start, in place of the parameter's."""
    message = str(error)
    if message.startswith(f"{error.key} "):
        return option_of(error.key) + message.removeprefix(error.key)
    return f"{option_of(error.key)}: {message}"
