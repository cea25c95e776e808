"""Compare the native firmware's scores with those of the paper's reference study, cell by cell.

``python tests/benchmarks/fidelity.py [--trials N] [--seed S] [--json]`` runs every cell of
``tests/data/reference_scores/fully_connected_trials.csv`` and prints the p-values of a two-sample
Kolmogorov-Smirnov test of h_K, h_e and H. A test rejects at 1 % in all, by Holm's correction over all of
them. Exit code: 0 all agree, 1 not.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp  # type: ignore[import-untyped]

from host_tools.experiments import Experiment, Mode
from host_tools.scores import Limits, score
from host_tools.simulation import run_trials

REFERENCE = Path(__file__).parents[1] / "data/reference_scores/fully_connected_trials.csv"
LIMITS = Limits(k_max=40_000, e_max=0.45)
LEVEL = 0.01
SCORES = ("h_K", "h_e", "H")
_DIGITS = 7
"""To which the reference's numbers are rounded, so that equal ones are equal here."""


@dataclass(frozen=True)
class Cell:
    """A configuration and its reference scores, shape (trials, 3)."""

    experiment: Experiment
    scores: NDArray[np.float64]


def read_cells(seed: int = 1, path: Path = REFERENCE) -> list[Cell]:
    """The cells of the reference in its order."""
    rows: dict[tuple[str, ...], list[list[float]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            key = tuple(
                row[name] for name in ("fill_ratio", "true_b", "flawed_b", "flawed_count", "mode", "tau")
            )
            rows.setdefault(key, []).append([float(row[name]) for name in SCORES])
    return [Cell(_experiment(key, seed), np.array(scores)) for key, scores in rows.items()]


def _experiment(key: tuple[str, ...], seed: int) -> Experiment:
    fill_ratio, true_accuracy, flawed_accuracy, flawed, mode, tau = key
    return Experiment(
        fill_ratio=float(fill_ratio),
        true_accuracy=float(true_accuracy),
        flawed_accuracy=float(flawed_accuracy),
        flawed=int(flawed),
        mode=Mode(mode),
        filter_period=int(tau) or 1000,  # 0 where nobody filters
        seed=seed,
    )


def simulate(experiment: Experiment, trials: int) -> NDArray[np.float64]:
    """Our scores, shape (trials, 3)."""
    measured = run_trials(experiment, 0, trials)
    scores = score(measured.settled, measured.errors, LIMITS)
    return np.stack([scores.h_k, scores.h_e, scores.h], axis=1)


def p_values(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> list[float]:
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
    """p-values of every cell, not corrected."""
    return [p_values(simulate(cell.experiment, trials), cell.scores) for cell in cells]


def main() -> int:
    """Compare and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Compare scores with the paper's reference study.")
    parser.add_argument("--trials", type=int, default=320, help="of each cell (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    cells = read_cells(args.seed)
    values = compare(cells, args.trials)
    corrected = np.reshape(holm(np.ravel(values).tolist()), (len(cells), len(SCORES)))
    if args.json:
        rows = [
            {"parameters": cell.experiment.parameters(), "p": dict(zip(SCORES, own, strict=True))}
            for cell, own in zip(cells, values, strict=True)
        ]
        print(json.dumps({"cells": rows, "smallest_corrected": float(corrected.min())}, indent=2))
    else:
        _print(cells, values)
        print(f"smallest p by Holm's correction over {corrected.size} tests: {corrected.min():.3g}")
    return int(corrected.min() < LEVEL)


def _print(cells: Sequence[Cell], values: Sequence[Sequence[float]]) -> None:
    print("   f    b b_hat flawed       mode  tau " + "".join(f"{name:>9}" for name in SCORES))
    for cell, own in zip(cells, values, strict=True):
        e = cell.experiment
        place = f"{e.fill_ratio:4g} {e.true_accuracy:4g} {e.flawed_accuracy:5g} {e.flawed:6}"
        print(f"{place} {e.mode.value:>10} {e.filter_period:4} " + "".join(f"{p:9.3g}" for p in own))


if __name__ == "__main__":
    sys.exit(main())
