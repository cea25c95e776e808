"""Speed of a sweep on two processors against one.

    python tests/benchmarks/sweep.py [--trials N] [--check]

Runs the same sweep of moving robots on one and on two workers and prints the time and the processor time of
each. Means something on a machine with two idle processors only: it says so where the load is above that.
Exit code 1 with --check if two workers are less than 1.9 times as fast.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

FLOOR = 1.9
_SWEEP = """\
topology = "dynamic"
latency = 1
robots = 20
steps = 40000
filter = ["none", "asdf-plus"]
flawed = ["10%", "50%"]
trials = {trials}
"""


class Taken(NamedTuple):
    """Seconds on the clock, and of processors."""

    clock: float
    processors: float


def main() -> int:
    """Measure; returns the exit code."""
    parser = argparse.ArgumentParser(description="Speed of a sweep on two processors against one.")
    parser.add_argument(
        "--trials", type=int, default=400, help="of each of 4 experiments (default %(default)s)"
    )
    parser.add_argument("--check", action="store_true", help=f"fail below {FLOOR}")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    if load > 1:
        print(f"the load is {load:.1f}: others use the processors, and the speed-up means little")
    taken = {workers: _run(workers, options.trials) for workers in (1, 2)}
    for workers, each in taken.items():
        print(f"{workers} workers: {each.clock:.1f} s, {each.processors:.1f} s of processors")
    speed_up = taken[1].clock / taken[2].clock
    print(f"speed-up {speed_up:.2f}")
    return int(options.check and speed_up < FLOOR)


def _run(workers: int, trials: int) -> Taken:
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "sweep.toml").write_text(_SWEEP.format(trials=trials), encoding="utf-8")
        command = [
            "-m",
            "mcp_asdf_tools.cli.main",
            "sweep",
            "sweep.toml",
            "--workers",
            str(workers),
            "--json",
        ]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        subprocess.run([sys.executable, *command], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        clock = time.monotonic() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Taken(clock, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


if __name__ == "__main__":
    sys.exit(main())
