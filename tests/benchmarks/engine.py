"""How fast the engine is beside float64 in Python, plain double C and the physics simulator, in one run.

``python tests/benchmarks/engine.py [--json]``, with the compiler that ``CC`` names (default ``cc``).
Robot-steps in a second of processor time of one core, fully connected (N = 10) and in the moving world
(N = 20, D = 1, messages a step late), 40 000 steps, filter on. Each is measured a few times and the best
counts. The physics simulator's figure, with its logging removed, is that of
tests/data/motion_statistics.json.
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
from host_tools.experiments import Experiment, Topology
from host_tools.moving import make_arena
from host_tools.simulation import run_by_message, run_trials

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
MOTION = ROOT / "tests/data/motion_statistics.json"
FULL = Experiment(trials=1)
MOVING = Experiment(topology=Topology.DYNAMIC, robots=20, flawed=6, latency=1, trials=1)
TRIALS, FEW_TRIALS = 96, 4
REPEATS = 3


def rate(experiment: Experiment, trials: int, work: Callable[[], object]) -> float:
    """Robot-steps of a second of processor time, the best of REPEATS."""
    best = float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return experiment.robots * experiment.steps * trials / best


def plain_double(source: str, trials: int) -> float:
    """The rate of a C program beside this file, compiled as the engine is."""
    arena = ROOT / "host_tools/arena"
    with tempfile.TemporaryDirectory() as folder:
        program, arena_object = Path(folder, "plain_double"), Path(folder, "arena.o")
        compiler = os.environ.get("CC", "cc")
        subprocess.run([compiler, "-std=c99", "-O3", "-c", arena / "arena.c", "-o", arena_object], check=True)
        options = ("-O3", f"-I{arena}", HERE / source, arena_object, "-o", program, "-lm")
        subprocess.run([compiler, *options], check=True)
        outputs = [
            subprocess.run([program, str(trials)], check=True, capture_output=True).stdout
            for _ in range(REPEATS)
        ]
    return max(float(output.split()[0]) for output in outputs)


def fully_connected() -> dict[str, float]:
    """Rates by name, robot-steps a second."""
    short = replace(FULL, steps=400, filter_period=100, firmware="reference")
    return {
        "float64 in Python": rate(short, 1, lambda: run_by_message(short, 0)),
        "plain double C": plain_double("plain_double.c", TRIALS),
        "firmware, call by call": rate(FULL, 16, lambda: native.run(FULL, 0, 16, lanes=False)),
        "firmware in lanes": rate(FULL, TRIALS, lambda: native.run(FULL, 0, TRIALS)),
        "firmware in lanes, with K and e": rate(FULL, TRIALS, lambda: run_trials(FULL, 0, TRIALS)),
    }


def moving() -> dict[str, float]:
    """The same in the moving world."""
    short = replace(MOVING, steps=400, filter_period=100, firmware="reference")
    trials = FEW_TRIALS
    return {
        "float64 in Python": rate(short, 1, lambda: run_by_message(short, 0)),
        "physics simulator": float(json.loads(MOTION.read_text("utf-8"))["robot_ticks_per_second"]),
        "plain double C": plain_double("plain_double_moving.c", trials),
        "motion alone": rate(MOVING, 1, lambda: make_arena(MOVING, 0).step(MOVING.steps)),
        "firmware, call by call": rate(MOVING, trials, lambda: native.run(MOVING, 0, trials, lanes=False)),
        "firmware in lanes": rate(MOVING, trials, lambda: native.run(MOVING, 0, trials)),
        "firmware in lanes, with K and e": rate(MOVING, trials, lambda: run_trials(MOVING, 0, trials)),
    }


def show(title: str, rates: dict[str, float]) -> None:
    """Print rates with their ratios to each yardstick."""
    yardsticks = [
        name for name in ("float64 in Python", "plain double C", "physics simulator") if name in rates
    ]
    print(f"{title:32}{'robot-steps/s':>14}" + "".join(f"{f'x {name}':>20}" for name in yardsticks))
    for name, value in rates.items():
        ratios = "".join(f"{value / rates[yardstick]:20.3g}" for yardstick in yardsticks)
        print(f"{name:32}{value:14.3g}{ratios}")


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure the engine's speed against yardsticks.")
    parser.add_argument("--json", action="store_true", help="print the rates as JSON")
    args = parser.parse_args()
    rates = {"fully connected": fully_connected(), "moving": moving()}
    if args.json:
        print(json.dumps(rates, indent=2))
        return 0
    for title, values in rates.items():
        show(title, values)
    return 0


if __name__ == "__main__":
    sys.exit(main())
