"""Experiments chosen from results by their parameters: the option ``--where``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError

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


def chosen(args: argparse.Namespace) -> list[Trials]:
    """The experiments of the file ``args.file`` that meet all conditions.

    Raises UsageError, with what there is, for a condition on no parameter and one that nothing meets.
    """
    from mcp_asdf_tools.experiments import results  # noqa: PLC0415 (the tables' library loads slowly)

    found = results.experiments_in(results.read_table(args.file))
    for condition in args.where:
        name, equals, value = condition.partition("=")
        if not equals:
            there = results.differing(found)
            raise UsageError(f"--where {condition}: write NAME=VALUE; the experiments differ in {there}")
        found = results.matching(found, {name: value})
    return found
