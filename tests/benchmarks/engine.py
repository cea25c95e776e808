"""How many robot-steps a second the engine makes, beside float64 in Python and plain double C, in one run.

``python tests/benchmarks/engine.py [--json]``, with the compiler that ``CC`` names (default ``cc``).
Processor time of one core; N = 10, fully connected, 40 000 steps, filter on. Each is measured three times and
the best counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from host_tools.engine import native
from host_tools.experiments import Experiment
from host_tools.simulation import run_trials

YARDSTICK = Path(__file__).with_name("plain_double.c")
EXPERIMENT = Experiment(trials=1)
TRIALS = 96
REPEATS = 3


def rate(experiment: Experiment, trials: int, work: Callable[[], object]) -> float:
    """Robot-steps of a second of processor time, the best of REPEATS."""
    best = float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return experiment.robots * experiment.steps * trials / best


def plain_double() -> float:
    """The rate of the C program beside this file, compiled as the engine is."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "plain_double")
        compiler = os.environ.get("CC", "cc")
        subprocess.run([compiler, "-O3", YARDSTICK, "-o", program, "-lm"], check=True)
        outputs = [
            subprocess.run([program, str(TRIALS)], check=True, capture_output=True).stdout
            for _ in range(REPEATS)
        ]
    return max(float(output.split()[0]) for output in outputs)


def measure() -> dict[str, float]:
    """Rates by name, robot-steps a second."""
    short = replace(EXPERIMENT, steps=400, filter_period=100, firmware="reference")
    return {
        "float64 in Python": rate(short, 1, lambda: run_trials(short, 0, 1)),
        "plain double C": plain_double(),
        "firmware, call by call": rate(EXPERIMENT, 16, lambda: native.run(EXPERIMENT, 0, 16, lanes=False)),
        "firmware in lanes": rate(EXPERIMENT, TRIALS, lambda: native.run(EXPERIMENT, 0, TRIALS)),
        "firmware in lanes, with K and e": rate(
            EXPERIMENT, TRIALS, lambda: run_trials(EXPERIMENT, 0, TRIALS)
        ),
    }


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure the engine's speed against two yardsticks.")
    parser.add_argument("--json", action="store_true", help="print the rates as JSON")
    args = parser.parse_args()
    rates = measure()
    if args.json:
        print(json.dumps(rates, indent=2))
        return 0
    slow, fast = rates["float64 in Python"], rates["plain double C"]
    print(f"{'':32}{'robot-steps/s':>14}{'x Python':>10}{'x double C':>11}")
    for name, value in rates.items():
        print(f"{name:32}{value:14.3g}{value / slow:10.3g}{value / fast:11.3g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
