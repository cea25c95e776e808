"""Compare the errors of swarms in ARGoS3 with those of ``mcp-asdf simulate``.

    python tests/benchmarks/argos.py                     # print the table of docs/platforms/argos.md
    python tests/benchmarks/argos.py FOLDER [FILTER ...] # run ARGoS3 first; FOLDER has the example, built

The second form makes tests/data/argos_results.csv anew, or only the rows of some filters. The example is
c_ref/examples/argos3; docs/platforms/argos.md says how it is built.
"""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp  # type: ignore[import-untyped]

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials

RESULTS = Path(__file__).parents[1] / "data/argos_results.csv"
SEEDS = range(1, 41)
TRIALS = 200
"""Trials of ``simulate`` that the seeds of ARGoS are compared with."""

FILTERS = {
    "none": {"healthy": "off", "flawed": "off"},
    "asdf-minus": {"healthy": "off", "flawed": "asdf"},
    "asdf-plus": {"healthy": "asdf", "flawed": "asdf"},
    "robust": {"healthy": "robust", "flawed": "robust"},
}
"""Filters of the controllers in swarm.argos, by the name of a swarm's filter."""

QUANTITIES = {
    "error_in_second_half": "mean error, second half",
    "error_at_end": "error at the end",
    "b_hat_error_at_end": "error of b_hat at the end",
}
"""Columns of the results, and what the page calls them. Each is a mean over the robots."""
DECIMALS = 6
"""Decimal places of the results, to which both sides are rounded, so that equal numbers are equal."""

STEPS, FILL_RATIO, TRUE_ACCURACY = 10_000, 0.55, 0.95
RESULTS_PERIOD = 100

ErrorsByQuantity = dict[str, NDArray[np.float64]]


# --- ARGoS3 ----------------------------------------------------------------------------------------------


def write_configuration(path: Path, example: Path, filter_name: str, seed: int, results: Path) -> None:
    """Write swarm.argos with the filters and the seed of a trial, and without logs."""
    tree = ElementTree.parse(example / "swarm.argos")
    for controller in tree.iterfind("controllers/*"):
        parameters = controller.find("params")
        assert parameters is not None
        parameters.set("filter", FILTERS[filter_name][controller.attrib["id"]])
        parameters.set("log_folder", "")
    for element, name, value in (
        ("framework/experiment", "random_seed", str(seed)),
        ("loop_functions", "results", str(results)),
    ):
        node = tree.find(element)
        assert node is not None
        node.set(name, value)
    tree.write(path)


def summarise(table: Path) -> dict[str, float]:
    """Return the QUANTITIES of a trial from the table that the loop functions have written."""
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    ticks = np.array([int(row["tick"]) for row in rows])
    errors = abs(np.array([float(row["x"]) for row in rows]) - FILL_RATIO)
    b_hat_errors = abs(np.array([float(row["b_hat"]) for row in rows]) - TRUE_ACCURACY)
    last_tick = ticks.max()
    return {
        "error_in_second_half": float(errors[ticks > last_tick / 2].mean()),
        "error_at_end": float(errors[ticks == last_tick].mean()),
        "b_hat_error_at_end": float(b_hat_errors[ticks == last_tick].mean()),
    }


def run_argos(example: Path, filter_name: str, seed: int) -> dict[str, float]:
    """Run a trial in ARGoS3, and return its QUANTITIES."""
    configuration, table = example / "trial.argos", example / "trial.csv"
    write_configuration(configuration, example, filter_name, seed, table)
    subprocess.run(["argos3", "-c", configuration.name], cwd=example, check=True, capture_output=True)
    return summarise(table)


def rewrite_results(example: Path, filter_names: Sequence[str]) -> None:
    """Run all seeds with some filters in ARGoS3, and replace the rows of these filters in the results."""
    with RESULTS.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["filter"] not in filter_names]
    for filter_name in filter_names:
        for seed in SEEDS:
            print(f"{filter_name}, seed {seed}", file=sys.stderr)
            values = run_argos(example, filter_name, seed)
            texts = {name: f"{value:.{DECIMALS}f}" for name, value in values.items()}
            rows.append({"filter": filter_name, "seed": str(seed), **texts})
    write_results(rows)


def write_results(rows: list[dict[str, str]]) -> None:
    """Write the rows of the results, in the order of FILTERS."""
    with RESULTS.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, ["filter", "seed", *QUANTITIES], lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: list(FILTERS).index(row["filter"])))


# --- Comparison ------------------------------------------------------------------------------------------


def read_results() -> dict[str, ErrorsByQuantity]:
    """Return the results of ARGoS3 by filter and quantity. Each is an array that has one value per seed."""
    with RESULTS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    results: dict[str, ErrorsByQuantity] = {}
    for filter_name in FILTERS:
        rows_of_filter = [row for row in rows if row["filter"] == filter_name]
        if rows_of_filter:
            results[filter_name] = {
                quantity: np.array([float(row[quantity]) for row in rows_of_filter])
                for quantity in QUANTITIES
            }
    return results


def simulate(filter_name: str, trials: int, **changes: Any) -> ErrorsByQuantity:
    """Return the QUANTITIES of trials of ``mcp-asdf simulate`` with the parameters of swarm.argos."""
    parameters: dict[str, Any] = {
        "topology": "dynamic",
        "latency": 1,
        "steps": STEPS,
        "fill_ratio": FILL_RATIO,
        "true_accuracy": TRUE_ACCURACY,
        "flawed": 6,
        "flawed_accuracy": 0.55,
        "filter": filter_name,
    }
    measured = run_trials(Experiment(**parameters | changes), 0, trials, RESULTS_PERIOD)
    errors = abs(measured.records["x"] - FILL_RATIO)  # shape (trials, samples, N)
    b_hat_errors = abs(measured.records["b_hat"][:, -1] - TRUE_ACCURACY)
    first_of_second_half = STEPS // 2 // RESULTS_PERIOD + 1
    return {
        "error_in_second_half": errors[:, first_of_second_half:].mean(axis=(1, 2)),
        "error_at_end": errors[:, -1].mean(axis=1),
        "b_hat_error_at_end": b_hat_errors.mean(axis=1),
    }


def p_values(simulated: ErrorsByQuantity, argos: ErrorsByQuantity) -> dict[str, float]:
    """Return p-values by quantity: how probable so large a difference is if both have one distribution."""
    return {
        quantity: float(ks_2samp(np.round(simulated[quantity], DECIMALS), argos[quantity]).pvalue)
        for quantity in QUANTITIES
    }


def format_table(trials: int = TRIALS) -> str:
    """Return the table of docs/platforms/argos.md: medians of both, and the p-value of each comparison."""
    lines = ["| filter | quantity, mean over the robots | ARGoS3 | `simulate` | p |", "|---|---|---|---|---|"]
    for filter_name, argos in read_results().items():
        simulated = simulate(filter_name, trials)
        p_by_quantity = p_values(simulated, argos)
        for quantity, meaning in QUANTITIES.items():
            medians = [float(np.median(errors[quantity])) for errors in (argos, simulated)]
            numbers = [*(f"{median:.4f}" for median in medians), f"{p_by_quantity[quantity]:.2f}"]
            lines.append(f"| {' | '.join([filter_name, meaning, *numbers])} |")
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Run ARGoS3 if a folder is named, and print the table; return the exit code."""
    if arguments:
        example, *filter_names = arguments
        rewrite_results(Path(example).resolve(), filter_names or list(FILTERS))
    print(format_table())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
