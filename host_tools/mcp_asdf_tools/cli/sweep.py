"""``mcp-asdf sweep``: run a grid of experiments on all processors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import print_again, reporting_missing_trials

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment

EPILOG = """\
examples:
  mcp-asdf sweep grid.toml                          # results in grid.parquet
  mcp-asdf sweep grid.toml --scheduler tcp://head:8786      # on a Dask cluster
  mcp-asdf sweep grid.toml --record 100 --output recorded.parquet     # with values over time
  mcp-asdf sweep grid.toml --seed 2 --firmware mirror --output mirror.parquet
To resume an interrupted sweep, repeat the command: finished trials are in OUTPUT.parts and do not run again.
If the file asks for more trials later, only the new ones run.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted (what was finished is kept)"""
LIBRARIES = ("numpy", "pyarrow", "rich.progress")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, the experiments, the options of experiments, such as ``--output``, and the scheduler."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="read the experiments from a .toml file, such as grid.toml"
    )
    options.add_experiment_options(
        parser, "write the results to a .parquet file (default: FILE's name with .parquet)"
    )
    options.add_scheduler_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the trials that the output file lacks, complete it, and print its scores; return exit code 0.

    With --json the scores are printed as JSON, with the number of trials that were run. Otherwise a table is
    printed, and the command that makes the same run again. If the run is cut off, a message says how many
    trials are missing.
    """
    from mcp_asdf_tools.cli.score_table import report_scores
    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.experiments.store import Store
    from mcp_asdf_tools.experiments.sweep import run_sweep

    workers = options.workers_of(args)
    limits = options.limits_of(args)
    experiments = options.experiments_of(args)
    output = args.output or args.file.with_suffix(".parquet")
    options.check_results_path(output)
    store = Store(output, experiments, args.record)
    # Counted before the run, after which none is missing.
    missing_count = store.missing_count
    with (
        reporting_missing_trials([store]),
        progress("trials", missing_count, args.json) as report_progress,
    ):
        run_sweep(store, workers, report_progress, args.scheduler)
    report_scores(output, limits, args.json, run=missing_count, output=str(output))
    if not args.json:
        _print_command(args, experiments)
    return 0


def _print_command(args: argparse.Namespace, experiments: Sequence[Experiment]) -> None:
    """Print the command that makes the same run again. It has a seed if all experiments have the same one."""
    seeds = {experiment.seed for experiment in experiments}
    if len(seeds) == 1:
        print_again(args, seed=seeds.pop())
    else:
        print_again(args)  # without a seed: the file names several, and --seed would replace them all
