"""Measure the firmware's cost on five microcontrollers and write it into the documentation.

    PYTHONPATH=tests python -m benchmarks.cost

Nothing is timed: the figures are the same on any machine with the same compilers. Exit code: 0 done, 2
something is missing.
"""

from __future__ import annotations

import shutil
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from mcp_asdf_tools.common.files import write_together

from .images import LEVELS, TARGETS
from .measurement import PAPER, ROBUST, Build, kilobot, measure_builds
from .report import fill, sections


def main() -> int:
    """Measure and write all pages, or none if it fails or is stopped; returns the exit code."""
    for target in TARGETS:
        if shutil.which(target.compiler) is None:
            print(
                f"cost: {target.compiler} is not installed: apt-get install {target.package}", file=sys.stderr
            )
            return 2
    with TemporaryDirectory() as name, ProcessPoolExecutor() as pool:
        measurements = {
            (target.name, level): pool.submit(measure_builds, target, level, Path(name, target.name, level))
            for target in TARGETS
            for level in LEVELS
        }
        cells = {cell: measurement.result() for cell, measurement in measurements.items()}
        robots = [kilobot(Path(name, f"kilobot{n}"), of) for n, of in enumerate((PAPER, Build(), ROBUST))]
        written = sections(cells, tuple(robots))
    write_together({path: fill(path.read_text(encoding="utf-8"), each) for path, each in written.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
