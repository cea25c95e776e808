"""What this project's own studies share: their options, the error that they measure, and tables.

Each study is a program. It runs the experiments of labelled rows, or resumes them, and writes tables with
these rows and a picture into a folder. In a trial each robot estimates f, the share of black floor, as x;
b_hat is the accuracy that it assumes for its sensor, b the true one. A flawed robot starts with a wrong
b_hat, a healthy one with the right one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import mcp_asdf_tools as m
from mcp_asdf_tools.common.files import make_folder, write_atomically
from mcp_asdf_tools.experiments.error_plot import plot_errors_over_time
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.peers import LIAR_COUNT, column_label, has_liars
from mcp_asdf_tools.studies.text_tables import format_cells

MOVING_SWARM: dict[str, Any] = {"topology": "dynamic", "latency": 1}
"""Parameters of swarms that move; without them, every robot receives from all others."""

PARAMETERS_BY_FLAW: dict[str, dict[str, Any]] = {
    "underconfident": {"fill_ratio": 0.55, "true_accuracy": 0.95, "flawed_accuracy": 0.55},
    "overconfident": {"fill_ratio": 0.95, "true_accuracy": 0.55, "flawed_accuracy": 0.95},
}
"""Parameters of the two kinds of flawed robots, which assume a far worse or a far better accuracy than b."""

ALL_FILTERS = ["none", "asdf-minus", "asdf-plus", "robust"]
FILTERS_OF_HEALTHY_SWARMS = ["none", "asdf-plus", "robust"]
"""The filters that differ where no robot is flawed: only flawed robots filter with ASDF-."""

QUICK_TRIALS, QUICK_STEPS = 2, 4000

LATE_ERROR_HEAD = "error of the last quarter"
"""Head of a table of errors: what its numbers are."""

Rows = Mapping[str, Sequence[Trials]]
"""The results of a table's rows, by the label that a row begins with."""


# --- Running ---------------------------------------------------------------------------------------------


def parse_arguments(description: str | None) -> argparse.Namespace:
    """Parse the options of a study's program: folder, workers and quick."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="for results, tables and picture")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    quick = f"{QUICK_TRIALS} trials of at most {QUICK_STEPS} steps, to see that it works"
    parser.add_argument("--quick", action="store_true", help=quick)
    return parser.parse_args()


def rows_of_swarms(swarms: Mapping[str, Mapping[str, Any]], **common: Any) -> dict[str, list[Experiment]]:
    """Return the experiments of each swarm with each kind of flaws, by labels such as "swarm, overconfident".

    ``swarms`` are the parameters of each swarm by its label, and ``common`` those that all have. A list among
    them makes an experiment of each of its values.
    """
    rows: dict[str, list[Experiment]] = {}
    for label, swarm in swarms.items():
        for flaw, flaw_parameters in PARAMETERS_BY_FLAW.items():
            rows[f"{label}, {flaw}"] = m.grid(**swarm, **flaw_parameters, **common)
    return rows


def run_rows(
    name: str,
    experiments_by_row: Mapping[str, Sequence[Experiment]],
    arguments: argparse.Namespace,
    record: int = 1000,
) -> dict[str, list[Trials]]:
    """Run the experiments of a table's rows, and return their trials by the labels of the rows.

    ``arguments`` are the options of the program; with ``--quick`` all experiments are shortened first. The
    trials are also written into ``FOLDER/name.parquet``, with x, every robot's estimate, at every
    ``record``-th step. If an earlier call was interrupted, only what the file lacks is run. The trials that
    are returned lack the estimates of liars.
    """
    if arguments.quick:
        experiments_by_row = _shorten(experiments_by_row)
    # One call for all rows, so that no worker waits at the end of each row.
    all_experiments = list(chain.from_iterable(experiments_by_row.values()))
    make_folder(arguments.folder)
    output = arguments.folder / f"{name}.parquet"
    table = m.simulate(all_experiments, output, workers=arguments.workers, record=record)
    trials_of = {trials.experiment: without_liars(trials) for trials in m.experiments_in(table)}
    return {
        label: [trials_of[experiment] for experiment in experiments]
        for label, experiments in experiments_by_row.items()
    }


def _shorten(experiments_by_row: Mapping[str, Sequence[Experiment]]) -> dict[str, list[Experiment]]:
    """Return the experiments of all rows, shortened to the trials and steps of the quick form."""
    return {
        label: [
            replace(experiment, trials=QUICK_TRIALS, steps=min(experiment.steps, QUICK_STEPS))
            for experiment in experiments
        ]
        for label, experiments in experiments_by_row.items()
    }


# --- Measures --------------------------------------------------------------------------------------------


def late_errors(trials: Trials) -> Sample:
    """Return the late error of each trial: the mean of |x - f| over its last quarter and over its robots.

    x is a robot's recorded estimate, f the share of black floor.
    """
    errors: Sample = last_quarter(trials.mean_errors_over_time()).mean(axis=1)
    return errors


def last_quarter(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values in the last quarter of each trial. Their shape is (trials, recorded steps, ...)."""
    _trials, recorded_steps, *_other_lengths = values.shape
    quarter_length = max(1, recorded_steps // 4)  # a short trial has few values, but at least one counts
    return values[:, -quarter_length:]


def without_liars(trials: Trials) -> Trials:
    """Return trials with x, the recorded estimates, of the honest robots alone.

    Other records are dropped, and results other than records still cover all robots.
    """
    x = trials.records["x"]  # shape (trials, steps, robots)
    if has_liars(trials.experiment):
        x = x[:, :, :-LIAR_COUNT]  # the last robots of a swarm lie
    return replace(trials, records={"x": x})


# --- Text ------------------------------------------------------------------------------------------------


def late_error_text(experiments: Sequence[Trials]) -> str:
    """Format the late error of experiments that share a cell of a table, such as "0.012".

    It is the median over the trials of each experiment, averaged over the experiments. An error below 0.01
    has four decimals, any other has three.
    """
    error = np.mean([np.median(late_errors(trials)) for trials in experiments])
    return f"{error:.4f}" if error < 0.01 else f"{error:.3f}"


# --- Pictures --------------------------------------------------------------------------------------------


def plot_errors_of_swarms(rows: Rows, swarms: Sequence[str]) -> Figure:
    """Draw |x - f|, the error of the estimates, over time: a line for each filter or peer.

    The panels of a row have the same kind of flaws of PARAMETERS_BY_FLAW, the underconfident ones first. Its
    columns are the ``swarms``: the labels of rows are these, with the kind of flaws after a comma.
    """
    labels = [f"{swarm}, {flaw}" for flaw in PARAMETERS_BY_FLAW for swarm in swarms]
    panels = {label: rows[label] for label in labels}
    return plot_errors_over_time(panels, column_label)


# --- Tables ----------------------------------------------------------------------------------------------


def markdown_table(head: str, rows: Rows, text_of: Callable[[Sequence[Trials]], str]) -> str:
    """Return a table in Markdown with a row for each label, and a column for each filter or peer.

    ``text_of`` formats the experiments that share a cell, which differ only in f, b or b_hat; a cell without
    experiments is empty. The columns are in the order in which they first come in the rows. ``head`` is the
    text of the upper left corner, which says what the numbers are.
    """
    trials_by_cell: dict[tuple[str, str], list[Trials]] = {}
    for row, experiments in rows.items():
        for trials in experiments:
            cell = (row, column_label(trials.experiment))
            trials_by_cell.setdefault(cell, []).append(trials)
    text_by_cell = {cell: text_of(trials) for cell, trials in trials_by_cell.items()}
    return format_cells(head, text_by_cell)


def write_tables(path: Path, title: str, tables: Mapping[str, str]) -> None:
    """Write tables into a Markdown file, each between its mark and ``<!-- end -->``, as docs/ has them."""
    marked_tables = [f"<!-- {mark} -->\n{table}\n<!-- end -->" for mark, table in tables.items()]
    paragraphs = [f"# {title}", *marked_tables]
    write_atomically(path, "\n\n".join(paragraphs) + "\n")
