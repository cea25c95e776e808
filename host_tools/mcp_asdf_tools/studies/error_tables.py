"""What this project's own studies share: their options, measures of errors, and tables with intervals.

Each study is a program: it runs experiments, or resumes them, and writes tables and a picture into a folder.
In a trial each robot estimates f, the share of black floor, as x; b_hat is the accuracy that it assumes for
its sensor, b the true one. A flawed robot starts with a wrong b_hat, a healthy one with the right one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import mcp_asdf_tools as m
from mcp_asdf_tools.common.files import make_folder, write_atomically
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.bootstrap import (
    Interval,
    Sample,
    mean_of_resampled,
    resample_mean,
    resample_median,
)

CONFIDENCE = 0.95
QUICK_TRIALS, QUICK_STEPS = 2, 4000

HARM_LIMIT = 0.05
"""A healthy robot whose b_hat ends farther from b than this has been harmed by its filter."""

INTERVAL_NOTE = (
    "Medians over trials. A 95 % interval stands in brackets where it reaches farther than 0.5 from H, a "
    "tenth from an error, or 1 % from a share of robots."
)

Measure = Callable[[Trials], Sample]
"""Gives a value for each trial of an experiment."""


# --- Running ---------------------------------------------------------------------------------------------


def parse_arguments(description: str | None) -> argparse.Namespace:
    """Parse the options of a study's program."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="for results, tables and picture")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    quick = f"{QUICK_TRIALS} trials of at most {QUICK_STEPS} steps, to see that it works"
    parser.add_argument("--quick", action="store_true", help=quick)
    return parser.parse_args()


def run_experiments(
    name: str, experiments: Sequence[Experiment], arguments: argparse.Namespace, record: int = 1000
) -> list[Trials]:
    """Run experiments, return their trials, and write these into the file ``FOLDER/name.parquet``.

    FOLDER, the number of processes and whether to run a short form are options in ``arguments``. The trials
    have x, every robot's estimate, at every ``record``-th step. If the file has some of the results from an
    earlier call that was interrupted, only the others are run.
    """
    if arguments.quick:
        experiments = [
            replace(experiment, trials=QUICK_TRIALS, steps=min(experiment.steps, QUICK_STEPS))
            for experiment in experiments
        ]
    make_folder(arguments.folder)
    output = arguments.folder / f"{name}.parquet"
    # Classes of this package have a dot in their names, and other processes cannot load them.
    workers: int = arguments.workers
    if any("." in experiment.firmware + experiment.sensor for experiment in experiments):
        workers = 1
    return m.experiments_in(m.simulate(experiments, output, workers=workers, record=record))


# --- Measures --------------------------------------------------------------------------------------------


def late_errors(
    trials: Trials, honest_robots: int | None = None, late_fill_ratio: float | None = None
) -> Sample:
    """Return the late error of each trial: the mean of |x - f| over its last quarter and over its robots.

    x is a robot's recorded estimate, f the share of black floor. ``honest_robots`` limits the mean to the
    first robots; None stands for all. ``late_fill_ratio`` is f in the last quarter; None stands for the
    experiment's.
    """
    if late_fill_ratio is None:
        late_fill_ratio = trials.experiment.fill_ratio
    x = trials.records["x"]  # shape (trials, recorded steps, robots)
    quarter_length = max(1, x.shape[1] // 4)  # a short trial has few values, but at least one counts
    late_x = x[:, -quarter_length:, :honest_robots]
    errors: Sample = abs(late_x - late_fill_ratio).mean(axis=(1, 2))
    return errors


def harmed_shares(trials: Trials) -> Sample:
    """Return for each trial the share, 0 to 1, of the healthy robots that the filter has harmed.

    These end with a b_hat, the accuracy that they assume, farther than HARM_LIMIT from b, the true one. The
    shares are NaN if all robots are flawed.
    """
    experiment = trials.experiment
    if experiment.flawed == experiment.robots:
        return np.full(len(trials.numbers), np.nan)
    # b_hat has the shape (trials, filter steps, robots), and the flawed robots come first.
    final_b_hat = trials.b_hat[:, -1, experiment.flawed :]
    is_harmed = abs(final_b_hat - experiment.true_accuracy) > HARM_LIMIT
    return np.asarray(is_harmed.mean(axis=1))


def mean_of_medians(measure: Measure, experiments: Sequence[Trials]) -> Interval:
    """Return the median of a measure over the trials of each experiment, averaged over the experiments.

    The result has its interval of CONFIDENCE.
    """
    # All experiments are resampled by the same trials, which had the same floors and random numbers.
    medians = [resample_median(measure(trials)) for trials in experiments]
    return mean_of_resampled(medians).interval(CONFIDENCE)


def mean_of_means(measure: Measure, experiments: Sequence[Trials]) -> Interval:
    """Return the mean of a measure over the trials of each experiment, averaged over the experiments.

    The result has its interval of CONFIDENCE. It serves for what is so rare that its median would be 0.
    """
    means = [resample_mean(measure(trials)) for trials in experiments]
    return mean_of_resampled(means).interval(CONFIDENCE)


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


def late_error_text(experiments: Sequence[Trials], measure: Measure = late_errors) -> str:
    """Format the late error of experiments that share a cell of a table, such as "0.012 (0.010..0.015)".

    It is the mean of |x - f| over the last quarter of a trial, unless ``measure`` computes another one.
    """
    interval = mean_of_medians(measure, experiments)
    return format_interval(interval, format_error, tolerance=interval.value / 10)


def score_text(experiments: Sequence[Trials]) -> str:
    """Format H, the score from 0 to 100, of experiments that share a cell of a table, such as "95.1"."""
    interval = mean_of_medians(h_scores, experiments)
    return format_interval(interval, format_tenths, tolerance=0.5)


def h_scores(trials: Trials) -> Sample:
    """Return H of each trial, the paper's score from 0 to 100 for accuracy and speed together."""
    return trials.scores()["H"]


def under_and_over_text(experiments: Sequence[Trials], measure: Measure = late_errors) -> str:
    """Format two late errors of experiments that share a cell of a table, such as "0.012, 0.034".

    The first is that of the underconfident swarms, the second that of the overconfident ones; one is left out
    if there are no such swarms. ``measure`` computes the late error of each trial.
    """
    underconfident = [trials for trials in experiments if not is_overconfident(trials.experiment)]
    overconfident = [trials for trials in experiments if is_overconfident(trials.experiment)]
    return ", ".join(late_error_text(group, measure) for group in (underconfident, overconfident) if group)


def is_overconfident(experiment: Experiment) -> bool:
    """Return whether the sensors are poor (b below 0.6), so that flawed robots can only overestimate them."""
    return experiment.true_accuracy < 0.6


def topology_label(experiment: Experiment) -> str:
    """Return "moving" or "fully connected", the label of an experiment's topology in tables."""
    return "moving" if experiment.is_dynamic else "fully connected"


def flawed_label(experiment: Experiment) -> str:
    """Return the percentage of flawed robots for the tables, such as "30 % flawed"."""
    return f"{round(100 * experiment.flawed / experiment.robots)} % flawed"


def markdown_table(
    head: str,
    experiments: Sequence[Trials],
    row_of: Callable[[Experiment], str],
    column_of: Callable[[Experiment], str],
    text_of: Callable[[Sequence[Trials]], str],
) -> str:
    """Return a table in Markdown with a cell for all experiments that have the same row and column label.

    ``row_of`` and ``column_of`` return an experiment's labels, and ``text_of`` formats the experiments of a
    cell; a cell without experiments is empty. Rows and columns are in the order of the experiments. ``head``
    is the text of the upper left corner, which says what the numbers are.
    """
    # Experiments that differ only in f, b or b_hat often share a cell.
    cells: dict[tuple[str, str], list[Trials]] = {}
    for trials in experiments:
        row_and_column = (row_of(trials.experiment), column_of(trials.experiment))
        cells.setdefault(row_and_column, []).append(trials)
    rows = list(dict.fromkeys(row for row, _ in cells))
    columns = list(dict.fromkeys(column for _, column in cells))
    lines = [f"| {head} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row in rows:
        texts = [text_of(cells[row, column]) if (row, column) in cells else "" for column in columns]
        lines.append(f"| {row} | {' | '.join(texts)} |")
    return "\n".join(lines)


def write_tables(path: Path, title: str, tables: Mapping[str, str]) -> None:
    """Write tables into a Markdown file, each between its mark and ``<!-- end -->``, as docs/ has them."""
    marked_tables = [f"<!-- {mark} -->\n{table}\n<!-- end -->" for mark, table in tables.items()]
    paragraphs = [f"# {title}", INTERVAL_NOTE, *marked_tables]
    write_atomically(path, "\n\n".join(paragraphs) + "\n")
