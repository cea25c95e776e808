"""``mcp-asdf export``: write the values of robots over time as a table, for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcp_asdf_tools.cli.output import json_report
from mcp_asdf_tools.common.errors import UsageError

EPILOG = """\
examples:
  mcp-asdf export run.parquet run.csv               # needs simulate --record or sweep --record
  mcp-asdf export grid.parquet grid_robots.parquet  # a column for each parameter that varies
  mcp-asdf export run.log run.csv                   # the robots of a swarm run again, from run.log.events
A row has trial, parameters that vary, step, robot, is_flawed, t, n, x_hat, alpha, x_bar, beta, x and b_hat.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted"""
LIBRARIES = ("numpy", "pyarrow")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare RESULTS, the results or log to be read, and TABLE, the file to be written."""
    parser.add_argument(
        "source", metavar="RESULTS", type=Path, help="read results (.parquet), or the log of a swarm (.log)"
    )
    parser.add_argument("table", metavar="TABLE", type=Path, help="write a .csv or .parquet file")


def run(args: argparse.Namespace) -> int:
    """Write the table, and print its path and number of rows; return exit code 0.

    With --json the path of the source is printed, too. Raises UsageError if the source has no values over
    time, or the table cannot be written or is the source.
    """
    from mcp_asdf_tools.experiments.tidy_tables import check_tidy_path, write_tidy_tables
    from mcp_asdf_tools.library import stream_tidy_tables

    # The path is checked before the robots of a log run again, which may take long.
    check_tidy_path(args.table)
    if args.table.resolve() == args.source.resolve():
        raise UsageError(f"{args.table} is what is to be exported; choose another name for the table")
    row_count = write_tidy_tables(args.table, stream_tidy_tables(args.source))
    if args.json:
        print(json_report({"source": str(args.source), "table": str(args.table), "rows": row_count}))
    else:
        print(f"wrote {row_count} rows to {args.table}")
    return 0
