"""Speed of the engine compared with float64 in Python, plain double C and the physics simulator, in one run.

``python tests/benchmarks/engine.py [--check]``, with the compiler that ``CC`` names (default ``cc``).
Robot-steps per second of processor time on one core, fully connected (N = 10) and in the moving world
(N = 20, D = 1, messages a step late), 40 000 steps, filter on. All are measured in turn, ten times over, and
the best of each counts. The physics simulator's figure, with its logging removed, is that of
tests/data/motion_statistics.json. ``--check`` exits with 1 where a ratio is below its floor.
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

from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import _run_by_message as run_by_message
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.world.arena import Arena

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
ARENA = ROOT / "host_tools/mcp_asdf_tools/world/arena"
MOTION = ROOT / "tests/data/motion_statistics.json"
FULL = Experiment(robots=10, flawed=3, steps=40_000, trials=1)
MOVING = Experiment(topology="dynamic", latency=1, steps=40_000, trials=1)
TRIALS, FEW_TRIALS = 96, 4
REPEATS = 10
COMPILER = os.environ.get("CC", "cc")

PYTHON, DOUBLE, SIMULATOR = "float64 in Python", "plain double C", "physics simulator"
CALLS, LANES = "firmware, call by call", "firmware in lanes"
YARDSTICKS = (PYTHON, DOUBLE, SIMULATOR)
FLOORS = {
    "fully connected": {(LANES, DOUBLE): 0.7, (LANES, CALLS): 4.0},
    "moving": {(LANES, DOUBLE): 0.7, (LANES, CALLS): 1.25},
}
"""Minimum ratio of two rates, on a processor with vectors of 64 bytes."""

Measurement = Callable[[], float]


def rate_of(experiment: Experiment, trials: int, work: Callable[[], object]) -> Measurement:
    """Robot-steps per second of processor time."""

    def measure() -> float:
        start = time.process_time()
        work()
        return experiment.robots * experiment.steps * trials / (time.process_time() - start)

    return measure


def best_of(measurements: dict[str, Measurement]) -> dict[str, float]:
    """The best of REPEATS runs of each, one after the other in every round."""
    best = dict.fromkeys(measurements, 0.0)
    for _ in range(REPEATS):
        for name, measure in measurements.items():
            best[name] = max(best[name], measure())
    return best


def plain_double(folder: Path, world: str, trials: int) -> Measurement:
    """The rate of plain_swarm.c, compiled as the engine is."""
    program = folder / world
    sources = [HERE / "plain_swarm.c", *sorted(ARENA.glob("*.c"))]
    subprocess.run([COMPILER, "-O3", f"-I{ARENA}", *sources, "-o", program, "-lm"], check=True)
    command = [str(program), world, str(trials)]
    return lambda: float(subprocess.run(command, check=True, capture_output=True).stdout.split()[0])


def fully_connected(folder: Path) -> dict[str, float]:
    """Rates by name, robot-steps per second."""
    short = replace(FULL, steps=400, filter_period=100, firmware="reference")
    return best_of(
        {
            PYTHON: rate_of(short, 1, lambda: run_by_message(short, 0, 0)),
            DOUBLE: plain_double(folder, "full", TRIALS),
            CALLS: rate_of(FULL, 16, lambda: native.run(FULL, 0, 16, lanes=False)),
            LANES: rate_of(FULL, TRIALS, lambda: native.run(FULL, 0, TRIALS, lanes=True)),
            f"{LANES}, with K and e": rate_of(FULL, TRIALS, lambda: run_trials(FULL, 0, TRIALS)),
        }
    )


def moving(folder: Path) -> dict[str, float]:
    """The same in the moving world."""
    short = replace(MOVING, steps=400, filter_period=100, firmware="reference")
    trials = FEW_TRIALS
    simulator = float(json.loads(MOTION.read_text("utf-8"))["robot_ticks_per_second"])
    return best_of(
        {
            PYTHON: rate_of(short, 1, lambda: run_by_message(short, 0, 0)),
            SIMULATOR: lambda: simulator,
            DOUBLE: plain_double(folder, "moving", trials),
            "motion alone": rate_of(MOVING, 1, lambda: Arena(MOVING, 0).step(MOVING.steps)),
            CALLS: rate_of(MOVING, trials, lambda: native.run(MOVING, 0, trials, lanes=False)),
            LANES: rate_of(MOVING, trials, lambda: native.run(MOVING, 0, trials, lanes=True)),
            f"{LANES}, with K and e": rate_of(MOVING, trials, lambda: run_trials(MOVING, 0, trials)),
        }
    )


def show(title: str, rates: dict[str, float]) -> None:
    """Print rates with their ratios to each yardstick."""
    yardsticks = [name for name in YARDSTICKS if name in rates]
    print(f"{title:32}{'robot-steps/s':>14}" + "".join(f"{f'x {name}':>20}" for name in yardsticks))
    for name, value in rates.items():
        ratios = "".join(f"{value / rates[yardstick]:20.3g}" for yardstick in yardsticks)
        print(f"{name:32}{value:14.3g}{ratios}")


def missed(rates: dict[str, dict[str, float]]) -> list[str]:
    """The floors that were missed, in words."""
    ratios = {
        (world, name, other): rates[world][name] / rates[world][other]
        for world, floors in FLOORS.items()
        for name, other in floors
    }
    return [
        f"{world}: {name} is {ratio:.3g} of {other}; the floor is {FLOORS[world][name, other]}"
        for (world, name, other), ratio in ratios.items()
        if ratio < FLOORS[world][name, other]
    ]


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure the engine's speed against yardsticks.")
    parser.add_argument("--check", action="store_true", help="exit with 1 where a floor is missed")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        rates = {"fully connected": fully_connected(Path(name)), "moving": moving(Path(name))}
    for title, found in rates.items():
        show(title, found)
    below = missed(rates) if args.check else []
    print(*below, sep="\n", end="\n" if below else "", file=sys.stderr)
    return int(bool(below))


if __name__ == "__main__":
    sys.exit(main())
