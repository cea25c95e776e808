"""``mcp-asdf plot``: draw results."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from host_tools.commands import experiment_options as options
from host_tools.errors import UsageError
from host_tools.results import Trials, experiments_in, read_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HELP = "draw results: scores as boxes or points, or a recorded trial over time"
EPILOG = """\
examples:
  mcp-asdf plot grid.parquet boxes.png              # H over the proportion of flawed robots
  mcp-asdf plot grid.parquet points.pdf --kind scatter --k-max 40000 --e-max 0.45
  mcp-asdf plot run.parquet series.svg --kind series --trial 0
exit code: 0 done, 2 bad usage"""

KINDS = ("boxes", "scatter", "series")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", type=Path, help="results: .parquet")
    parser.add_argument("picture", metavar="PICTURE", type=Path, help="what to draw into: .png, .svg or .pdf")
    parser.add_argument("--kind", choices=KINDS, default=KINDS[0], help="what to draw (default %(default)s)")
    parser.add_argument("--trial", metavar="N", type=int, default=0, help="of a series (default %(default)s)")
    options.add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Draw."""
    from host_tools.plot_files import check_plot_path, save_figure  # noqa: PLC0415 (matplotlib loads slowly)

    check_plot_path(args.picture)
    experiments = experiments_in(read_table(args.file))
    save_figure(_draw(args, experiments), args.picture)
    if args.json:
        print(json.dumps({"picture": str(args.picture), "kind": args.kind, "experiments": len(experiments)}))
    else:
        print(args.picture)
    return 0


def _draw(args: argparse.Namespace, experiments: list[Trials]) -> Figure:
    from host_tools import experiment_plots  # noqa: PLC0415

    if args.kind == "series":
        if len(experiments) != 1:
            raise UsageError(f"{args.file} holds {len(experiments)} experiments; a series is drawn of one")
        return experiment_plots.series(experiments[0], args.trial)
    draw = experiment_plots.boxes if args.kind == "boxes" else experiment_plots.scatter
    return draw(experiments, options.limits_of(args, experiments))
