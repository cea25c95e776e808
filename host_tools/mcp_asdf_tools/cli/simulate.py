"""``mcp-asdf simulate``: run one experiment."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.again import json_report, print_again
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.library import simulate

EPILOG = """\
examples:
  mcp-asdf simulate                                 # 20 fully connected robots, 6 of them flawed
  mcp-asdf simulate --filter none --flawed 5 --output none.parquet
  mcp-asdf simulate --filter robust --flawed 5      # this project's own filter
  mcp-asdf simulate --trials 1 --record 100 --output run.parquet   # for mcp-asdf plot --kind series
  mcp-asdf simulate --drift linear --drift-rate=-1e-5 --memory 2000
FILE is an experiment (.toml). Equal parameters give equal results.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", nargs="?", type=Path, help="describes the experiment: .toml")
    options.add_run(parser, "keep the results: .parquet")


def run(args: argparse.Namespace) -> int:
    """Run the experiment, keep and print what came out."""
    from mcp_asdf_tools.experiments.result_tables import (  # noqa: PLC0415 (pyarrow loads slowly)
        experiments_in,
        read_metadata,
    )

    experiment, *more = options.experiments_of(args)
    if more:
        raise UsageError(f"{args.file} describes {len(more) + 1} experiments; run it with mcp-asdf sweep")
    workers, limits = options.check_workers(args.workers), options.limits_of(args)
    # A few seconds' work is done sooner than processes start.
    robot_steps = experiment.trials * experiment.robots * experiment.steps
    few = 1 if experiment.firmware == "native" and robot_steps < 10**8 else workers
    output = args.output and options.checked_output(args.output)
    table = simulate(experiment, output, workers=few, record=args.record, quiet=args.json)
    results = experiments_in(table)
    if args.json:
        print(json_report({**read_metadata(table), **options.summary(results, limits)[0]}))
    else:
        options.show(options.summary(results, limits), "one experiment")
        print_again(args, seed=experiment.seed)
    return 0
