"""``mcp-asdf reproduce``: run the paper's whole study and say which of its claims hold."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.sweep import add_scheduler, run_stores
from mcp_asdf_tools.common import ParameterError, UsageError
from mcp_asdf_tools.experiments import Convention, Store, experiments_in
from mcp_asdf_tools.reproduction import (
    PART_NAMES,
    PERIODS,
    QUICK,
    Part,
    Scale,
    Verdict,
    cells_of,
    experiment_of,
    study_of,
)
from mcp_asdf_tools.robots import FIRMWARES

if TYPE_CHECKING:
    from mcp_asdf_tools.reproduction import Decided

EPILOG = """\
examples:
  mcp-asdf reproduce                                # everything; report in reproduction/report.md
  mcp-asdf reproduce --quick                        # fewer and shorter trials, in reproduction-quick
  mcp-asdf reproduce --part fully_connected --seed 2 --output second
  mcp-asdf reproduce --firmware reference --conventions authors --output authors
A run that was interrupted is resumed by the same command: finished trials are kept and not run again.
exit code: 0 done, whatever the claims' verdicts, 2 bad usage, 128 + signal if interrupted (what
was finished is kept)"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, help="for report and results (default: reproduction[-quick])"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"{QUICK.trials} trials of {QUICK.steps} steps: whether it works, not whether claims hold",
    )
    parser.add_argument(
        "--part",
        action="append",
        choices=[part.value for part in Part],
        help="only this part of the study; may be repeated (default: all)",
    )
    full = Scale()
    parser.add_argument("--trials", type=int, metavar="N", help=f"of each experiment (default {full.trials})")
    parser.add_argument("--steps", type=int, metavar="N", help=f"at most, of a trial (default {full.steps})")
    parser.add_argument("--seed", type=int, metavar="N", help=f"of everything random (default {full.seed})")
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
    workers, scale = options.check_workers(args.workers), _scale(args)
    parts = [part for part in Part if args.part is None or part.value in args.part]
    folder = args.output or Path("reproduction-quick" if args.quick else "reproduction")
    stores = _stores(folder, parts, scale)
    tables = run_stores(stores, workers, args)

    from mcp_asdf_tools.reproduction import study_report  # noqa: PLC0415 (matplotlib loads slowly)

    with Console(stderr=True).status("deciding claims, drawing pictures"):
        study = study_of(zip(parts, map(experiments_in, tables), strict=True), scale)
        decided = study_report.write_report(folder, study, scale)
    report = str(folder / "report.md")
    if args.json:
        print(json.dumps({"report": report, "claims": study_report.plain(decided)}, indent=2))
    else:
        _show(decided)
        print(report)
    return 0


def _scale(args: argparse.Namespace) -> Scale:
    given = {name: getattr(args, name) for name in ("trials", "steps", "seed", "firmware")}
    given["conventions"] = None if args.conventions is None else Convention(args.conventions)
    scale = replace(
        QUICK if args.quick else Scale(),
        **{name: value for name, value in given.items() if value is not None},
    )
    if scale.trials < 2:
        raise UsageError(f"--trials is {scale.trials}; give at least 2: one says nothing of how sure it is")
    if scale.steps < PERIODS[-1]:
        raise UsageError(
            f"--steps is {scale.steps}; give at least {PERIODS[-1]}, the longest filtering period"
        )
    return scale


def _stores(folder: Path, parts: list[Part], scale: Scale) -> list[Store]:
    """A place for each part's results, where they are by and by."""
    try:
        grids = {part: [experiment_of(cell, scale) for cell in cells_of(part)] for part in parts}
    except ParameterError as error:
        raise UsageError(f"--{error.key}: {error}") from error
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}; choose another") from error
    return [Store(folder / f"{part.value}.parquet", grid) for part, grid in grids.items()]


def _show(decided: Decided) -> None:
    """A line for each claim."""
    table = Table(title="the paper's claims", title_justify="left")
    for heading in ("section", "about", "claim", "hold", "fail", "open", "verdict"):
        table.add_column(heading, no_wrap=True)
    colours = {Verdict.AGREE: "green", Verdict.MIXED: "yellow", Verdict.DISAGREE: "red"}
    for claim, finding in decided:
        counts = (str(finding.count(holds)) for holds in (True, False, None))
        verdict = f"[{colours[finding.verdict]}]{finding.verdict.value}"
        about = "" if claim.part is None else PART_NAMES[claim.part]
        table.add_row(claim.section, about, claim.name.replace("_", " "), *counts, verdict)
    # Lines longer than a terminal wrap; columns that shrink to fit would lose words.
    Console(width=Console(width=10_000).measure(table).maximum).print(table)
