"""What this project's own studies share: their options, measures of errors, and tables with intervals.

Each study is a program: it runs experiments, or resumes them, and writes tables and a picture into a folder.
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
"""A healthy robot whose b_hat ends farther from b has been harmed by its filter."""

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
    """Run experiments, and keep their results with x every ``record`` steps in ``FOLDER/name.parquet``.

    The same call resumes what was interrupted. Robots and sensors of this package run in this process alone.
    """
    if arguments.quick:
        experiments = [
            replace(experiment, trials=QUICK_TRIALS, steps=min(experiment.steps, QUICK_STEPS))
            for experiment in experiments
        ]
    make_folder(arguments.folder)
    output = arguments.folder / f"{name}.parquet"
    # Worker processes know only firmwares and sensors that are installed under a name.
    is_installed = all("." not in experiment.firmware + experiment.sensor for experiment in experiments)
    workers = arguments.workers if is_installed else 1
    return m.experiments_in(m.simulate(experiments, output, workers=workers, record=record))


# --- Measures --------------------------------------------------------------------------------------------


def late_errors(trials: Trials, honest: int | None = None, fill_ratio: float | None = None) -> Sample:
    """Return the mean |x - f| over the last quarter of each trial.

    Only the first ``honest`` robots are counted, all by default; ``fill_ratio`` is f in the last quarter
    where it is not the experiment's.
    """
    x = trials.records["x"][:, :, :honest]
    quarter = max(1, x.shape[1] // 4)  # a short trial has few values, but at least one counts
    true_fill_ratio = trials.experiment.fill_ratio if fill_ratio is None else fill_ratio
    errors: Sample = abs(x[:, -quarter:] - true_fill_ratio).mean(axis=(1, 2))
    return errors


def harmed_shares(trials: Trials) -> Sample:
    """Return the share of the healthy robots whose b_hat ends wrong, of each trial; NaN if all are flawed."""
    experiment = trials.experiment
    # Flawed robots come first; where all are flawed there is no mean over the others.
    if experiment.flawed == experiment.robots:
        return np.full(len(trials.numbers), np.nan)
    final_b_hat = trials.b_hat[:, -1, experiment.flawed :]
    is_harmed = abs(final_b_hat - experiment.true_accuracy) > HARM_LIMIT
    return np.asarray(is_harmed.mean(axis=1))


def mean_of_medians(measure: Measure, experiments: Sequence[Trials]) -> Interval:
    """Return the mean over experiments of the medians over their trials, with its interval."""
    # All experiments are resampled by the same trials, which saw the same worlds.
    medians = [resample_median(measure(trials)) for trials in experiments]
    return mean_of_resampled(medians).interval(CONFIDENCE)


def mean_of_means(measure: Measure, experiments: Sequence[Trials]) -> Interval:
    """Return the same with means over the trials: for what is so rare that medians would be 0."""
    means = [resample_mean(measure(trials)) for trials in experiments]
    return mean_of_resampled(means).interval(CONFIDENCE)


# --- Text ------------------------------------------------------------------------------------------------


def format_error(value: float) -> str:
    """Format an error with two or three significant digits."""
    return f"{value:.4f}" if value < 0.01 else f"{value:.3f}"


def format_tenths(value: float) -> str:
    """Format a score or a percentage with one decimal."""
    return f"{value:.1f}"


def format_interval(interval: Interval, format_value: Callable[[float], str], tolerance: float) -> str:
    """Format a number; its interval follows in brackets where that reaches farther than ``tolerance``."""
    value, low, high = (format_value(number) for number in interval)
    # Where the interval is narrow it would only make the table harder to read.
    reach = max(interval.high - interval.value, interval.value - interval.low)
    return value if reach <= tolerance or low == high else f"{value} ({low}..{high})"


def late_error_text(experiments: Sequence[Trials], measure: Measure = late_errors) -> str:
    """Format the error of the last quarter of experiments that stand in one cell of a table."""
    interval = mean_of_medians(measure, experiments)
    return format_interval(interval, format_error, interval.value / 10)


def score_text(experiments: Sequence[Trials]) -> str:
    """Format H of experiments that stand in one cell of a table."""
    return format_interval(
        mean_of_medians(lambda trials: trials.scores()["H"], experiments), format_tenths, 0.5
    )


def under_and_over_text(experiments: Sequence[Trials], measure: Measure = late_errors) -> str:
    """Format the error of the last quarter of underconfident robots, then of overconfident ones, if any."""
    underconfident = [trials for trials in experiments if not is_overconfident(trials.experiment)]
    overconfident = [trials for trials in experiments if is_overconfident(trials.experiment)]
    return ", ".join(late_error_text(group, measure) for group in (underconfident, overconfident) if group)


def is_overconfident(experiment: Experiment) -> bool:
    """Return whether an experiment is of those with poor sensors, which flawed robots overestimate."""
    return experiment.true_accuracy < 0.6


def topology_label(experiment: Experiment) -> str:
    """Return whether robots move, in the words of the tables."""
    return "moving" if experiment.is_dynamic else "fully connected"


def flawed_label(experiment: Experiment) -> str:
    """Return the percentage of robots that are flawed, in the words of the tables."""
    return f"{round(100 * experiment.flawed / experiment.robots)} % flawed"


def markdown_table(
    head: str,
    experiments: Sequence[Trials],
    row_of: Callable[[Experiment], str],
    column_of: Callable[[Experiment], str],
    text_of: Callable[[Sequence[Trials]], str],
) -> str:
    """Return a table in Markdown; ``text_of`` formats all experiments that belong to one row and column.

    Rows and columns are in the order of the experiments; ``head`` says what the numbers are.
    """
    # Experiments that differ only in f, b or b_hat often share a cell.
    cells: dict[tuple[str, str], list[Trials]] = {}
    for trials in experiments:
        place = (row_of(trials.experiment), column_of(trials.experiment))
        cells.setdefault(place, []).append(trials)
    rows = list(dict.fromkeys(row for row, _ in cells))
    columns = list(dict.fromkeys(column for _, column in cells))
    lines = [f"| {head} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row in rows:
        texts = [text_of(cells[row, column]) if (row, column) in cells else "" for column in columns]
        lines.append(f"| {row} | {' | '.join(texts)} |")
    return "\n".join(lines)


def write_tables(path: Path, title: str, tables: Mapping[str, str]) -> None:
    """Write tables into a Markdown file, each between its mark and ``<!-- end -->``, as docs/ has them."""
    marked = [f"<!-- {mark} -->\n{table}\n<!-- end -->" for mark, table in tables.items()]
    write_atomically(path, "\n\n".join([f"# {title}", INTERVAL_NOTE, *marked]) + "\n")
