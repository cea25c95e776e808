"""``mcp-asdf score``: the paper's scores of results."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcp_asdf_tools.cli import options

EPILOG = """\
examples:
  mcp-asdf score grid.parquet                       # K_max and e_max as in the paper: T and 0.45
  mcp-asdf score grid.parquet --k-max 40000 --e-max 0.45
  mcp-asdf score grid.parquet --csv grid.csv        # a line for every trial
exit code: 0 done, 2 bad usage"""
LIBRARIES = ("numpy", "pyarrow", "rich.console")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, the results, ``--csv``, the file for a line on each trial, and the limits of scores."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="read the results from a .parquet file, such as grid.parquet"
    )
    parser.add_argument(
        "--csv",
        metavar="FILE",
        type=Path,
        help="write a line for each trial, such as to grid.csv (default: no file)",
    )
    options.add_limit_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read results, write their trials as CSV if asked to, and print their scores; return exit code 0.

    With --json the scores are printed as JSON, with the metadata. Raises UsageError if the results cannot be
    read, the CSV file cannot be written, or a limit is out of range.
    """
    from mcp_asdf_tools.cli.score_table import report_scores
    from mcp_asdf_tools.experiments.result_files import stream_experiments
    from mcp_asdf_tools.experiments.results import write_csv

    limits = options.limits_of(args)
    if args.csv is not None:
        write_csv(args.csv, stream_experiments(args.file), limits)
    # Read a second time rather than kept, as a large file does not fit in memory.
    report_scores(args.file, limits, args.json)
    return 0
