"""``mcp-asdf plot``: draw results."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from mcp_asdf_tools.cli import options
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.plots import KINDS, load_plot

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
LIBRARIES = ("numpy", "matplotlib", "pyarrow")

_PLOT_OPTIONS = ("trial", "x", "hue", "y", "facet")
"""Options that are passed to the function of a kind of picture under the same name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, the results, PICTURE, the file to draw into, the kind of picture, and what it shows.

    ``--trial`` is for series, ``--x``, ``--hue``, ``--y`` and ``--facet`` are for curves, and the limits for
    pictures of scores.
    """
    parser.add_argument("file", metavar="FILE", type=Path, help="read the results from a .parquet file")
    parser.add_argument("picture", metavar="PICTURE", type=Path, help="draw into a .png, .svg or .pdf file")
    parser.add_argument(
        "--kind", choices=KINDS, default="boxes", help="draw this kind of picture (default %(default)s)"
    )
    options.add_where_option(parser)
    parser.add_argument("--trial", metavar="N", type=int, help="draw trial N, for series (default 0)")
    group = parser.add_argument_group("curves")
    group.add_argument("--x", metavar="NAME", help="draw over this parameter, such as flawed")
    group.add_argument("--hue", metavar="NAME", help="draw a curve for each value of it, such as filter")
    group.add_argument("--y", metavar="NAME", help="draw H, h_K, h_e, K (steps) or e (default H)")
    group.add_argument("--facet", metavar="NAME", help="draw a panel for each value of it, such as robots")
    options.add_limit_options(parser)


def run(args: argparse.Namespace) -> int:
    """Draw the picture into its file, and print the file's path; return exit code 0.

    With --json the kind of picture and the number of experiments are printed, too. Raises UsageError for
    options that do not go together, and if results cannot be read or the picture not be written.
    """
    from mcp_asdf_tools.common.figures import check_plot_path, save_figure

    # Path and options are checked before the results are read, which may take long.
    check_plot_path(args.picture)
    keywords = _plot_keywords(args)
    experiments = options.read_selected_experiments(args)
    draw = load_plot(args.kind)
    save_figure(draw(experiments, **keywords), args.picture)
    if args.json:
        report = {"picture": str(args.picture), "kind": args.kind, "experiments": len(experiments)}
        print(json.dumps(report))
    else:
        print(args.picture)
    return 0


def _plot_keywords(args: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword arguments for the function that draws the picture: the options that the user typed.

    Raises UsageError for the first option that the function has no parameter for, for limits of scores if
    what the picture shows is no score, and for limits out of range.
    """
    from mcp_asdf_tools.experiments.scores import SCORES

    keywords: dict[str, Any] = {}
    for option_name in _PLOT_OPTIONS:
        value = getattr(args, option_name)
        if value is not None:
            _check_kind_has(args.kind, option_name, f"--{option_name}")
            keywords[option_name] = value
    typed_limits = [option for option in ("--k-max", "--e-max") if option in args.typed_options]
    for option in typed_limits:
        _check_kind_has(args.kind, "limits", option)
        # The limits scale the scores only. Where y is K or e, a curve shows steps or errors instead.
        y = keywords.get("y", "H")  # without --y a curve shows H
        if y not in SCORES:
            raise UsageError(f"{option} would do nothing: it is for scores, and y is none; leave it out")
        keywords["limits"] = options.limits_of(args)
    return keywords


def _check_kind_has(kind: str, keyword: str, option: str) -> None:
    """Raise UsageError if ``option`` would do nothing in a picture of this kind.

    That is so if the function that draws the kind has no parameter ``keyword``, which the option sets. The
    message names the kinds that the option is for.
    """
    from inspect import signature

    # The parameters of its function say which options a kind has, so that no list repeats them.
    kinds_with_it = [name for name in KINDS if keyword in signature(load_plot(name)).parameters]
    if kind not in kinds_with_it:
        reason = f"it is for {' and '.join(kinds_with_it)}, and kind is {kind}"
        raise UsageError(f"{option} would do nothing: {reason}; leave it out")
