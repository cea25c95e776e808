"""Options, progress and output shared by the commands that run experiments."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment, ExperimentError
from mcp_asdf_tools.experiments.experiment_files import flawed_count
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import Limits, found_limits, score
from mcp_asdf_tools.experiments.sweep import Report, default_workers
from mcp_asdf_tools.robots.firmwares import FIRMWARES
from mcp_asdf_tools.tables.thresholds import parse_omega

_HELP = {
    "topology": "topology",
    "robots": "N",
    "flawed": "how many robots have a flawed assumed accuracy",
    "fill_ratio": "f, the share of black tiles",
    "true_accuracy": "b of every sensor, which robots that are not flawed assume",
    "flawed_accuracy": "b_hat of flawed robots at the start",
    "mode": "which robots recalibrate",
    "activation": "when they do: if the test rejects, or without a test",
    "filter_period": "nominal filtering period tau, steps",
    "comms_period": "steps between broadcasts",
    "omega": "type II error probability of the test",
    "memory": "forgetting: halve t and n at this many observations, a multiple of 4",
    "drift": "how the true accuracy changes",
    "drift_rate": "change of the true accuracy per step",
    "drift_period": "steps between the changes of a stepped drift",
    "drift_diffusion": "standard deviation of a Wiener process's change per step",
    "lowest_accuracy": "below which no drift takes the true accuracy",
    "density": "swarm density D of a square arena",
    "width": "side of a rectangular arena along x in place of a density, metres",
    "height": "its side along y",
    "speed": "limit of a wheel, m/s",
    "radio_range": "distance below which two robots hear each other, metres",
    "floor": "what moving robots observe",
    "tile": "side of a tile, metres",
    "picture": "path of the picture of a floor",
    "picture_sha256": "of that file, checked if given",
    "ticks_per_second": "steps per second",
    "observation_period": "steps between observations",
    "latency": "steps that a message takes, 0 or 1",
    "steps": "length of a trial",
    "trials": "how many",
    "seed": "of everything random",
    "firmware": "the C itself, the same in Python integers, or the paper's equations",
    "conventions": "whose reading of the equations the reference firmware follows",
}


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """An option for every parameter of an experiment; those not given are None."""
    group = parser.add_argument_group("experiment (values replace those of FILE)")
    for field in fields(Experiment):
        default, kind = field.default, type(field.default)
        choices = [member.value for member in kind] if issubclass(kind, Enum) else None
        group.add_argument(
            f"--{field.name.replace('_', '-')}",
            type=str if choices or field.name == "omega" else kind,
            choices=choices or (list(FIRMWARES) if field.name == "firmware" else None),
            metavar=None if choices or field.name == "firmware" else field.name.split("_")[-1].upper(),
            help=f"{_HELP[field.name]} (default {default.value if isinstance(default, Enum) else default})",
        )
    group.add_argument("--flawed-proportion", type=float, metavar="P", help="in place of --flawed, 0 to 1")


def given_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """The parameters that were given. Raises UsageError for two that say the same."""
    given = {field.name: getattr(args, field.name) for field in fields(Experiment)}
    given = {name: value for name, value in given.items() if value is not None}
    if "picture" in given:
        given.setdefault("picture_sha256", "")  # not that of the picture in FILE
    if "omega" in given:
        given["omega"] = parse_omega(given["omega"])
    if args.flawed_proportion is not None and "flawed" in given:
        raise UsageError("--flawed and --flawed-proportion say the same; give one of them")
    return given


def with_parameters(experiment: Experiment, args: argparse.Namespace) -> Experiment:
    """``experiment`` with the parameters that were given. Raises UsageError for a value out of range."""
    given = {**experiment.parameters(), **given_parameters(args)}
    if args.flawed_proportion is not None:
        given["flawed"] = flawed_count(args.flawed_proportion, given["robots"])
    try:
        return Experiment.from_parameters(given)
    except ExperimentError as error:
        raise UsageError(f"--{error.key.replace('_', '-')}: {error}") from error


def add_workers(parser: argparse.ArgumentParser) -> None:
    """The option for parallel work."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        default=default_workers(),
        help="processes (default %(default)s: one a processor)",
    )


def check_workers(workers: int) -> int:
    """Return ``workers``. Raises UsageError if there are none."""
    if not 1 <= workers <= 1024:
        raise UsageError(f"--workers is {workers}; choose 1 to 1024")
    return workers


FOUND = ("the largest found", "the largest found")
WORST = ("the length of a trial", "the largest possible")


def add_limits(parser: argparse.ArgumentParser, defaults: tuple[str, str] = FOUND) -> None:
    """The options for what scores are relative to."""
    group = parser.add_argument_group("scores")
    group.add_argument(
        "--k-max", type=float, metavar="STEPS", help=f"K that scores 0 (default: {defaults[0]})"
    )
    group.add_argument(
        "--e-max", type=float, metavar="ERROR", help=f"e that scores 0 (default: {defaults[1]})"
    )


def limits_of(args: argparse.Namespace, experiments: Sequence[Trials]) -> Limits:
    """The limits given, or those found in ``experiments``. Raises UsageError for limits of 0 or less."""
    found = [found_limits(trials.settled, trials.errors) for trials in experiments]
    values = (
        max(limits.k_max for limits in found) if args.k_max is None else args.k_max,
        max(limits.e_max for limits in found) if args.e_max is None else args.e_max,
    )
    for name, value in zip(("--k-max", "--e-max"), values, strict=True):
        if not 0 < value < float("inf"):
            raise UsageError(f"{name} is {value}; it must be above 0")
    return Limits(*values)


@contextmanager
def progress(total: int, quiet: bool) -> Iterator[Report]:
    """A bar that counts trials, on a terminal only."""
    console = Console(stderr=True)
    columns = (TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as bar:
        task = bar.add_task("trials", total=total)
        yield lambda trials: bar.advance(task, trials)


def summary(experiments: Sequence[Trials], limits: Limits) -> list[dict[str, Any]]:
    """For each experiment its parameters, and medians and quartiles over the trials, as plain values."""
    return [
        {
            "parameters": trials.experiment.parameters(),
            "trials": len(trials.numbers),
            **_figures(trials, limits),
        }
        for trials in experiments
    ]


def _figures(trials: Trials, limits: Limits) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    scores = score(trials.settled, trials.errors, limits)
    values = {
        "H": scores.h,
        "h_K": scores.h_k,
        "h_e": scores.h_e,
        "K": trials.settled.mean(axis=1),
        "e": trials.errors.mean(axis=1),
        "updates": trials.updates.sum(axis=1),
    }
    quartiles = {name: np.percentile(value, [25, 50, 75]).tolist() for name, value in values.items()}
    return {
        name: dict(zip(("q25", "median", "q75"), three, strict=True)) for name, three in quartiles.items()
    }


def show(experiments: Sequence[Trials], limits: Limits, title: str) -> None:
    """Print a table with a row for each experiment and a column for each parameter in which they differ."""
    rows = summary(experiments, limits)
    varying = [name for name in rows[0]["parameters"] if len({row["parameters"][name] for row in rows}) > 1]
    table = Table(title=title, title_justify="left", caption_justify="left")
    table.caption = (
        f"K_max {limits.k_max:g}, e_max {limits.e_max:.6g}; medians over the trials, H with quartiles"
    )
    for name in (*varying, "trials", "H", "h_K", "h_e", "K", "e", "updates"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*(f"{row['parameters'][name]}" for name in varying), f"{row['trials']}", *_cells(row))
    # Lines longer than a terminal wrap; columns that shrink to fit would lose figures.
    width = Console(width=10_000).measure(table).maximum
    Console(width=width).print(table)


def _cells(row: dict[str, Any]) -> Iterator[str]:
    yield f"{row['H']['median']:.2f} [{row['H']['q25']:.2f}, {row['H']['q75']:.2f}]"
    for name, layout in (("h_K", ".2f"), ("h_e", ".2f"), ("K", "g"), ("e", ".5f"), ("updates", "g")):
        yield format(row[name]["median"], layout)


def checked_output(path: Path) -> Path:
    """Return ``path``. Raises UsageError if it does not end as results do."""
    if path.suffix != ".parquet":
        raise UsageError(f"cannot write results to {path}: choose a name that ends in .parquet")
    return path
