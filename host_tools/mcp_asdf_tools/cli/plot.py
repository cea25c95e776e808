"""``mcp-asdf plot``: draw results."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.cli.choosing import add_where, chosen, differing
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.experiments import Trials, experiments_in, read_table
from mcp_asdf_tools.library import PLOTS, PlotChoice, plot_trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EPILOG = """\
examples:
  mcp-asdf plot grid.parquet boxes.png              # H over proportion and accuracy of the flawed
  mcp-asdf plot grid.parquet strips.png --kind strips       # the same, a point for each trial
  mcp-asdf plot grid.parquet points.pdf --kind scatter --k-max 40000 --e-max 0.45
  mcp-asdf plot grid.parquet curves.svg --kind curve --x omega --hue density --y e
  mcp-asdf plot grid.parquet bands.png --kind bands         # b_hat of all robots and trials
  mcp-asdf plot grid.parquet none.png --where filter=none --where fill_ratio=0.95
  mcp-asdf plot run.parquet series.svg --kind series --trial 0     # needs simulate --record
  mcp-asdf plot run.parquet paths.svg --kind trajectories --step 600
  mcp-asdf plot run.parquet links.svg --kind network --step 600
  mcp-asdf plot alpha.svg --kind alpha              # confidence against assumed accuracy
exit code: 0 done, 2 bad usage"""

KINDS = (*PLOTS, "alpha")
PLOTS_OF_ONE = ("series", "trajectories", "network")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", type=Path, nargs="?", help="results: .parquet")
    parser.add_argument("picture", metavar="PICTURE", type=Path, help="what to draw into: .png, .svg or .pdf")
    parser.add_argument("--kind", choices=KINDS, default=KINDS[0], help="what to draw (default %(default)s)")
    add_where(parser)
    parser.add_argument("--trial", metavar="N", type=int, default=0, help="which one (default %(default)s)")
    parser.add_argument(
        "--step",
        metavar="N",
        type=int,
        default=600,
        help="of a network, and the last of trajectories (default %(default)s)",
    )
    group = parser.add_argument_group("curves")
    group.add_argument("--x", metavar="NAME", default="", help="parameter along the axis, or its letter: tau")
    group.add_argument("--hue", metavar="NAME", default="", help="parameter with a curve for each value")
    group.add_argument("--y", metavar="NAME", default="H", help="H, h_K, h_e, K or e (default %(default)s)")
    options.add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Draw."""
    from mcp_asdf_tools.common import check_plot_path, save_figure  # noqa: PLC0415 (matplotlib loads slowly)

    check_plot_path(args.picture)
    experiments = _experiments_of(args)
    save_figure(_draw(args, experiments), args.picture)
    if args.json:
        print(json.dumps({"picture": str(args.picture), "kind": args.kind, "experiments": len(experiments)}))
    else:
        print(args.picture)
    return 0


def _experiments_of(args: argparse.Namespace) -> list[Trials]:
    """Contents of the file, if the picture needs one."""
    if (args.file is None) != (args.kind == "alpha"):
        if args.kind == "alpha":
            raise UsageError(f"a picture of kind alpha needs no results; leave out {args.file}")
        raise UsageError(
            f"a picture of kind {args.kind} needs results: mcp-asdf plot RESULTS.parquet {args.picture}"
        )
    if args.file is None:
        if args.where:
            raise UsageError("--where chooses from results, and there are none; leave it out")
        return []
    found = chosen(experiments_in(read_table(args.file)), args.where, args.file)
    if len(found) > 1 and args.kind in PLOTS_OF_ONE:
        raise UsageError(
            f"a picture of kind {args.kind} shows one experiment, and {len(found)} match; choose one with "
            f"--where {differing(found)}"
        )
    return found


def _draw(args: argparse.Namespace, experiments: list[Trials]) -> Figure:
    if args.kind != "alpha":
        choice = PlotChoice(args.kind, args.trial, args.step, args.x, args.hue, args.y)
        return plot_trials(experiments, choice, options.limits_of(args))
    from mcp_asdf_tools.experiments import plots  # noqa: PLC0415

    return plots.confidence()
