"""Cost of the firmware on five microcontrollers: instructions, cycles, bytes and stack.

    PYTHONPATH=tests python -m benchmarks.cost [--write | --draw FILE | --json]

Builds the firmware and a floating-point baseline with the cross compilers, runs them under Unicorn and
simavr, and prints the README's table. Nothing is timed: the figures are the same on any machine with the
same compilers. Exit code: 0 done, 2 something is missing.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.figures import check_plot_path, image_of, save_figure
from mcp_asdf_tools.common.files import FileSet

from . import figures, picture, report
from .images import TARGETS
from .machines import simavr
from .measurement import Figures


def main() -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.cost",
        description="Measure what the firmware costs on five microcontrollers.",
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--write", action="store_true", help="write tables, picture and kept figures again")
    choice.add_argument("--draw", type=Path, metavar="FILE", help="draw the kept figures without measuring")
    choice.add_argument("--json", action="store_true", help="print everything measured")
    options = parser.parse_args()
    try:
        if options.draw is not None:
            save_figure(picture.draw(figures.kept()), check_plot_path(options.draw))
            return 0
        return _measure(options.write, options.json)
    except UsageError as error:
        print(f"cost: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("cost: stopped", file=sys.stderr)
        return 130


def _measure(writes: bool, as_json: bool) -> int:
    _check_tools()
    measured: Figures = {}
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("measuring")
        for done, parts, measured in figures.gather():  # noqa: B007
            progress.update(task, completed=done, total=parts)
    if writes:
        _write(measured)
    table = report.pages(measured)[report.README]["cost table"]
    print(json.dumps(measured, indent=1) if as_json else table)
    return 0


def _write(measured: Figures) -> None:
    """Write the figures, the pages and the picture: all together, or nothing if it fails or is stopped."""
    with FileSet() as files:
        files.write(figures.KEPT, figures.text_of(measured))
        for path, text in report.filled(measured).items():
            files.write(path, text)
        files.write(picture.PATH, image_of(picture.draw(measured), picture.PATH))


def _check_tools() -> None:
    for target in TARGETS:
        if shutil.which(target.compiler) is None:
            raise UsageError(f"{target.compiler} is not installed: apt-get install {target.package}")
    try:
        simavr()
    except (OSError, subprocess.CalledProcessError) as error:
        raise UsageError(
            f"cannot build against simavr: apt-get install libsimavr-dev gcc ({error})"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
