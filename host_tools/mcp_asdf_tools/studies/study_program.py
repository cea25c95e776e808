"""What this project's own studies share: their options, measures of errors, and tables with intervals.

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
from mcp_asdf_tools.studies.bootstrap import (
    Interval,
    Resampled,
    Sample,
    mean_of_resampled,
    resample_mean,
    resample_median,
)
from mcp_asdf_tools.studies.peers import column_label

MOVING_SWARM: dict[str, Any] = {"topology": "dynamic", "latency": 1}
"""Parameters of swarms that move; without them, every robot receives from all others."""

PARAMETERS_BY_FLAW: dict[str, dict[str, Any]] = {
    "underconfident": {"fill_ratio": 0.55, "true_accuracy": 0.95, "flawed_accuracy": 0.55},
    "overconfident": {"fill_ratio": 0.95, "true_accuracy": 0.55, "flawed_accuracy": 0.95},
}
"""Parameters of the two kinds of flawed robots, which assume a far worse or a far better accuracy than b."""

BOTH_FLAWS = list(PARAMETERS_BY_FLAW.values())
ALL_FILTERS = ["none", "asdf-minus", "asdf-plus", "robust"]
FILTERS_OF_HEALTHY_SWARMS = ["none", "asdf-plus", "robust"]
"""The filters that differ where no robot is flawed: only flawed robots filter with ASDF-."""

CONFIDENCE = 0.95
QUICK_TRIALS, QUICK_STEPS = 2, 4000

INTERVAL_NOTE = (
    "Medians over trials. A 95 % interval stands in brackets where it reaches farther than 0.5 from H, a "
    "tenth from an error, or 1 % from a share of robots."
)

PLAIN_NOTE = "Errors are medians over trials, and percentages means; the picture has the errors' intervals."

Measure = Callable[[Trials], Sample]
"""Returns a value for each trial of an experiment."""

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


def run_rows(
    name: str,
    experiments_by_row: Mapping[str, Sequence[Experiment]],
    arguments: argparse.Namespace,
    record: int = 1000,
) -> dict[str, list[Trials]]:
    """Run the experiments of a table's rows, and return their trials by the labels of the rows.

    ``arguments`` are the options of the program; with ``--quick`` all experiments are shortened first. The
    trials are also written into ``FOLDER/name.parquet``, with x, every robot's estimate, at every
    ``record``-th step. If an earlier call was interrupted, only what the file lacks is run.
    """
    experiments_to_run: dict[str, Sequence[Experiment]] = dict(experiments_by_row)
    if arguments.quick:
        for label, experiments in experiments_by_row.items():
            experiments_to_run[label] = [_shorten(experiment) for experiment in experiments]
    # One call for all rows, so that no worker waits at the end of each row.
    all_experiments = list(chain.from_iterable(experiments_to_run.values()))
    make_folder(arguments.folder)
    output = arguments.folder / f"{name}.parquet"
    table = m.simulate(all_experiments, output, workers=arguments.workers, record=record)
    trials_by_experiment = {trials.experiment: trials for trials in m.experiments_in(table)}
    rows: dict[str, list[Trials]] = {}
    for label, experiments in experiments_to_run.items():
        rows[label] = [trials_by_experiment[experiment] for experiment in experiments]
    return rows


def _shorten(experiment: Experiment) -> Experiment:
    """Return the experiment with the trials and steps of the quick form."""
    return replace(experiment, trials=QUICK_TRIALS, steps=min(experiment.steps, QUICK_STEPS))


# --- Measures --------------------------------------------------------------------------------------------


def late_errors(trials: Trials) -> Sample:
    """Return the late error of each trial: the mean of |x - f| over its last quarter and over its robots.

    x is a robot's recorded estimate, f the share of black floor.
    """
    late_x = late_estimates(trials)
    errors: Sample = abs(late_x - trials.experiment.fill_ratio).mean(axis=(1, 2))  # over steps and robots
    return errors


def late_estimates(trials: Trials) -> NDArray[np.float64]:
    """Return x, the recorded estimates, in the last quarter of each trial; shape (trials, steps, robots)."""
    x = trials.records["x"]
    quarter_length = max(1, x.shape[1] // 4)  # a short trial has few values, but at least one counts
    late_x: NDArray[np.float64] = x[:, -quarter_length:, :]
    return late_x


def harmed_percents(trials: Trials) -> Sample:
    """Return for each trial the percentage of the healthy robots that the filter has harmed, shape (trials,).

    A robot is harmed if its b_hat ends far from where it began. The percentages are NaN if all robots are
    flawed.
    """
    is_harmed = trials.find_harmed_robots()  # shape (trials, healthy robots), empty if none is healthy
    if not is_harmed.size:
        return np.full(len(trials.numbers), np.nan)
    return np.asarray(100 * is_harmed.mean(axis=1))


def mean_over_experiments(
    measure: Measure,
    experiments: Sequence[Trials],
    resample: Callable[[Sample], Resampled] = resample_median,
) -> Interval:
    """Return the median of a measure over the trials of each experiment, averaged over the experiments.

    The result has its interval of CONFIDENCE. ``resample`` computes another statistic than the median. All
    experiments are resampled by the same trials, which had the same floors and random numbers.
    """
    statistics = [resample(measure(trials)) for trials in experiments]
    return mean_of_resampled(statistics).interval(CONFIDENCE)


def mean_harmed_percent(experiments: Sequence[Trials]) -> Interval | None:
    """Return the mean percentage of healthy robots that a filter harmed, or None if all are flawed.

    It is the mean over trials and experiments: so few robots are harmed that most medians would be 0.
    """
    harmed_percent = mean_over_experiments(harmed_percents, experiments, resample_mean)
    has_healthy_robots = not np.isnan(harmed_percent.value)
    return harmed_percent if has_healthy_robots else None


# --- Text ------------------------------------------------------------------------------------------------


def format_error(value: float) -> str:
    """Format an error with four decimals if it is below 0.01, otherwise with three."""
    return f"{value:.4f}" if value < 0.01 else f"{value:.3f}"


def format_tenths(value: float) -> str:
    """Format a score or a percentage with one decimal."""
    return f"{value:.1f}"


def format_interval(interval: Interval, format_value: Callable[[float], str], tolerance: float) -> str:
    """Format a number and, if an end of its interval is farther than ``tolerance`` from it, the interval.

    "95.1" and "95.1 (93.0..96.2)" are examples. An interval whose ends have the same text is left out, too.
    """
    value_text = format_value(interval.value)
    low_text = format_value(interval.low)
    high_text = format_value(interval.high)
    # A narrow interval would only make the table harder to read.
    reach = max(interval.high - interval.value, interval.value - interval.low)
    if reach <= tolerance or low_text == high_text:
        return value_text
    return f"{value_text} ({low_text}..{high_text})"


def plain_error_text(experiments: Sequence[Trials], measure: Measure = late_errors) -> str:
    """Format an error of experiments that share a cell of a table, without an interval, such as "0.012"."""
    return format_error(mean_over_experiments(measure, experiments).value)


def late_error_text(experiments: Sequence[Trials]) -> str:
    """Format the late error of experiments that share a cell of a table, such as "0.012 (0.010..0.015)"."""
    interval = mean_over_experiments(late_errors, experiments)
    return format_interval(interval, format_error, tolerance=interval.value / 10)


def score_text(experiments: Sequence[Trials]) -> str:
    """Format H, the score from 0 to 100, of experiments that share a cell of a table, such as "95.1"."""
    interval = mean_over_experiments(h_scores, experiments)
    return format_interval(interval, format_tenths, tolerance=0.5)


def h_scores(trials: Trials) -> Sample:
    """Return H of each trial, the paper's score from 0 to 100 for accuracy and speed together."""
    return trials.scores()["H"]


def under_and_over_text(experiments: Sequence[Trials]) -> str:
    """Format two late errors of experiments that share a cell of a table, such as "0.012, 0.034".

    The first is the error of the underconfident swarms, the second the error of the overconfident swarms. An
    error is left out if there are no such swarms.
    """
    texts: list[str] = []
    # b alone tells the two kinds apart: it is high only where robots are underconfident.
    for flaw_parameters in BOTH_FLAWS:
        b = flaw_parameters["true_accuracy"]
        swarms_with_flaw = [trials for trials in experiments if trials.experiment.true_accuracy == b]
        if swarms_with_flaw:
            texts.append(late_error_text(swarms_with_flaw))
    return ", ".join(texts)


# --- Pictures --------------------------------------------------------------------------------------------


def plot_errors_of_swarms(rows: Rows, swarms: Sequence[str]) -> Figure:
    """Draw |x - f|, the error of the estimates, over time: a line for each filter or peer.

    The panels of a row have the same kind of flaws of PARAMETERS_BY_FLAW, the underconfident ones first. Its
    columns are the ``swarms``: the labels of rows are these, with the kind of flaws after a comma.
    """
    labels = [f"{swarm}, {flaw}" for flaw in PARAMETERS_BY_FLAW for swarm in swarms]
    panels = {label: rows[label] for label in labels}
    return plot_errors_over_time(panels, series_name=column_label)


# --- Tables ----------------------------------------------------------------------------------------------


def markdown_table(head: str, rows: Rows, text_of: Callable[[Sequence[Trials]], str]) -> str:
    """Return a table in Markdown with a row for each label, and a column for each filter or peer.

    ``text_of`` formats the experiments that share a cell, which differ only in f, b or b_hat; a cell without
    experiments is empty. The columns are in the order in which they first come in the rows. ``head`` is the
    text of the upper left corner, which says what the numbers are.
    """
    cells: dict[tuple[str, str], list[Trials]] = {}
    columns: list[str] = []
    for row, experiments in rows.items():
        for trials in experiments:
            column = column_label(trials.experiment)
            if column not in columns:
                columns.append(column)
            cells.setdefault((row, column), []).append(trials)
    lines = [f"| {head} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row in rows:
        texts: list[str] = []
        for column in columns:
            is_empty = (row, column) not in cells
            texts.append("" if is_empty else text_of(cells[row, column]))
        lines.append(f"| {row} | {' | '.join(texts)} |")
    return "\n".join(lines)


def write_tables(path: Path, title: str, tables: Mapping[str, str], note: str = INTERVAL_NOTE) -> None:
    """Write tables into a Markdown file, each between its mark and ``<!-- end -->``, as docs/ has them.

    ``note`` says above the tables what their numbers are.
    """
    marked_tables = [f"<!-- {mark} -->\n{table}\n<!-- end -->" for mark, table in tables.items()]
    paragraphs = [f"# {title}", note, *marked_tables]
    write_atomically(path, "\n\n".join(paragraphs) + "\n")
