"""``mcp-asdf plot``: draw results."""

from __future__ import annotations

import argparse
import json
from inspect import signature
from pathlib import Path
from typing import Any

from mcp_asdf_tools.cli import experiment_options as options
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.scores import SCORES
from mcp_asdf_tools.library import PLOTS

EPILOG = """\
examples:
  mcp-asdf plot grid.parquet boxes.png              # H over proportion and accuracy of the flawed
  mcp-asdf plot grid.parquet points.pdf --kind scatter --k-max 40000 --e-max 0.45
  mcp-asdf plot grid.parquet curves.svg --kind curve --x omega --hue density --y e
  mcp-asdf plot grid.parquet filters.svg --kind curve --x flawed --hue filter
  mcp-asdf plot grid.parquet bands.png --kind bands         # b_hat of all robots and trials
  mcp-asdf plot grid.parquet none.png --where filter=none --where fill_ratio=0.95
  mcp-asdf plot run.parquet series.svg --kind series --trial 0     # needs simulate --record
exit code: 0 done, 2 bad usage"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="results: .parquet")
    parser.add_argument("picture", metavar="PICTURE", type=Path, help="what to draw into: .png, .svg or .pdf")
    parser.add_argument(
        "--kind", choices=[*PLOTS], default="boxes", help="what to draw (default %(default)s)"
    )
    options.add_where(parser)
    parser.add_argument("--trial", metavar="N", type=int, help="which one, for series (default 0)")
    group = parser.add_argument_group("curves")
    group.add_argument("--x", metavar="NAME", help="parameter along the axis")
    group.add_argument("--hue", metavar="NAME", help="parameter with a curve for each value")
    group.add_argument("--y", metavar="NAME", help="H, h_K, h_e, K or e (default H)")
    group.add_argument("--facet", metavar="NAME", help="parameter with a panel for each value")
    options.add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Draw the picture, and print its path."""
    from mcp_asdf_tools.common.figures import check_plot_path, save_figure  # noqa: PLC0415

    check_plot_path(args.picture)
    plot_options: dict[str, Any] = {
        name: getattr(args, name)
        for name in ("trial", "x", "hue", "y", "facet")
        if getattr(args, name) is not None
    }
    typed_limits = options.limits_given(args)
    _check_options(args.kind, plot_options, typed_limits)
    if typed_limits:
        plot_options["limits"] = options.limits_of(args)
    experiments = options.chosen(args)
    save_figure(PLOTS[args.kind](experiments, **plot_options), args.picture)
    if args.json:
        report = {"picture": str(args.picture), "kind": args.kind, "experiments": len(experiments)}
        print(json.dumps(report))
    else:
        print(args.picture)
    return 0


def _check_options(kind: str, plot_options: dict[str, Any], typed_limits: list[str]) -> None:
    """Raise UsageError for the first option that would do nothing in a picture of this kind."""
    typed_options = [(name, f"--{name}") for name in plot_options]
    typed_options += [("limits", option) for option in typed_limits]
    for name, option in typed_options:
        kinds = [other for other, plot in PLOTS.items() if name in signature(plot).parameters]
        if kind not in kinds:
            message = f"it is for {' and '.join(kinds)}, and kind is {kind}"
            raise UsageError(f"{option} would do nothing: {message}; leave it out")
        if name == "limits" and plot_options.get("y", "H") not in SCORES:
            raise UsageError(f"{option} would do nothing: it is for scores, and y is none; leave it out")
