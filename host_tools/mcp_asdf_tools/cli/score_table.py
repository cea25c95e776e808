"""Scores of experiments, summed up over the trials: as plain values for JSON, and as a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.cli.output import json_report
from mcp_asdf_tools.experiments.result_files import read_table, stream_experiments
from mcp_asdf_tools.experiments.result_tables import read_metadata
from mcp_asdf_tools.experiments.results import Trials, find_differences
from mcp_asdf_tools.experiments.scores import Limits

_FORMAT_OF_MEASURE = {"h_K": ".2f", "h_e": ".2f", "K": "g", "e": ".5f", "updates": "g"}
"""Measures of which a table has the median alone, with the format of that number."""

_WIDER_THAN_ANY_TABLE = 10_000
"""Characters."""


def report_scores(path: Path, limits: Limits, as_json: bool, **details: object) -> None:
    """Print the scores of the experiments in a file of results, as a table or as JSON.

    The JSON has the metadata of the results and the ``details``, too. Raises UsageError if the file cannot be
    read.
    """
    rows = summarize(stream_experiments(path), limits)
    if as_json:
        # The metadata come with any column, so that a single small one is read.
        metadata = read_metadata(read_table(path, ["trial"]))
        print(json_report({**metadata, **details, "experiments": rows}))
    else:
        print_scores(rows, str(path))


def summarize(experiments: Iterable[Trials], limits: Limits) -> list[dict[str, Any]]:
    """Return a row of plain values for each experiment, for JSON and for ``print_scores``.

    A row has the keys ``parameters``, ``filter`` (a description), ``trials`` (their number) and ``limits``
    (of the scores), and the name of each measure, such as the score H, with its quartiles over the trials:
    ``{"q25": ..., "median": ..., "q75": ...}``.
    """
    rows = []
    for trials in experiments:
        experiment = trials.experiment
        k_max, e_max = limits.of(experiment)
        row: dict[str, Any] = {
            "parameters": experiment.parameters(),
            "filter": experiment.filter_description,
            "trials": len(trials.numbers),
            "limits": {"k_max": k_max, "e_max": e_max},
        }
        rows.append(row | _quartiles(trials, limits))
    return rows


def _quartiles(trials: Trials, limits: Limits) -> dict[str, dict[str, float]]:
    """Return the quartiles of each measure over the trials, by the measure's name."""
    quartiles = {}
    for measure_name, values in trials.measures(limits).items():
        q25, median, q75 = np.percentile(values, [25, 50, 75]).tolist()
        quartiles[measure_name] = {"q25": q25, "median": median, "q75": q75}
    return quartiles


def print_scores(rows: Sequence[dict[str, Any]], title: str) -> None:
    """Print the rows of ``summarize`` as a table, with a row for each experiment.

    The columns are the parameters in which the experiments differ, the number of trials, the score H with its
    quartiles over the trials, and the medians of h_K, h_e, K, e and the number of updates.
    """
    # What all experiments have in common would only make the table wide.
    varying_parameters = find_differences(row["parameters"] for row in rows)
    table = Table(title=title, title_justify="left", caption=_caption(rows), caption_justify="left")
    # _FORMAT_OF_MEASURE has the other measures by name, each with the format of its medians.
    for name in (*varying_parameters, "trials", "H", *_FORMAT_OF_MEASURE):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        parameter_texts = [str(row["parameters"][name]) for name in varying_parameters]
        medians = [
            format(row[name]["median"], number_format) for name, number_format in _FORMAT_OF_MEASURE.items()
        ]
        table.add_row(*parameter_texts, _describe_trial_count(row), _describe_score(row["H"]), *medians)
    # As wide as the table is: lines longer than a terminal wrap, but columns that shrink would lose figures.
    width = Console(width=_WIDER_THAN_ANY_TABLE).measure(table).maximum
    Console(width=width).print(table)


def _describe_trial_count(row: dict[str, Any]) -> str:
    """Return the number of an experiment's trials, such as "100", or "40 of 100" if some have not run yet."""
    trial_count = row["trials"]
    planned_count = row["parameters"]["trials"]
    return f"{trial_count}" if trial_count >= planned_count else f"{trial_count} of {planned_count}"


def _describe_score(quartiles: dict[str, float]) -> str:
    """Format the median of a score, followed by its other two quartiles in brackets."""
    return f"{quartiles['median']:.2f} [{quartiles['q25']:.2f}, {quartiles['q75']:.2f}]"


def _caption(rows: Sequence[dict[str, Any]]) -> str:
    """Return the text below the table of a summary, which names the filters and the limits of the scores."""
    filter_lines = sorted({row["filter"] for row in rows})
    # Without --k-max each experiment's limit is the length of its own trials.
    k_maxima = {row["limits"]["k_max"] for row in rows}
    k_max_text = "the length of a trial"
    if len(k_maxima) == 1:
        k_max_text = f"{k_maxima.pop():g}"
    e_max = rows[0]["limits"]["e_max"]  # the same for all experiments
    limit_text = f"K_max {k_max_text}, e_max {e_max:.6g}; medians over the trials, H with quartiles"
    return "\n".join([*filter_lines, limit_text])
