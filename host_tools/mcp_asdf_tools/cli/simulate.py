"""``mcp-asdf simulate``: run one experiment."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.again import print_again
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import read_experiments
from mcp_asdf_tools.experiments.results import experiments_in, metadata_of
from mcp_asdf_tools.experiments.sweep import Store, run_sweep

EPILOG = """\
examples:
  mcp-asdf simulate                                 # 20 fully connected robots, 6 of them flawed
  mcp-asdf simulate --filter none --flawed 5 --output none.parquet
  mcp-asdf simulate --trials 1 --record 100 --output run.parquet   # for mcp-asdf plot --kind series
  mcp-asdf simulate --drift linear --drift-rate=-1e-5 --memory 2000
FILE is an experiment (.toml). Equal parameters give equal results.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", nargs="?", type=Path, help="describes the experiment: .toml")
    options.add_parameters(parser)
    options.add_limits(parser)
    output = parser.add_argument_group("output")
    output.add_argument("--output", metavar="FILE", type=Path, help="keep the results: .parquet")
    options.add_record(output)
    options.add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Run the experiment, keep and print what came out."""
    experiment = settings_of(args)
    workers, interval = options.check_workers(args.workers), options.sampling_interval(args, [experiment])
    with tempfile.TemporaryDirectory() as folder:
        output = (
            Path(folder, "results.parquet") if args.output is None else options.checked_output(args.output)
        )
        store = Store(output, [experiment], interval)
        missing = len(store.missing(experiment))
        with progress("trials", missing, args.json) as report:
            # A few seconds' work is done sooner than processes start.
            is_short = (
                experiment.firmware == "native" and missing * experiment.robots * experiment.steps < 10**8
            )
            table = run_sweep(store, 1 if is_short else workers, interval, report)
    experiments = experiments_in(table)
    limits = options.limits_of(args)
    if args.json:
        print(json.dumps({**metadata_of(table), **options.summary(experiments, limits)[0]}, indent=2))
    else:
        options.show(experiments, limits, "one experiment")
        print_again(args, seed=experiment.seed)
    return 0


def settings_of(args: argparse.Namespace) -> Experiment:
    """The experiment of file and options. Raises UsageError for a value out of range."""
    if args.file is None:
        return options.experiment_of(args)
    experiments = read_experiments(args.file)
    if len(experiments) != 1:
        raise UsageError(f"{args.file} describes {len(experiments)} experiments; run it with mcp-asdf sweep")
    return options.with_parameters(experiments[0], args)
