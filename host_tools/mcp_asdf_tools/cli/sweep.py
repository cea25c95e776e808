"""``mcp-asdf sweep``: run a grid of experiments on all processors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.again import json_report, print_again
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.experiments.sweep import run_sweep

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.store import Store

EPILOG = """\
examples:
  mcp-asdf sweep grid.toml                          # results in grid.parquet
  mcp-asdf sweep grid.toml --scheduler tcp://head:8786      # on a Dask cluster
  mcp-asdf sweep grid.toml --record 100 --output recorded.parquet     # with values over time
  mcp-asdf sweep grid.toml --seed 2 --firmware mirror --output mirror.parquet
A sweep that was interrupted is resumed by the same command: finished trials are in OUTPUT.parts and not run
again. So are those of a finished sweep when the file asks for more.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted (what was finished is kept)"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="describes the experiments: .toml")
    options.add_run(parser, "where results go (default: FILE's name with .parquet)")
    add_scheduler(parser)


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--scheduler``, which runs trials on a cluster."""
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on the Dask cluster with this scheduler, such as tcp://HOST:8786, not in processes here",
    )


@contextmanager
def telling_what_is_left(stores: Sequence[Store]) -> Iterator[None]:
    """Print to standard error how many trials are left if Ctrl-C or a signal ends this context."""
    missing_at_start = sum(store.missing_count for store in stores)
    try:
        yield
    except KeyboardInterrupt:
        still_missing = sum(store.missing_count for store in stores)
        print(f"{still_missing} of {missing_at_start} trials left; the same command goes on", file=sys.stderr)
        raise


def run(args: argparse.Namespace) -> int:
    """Run the trials that the output file lacks, complete it, and print its scores; return exit code 0."""
    from mcp_asdf_tools.experiments.result_files import (  # noqa: PLC0415 (pyarrow loads slowly)
        read_table,
        stream_experiments,
    )
    from mcp_asdf_tools.experiments.result_tables import read_metadata  # noqa: PLC0415
    from mcp_asdf_tools.experiments.store import Store  # noqa: PLC0415

    workers = options.check_workers(args.workers)
    limits = options.limits_of(args)
    experiments = options.experiments_of(args)
    output = options.checked_output(args.output or args.file.with_suffix(".parquet"))
    store = Store(output, experiments, args.record)
    missing_count = store.missing_count
    with telling_what_is_left([store]), progress("trials", missing_count, args.json) as report_progress:
        run_sweep(store, workers, report_progress, args.scheduler)
    rows = options.summary(stream_experiments(output), limits)
    if args.json:
        metadata = read_metadata(read_table(output, ["trial"]))
        result = {**metadata, "run": missing_count, "output": str(output), "experiments": rows}
        print(json_report(result))
    else:
        options.show(rows, str(output))
        seeds = {experiment.seed for experiment in experiments}
        if len(seeds) == 1:
            print_again(args, seed=seeds.pop())
        else:
            print_again(args)  # the file has several seeds, and an option would replace them all
    return 0
