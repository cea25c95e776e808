"""``mcp-asdf reproduce``: run the paper's whole study and say which of its claims hold."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from pathlib import Path

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.again import json_report, print_again
from mcp_asdf_tools.cli.sweep import add_scheduler, telling_what_is_left
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import make_folder
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.experiments.results import experiments_in
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.sweep import run_missing, run_sweep
from mcp_asdf_tools.reproduction import ageing, robust, scaling
from mcp_asdf_tools.reproduction.runs import StudyFolder
from mcp_asdf_tools.reproduction.study import PAPER, PERIODS, QUICK, Part, Scale

OWN = {"robust": robust, "ageing": ageing, "scale": scaling}
"""Parts that are not the paper's, each a study of its own."""

EPILOG = """\
examples:
  mcp-asdf reproduce                                # as many trials as decide
  mcp-asdf reproduce --paper                        # the paper's 30 trials, in reproduction-paper
  mcp-asdf reproduce --quick                        # fewer and shorter trials, no verdicts
  mcp-asdf reproduce --part fully_connected --seed 7 --output other
  mcp-asdf reproduce --part robust                  # not the paper's: the robust filter
  mcp-asdf reproduce --part ageing                  # not the paper's: sensors that age
  mcp-asdf reproduce --part scale                   # not the paper's: 20 to 10,000 robots
The same command resumes a run that was interrupted, and makes the report of a finished one again.
exit code: 0 done, whatever the claims' verdicts, 2 bad usage, 128 + signal if interrupted (what
was finished is kept)"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add, full = parser.add_argument, Scale()
    size = parser.add_mutually_exclusive_group()
    quick = f"{QUICK.trials} trials of {QUICK.steps} steps: whether it works, without verdicts"
    size.add_argument("--quick", action="store_true", help=quick)
    size.add_argument(
        "--paper", action="store_true", help=f"the paper's {PAPER.trials} trials, with one seed"
    )
    add("--output", metavar="FOLDER", type=Path, help="for report and results (default: reproduction[-...])")
    parts = [*(part.value for part in Part), *OWN]
    text = f"only this part; may be repeated (default: the paper's, all but {' and '.join(OWN)})"
    add("--part", action="append", choices=parts, help=text)
    add("--trials", type=int, metavar="N", help="of each experiment (default: more until all is decided)")
    add("--steps", type=int, metavar="N", help=f"at most, of a trial (default {full.steps})")
    add("--seed", type=int, metavar="N", help=f"the first one (default {full.seed})")
    add("--seeds", type=int, metavar="N", help="how many (default: 2 where robots move, else 3)")
    options.add_workers(parser)
    add_scheduler(parser)


def run(args: argparse.Namespace) -> int:
    """Run what is missing, decide the claims, write the report."""
    from mcp_asdf_tools.reproduction import report  # noqa: PLC0415 (matplotlib loads slowly)

    workers, scale = options.check_workers(args.workers), scale_of(args)
    for name in OWN:
        if args.part is not None and name in args.part:
            return _run_own(name, args, workers, scale)
    parts = [part for part in Part if args.part is None or part.value in args.part]
    suffix = "-quick" if args.quick else "-paper" if args.paper else ""
    folder = args.output or Path(f"reproduction{suffix}")
    try:
        study = StudyFolder(folder, parts, scale)
    except ParameterError as error:
        raise UsageError(f"--{error.key}: {error}") from error
    if not args.json:
        print(f"{sum(store.left for store in study.stores)} trials to run", file=sys.stderr)

    def run_store(store: Store) -> None:
        with progress(f"{store.output.stem}: trials", store.left, args.json) as bar:
            run_missing(store, workers, bar, args.scheduler)

    with telling_what_is_left(study.stores):
        runs = list(study.runs(run_store))

    report.write_report(folder, runs, scale)
    claims = report.as_values(runs[0], scale)
    if args.json:
        print(json_report({"report": str(folder / "report.html"), "claims": claims}))
        return 0
    for each in claims:
        print(f"{each['verdict'] or 'too short':10} {each['part'] or 'equations':16} {each['claim']}")
    print(folder / "report.html")
    print_again(args, seed=scale.seed)
    return 0


def _run_own(part: str, args: argparse.Namespace, workers: int, scale: Scale) -> int:
    """A study that is not the paper's: all of its files, and its report."""
    if set(args.part) != {part} or args.paper or args.seeds is not None:
        raise UsageError(f"--part {part} is a study of its own; leave out --paper, --seeds and other parts")
    folder = args.output or Path(f"reproduction-{part}{'-quick' if args.quick else ''}")
    wanted = {name: robust.experiments_of(name, scale, args.seed) for name in OWN[part].FILES}
    make_folder(folder)
    stores = {
        name: Store(folder / f"{name}.parquet", experiments, robust.SAMPLING_INTERVAL)
        for name, experiments in wanted.items()
    }
    results = {}
    with telling_what_is_left(list(stores.values())):
        for name, store in stores.items():
            with progress(f"{name}: trials", store.left, args.json) as bar:
                table = run_sweep(store, workers, bar, args.scheduler)
            results[name] = experiments_in(table)
    OWN[part].write_report(folder, results)
    report = str(folder / f"{part}.md")
    print(json_report({"report": report}) if args.json else report)
    return 0


def scale_of(args: argparse.Namespace) -> Scale:
    """Size of the study by the options. Raises UsageError for values out of range."""
    names = [field.name for field in fields(Scale)]
    given = {name: value for name in names if (value := getattr(args, name)) is not None}
    scale = replace(QUICK if args.quick else PAPER if args.paper else Scale(), **given)
    least = {
        "trials": (2, "one says nothing of how sure it is"),
        "seeds": (1, "the first one"),
        "steps": (PERIODS[-1], "the longest tau"),
    }
    for name, (value, why) in least.items():
        if (own := getattr(scale, name)) is not None and own < value:
            raise UsageError(f"--{name} is {own}; give at least {value}: {why}")
    return scale
