"""``mcp-asdf sweep``: run a grid of experiments on all processors."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from host_tools.commands import experiment_options as options
from host_tools.experiment_files import read_experiments
from host_tools.results import describe, experiments_in
from host_tools.sweeps import Store, run_sweep

HELP = "run a grid of experiments on all processors; goes on where it was interrupted"
EPILOG = """\
examples:
  mcp-asdf sweep grid.toml                          # results in grid.parquet
  mcp-asdf sweep param_multi_robot_sim_1d_static_degradation.yml --output authors.parquet
  mcp-asdf sweep grid.toml --seed 2 --firmware mirror --output mirror.parquet
A sweep that was interrupted is resumed by the same command: finished trials are in OUTPUT.parts and not run
again. So are those of a finished sweep when the file asks for more.
exit code: 0 done, 2 bad usage, 130 interrupted (what was finished is kept)"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", type=Path, help="describes the experiments: .toml, .yml")
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="where results go (default: FILE's name with .parquet)"
    )
    options.add_parameters(parser)
    options.add_limits(parser)
    options.add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Run what is missing, keep and print what came out."""
    workers = options.check_workers(args.workers)
    given = [options.with_parameters(experiment, args) for experiment in read_experiments(args.file)]
    store = Store(options.checked_output(args.output or args.file.with_suffix(".parquet")), given)
    missing = sum(len(store.missing(experiment)) for experiment in store.experiments)
    try:
        with options.progress(missing, args.json) as report:
            table = run_sweep(store, workers, report=report)
    except KeyboardInterrupt:
        left = sum(len(store.missing(experiment)) for experiment in store.experiments)
        print(f"{left} of {missing} trials left; the same command goes on", file=sys.stderr)
        raise
    experiments = experiments_in(table)
    limits = options.limits_of(args, experiments)
    if args.json:
        result = {**describe(table), "limits": limits._asdict(), "run": missing, "output": str(store.output)}
        print(json.dumps({**result, "experiments": options.summary(experiments, limits)}, indent=2))
    else:
        options.show(experiments, limits, str(store.output))
    return 0
