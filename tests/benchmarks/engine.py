"""Speed of the engine compared with float64 in Python, plain double C and the physics simulator, in one run.

``python tests/benchmarks/engine.py [--json] [--check] [--vectors x86-64-v3]``, with the compiler that ``CC``
names (default ``cc``). Robot-steps per second of processor time on one core, fully connected (N = 10) and in
the moving world (N = 20, D = 1, messages a step late), 40 000 steps, filter on. All are measured in turn, ten
times over, and the best of each counts. The physics simulator's figure, with its logging removed, is that of
tests/data/motion_statistics.json. With ``--vectors`` the engine is built from these sources with the vectors
of that architecture, in place of the installed one; ``--check`` exits with 1 where a floor is missed.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import _run_by_message as run_by_message
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.settings import Topology

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
TOOLS, CORE = ROOT / "host_tools/mcp_asdf_tools", ROOT / "c_ref/src"
ARENA, ENGINE = TOOLS / "world/arena", TOOLS / "experiments/engine"
MODULE = "mcp_asdf_tools.experiments._engine"
MOTION = ROOT / "tests/data/motion_statistics.json"
FULL = Experiment(robots=10, flawed=3, steps=40_000, trials=1)
MOVING = Experiment(topology=Topology.DYNAMIC, latency=1, steps=40_000, trials=1)
TRIALS, FEW_TRIALS = 96, 4
REPEATS = 10
ARCHITECTURES = ("x86-64-v3", "x86-64-v4")
COMPILER = os.environ.get("CC", "cc")

PYTHON, DOUBLE, SIMULATOR = "float64 in Python", "plain double C", "physics simulator"
CALLS, LANES = "firmware, call by call", "firmware in lanes"
YARDSTICKS = (PYTHON, DOUBLE, SIMULATOR)
FLOORS = {
    "fully connected": {(LANES, DOUBLE): 0.7, (LANES, CALLS): 4.0},
    "moving": {(LANES, DOUBLE): 0.7, (LANES, CALLS): 1.25},
}
"""Minimum ratio of two rates, with vectors of 64 bytes."""
SHORT_VECTORS_FLOOR = 0.4
"""Minimum ratio of fully connected lanes to plain double C, with vectors of 32 bytes."""

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


def compile_arena(folder: Path, *options: str) -> list[Path]:
    """The arena's objects, compiled as CMakeLists.txt has it."""
    sources = sorted(ARENA.glob("*.c"))
    subprocess.run([COMPILER, "-std=c99", "-O3", *options, "-c", *sources], cwd=folder, check=True)
    return sorted(folder.glob("*.o"))


def plain_double(folder: Path, source: str, trials: int) -> Measurement:
    """The rate of a C program beside this file, compiled as the engine is."""
    program = folder / Path(source).stem
    arena = compile_arena(folder)
    subprocess.run([COMPILER, "-O3", f"-I{ARENA}", HERE / source, *arena, "-o", program, "-lm"], check=True)
    command = [str(program), str(trials)]
    return lambda: float(subprocess.run(command, check=True, capture_output=True).stdout.split()[0])


def build_engine(folder: Path, architecture: str) -> ModuleType:
    """The engine of these sources, with vectors of one architecture."""
    glue, module = folder / "_engine.c", folder / "_engine.so"
    headers = [CORE / "mcp_asdf.h", CORE / "mcp_asdf_image.h", ARENA / "arena.h", ENGINE / "engine.h"]
    generator = ROOT / "firmware_py/build_native.py"
    subprocess.run([sys.executable, generator, MODULE, glue, *headers], check=True)
    arena = compile_arena(folder, "-fPIC")
    includes = (f"-I{path}" for path in (CORE, ARENA, ENGINE, sysconfig.get_path("include")))
    target = f'__attribute__((target("arch={architecture}")))'
    options = ("-O3", "-fPIC", "-shared", "-fno-trapping-math", f"-DFOR_EACH_TARGET={target}")
    sources = (glue, *sorted(ENGINE.glob("*.c")), CORE / "mcp_asdf_image.c")
    subprocess.run([COMPILER, *options, *includes, *sources, *arena, "-o", module, "-lm"], check=True)
    spec = importlib.util.spec_from_file_location(MODULE, module)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def fully_connected(folder: Path) -> dict[str, float]:
    """Rates by name, robot-steps per second."""
    short = replace(FULL, steps=400, filter_period=100, firmware="reference")
    return best_of(
        {
            PYTHON: rate_of(short, 1, lambda: run_by_message(short, 0, 0)),
            DOUBLE: plain_double(folder, "plain_double.c", TRIALS),
            CALLS: rate_of(FULL, 16, lambda: native.run(FULL, 0, 16, lanes=False)),
            LANES: rate_of(FULL, TRIALS, lambda: native.run(FULL, 0, TRIALS, lanes=True)),
            f"{LANES}, with K and e": rate_of(FULL, TRIALS, lambda: run_trials(FULL, 0, TRIALS)),
        }
    )


def moving(folder: Path) -> dict[str, float]:
    """The same in the moving world."""
    short = replace(MOVING, steps=400, filter_period=100, firmware="reference")
    trials = FEW_TRIALS
    simulator = float(json.loads(MOTION.read_text("utf-8"))["robot_steps_per_second"])
    return best_of(
        {
            PYTHON: rate_of(short, 1, lambda: run_by_message(short, 0, 0)),
            SIMULATOR: lambda: simulator,
            DOUBLE: plain_double(folder, "plain_double_moving.c", trials),
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


def missed(rates: dict[str, dict[str, float]], short_vectors: bool) -> list[str]:
    """The floors that were missed, in words."""
    found = []
    for world, floors in FLOORS.items():
        for (name, other), floor in floors.items():
            is_lower = short_vectors and (world, other) == ("fully connected", DOUBLE)
            least, ratio = (
                SHORT_VECTORS_FLOOR if is_lower else floor,
                rates[world][name] / rates[world][other],
            )
            if ratio < least:
                found.append(f"{world}: {name} is {ratio:.3g} of {other}; the floor is {least}")
    return found


def has_long_vectors() -> bool:
    """True if this processor has vectors of 64 bytes."""
    return " avx512vl " in Path("/proc/cpuinfo").read_text(encoding="ascii").replace("\n", " ")


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure the engine's speed against yardsticks.")
    parser.add_argument("--json", action="store_true", help="print the rates as JSON")
    parser.add_argument("--check", action="store_true", help="exit with 1 where a floor is missed")
    parser.add_argument("--vectors", choices=ARCHITECTURES, help="build the engine with these")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.vectors:
            engine_folder = folder / "engine"
            engine_folder.mkdir()
            vars(native)["_engine"] = build_engine(engine_folder, args.vectors)
        rates = {"fully connected": fully_connected(folder), "moving": moving(folder)}
    if args.json:
        print(json.dumps(rates, indent=2))
    else:
        for title, values in rates.items():
            show(title, values)
    complaints = (
        missed(rates, args.vectors == ARCHITECTURES[0] or not has_long_vectors()) if args.check else []
    )
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
