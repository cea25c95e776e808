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

from mcp_asdf_tools.common.parameters import plain_value
from mcp_asdf_tools.experiments.experiment import Convention, Experiment
from mcp_asdf_tools.experiments.scores import Limits, score
from mcp_asdf_tools.experiments.sweep import default_workers
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.population import Filtering
from mcp_asdf_tools.world.settings import Topology

FOLDER = Path(__file__).parents[1] / "data/reference_scores"
REFERENCE, PHYSICS = FOLDER / "fully_connected_trials.csv", FOLDER / "dynamic_trials.csv"
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


@dataclass(frozen=True)
class Row:
    """One configuration's samples of scores, shape (trials, 3), and what they are compared with."""

    experiment: Experiment
    ours: Floats
    others: Floats

    def p_values(self) -> list[float]:
        """Of each score, that both samples come from one distribution."""
        return p_values(self.ours, self.others)


def read_cells(seed: int = 1, path: Path = REFERENCE) -> list[Cell]:
    """The cells of a reference in its order."""
    rows: dict[tuple[str, ...], list[list[float]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            key = tuple(
                row[name] for name in ("fill_ratio", "true_b", "flawed_b", "flawed_count", "mode", "tau")
            )
            rows.setdefault(key, []).append([float(row[name]) for name in SCORES])
    base = Experiment(robots=10, flawed=0, steps=40_000, seed=seed) if path == REFERENCE else physics(seed)
    return [Cell(_experiment(key, base), np.array(scores)) for key, scores in rows.items()]


def physics(seed: int) -> Experiment:
    """The setup of the authors' batch scripts, natively."""
    return Experiment(topology=Topology.DYNAMIC, robots=20, steps=40_000, latency=1, seed=seed)


def _experiment(key: tuple[str, ...], base: Experiment) -> Experiment:
    fill_ratio, true_accuracy, flawed_accuracy, flawed, mode, tau = key
    return replace(
        base,
        fill_ratio=float(fill_ratio),
        true_accuracy=float(true_accuracy),
        flawed_accuracy=float(flawed_accuracy),
        flawed=int(flawed),
        filter=Filtering(mode.replace("_", "-")),
        filter_period=int(tau) or 1000,  # 0 without a filter
    )


def by_reference(experiment: Experiment, conventions: Convention = Convention.PAPER) -> Experiment:
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


def smallest(rows: Sequence[Row]) -> float:
    """The least of all p-values by Holm's correction."""
    return min(holm([value for row in rows for value in row.p_values()]))


# --- Parts -----------------------------------------------------------------------------------------------


class Parts:
    """The comparisons by name. Each experiment is run once, on all workers together."""

    def __init__(self, seed: int, trials: int | None, workers: int) -> None:
        self._seed, self._trials, self._workers = seed, trials, workers

    def fully_connected(self) -> list[Row]:
        """Native against the independent float64 program."""
        return self._against_scores(read_cells(self._seed), "fully_connected")

    def dynamic(self) -> list[Row]:
        """The reference with the authors' conventions against the authors' programs."""
        cells = read_cells(self._seed, PHYSICS)
        authors = [
            replace(cell, experiment=by_reference(cell.experiment, Convention.AUTHORS)) for cell in cells
        ]
        return self._against_scores(authors, "dynamic")

    def native(self) -> list[Row]:
        """Native against the reference, with other draws."""
        all_natives = self._natives()
        others = [by_reference(replace(each, seed=each.seed + _OTHER_DRAWS)) for each in all_natives]
        return self._rows("native", all_natives, others)

    def _natives(self) -> list[Experiment]:
        return [cell.experiment for path in (REFERENCE, PHYSICS) for cell in read_cells(self._seed, path)]

    def _against_scores(self, cells: Sequence[Cell], part: str) -> list[Row]:
        samples = self._run(part, [cell.experiment for cell in cells])
        return [
            Row(cell.experiment, sample, cell.scores) for cell, sample in zip(cells, samples, strict=True)
        ]

    def _rows(self, part: str, ours: Sequence[Experiment], others: Sequence[Experiment]) -> list[Row]:
        samples = self._run(part, [*ours, *others])
        half = len(ours)
        return [Row(*row) for row in zip(ours, samples[:half], samples[half:], strict=True)]

    def _run(self, part: str, experiments: Sequence[Experiment]) -> list[Floats]:
        trials = TRIALS[part] if self._trials is None else self._trials
        with ProcessPoolExecutor(self._workers) as pool:
            return list(pool.map(partial(simulate, trials=trials), experiments))


# --- Output ----------------------------------------------------------------------------------------------


def _place(experiment: Experiment) -> str:
    e = experiment
    accuracies = f"{e.fill_ratio:4g} {e.true_accuracy:4g} {e.flawed_accuracy:5g} {e.flawed:6}"
    return f"{plain_value(e.topology):>15} {accuracies} {e.filter.value:>10} {e.filter_period:4}"


def show(part: str, rows: Sequence[Row]) -> None:
    """Print a part as a table."""
    print(f"\n{part}: medians of H, p-values of {', '.join(SCORES)}")
    print(f"{'topology':>15}    f    b b_hat flawed       mode  tau    ours   other")
    for row in rows:
        medians = f"{np.median(row.ours[:, 2]):7.2f} {np.median(row.others[:, 2]):7.2f}"
        print(f"{_place(row.experiment)} {medians} " + "".join(f"{p:9.3g}" for p in row.p_values()))
    print(f"smallest p by Holm's correction over {3 * len(rows)} tests: {smallest(rows):.3g}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Compare scores with references and with each other.")
    parser.add_argument("parts", metavar="PART", nargs="*", help=f"of {', '.join(TRIALS)}; default all")
    parser.add_argument("--trials", type=int, help=f"of each configuration (default by part: {TRIALS})")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=default_workers())
    args = parser.parse_args()
    if unknown := set(args.parts) - set(TRIALS):
        parser.error(f"unknown part {', '.join(unknown)}; choose of {', '.join(TRIALS)}")
    return args


def main() -> int:
    """Compare and print; returns the exit code."""
    args = _arguments()
    parts = Parts(args.seed, args.trials, args.workers)
    agrees = True
    for part in args.parts or TRIALS:
        rows = getattr(parts, part)()
        show(part, rows)
        agrees = agrees and smallest(rows) >= LEVEL
    return int(not agrees)


if __name__ == "__main__":
    sys.exit(main())
