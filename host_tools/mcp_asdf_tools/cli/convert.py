"""``mcp-asdf convert``: convert trial files of the paper's authors into results."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]

EPILOG = """\
examples:
  mcp-asdf convert data --output theirs.parquet      # all .json files in a folder and below
  mcp-asdf convert flw6_t0.json flw6_t1.json --output theirs.parquet --record 100
  mcp-asdf score theirs.parquet
  mcp-asdf view theirs.parquet --trial 1
The files are those of github.com/NESTLab/sensor-degradation-filter, of fixed networks and of ARGoS.
exit code: 0 done, 2 bad usage"""
LIBRARIES = ("numpy", "pyarrow", "rich.progress")

_DEFAULT_RECORD = 10
"""Steps from one recorded value to the next: fine enough for a page, and a tenth of the data."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the trial files, ``--output``, the results, and ``--record``, how often to keep values."""
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=Path,
        help="read trials from .json files, or from folders of them",
    )
    parser.add_argument(
        "--output", metavar="FILE", type=Path, required=True, help="write the results to a .parquet file"
    )
    parser.add_argument(
        "--record",
        metavar="STEPS",
        type=int,
        default=_DEFAULT_RECORD,
        help="keep the values of each robot every STEPS steps; 0: only the scores (default %(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Read the trials, write them to the file of results, and print their scores; return exit code 0.

    With --json the scores are printed as JSON, with the metadata and the path of the results. Raises
    UsageError for options out of range, for a file that is no trial of the paper's method, and if the results
    cannot be written.
    """
    from mcp_asdf_tools.cli.score_table import report_scores
    from mcp_asdf_tools.common.files import check_target
    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.experiments.authors_trials import find_trial_files
    from mcp_asdf_tools.experiments.result_files import collect_rows, write_tables
    from mcp_asdf_tools.experiments.scores import PAPER_LIMITS

    # Path and options are checked before the trials are read, which may take long.
    options.check_results_path(args.output)
    check_target(args.output)
    if args.record < 0:
        raise UsageError(f"--record is {args.record}; choose a number of steps, or 0 for none")
    files = find_trial_files(args.files)
    with progress("trials", len(files), args.json) as report_progress:
        tables = _read_tables(files, args.record, report_progress)
        # A row group for each trial would make the time to read them grow with the square of their number.
        write_tables(args.output, collect_rows(tables))
    report_scores(args.output, PAPER_LIMITS, args.json, output=str(args.output))
    return 0


def _read_tables(
    files: Iterable[Path], sampling_interval: int, report_progress: Callable[[float], None]
) -> Iterator[pa.Table]:
    """Yield each trial as a table of one row, and report it as done."""
    from mcp_asdf_tools.experiments.authors_trials import read_trials
    from mcp_asdf_tools.experiments.result_tables import trials_to_table

    for trials in read_trials(files, sampling_interval):
        yield trials_to_table(trials)
        report_progress(1)
