"""How the moving world compares with the simulation it is modelled on: statistics of the motion, and speed.

    PYTHONPATH=tests python -m benchmarks.arena [--trials N] [--steps T] [--seed S] [--json]
        [--write docs/arena.md]

Runs trials of the paper's dynamic setup (N = 20, D = 1) and prints every statistic beside the reference's, in
tests/data/motion_statistics.json, with the standard error of the trials. Then it measures how many
robot-ticks a second one core does, motion, sensors and neighbours together, as a ratio to the 1.85e5 of the
physics simulator with its logging removed. Exit code 1 if a statistic is off by more than 5 % and three
standard errors, except for those that the table marks as not measured alike.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.motion_statistics import motion_statistics
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.settings import WorldSettings

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = json.loads((ROOT / "tests/data/motion_statistics.json").read_text(encoding="utf-8"))
START, END = "<!-- motion table -->", "<!-- end of motion table -->"
SETTINGS = WorldSettings(topology="dynamic", robots=20, density=1.0)
SPEED_TICKS, SPEED_REPEATS = 40000, 5
OTHERWISE = ("time between contacts", "largest coordinate")
"""Depend on a definition or on the length of a run that the reference does not state."""


def trial(seed: int, ticks: int) -> dict[str, float]:
    """Statistics of one trial, the degree without blocking included."""
    motion = Arena(SETTINGS, seed).record(ticks)
    near = [
        np.count_nonzero(np.linalg.norm(place[:, np.newaxis] - place, axis=2) < SETTINGS.radio_range)
        for place in motion.position
    ]
    without = float(np.mean(near)) / SETTINGS.robots - 1  # each robot is near itself
    return {**motion_statistics(motion), "degree without blocking": without}


def compare(trials: int, ticks: int, seed: int) -> list[dict[str, object]]:
    """A row for each statistic of the reference."""
    with ThreadPoolExecutor() as pool:
        results = list(pool.map(lambda index: trial(seed + index, ticks), range(trials)))
    rows = []
    for name, expected in REFERENCE["statistics"].items():
        values = np.array([result[name] for result in results])
        mean, error = float(values.mean()), float(values.std(ddof=1)) / math.sqrt(trials)
        rows.append(
            {
                "statistic": name,
                "reference": expected,
                "here": mean,
                "standard error": error,
                "difference": mean / expected - 1,
                "agrees": abs(mean - expected) <= 0.05 * abs(expected) + 3 * error + half_digit(expected),
                "measured alike": name not in OTHERWISE,
            }
        )
    return rows


def half_digit(value: float) -> float:
    """Half of the last digit with which a number is printed."""
    return 0.5 * 10.0 ** -len(str(value).partition(".")[2])


def markdown(rows: Sequence[dict[str, object]], trials: int, ticks: int) -> str:
    """The comparison as a table."""
    lines = ["| statistic | reference | here | difference |", "|---|---|---|---|"]
    for row in rows:
        name = f"{row['statistic']}{'' if row['measured alike'] else ' *'}"
        here = f"{row['here']:.4f} +- {row['standard error']:.4f}"
        lines.append(
            f"| {name} | {row['reference']} | {here} | {100 * float(str(row['difference'])):+.1f} % |"
        )
    lines += ["", f"{trials} trials of {ticks} ticks: mean and standard error. * is not measured alike."]
    return "\n".join(lines)


def robot_steps_per_second() -> float:
    """The best of a few repeats, by the processor's time."""
    rates = []
    for repeat in range(SPEED_REPEATS):
        arena = Arena(SETTINGS, repeat)
        start = time.process_time()
        arena.step(SPEED_TICKS)
        rates.append(SPEED_TICKS * SETTINGS.robots / (time.process_time() - start))
    return max(rates)


def write_between_markers(path: Path, table: str) -> None:
    """Replace what stands between the markers. Raises ValueError if they are missing."""
    text = path.read_text(encoding="utf-8")
    if START not in text or END not in text:
        raise ValueError(f"{path} has no lines {START} and {END}")
    head, rest = text.split(START, 1)
    path.write_text(f"{head}{START}\n{table}\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Compare the moving world with its model.")
    parser.add_argument("--trials", type=int, default=24, help="at least 2; default %(default)s")
    parser.add_argument("--steps", type=int, default=40000, help="above 500; default %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial; default %(default)s")
    parser.add_argument("--json", action="store_true", help="print everything measured as JSON")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table between its markers")
    args = parser.parse_args()
    if args.trials < 2 or args.steps <= 500 or args.seed < 0:
        parser.error(f"--trials {args.trials} --steps {args.steps} --seed {args.seed}: at least 2, 501 and 0")
    rate, baseline = robot_steps_per_second(), float(REFERENCE["robot_ticks_per_second"])
    rows = compare(args.trials, args.steps, args.seed)
    table = markdown(rows, args.trials, args.steps)
    if args.json:
        everything = {"statistics": rows, "robot_steps_per_second": rate, "baseline": baseline}
        print(json.dumps(everything, indent=2))
    else:
        ratio = f"{rate / baseline:.0f} times the physics simulator's {baseline:.3g}"
        print(f"{table}\n\n{rate:.3g} robot-ticks a second and core: {ratio}")
    if args.write is not None:
        write_between_markers(args.write, table)
    return 0 if all(row["agrees"] for row in rows if row["measured alike"]) else 1


if __name__ == "__main__":
    sys.exit(main())
