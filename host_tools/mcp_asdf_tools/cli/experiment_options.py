"""Options, progress and output shared by the commands that run experiments."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.cli.parameter_options import add_common_parameters, add_further_parameters, settings_from
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import read_experiments
from mcp_asdf_tools.experiments.results import Trials, describe_differences, select_experiments
from mcp_asdf_tools.experiments.scores import E_MAX, Limits
from mcp_asdf_tools.experiments.sweep import default_workers


def add_run(parser: argparse.ArgumentParser, output_help: str) -> None:
    """Add the options of a command that runs experiments: parameters, output, limits of scores and workers.

    The parsed value of a parameter that the user leaves out is None. ``output_help`` is the help of
    ``--output``.
    """
    parser.add_argument("--output", metavar="FILE", type=Path, help=output_help)
    parser.add_argument(
        "--record",
        metavar="STEPS",
        type=int,
        default=0,
        help="also keep every robot's values, every STEPS steps (default: only the scores)",
    )
    add_workers(parser)
    add_common_parameters(parser, Experiment, "experiment (values replace those of FILE)")
    add_limits(parser)
    add_further_parameters(parser, Experiment)


def experiments_of(args: argparse.Namespace) -> list[Experiment]:
    """Return the experiments of FILE, or the default one without a file, with the options' parameters.

    Raises UsageError for a value out of range, and if ``--record`` is longer than a trial.
    """
    if args.file is None:
        base_values: list[dict[str, Any]] = [{}]
    else:
        base_values = [experiment.parameters() for experiment in read_experiments(args.file)]
    experiments = [settings_from(args, Experiment, values) for values in base_values]
    shortest_trial = min(experiment.steps for experiment in experiments)
    if not 0 <= args.record <= shortest_trial:
        raise UsageError(f"--record is {args.record}; choose 1 to {shortest_trial} steps, or 0 for none")
    return experiments


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--workers``, the number of processes that run trials."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=default_workers(),
        help="processes (default %(default)s: one per processor)",
    )


def check_workers(workers: int) -> int:
    """Return ``workers``. Raises UsageError if it is no possible number of processes."""
    if not 1 <= workers <= 1024:
        raise UsageError(f"--workers is {workers}; choose 1 to 1024")
    return workers


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options for K_max and e_max, the convergence time K and the error e that score 0."""
    group = parser.add_argument_group("scores")
    group.add_argument(
        "--k-max", type=float, metavar="STEPS", help="K that scores 0 (default: the length of a trial)"
    )
    group.add_argument("--e-max", type=float, metavar="ERROR", help=f"e that scores 0 (default: {E_MAX})")


def limits_of(args: argparse.Namespace) -> Limits:
    """Return the limits that the user typed, or else the paper's. Raises UsageError for one of 0 or less."""
    return Limits(args.k_max, E_MAX if args.e_max is None else args.e_max)


def limits_given(args: argparse.Namespace) -> list[str]:
    """Return the options for K_max and e_max that the user has typed, such as ``["--e-max"]``."""
    values = {"--k-max": args.k_max, "--e-max": args.e_max}
    return [option for option, value in values.items() if value is not None]


def add_where(parser: argparse._ActionsContainer) -> None:
    """Add the option ``--where``, whose conditions ``chosen`` applies."""
    parser.add_argument(
        "--where",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="only experiments with this parameter, such as filter=none; repeatable",
    )


def chosen(args: argparse.Namespace) -> list[Trials]:
    """Read the results file ``args.file``, and return the experiments that meet all ``--where`` conditions.

    Raises UsageError, with the existing values, for a condition on no parameter and one that nothing meets.
    """
    from mcp_asdf_tools.experiments.result_files import read_table  # noqa: PLC0415 (pyarrow loads slowly)
    from mcp_asdf_tools.experiments.result_tables import experiments_in  # noqa: PLC0415

    experiments = experiments_in(read_table(args.file))
    for condition in args.where:
        name, equals_sign, value = condition.partition("=")
        if not equals_sign:
            differences = describe_differences(experiments)
            raise UsageError(
                f"--where {condition}: write NAME=VALUE; the experiments differ in {differences}"
            )
        experiments = select_experiments(experiments, {name: value})
    return experiments


def summary(experiments: Iterable[Trials], limits: Limits) -> list[dict[str, Any]]:
    """Return for each experiment a row of plain values: its parameters, and its measures' quartiles.

    A measure, such as the score H, has an entry of its own: ``{"q25": ..., "median": ..., "q75": ...}``.
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
    import numpy as np  # noqa: PLC0415

    quartiles = {}
    for name, values in trials.measures(limits).items():
        q25, median, q75 = np.percentile(values, [25, 50, 75]).tolist()
        quartiles[name] = {"q25": q25, "median": median, "q75": q75}
    return quartiles


_MEDIAN_FORMATS = {"h_K": ".2f", "h_e": ".2f", "K": "g", "e": ".5f", "updates": "g"}
"""Measures of which a table has the median, with its format."""


def show(rows: Sequence[dict[str, Any]], title: str) -> None:
    """Print a summary: a row for each experiment, a column for each parameter in which they differ."""
    varying_parameters = [
        name for name in rows[0]["parameters"] if len({row["parameters"][name] for row in rows}) > 1
    ]
    table = Table(title=title, title_justify="left", caption=_caption(rows), caption_justify="left")
    for name in (*varying_parameters, "trials", "H", *_MEDIAN_FORMATS):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        trial_count, planned_count = row["trials"], row["parameters"]["trials"]
        score = row["H"]
        table.add_row(
            *(str(row["parameters"][name]) for name in varying_parameters),
            f"{trial_count}" if trial_count >= planned_count else f"{trial_count} of {planned_count}",
            f"{score['median']:.2f} [{score['q25']:.2f}, {score['q75']:.2f}]",
            *(format(row[name]["median"], style) for name, style in _MEDIAN_FORMATS.items()),
        )
    # Lines longer than a terminal wrap; columns that shrink to fit would lose figures.
    width = Console(width=10_000).measure(table).maximum
    Console(width=width).print(table)


def _caption(rows: Sequence[dict[str, Any]]) -> str:
    """Return what a summary's table has below it: the filters, and the limits of the scores."""
    filters = sorted({row["filter"] for row in rows})
    k_maxima = sorted({row["limits"]["k_max"] for row in rows})
    e_max = min(row["limits"]["e_max"] for row in rows)
    # Without --k-max each experiment's limit is the length of its own trials.
    k_max = f"{k_maxima[0]:g}" if len(k_maxima) == 1 else "the length of a trial"
    limits = f"K_max {k_max}, e_max {e_max:.6g}; medians over the trials, H with quartiles"
    return "\n".join([*filters, limits])


def checked_output(path: Path) -> Path:
    """Return ``path``. Raises UsageError if its name does not end in .parquet."""
    if path.suffix != ".parquet":
        raise UsageError(f"cannot write results to {path}: choose a name that ends in .parquet")
    return path
