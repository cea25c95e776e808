"""Compare distributions of scores, configuration by configuration: with the paper's reference study, and our
firmwares with each other.

    python tests/benchmarks/fidelity.py [PART ...] [--trials N] [--seed S] [--workers N]

Parts, all of them by default:

- ``fully_connected``: the native firmware with an independent float64 program of the paper's conventions, 46
  configurations;
- ``dynamic``: the reference firmware with the authors' conventions and messages a step late, in our arena,
  with the authors' own programs in their physics simulation, 11 configurations;
- ``native``: the native firmware with the reference firmware, both with the paper's conventions, in all 57,
  with other draws.

These are two-sample Kolmogorov-Smirnov tests of h_K, h_e and H by configuration; a part fails at 1 % in all,
by Holm's correction over its tests. Exit code: 0 all agree, 1 not. The references are in
tests/data/reference_scores/.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # products are small, and processes as many as processors

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp  # type: ignore[import-untyped]

from mcp_asdf_tools.experiments.experiment import Convention, Experiment
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.sweep import default_workers
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Filtering

FOLDER = Path(__file__).parents[1] / "data/reference_scores"
REFERENCE, PHYSICS = FOLDER / "fully_connected.csv", FOLDER / "dynamic.csv"
LIMITS = Limits(k_max=40_000, e_max=0.45)
LEVEL = 0.01
SCORES = ("h_K", "h_e", "H")
TRIALS = {"fully_connected": 320, "dynamic": 120, "native": 60}
"""Of each configuration, unless given; those of the reference are slower."""

_OTHER_DRAWS = 1000
_DIGITS = 7
"""To which the reference's numbers are rounded, so that equal ones are equal here."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """A configuration, run natively, and the scores of its reference, shape (trials, 3)."""

    experiment: Experiment
    scores: Floats


def read_cells(seed: int = 1, path: Path = REFERENCE) -> list[Cell]:
    """The cells of a reference in its order."""
    base = Experiment(robots=10, flawed=0, steps=40_000, seed=seed) if path == REFERENCE else physics(seed)
    cells = []
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            key = [row[name] for name in ("fill_ratio", "true_b", "flawed_b", "flawed_count", "mode", "tau")]
            h_k, h_e = (np.array(row[name].split(), float) for name in ("h_K", "h_e"))
            cells.append(Cell(_experiment(key, base), np.stack([h_k, h_e, (h_k + h_e) / 2], axis=1)))
    return cells


def physics(seed: int) -> Experiment:
    """The setup of the authors' batch scripts, natively."""
    return Experiment(topology="dynamic", robots=20, steps=40_000, latency=1, seed=seed)


MODES: dict[str, Filtering] = {"none": "none", "asdf_minus": "asdf-minus", "asdf_plus": "asdf-plus"}


def _experiment(key: Sequence[str], base: Experiment) -> Experiment:
    fill_ratio, true_accuracy, flawed_accuracy, flawed, mode, tau = key
    return replace(
        base,
        fill_ratio=float(fill_ratio),
        true_accuracy=float(true_accuracy),
        flawed_accuracy=float(flawed_accuracy),
        flawed=int(flawed),
        filter=MODES[mode],
        filter_period=int(tau) or 1000,  # 0 without a filter
    )


def by_reference(experiment: Experiment, conventions: Convention = "paper") -> Experiment:
    """The same by the reference firmware."""
    return replace(experiment, firmware="reference", conventions=conventions)


def simulate(experiment: Experiment, trials: int) -> Floats:
    """Our scores, shape (trials, 3)."""
    measured = run_trials(experiment, 0, trials)
    scores = score(measured.convergence_steps, measured.errors, LIMITS)
    return np.stack([scores.h_k, scores.h_e, scores.h], axis=1)


def p_values(ours: Floats, theirs: Floats) -> list[float]:
    """Of each score, that both samples come from one distribution."""
    pairs = zip(np.round(ours, _DIGITS).T, np.round(theirs, _DIGITS).T, strict=True)
    return [float(ks_2samp(own, other, method="exact").pvalue) for own, other in pairs]


def holm(values: Sequence[float]) -> list[float]:
    """p-values corrected for being many: below the level where Holm's procedure rejects."""
    order = np.argsort(values)
    scaled = np.array(values)[order] * (len(values) - np.arange(len(values)))
    corrected = np.empty(len(values))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return [float(value) for value in corrected]


def compare(cells: Sequence[Cell], trials: int) -> list[list[float]]:
    """p-values of every cell against its reference, not corrected."""
    return [p_values(simulate(cell.experiment, trials), cell.scores) for cell in cells]


# --- The command -----------------------------------------------------------------------------------------


def pairs_of(part: str, seed: int, trials: int, workers: int) -> list[tuple[Experiment, Floats, Floats]]:
    """The configurations of a part, with both samples of scores."""
    cells = {
        "fully_connected": read_cells(seed),
        "dynamic": read_cells(seed, PHYSICS),
        "native": [*read_cells(seed), *read_cells(seed, PHYSICS)],
    }[part]
    ours = [cell.experiment for cell in cells]
    if part == "dynamic":
        ours = [by_reference(each, "authors") for each in ours]
    with ProcessPoolExecutor(workers) as pool:
        others = [cell.scores for cell in cells]
        if part == "native":
            drawn = [by_reference(replace(each, seed=each.seed + _OTHER_DRAWS)) for each in ours]
            others = list(pool.map(partial(simulate, trials=trials), drawn))
        return list(zip(ours, pool.map(partial(simulate, trials=trials), ours), others, strict=True))


def agrees(part: str, pairs: Sequence[tuple[Experiment, Floats, Floats]]) -> bool:
    """Print a part as a table; whether all its tests pass."""
    print(f"\n{part}: medians of H, ours and the other; p-values of {', '.join(SCORES)}")
    values = [p_values(own, other) for _, own, other in pairs]
    for (experiment, own, other), ps in zip(pairs, values, strict=True):
        e, medians = experiment, [np.median(sample[:, 2]) for sample in (own, other)]
        place = (e.robots, e.fill_ratio, e.true_accuracy, e.flawed_accuracy, e.flawed, e.filter_period)
        print(*place, e.filter, *(f"{each:8.3g}" for each in (*medians, *ps)))
    least = min(holm([value for ps in values for value in ps]))
    print(f"smallest p by Holm's correction over {3 * len(pairs)} tests: {least:.3g}")
    return least >= LEVEL


def main() -> int:
    """Compare and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Compare scores with references and with each other.")
    parser.add_argument("parts", metavar="PART", nargs="*", help=f"of {', '.join(TRIALS)}; default all")
    parser.add_argument("--trials", type=int, help=f"of each configuration (default by part: {TRIALS})")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=default_workers())
    args = parser.parse_args()
    if unknown := set(args.parts) - set(TRIALS):
        parser.error(f"unknown part {', '.join(unknown)}; choose of {', '.join(TRIALS)}")
    found = [
        agrees(part, pairs_of(part, args.seed, args.trials or TRIALS[part], args.workers))
        for part in args.parts or TRIALS
    ]
    return int(not all(found))


if __name__ == "__main__":
    sys.exit(main())
