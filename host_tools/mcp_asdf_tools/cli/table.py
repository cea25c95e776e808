"""``mcp-asdf table``: make t-tables, and check generated files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report, print_again
from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from mcp_asdf_tools.tables.table_files import TableCheck

EPILOG = """\
examples:
  mcp-asdf table --output build/tables            # the paper's omega, any number of neighbours
      omega 0.05, q 127: 520 bytes (12 + 4 q)
  mcp-asdf table --omega 0.1 --neighbours 30 --output build/tables
  mcp-asdf table --check tables/*.c tables/*.json
exit code: 0 done, 1 a table is not what it should be, 2 bad usage"""
LIBRARIES = ("mpmath",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``--output`` and ``--check``, of which exactly one is required, and the options of the t-table.

    The options of the t-table are for ``--output`` alone.
    """
    job = parser.add_mutually_exclusive_group(required=True)
    job.add_argument(
        "--output", metavar="DIR", type=Path, help="write a t-table as a C and a JSON file into this folder"
    )
    job.add_argument(
        "--check",
        metavar="FILE",
        type=Path,
        nargs="+",
        help="check that these generated .c or .json files are as the generator makes them",
    )
    options.add_table_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write a table, or check files; return exit code 1 if a file is not what the generator makes, else 0.

    Raises UsageError for wrong options, and for a file that cannot be read or written.
    """
    from mcp_asdf_tools.tables.table_files import check_file

    if args.output is not None:
        omega, q = options.table_of(args)
        return _write(omega, q, args)
    # These options would do nothing here, and the user should know.
    if args.typed_options & {"--omega", "--neighbours"}:
        raise UsageError("--omega and --neighbours go with --output; a table to be checked states its own")
    return _print_checks([check_file(path) for path in args.check], args.json)


def _write(omega: Decimal, q: int, args: argparse.Namespace) -> int:
    """Write the table of omega and q, the number of neighbours with an exact threshold; return exit code 0.

    Its size, its errors and the names of its files are printed, or as JSON all that is known of it.
    """
    from mcp_asdf_tools.tables.table_files import describe_table, write_table
    from mcp_asdf_tools.tables.thresholds import MAX_MESSAGES

    files = [str(path) for path in write_table(omega, q, args.output)]
    table_facts = describe_table(omega, q)
    if args.json:
        print(json_report({"files": files} | table_facts))
        return 0
    worst_error = table_facts["worst_threshold_error"]
    error_beyond_q = ""
    if q < MAX_MESSAGES:  # of more messages than q the firmware computes a threshold, which is less exact
        error_beyond_q = f", {worst_error['beyond_q']:.2%} for {q} < m <= {MAX_MESSAGES}"
    print(f"omega {omega:f}, q {q}: {table_facts['bytes']} bytes ({table_facts['bytes_formula']})")
    print(f"worst threshold error: {worst_error['rounding']:.2e} by rounding{error_beyond_q}")
    print("\n".join(f"wrote {file}" for file in files))
    print_again(args, omega=omega, neighbours=q)
    return 0


def _print_checks(checks: Sequence[TableCheck], as_json: bool) -> int:
    """Print the outcome of checks; return the exit code, 1 if a table is not what it should be, else 0.

    There is a line for each file or, with ``as_json``, one object with all of them.
    """
    ok = all(check.problem is None for check in checks)
    if as_json:
        tables = [
            {"place": check.path, "omega": float(check.omega), "q": check.q, "problem": check.problem}
            for check in checks
        ]
        print(json_report({"ok": ok, "tables": tables}))
    else:
        for check in checks:
            print(f"{check.path}: omega {check.omega:f}, q {check.q}: {check.problem or 'ok'}")
    return 0 if ok else 1
