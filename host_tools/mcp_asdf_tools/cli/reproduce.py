"""``mcp-asdf reproduce``: run the paper's whole study and say which of its claims hold."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.cli.output import json_report, print_again, reporting_missing_trials
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.robots.filters import FILTERS
from mcp_asdf_tools.studies.cells import (
    FILTER_PERIODS,
    PAPERS_FILTERS,
    PAPERS_FIRMWARE,
    Cell,
    StudyPart,
    StudySize,
    cell_of,
    cells_of,
    experiment_of,
    users_experiments_of,
)

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.experiment import Experiment
    from mcp_asdf_tools.experiments.results import Trials
    from mcp_asdf_tools.experiments.store import Store
    from mcp_asdf_tools.studies.study_results import StudyResults

EPILOG = """\
examples:
  mcp-asdf reproduce                                # every figure and claim, with the paper's 30 trials
  mcp-asdf reproduce --part dynamic                 # figures 3 and 4 only
  mcp-asdf reproduce --quick --filter robust        # short trials, with the robust filter in each figure
  mcp-asdf reproduce --part physical --firmware reference --output mine   # another firmware in figure 8
  mcp-asdf reproduce --trials 120                   # decide more claims, with more trials
The same command resumes an interrupted run, and renews the report of a finished one. With more trials it runs
only the new ones.
exit code: 0 done, whatever the claims' verdicts, 2 bad usage, 128 + signal if interrupted (what
was finished is kept)"""
LIBRARIES = ("numpy", "matplotlib", "pyarrow", "rich.progress")

StoreKey = tuple[StudyPart, str]
"""Key of a file of results: the part of the study, and the name of the user's firmware or filter in the file.
The name is empty for the paper's study."""

PAPER_SIZE = StudySize()
QUICK_SIZE = StudySize(trials=10, steps=10_000)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare which parts of the study run, with how many trials and steps, by which workers, and the output.

    ``--firmware`` and ``--filter`` are of the user's, to be compared with the paper's.
    """
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"run {QUICK_SIZE.trials} trials of {QUICK_SIZE.steps} steps, without verdicts",
    )
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        type=Path,
        help="write report and results there (default: reproduction[-quick])",
    )
    parser.add_argument(
        "--part",
        action="append",
        choices=[study_part.value for study_part in StudyPart],
        help="run only this part; repeat for a second one (default: all)",
    )
    options.add_firmware_option(
        parser, "draw this firmware of yours beside the paper's filter, such as beta (default: none)"
    )
    parser.add_argument(
        "--filter",
        choices=[name for name in FILTERS if name not in PAPERS_FILTERS],
        help="draw this filter beside the paper's (default: none)",
    )
    parser.add_argument(
        "--trials",
        type=int,
        metavar="N",
        help=f"run so many trials of each experiment (default {PAPER_SIZE.trials})",
    )
    parser.add_argument(
        "--steps", type=int, metavar="N", help=f"end a trial after N steps (default {PAPER_SIZE.steps})"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help=f"seed all random numbers (default {PAPER_SIZE.seed})"
    )
    options.add_worker_option(parser)
    options.add_scheduler_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the trials that are missing, decide the claims and write the report; return exit code 0.

    The verdict on each claim and the path of the report are printed, as JSON with --json. Raises UsageError
    for wrong options, and if trials cannot be run or files not be written.
    """
    from mcp_asdf_tools.studies import report
    from mcp_asdf_tools.studies.claims import decide

    workers = options.workers_of(args)
    study_size = study_size_from(args)
    default_folder = "reproduction-quick" if args.quick else "reproduction"
    output_folder = args.output or Path(default_folder)
    stores = open_stores(output_folder, experiments_by_store(args, study_size))
    _run_missing_trials(stores, workers, args)
    study_results = _read_results(stores)
    decisions = decide(study_results)
    report.write_report(output_folder, study_results, decisions, study_size)
    claims = report.decisions_as_json(decisions, study_size)
    report_path = output_folder / "report.html"
    if args.json:
        print(json_report({"report": str(report_path), "claims": claims}))
    else:
        _print_verdicts(claims)
        print(report_path)
        print_again(args, seed=study_size.seed)
    return 0


def _print_verdicts(claims: Sequence[Mapping[str, Any]]) -> None:
    """Print one line per claim, with the claim's verdict, its part of the study, and its text."""
    for claim in claims:
        verdict = claim["verdict"] or "too short"  # as trials are with --quick, which have no verdicts
        subject = claim["part"] or "equations"  # which are no part of the study
        print(f"{verdict:10} {subject:16} {claim['claim']}")


def study_size_from(args: argparse.Namespace) -> StudySize:
    """Return how many trials of how many steps are to be run, and the seed.

    What the options leave open is as in the paper, or as --quick has it. Raises UsageError for fewer than two
    trials, and for fewer steps than the longest filter period.
    """
    default_size = QUICK_SIZE if args.quick else PAPER_SIZE
    study_size = StudySize(
        trials=default_size.trials if args.trials is None else args.trials,
        steps=default_size.steps if args.steps is None else args.steps,
        seed=default_size.seed if args.seed is None else args.seed,
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


def firmware_and_filter_of_user(args: argparse.Namespace) -> tuple[str, str | None]:
    """Return the firmware, and the filter if there is one, that the user sets beside the paper's filter.

    Without --firmware the firmware is the paper's. Raises UsageError if the user has typed the paper's.
    """
    if args.firmware == PAPERS_FIRMWARE:
        raise UsageError(
            f"--firmware {args.firmware} would do nothing: the study runs it anyway; leave it out"
        )
    return args.firmware or PAPERS_FIRMWARE, args.filter


def experiments_by_store(args: argparse.Namespace, study_size: StudySize) -> dict[StoreKey, list[Experiment]]:
    """Return a dictionary from the key of a file of results to the experiments of that file.

    Each chosen part of the study has one file, in the paper's order. If the user has chosen a firmware or a
    filter, each part has a second file with that choice. The second files come last. Raises UsageError for
    a wrong choice, and for a size of the study that is out of range.
    """
    from mcp_asdf_tools.studies.study_results import users_name_of

    users_firmware, users_filter = firmware_and_filter_of_user(args)
    has_users_choice = users_firmware != PAPERS_FIRMWARE or users_filter is not None
    # Without --part, which is None then, all parts are chosen.
    parts = [study_part for study_part in StudyPart if args.part is None or study_part.value in args.part]
    experiments_by_key = {}
    try:
        for study_part in parts:
            papers_experiments = [experiment_of(cell, study_size) for cell in cells_of(study_part)]
            experiments_by_key[study_part, ""] = papers_experiments
        if has_users_choice:
            for study_part in parts:
                users_experiments = users_experiments_of(study_part, study_size, users_firmware, users_filter)
                any_experiment = users_experiments[0]  # all have what the name is made of
                experiments_by_key[study_part, users_name_of(any_experiment)] = users_experiments
    except ParameterError as error:
        raise UsageError(f"--{error.key}: {error}") from error
    return experiments_by_key


def open_stores(
    folder: Path, experiments_by_key: Mapping[StoreKey, Sequence[Experiment]]
) -> dict[StoreKey, Store]:
    """Open the files of results in a folder, which is made if need be; results that exist are kept.

    Raises UsageError for results of another study, and for a folder that cannot be written.
    """
    from mcp_asdf_tools.common.files import make_folder
    from mcp_asdf_tools.experiments.store import Store

    make_folder(folder)
    stores = {}
    for (study_part, users_name), experiments in experiments_by_key.items():
        file_name = f"{study_part.value}_{users_name}" if users_name else study_part.value
        stores[study_part, users_name] = Store(folder / f"{file_name}.parquet", experiments)
    return stores


def _run_missing_trials(stores: Mapping[StoreKey, Store], workers: int, args: argparse.Namespace) -> None:
    """Run the trials that the stores lack, one store after the other.

    Progress goes to standard error, unless --json is given. Raises UsageError if trials cannot be run or
    written.
    """
    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.experiments.sweep import run_sweep

    if not args.json:
        missing_count = sum(store.missing_count for store in stores.values())
        print(f"{missing_count} trials to run", file=sys.stderr)
    with reporting_missing_trials(list(stores.values())):
        for (study_part, users_name), store in stores.items():
            # The store of the paper's own filters has no name of a user.
            label = f"{study_part.value} {users_name}".rstrip()
            with progress(f"{label}: trials", store.missing_count, args.json) as report_progress:
                run_sweep(store, workers, report_progress, args.scheduler)


def _read_results(stores: Mapping[StoreKey, Store]) -> StudyResults:
    """Read the trials of finished stores: those of the paper's study, and those of the user's choice."""
    from mcp_asdf_tools.experiments.result_files import stream_experiments
    from mcp_asdf_tools.studies.study_results import StudyResults

    trials_by_cell: dict[Cell, Trials] = {}
    users_trials: dict[StudyPart, list[Trials]] = {}
    for (study_part, users_name), store in stores.items():
        trials_of_store = list(stream_experiments(store.output))
        if users_name:
            users_trials[study_part] = trials_of_store
        else:
            for trials in trials_of_store:
                trials_by_cell[cell_of(study_part, trials.experiment)] = trials
    return StudyResults(trials_by_cell, users_trials)
