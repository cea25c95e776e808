"""``mcp-asdf reproduce``: run the paper's whole study and say which of its claims hold."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.again import print_again
from mcp_asdf_tools.cli.sweep import add_scheduler, telling_what_is_left
from mcp_asdf_tools.common import ParameterError, UsageError, progress
from mcp_asdf_tools.experiments import Convention, Store, Trials, run_missing
from mcp_asdf_tools.reproduction import (
    PAPER,
    PAPER_TRIALS,
    PART_NAMES,
    PERIODS,
    QUICK,
    Part,
    Run,
    Scale,
    StudyFolder,
    Verdict,
    seconds_of,
)
from mcp_asdf_tools.robots import FIRMWARES

EPILOG = """\
examples:
  mcp-asdf reproduce                                # as many trials as decide; says how long
  mcp-asdf reproduce --paper                        # the paper's 30 trials, in reproduction-paper
  mcp-asdf reproduce --quick                        # fewer and shorter trials, no verdicts
  mcp-asdf reproduce --part fully_connected --seed 7 --output other
  mcp-asdf reproduce --redraw                       # the report again, nothing is run
  mcp-asdf reproduce --firmware reference --conventions authors --trials 30 --output authors
A run that was interrupted is resumed by the same command: finished trials are kept and not run again.
exit code: 0 done, whatever the claims' verdicts, 2 bad usage, 128 + signal if interrupted (what
was finished is kept)"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, help="for report and results (default: reproduction[-quick])"
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick",
        action="store_true",
        help=f"{QUICK.trials} trials of {QUICK.steps} steps: whether it works, without verdicts",
    )
    size.add_argument(
        "--paper", action="store_true", help=f"the paper's {PAPER_TRIALS} trials, with one seed"
    )
    parser.add_argument(
        "--part",
        action="append",
        choices=[part.value for part in Part],
        help="only this part of the study; may be repeated (default: all)",
    )
    parser.add_argument(
        "--redraw", action="store_true", help="make the report again from the results; refuse to run anything"
    )
    full = Scale()
    parser.add_argument(
        "--trials",
        type=int,
        metavar="N",
        help="of each experiment (default: more until comparisons are decided)",
    )
    parser.add_argument("--steps", type=int, metavar="N", help=f"at most, of a trial (default {full.steps})")
    parser.add_argument("--seed", type=int, metavar="N", help=f"the first one (default {full.seed})")
    parser.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="how many, from the first on (default: 2 where robots move, else 3)",
    )
    parser.add_argument("--firmware", choices=FIRMWARES, help=f"of the robots (default {full.firmware})")
    parser.add_argument(
        "--conventions",
        choices=[each.value for each in Convention],
        help=f"of the reference firmware (default {full.conventions.value})",
    )
    options.add_workers(parser)
    add_scheduler(parser)


def run(args: argparse.Namespace) -> int:
    """Run what is missing, decide the claims, write the report."""
    workers, scale = options.check_workers(args.workers), scale_of(args)
    parts = [part for part in Part if args.part is None or part.value in args.part]
    folder = args.output or Path(
        "reproduction" + ("-quick" if args.quick else "-paper" if args.paper else "")
    )
    try:
        study = StudyFolder(folder, parts, scale)
    except ParameterError as error:
        raise UsageError(f"--{error.key}: {error}") from error
    _say_how_long(study.stores, scale, workers, args)
    runs, series = _run(study, workers, args)

    from mcp_asdf_tools.reproduction import report_text, study_report  # noqa: PLC0415 (matplotlib loads slowly)

    with Console(stderr=True).status("drawing pictures"):
        study_report.write_report(folder, runs, series, scale)
    report = str(folder / "report.html")
    if args.json:
        verdicts = report_text.verdicts_of(runs)
        claims = report_text.as_values(runs[0].decided, verdicts, scale)
        print(json.dumps({"report": report, "claims": claims}, indent=2))
    else:
        _show(runs[0], scale)
        print(report)
        print_again(args, seed=scale.seed)
    return 0


def _run(study: StudyFolder, workers: int, args: argparse.Namespace) -> tuple[list[Run], list[Trials]]:
    """Run what is missing, with a bar in seconds of one processor."""
    total = sum(map(seconds_of, study.stores))
    known = {store: seconds_of(store) for store in study.stores}
    with telling_what_is_left(study.stores), progress("processor seconds", round(total), args.json) as bar:

        def run_store(store: Store, interval: int) -> None:
            if args.redraw and store.left:
                raise UsageError(f"{store.output} lacks {store.left} trials; leave out --redraw to run them")
            missing = seconds_of(store)
            bar(0, more=missing - known[store])
            each = missing / max(1, store.left)
            run_missing(store, workers, interval, lambda count: bar(count * each), args.scheduler)
            known[store] = 0.0

        series = study.series(run_store)
        return list(study.runs(run_store)), series


def _say_how_long(stores: Sequence[Store], scale: Scale, workers: int, args: argparse.Namespace) -> None:
    """The trials that are missing and the time that they take, before anything is run."""
    trials, seconds = sum(store.left for store in stores), sum(map(seconds_of, stores))
    if not trials or args.json:
        return
    words = f"{trials} trials to run"
    if scale.firmware == "native":
        words += f", about {_minutes(seconds)} of processor time"
        if args.scheduler is None:
            words += f", {_minutes(seconds / workers)} with {workers} worker{'s' * (workers > 1)}"
    if scale.trials is None:
        words += "; up to half as many more where comparisons stay open"
    print(words, file=sys.stderr)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def scale_of(args: argparse.Namespace) -> Scale:
    """Size of the study by the options. Raises UsageError for values out of range."""
    given = {name: getattr(args, name) for name in ("trials", "steps", "seed", "seeds", "firmware")}
    given["conventions"] = None if args.conventions is None else Convention(args.conventions)
    scale = replace(
        QUICK if args.quick else PAPER if args.paper else Scale(),
        **{name: value for name, value in given.items() if value is not None},
    )
    if scale.trials is not None and scale.trials < 2:
        raise UsageError(f"--trials is {scale.trials}; give at least 2: one says nothing of how sure it is")
    if scale.seeds is not None and not 1 <= scale.seeds <= 100:
        raise UsageError(f"--seeds is {scale.seeds}; give 1 to 100")
    if scale.steps < PERIODS[-1]:
        raise UsageError(
            f"--steps is {scale.steps}; give at least {PERIODS[-1]}, the longest filtering period"
        )
    return scale


def _show(run: Run, scale: Scale) -> None:
    """A line for each claim."""
    table = Table(title="the paper's claims", title_justify="left")
    for heading in ("where", "about", "claim", "hold", "fail", "open", "verdict"):
        table.add_column(heading, no_wrap=True)
    colours = {
        Verdict.AGREE: "green",
        Verdict.MIXED: "yellow",
        Verdict.DISAGREE: "red",
        Verdict.UNDECIDED: "blue",
    }
    for each in run.decided:
        finding = each.finding
        counts = (str(finding.count(holds)) for holds in (True, False, None))
        verdict = f"[{colours[finding.verdict]}]{finding.verdict.value}" if scale.allows_verdicts else ""
        about = "" if each.part is None else PART_NAMES[each.part]
        table.add_row(each.claim.where, about, each.claim.name.replace("_", " "), *counts, verdict)
    if not scale.allows_verdicts:
        table.caption = "too short for verdicts: none is given"
    # Lines longer than a terminal wrap; columns that shrink to fit would lose words.
    Console(width=Console(width=10_000).measure(table).maximum).print(table)
