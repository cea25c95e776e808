"""Speed of the engine compared with float64 in Python, plain double C and the physics simulator, in one run.

``python tests/benchmarks/engine.py``, with the compiler that ``CC`` names (default ``cc``): robot-steps per
second of processor time on one core, fully connected (N = 10) and in the moving world (N = 20, D = 1,
messages a step late), 40 000 steps, filter on: the paper's, then the robust one, whose price fully connected
is that each robot keeps every message. All are measured in turn, ten times over, and the best of each counts.
The physics simulator's figure, with its logging removed, is that of tests/data/motion_statistics.json. Plain
double C is plain_swarm.c on the arena as its text stands, one robot after the other, and on its vectors.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import _run_by_message as run_by_message
from mcp_asdf_tools.experiments.trials import run_trials

HERE = Path(__file__).parent
MOTION = HERE.parent / "data/motion_statistics.json"
ARENA = HERE.parents[1] / "host_tools/mcp_asdf_tools/world/arena"
SCALAR, VECTORS = ("-DFOR_EACH_TARGET=",), ("-fno-trapping-math", "-fno-math-errno")
FULL = Experiment(robots=10, flawed=3, filter="asdf-plus", steps=40_000, trials=1)
MOVING = Experiment(topology="dynamic", filter="asdf-plus", latency=1, steps=40_000, trials=1)
REPEATS = 10
PYTHON, SIMULATOR = "float64 in Python", "physics simulator"
PLAIN, PLAIN_IN_VECTORS = "plain double C", "plain double C, same motion"
CALLS, LANES = "firmware, call by call", "firmware in lanes"

Measurement = Callable[[], float]


def rate_of(experiment: Experiment, trials: int, work: Callable[[], object]) -> Measurement:
    """Return a program's robot-steps per second of processor time."""

    def measure() -> float:
        start = time.process_time()
        work()
        return experiment.robots * experiment.steps * trials / (time.process_time() - start)

    return measure


def plain(folder: str, world: str, trials: int, options: tuple[str, ...]) -> Measurement:
    """Return the rate of plain_swarm.c."""
    program = Path(folder, world + options[0])
    sources = [HERE / "plain_swarm.c", *sorted(ARENA.glob("*.c"))]
    compiler = [os.environ.get("CC", "cc"), "-std=c99", "-O3", *options, f"-I{ARENA}"]
    subprocess.run([*compiler, *map(str, sources), "-o", str(program), "-lm"], check=True)
    command = [str(program), world, str(trials)]
    return lambda: float(subprocess.run(command, check=True, capture_output=True).stdout.split()[0])


def rates_of(
    experiment: Experiment, calls: int, lanes: int, more: dict[str, Measurement]
) -> dict[str, float]:
    """Return the best of REPEATS rates by name. ``calls`` and ``lanes`` are numbers of trials."""
    short = replace(experiment, steps=400, filter_period=100, firmware="reference")
    measurements = {
        PYTHON: rate_of(short, 1, lambda: run_by_message(short, 0, 0)),
        **more,
        CALLS: rate_of(experiment, calls, lambda: native.run(experiment, 0, calls, lanes=False)),
        LANES: rate_of(experiment, lanes, lambda: native.run(experiment, 0, lanes, lanes=True)),
        f"{LANES}, with K and e": rate_of(experiment, lanes, lambda: run_trials(experiment, 0, lanes)),
    }
    best = dict.fromkeys(measurements, 0.0)
    for _ in range(REPEATS):
        for name, measure in measurements.items():
            best[name] = max(best[name], measure())
    return best


def rates_by_world() -> dict[str, dict[str, float]]:
    """Measure each program in five worlds, and return its rates by the names of world and program."""
    simulator = float(json.loads(MOTION.read_text("utf-8"))["robot_ticks_per_second"])
    with tempfile.TemporaryDirectory() as folder:
        full = {PLAIN: plain(folder, "full", 96, SCALAR)}
        moving = {
            SIMULATOR: lambda: simulator,
            PLAIN: plain(folder, "moving", 8, SCALAR),
            PLAIN_IN_VECTORS: plain(folder, "moving", 8, VECTORS),
        }
        robust, robust_moving = (replace(each, filter="robust") for each in (FULL, MOVING))
        return {
            "fully connected": rates_of(FULL, 16, 96, full),
            "moving": rates_of(MOVING, 4, 8, moving),
            "fully connected, robust": rates_of(robust, 4, 32, full),
            "fully connected, robust, N = 20": rates_of(replace(robust, robots=20), 2, 16, {}),
            "moving, robust": rates_of(robust_moving, 4, 8, moving),
        }


def print_rates(world: str, rates: dict[str, float]) -> None:
    """Print a table of a world, with one row per program.

    A row has the rate of the program, and its ratios to the rates of Python and of plain C, if these were
    measured.
    """
    yardsticks = [name for name in (PYTHON, PLAIN) if name in rates]
    print(f"{world:32}{'robot-steps/s':>14}" + "".join(f"{f'x {name}':>20}" for name in yardsticks))
    for name, value in rates.items():
        ratios = "".join(f"{value / rates[yardstick]:20.3g}" for yardstick in yardsticks)
        print(f"{name:32}{value:14.3g}{ratios}")


def main() -> None:
    """Measure and print."""
    for world, rates in rates_by_world().items():
        print_rates(world, rates)


if __name__ == "__main__":
    main()
