"""``mcp-asdf reproduce``: run the paper's whole study and say which of its claims hold."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report, print_again, reporting_missing_trials
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.studies.cells import (
    FILTER_PERIODS,
    Cell,
    StudyPart,
    StudySize,
    cell_of,
    cells_of,
    experiment_of,
)

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.results import Trials
    from mcp_asdf_tools.experiments.store import Store

EPILOG = """\
examples:
  mcp-asdf reproduce                                # the paper's 30 trials of each experiment
  mcp-asdf reproduce --trials 120                   # more trials, which leave fewer claims undecided
  mcp-asdf reproduce --quick                        # fewer and shorter trials, no verdicts
  mcp-asdf reproduce --part fully_connected --seed 7 --output other
The same command resumes a run that was interrupted, and makes the report of a finished one again. With more
trials it runs those that are new.
exit code: 0 done, whatever the claims' verdicts, 2 bad usage, 128 + signal if interrupted (what
was finished is kept)"""
LIBRARIES = ("numpy", "matplotlib", "pyarrow", "rich.progress")

PAPER_SIZE = StudySize()
QUICK_SIZE = StudySize(trials=10, steps=10_000)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"{QUICK_SIZE.trials} trials of {QUICK_SIZE.steps} steps: whether it works, without verdicts",
    )
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, help="for report and results (default: reproduction[-quick])"
    )
    parser.add_argument(
        "--part",
        action="append",
        choices=[study_part.value for study_part in StudyPart],
        help="only this part; may be repeated (default: all)",
    )
    parser.add_argument(
        "--trials", type=int, metavar="N", help=f"of each experiment (default {PAPER_SIZE.trials})"
    )
    parser.add_argument(
        "--steps", type=int, metavar="N", help=f"at most, of a trial (default {PAPER_SIZE.steps})"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help=f"of all random numbers (default {PAPER_SIZE.seed})"
    )
    options.add_worker_option(parser)
    options.add_scheduler_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the trials that are missing, decide the claims and write the report; return exit code 0."""
    from mcp_asdf_tools.studies import report
    from mcp_asdf_tools.studies.claims import decide
    from mcp_asdf_tools.studies.study_results import StudyResults

    workers = options.workers_of(args)
    study_size = study_size_from(args)
    output_folder = args.output or Path("reproduction-quick" if args.quick else "reproduction")
    # In the paper's order, whichever the options have.
    study_parts = [
        study_part for study_part in StudyPart if args.part is None or study_part.value in args.part
    ]
    stores = open_stores(output_folder, study_parts, study_size)
    study_results = StudyResults(_run_missing_trials(stores, workers, args))
    decisions = decide(study_results)
    report.write_report(output_folder, study_results, decisions, study_size)

    claims = report.decisions_as_json(decisions, study_size)
    if args.json:
        print(json_report({"report": str(output_folder / "report.html"), "claims": claims}))
        return 0
    for claim in claims:
        print(f"{claim['verdict'] or 'too short':10} {claim['part'] or 'equations':16} {claim['claim']}")
    print(output_folder / "report.html")
    print_again(args, seed=study_size.seed)
    return 0


def study_size_from(args: argparse.Namespace) -> StudySize:
    """Return how much is to be run, by the options. Raises UsageError for too few trials or steps."""
    default_size = QUICK_SIZE if args.quick else PAPER_SIZE
    study_size = StudySize(
        default_size.trials if args.trials is None else args.trials,
        default_size.steps if args.steps is None else args.steps,
        default_size.seed if args.seed is None else args.seed,
    )
    if study_size.trials < 2:
        raise UsageError(
            f"--trials is {study_size.trials}; give at least 2: one says nothing of how sure it is"
        )
    # In fewer steps the robots with this period would never filter.
    longest_period = FILTER_PERIODS[-1]
    if study_size.steps < longest_period:
        raise UsageError(f"--steps is {study_size.steps}; give at least {longest_period}: the longest tau")
    return study_size


def open_stores(folder: Path, parts: list[StudyPart], study_size: StudySize) -> dict[StudyPart, Store]:
    """Open the results of each part in a folder, which is made if need be; those that exist are kept.

    Raises UsageError for a size out of range, results of another study, and a folder that cannot be written.
    """
    from mcp_asdf_tools.common.files import make_folder
    from mcp_asdf_tools.experiments.store import Store

    try:
        # All experiments are made first: a wrong option must leave no folder behind.
        experiments_by_part = {
            study_part: [experiment_of(cell, study_size) for cell in cells_of(study_part)]
            for study_part in parts
        }
    except ParameterError as error:
        raise UsageError(f"--{error.key}: {error}") from error
    make_folder(folder)
    return {
        study_part: Store(folder / f"{study_part.value}.parquet", experiments)
        for study_part, experiments in experiments_by_part.items()
    }


def _run_missing_trials(
    stores: dict[StudyPart, Store], workers: int, args: argparse.Namespace
) -> dict[Cell, Trials]:
    """Run the trials that the stores lack, part by part, and return all trials by cell of the study.

    Progress goes to standard error, unless --json is given.
    """
    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.experiments.result_files import stream_experiments
    from mcp_asdf_tools.experiments.sweep import run_sweep

    if not args.json:
        missing_count = sum(store.missing_count for store in stores.values())
        print(f"{missing_count} trials to run", file=sys.stderr)
    trials_by_cell = {}
    with reporting_missing_trials(list(stores.values())):
        for study_part, store in stores.items():
            with progress(f"{study_part.value}: trials", store.missing_count, args.json) as report_progress:
                run_sweep(store, workers, report_progress, args.scheduler)
            # Read from the file, which also has the trials of earlier runs.
            for trials in stream_experiments(store.output):
                trials_by_cell[cell_of(study_part, trials.experiment)] = trials
    return trials_by_cell
