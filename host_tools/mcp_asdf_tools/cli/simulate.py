"""``mcp-asdf simulate``: run one experiment."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report, print_again
from mcp_asdf_tools.common.errors import UsageError

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment

EPILOG = """\
examples:
  mcp-asdf simulate                                 # 20 fully connected robots, 6 of them flawed
  mcp-asdf simulate --filter none --flawed 5 --output none.parquet
  mcp-asdf simulate --topology dynamic --filter robust             # moving robots, the robust filter
  mcp-asdf simulate --trials 1 --record 100 --output run.parquet   # for mcp-asdf plot --kind series
  mcp-asdf simulate --drift linear --drift-rate=-1e-5 --memory 2000
Equal parameters give equal results.
exit code: 0 done, 2 bad usage, 128 + signal if interrupted"""
LIBRARIES = ("numpy", "pyarrow", "rich.console")

_ROBOT_STEPS_FOR_PROCESSES = 10**8
"""Steps of all robots from which on further processes pay: fewer take a second or two in this one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, the experiment, which may be left out, and the options of experiments.

    These are ``--output``, ``--record``, ``--workers``, parameters that replace those of FILE, and the limits
    of scores.
    """
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        type=Path,
        help="read the experiment from a .toml file, such as one.toml",
    )
    options.add_experiment_options(
        parser, "write the results to a .parquet file (default: print only their scores)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the experiment, write its results if ``--output`` names a file, and print its scores; return 0.

    An experiment of the native firmware that takes a second or two runs in this process, whatever the number
    of workers. With --json the scores are printed as JSON, with the metadata. Raises UsageError for wrong
    options, for a file of several experiments, and if the results cannot be written.
    """
    from mcp_asdf_tools.cli.score_table import print_scores, summarize
    from mcp_asdf_tools.experiments.result_tables import read_metadata
    from mcp_asdf_tools.library import experiments_in, simulate

    experiments = options.experiments_of(args)
    if len(experiments) > 1:
        raise UsageError(f"{args.file} describes {len(experiments)} experiments; run it with mcp-asdf sweep")
    experiment = experiments[0]
    workers = options.workers_of(args)
    limits = options.limits_of(args)
    if _is_short(experiment):
        workers = 1
    if args.output is not None:
        options.check_results_path(args.output)
    table = simulate(experiment, args.output, workers=workers, record=args.record, quiet=args.json)
    rows = summarize(experiments_in(table), limits)
    if args.json:
        print(json_report({**read_metadata(table), **rows[0]}))
    else:
        print_scores(rows, "one experiment")
        print_again(args, seed=experiment.seed)
    return 0


def _is_short(experiment: Experiment) -> bool:
    """Return whether an experiment takes less time than worker processes would take to start.

    Only trials of the native firmware can be so short. Those of other firmwares run in Python, which is slow.
    """
    robot_steps = experiment.trials * experiment.robots * experiment.steps
    return experiment.firmware == "native" and robot_steps < _ROBOT_STEPS_FOR_PROCESSES
