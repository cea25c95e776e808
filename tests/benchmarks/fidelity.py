"""Compare distributions of the native firmware's scores, configuration by configuration, with references.

    python tests/benchmarks/fidelity.py

Part ``fully_connected``: with an independent float64 program of the paper's conventions, 46 configurations.
Part ``dynamic``, messages a step late: with the authors' own programs in their physics simulation, 11.

These are two-sample Kolmogorov-Smirnov tests of h_K, h_e and H by configuration; a part fails at 1 % in all,
by Holm's correction over its tests. Exit code: 0 all agree, 1 not. The references are in
tests/data/reference_scores/.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp  # type: ignore[import-untyped]

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.metrics import score
from mcp_asdf_tools.experiments.scores import E_MAX
from mcp_asdf_tools.experiments.trials import run_trials

FOLDER = Path(__file__).parents[1] / "data/reference_scores"
REFERENCE, PHYSICS = FOLDER / "fully_connected.csv", FOLDER / "dynamic.csv"
K_MAX = 40_000
LEVEL = 0.01
SCORES = ("h_K", "h_e", "H")
PARTS = {"fully_connected": (REFERENCE, 320), "dynamic": (PHYSICS, 120)}
"""References, and trials of each configuration."""

_DIGITS = 7
"""To which the reference's numbers are rounded, so that equal ones are equal here."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StoredExperiment:
    """A configuration, run natively, and the scores of its reference, shape (trials, 3)."""

    experiment: Experiment
    scores: Floats


def read_stored_experiments(path: Path = REFERENCE) -> list[StoredExperiment]:
    """Return the experiments of a reference in its order, set up as in the authors' scripts."""
    world: Any = {"robots": 10} if path == REFERENCE else {"topology": "dynamic", "robots": 20, "latency": 1}
    stored_experiments = []
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            mode: Any = row["mode"].replace("_", "-")
            experiment = Experiment(
                **world,
                steps=40_000,
                fill_ratio=float(row["fill_ratio"]),
                true_accuracy=float(row["true_b"]),
                flawed_accuracy=float(row["flawed_b"]),
                flawed=int(row["flawed_count"]),
                filter=mode,
                filter_period=int(row["tau"]) or 1000,  # 0 without a filter
            )
            h_k, h_e = (np.array(row[name].split(), float) for name in ("h_K", "h_e"))
            stored_experiments.append(
                StoredExperiment(experiment, np.stack([h_k, h_e, (h_k + h_e) / 2], axis=1))
            )
    return stored_experiments


def simulate(experiment: Experiment, trials: int) -> Floats:
    """Return our scores, shape (trials, 3)."""
    measured = run_trials(experiment, 0, trials)
    scores = score(measured.convergence_steps, measured.errors, K_MAX, E_MAX)
    return np.stack([scores[name] for name in SCORES], axis=1)


def p_values(ours: Floats, theirs: Floats) -> list[float]:
    """Return p-values by score: how probable so large a difference is if both have one distribution."""
    pairs = zip(np.round(ours, _DIGITS).T, np.round(theirs, _DIGITS).T, strict=True)
    return [float(ks_2samp(own, other, method="exact").pvalue) for own, other in pairs]


def smallest(values: Sequence[Sequence[float]]) -> float:
    """Return the smallest p-value, corrected for their number: the first step of Holm's procedure."""
    return min(1.0, np.size(values) * float(np.min(values)))


def agrees(part: str) -> bool:
    """Print a part as a table, and return whether all its tests pass."""
    path, trials = PARTS[part]
    stored_experiments = read_stored_experiments(path)
    experiments = [stored.experiment for stored in stored_experiments]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        samples = list(pool.map(partial(simulate, trials=trials), experiments))

    print(f"\n{part}: medians of H, ours and the other; p-values of {', '.join(SCORES)}")
    values = []
    for stored, our_scores in zip(stored_experiments, samples, strict=True):
        values.append(p_values(our_scores, stored.scores))
        print_row(stored, our_scores, values[-1])
    least = smallest(values)
    print(f"smallest p by Holm's correction over {3 * len(stored_experiments)} tests: {least:.3g}")
    return least >= LEVEL


def print_row(stored: StoredExperiment, our_scores: Floats, p_values_of_scores: list[float]) -> None:
    """Print parameters of an experiment, the medians of our H and the stored H, and a p-value per score."""
    e = stored.experiment
    place = (e.robots, e.fill_ratio, e.true_accuracy, e.flawed_accuracy, e.flawed, e.filter_period, e.filter)
    medians_of_h = (np.median(our_scores[:, 2]), np.median(stored.scores[:, 2]))
    print(*place, *(f"{number:8.3g}" for number in (*medians_of_h, *p_values_of_scores)))


def main() -> int:
    """Compare and print; returns the exit code."""
    return int(not all([agrees(part) for part in PARTS]))


if __name__ == "__main__":
    sys.exit(main())
