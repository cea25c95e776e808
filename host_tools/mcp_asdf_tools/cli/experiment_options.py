"""Options, progress and output shared by the commands that run experiments."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from mcp_asdf_tools.cli import parameter_options
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import E_MAX, LimitsOf, chosen_limits
from mcp_asdf_tools.experiments.sweep import default_workers


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """An option for every parameter of an experiment; those not given are None."""
    parameter_options.add_parameters(parser, Experiment, "experiment (values replace those of FILE)")


def experiment_of(args: argparse.Namespace) -> Experiment:
    """The experiment with the parameters that were given. Raises UsageError for a value out of range."""
    return parameter_options.settings_from(args, Experiment)


def with_parameters(experiment: Experiment, args: argparse.Namespace) -> Experiment:
    """``experiment`` with the parameters that were given. Raises UsageError for a value out of range."""
    return parameter_options.settings_from(args, Experiment, experiment.parameters())


def add_record(group: argparse._ActionsContainer) -> None:
    """The option for values over time."""
    group.add_argument(
        "--record",
        metavar="STEPS",
        type=int,
        default=0,
        help="also keep every robot's values, every STEPS steps (default: only the scores)",
    )


def sampling_interval(args: argparse.Namespace, experiments: Sequence[Experiment]) -> int:
    """The steps of ``--record``. Raises UsageError if trials are shorter."""
    interval: int = args.record
    most = min(experiment.steps for experiment in experiments)
    if not 0 <= interval <= most:
        raise UsageError(f"--record is {interval}; choose 1 to {most} steps, or 0 for none")
    return interval


def add_workers(parser: argparse.ArgumentParser) -> None:
    """The option for parallel work."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=default_workers(),
        help="processes (default %(default)s: one per processor)",
    )


def check_workers(workers: int) -> int:
    """Return ``workers``. Raises UsageError if there are none."""
    if not 1 <= workers <= 1024:
        raise UsageError(f"--workers is {workers}; choose 1 to 1024")
    return workers


def add_limits(parser: argparse.ArgumentParser) -> None:
    """The options for K_max and e_max."""
    group = parser.add_argument_group("scores")
    group.add_argument(
        "--k-max", type=float, metavar="STEPS", help="K that scores 0 (default: the length of a trial)"
    )
    group.add_argument("--e-max", type=float, metavar="ERROR", help=f"e that scores 0 (default: {E_MAX})")


def limits_of(args: argparse.Namespace) -> LimitsOf:
    """The limits given, or else the paper's. Raises UsageError for limits of 0 or less."""
    return chosen_limits(args.k_max, args.e_max)


def summary(experiments: Sequence[Trials], limits: LimitsOf) -> list[dict[str, Any]]:
    """For each experiment its parameters, and medians and quartiles over the trials, as plain values."""
    return [
        {
            "parameters": trials.experiment.parameters(),
            "trials": len(trials.numbers),
            "limits": limits(trials.experiment)._asdict(),
            **_figures(trials, limits),
        }
        for trials in experiments
    ]


def _figures(trials: Trials, limits: LimitsOf) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    scores = trials.scores(limits)
    values = {
        "H": scores.h,
        "h_K": scores.h_k,
        "h_e": scores.h_e,
        "K": trials.convergence_steps.mean(axis=1),
        "e": trials.errors.mean(axis=1),
        "updates": trials.updates.sum(axis=1),
    }
    quartiles = {name: np.percentile(value, [25, 50, 75]).tolist() for name, value in values.items()}
    return {
        name: dict(zip(("q25", "median", "q75"), three, strict=True)) for name, three in quartiles.items()
    }


def show(experiments: Sequence[Trials], limits: LimitsOf, title: str) -> None:
    """Print a table with a row for each experiment and a column for each parameter in which they differ."""
    rows = summary(experiments, limits)
    varying = [name for name in rows[0]["parameters"] if len({row["parameters"][name] for row in rows}) > 1]
    table = Table(title=title, title_justify="left", caption_justify="left")
    chosen = {limits(trials.experiment) for trials in experiments}
    k_max = f"{min(chosen).k_max:g}" if len(chosen) == 1 else "the length of a trial"
    e_max = f"{min(chosen).e_max:.6g}"
    table.caption = f"K_max {k_max}, e_max {e_max}; medians over the trials, H with quartiles"
    for name in (*varying, "trials", "H", "h_K", "h_e", "K", "e", "updates"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*(f"{row['parameters'][name]}" for name in varying), _trials(row), *_cells(row))
    # Lines longer than a terminal wrap; columns that shrink to fit would lose figures.
    width = Console(width=10_000).measure(table).maximum
    Console(width=width).print(table)


def _trials(row: dict[str, Any]) -> str:
    """How many trials there are, and how many there should be if some are missing."""
    found, wanted = row["trials"], row["parameters"]["trials"]
    return f"{found}" if found >= wanted else f"{found} of {wanted}"


def _cells(row: dict[str, Any]) -> Iterator[str]:
    yield f"{row['H']['median']:.2f} [{row['H']['q25']:.2f}, {row['H']['q75']:.2f}]"
    for name, layout in (("h_K", ".2f"), ("h_e", ".2f"), ("K", "g"), ("e", ".5f"), ("updates", "g")):
        yield format(row[name]["median"], layout)


def checked_output(path: Path) -> Path:
    """Return ``path``. Raises UsageError if it does not end as results do."""
    if path.suffix != ".parquet":
        raise UsageError(f"cannot write results to {path}: choose a name that ends in .parquet")
    return path
