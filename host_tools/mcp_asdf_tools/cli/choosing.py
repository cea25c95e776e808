"""Experiments chosen from results by their parameters: the option ``--where``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError, offer

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.results import Trials


def add_where(parser: argparse._ActionsContainer) -> None:
    """The option; ``chosen`` obeys it."""
    parser.add_argument(
        "--where",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="only experiments with this parameter, such as filter=none; repeatable",
    )


def chosen(args: argparse.Namespace, only_one: bool = False) -> list[Trials]:
    """The experiments of the file ``args.file`` that meet all conditions.

    Raises UsageError, with what there is, for a condition on no parameter and one that nothing meets, and if
    there are several where ``only_one`` can be shown.
    """
    from mcp_asdf_tools.experiments.results import experiments_in, is_value, read_table  # noqa: PLC0415

    found = experiments_in(read_table(args.file))
    for condition in args.where:
        name, equals, value = condition.partition("=")
        known = found[0].experiment.parameters()
        if not equals or name not in known:
            raise UsageError(
                f"--where {condition}: write NAME=VALUE with a parameter's name{offer(name, known)}; "
                f"in {args.file} differ {_differing(found) or 'no parameters'}"
            )
        values = {str(each.experiment.parameters()[name]) for each in found}
        found = [each for each in found if is_value(each.experiment.parameters()[name], value)]
        if not found:
            there = " or ".join(sorted(values))
            raise UsageError(f"--where {condition}: no experiment of {args.file} has it; {name} is {there}")
    if only_one and len(found) > 1:
        raise UsageError(f"{len(found)} experiments match; choose one with --where {_differing(found)}")
    return found


def _differing(found: Sequence[Trials]) -> str:
    """The parameters in which experiments differ, with their values."""
    parameters = [each.experiment.parameters() for each in found]
    values = {name: sorted({str(each[name]) for each in parameters}) for name in parameters[0]}
    return ", ".join(f"{name}={'|'.join(each)}" for name, each in values.items() if len(each) > 1)
