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


def add_run(parser: argparse.ArgumentParser, output: str) -> None:
    """Options of a run: the experiment's parameters, None where not given; output, limits and workers."""
    parser.add_argument("--output", metavar="FILE", type=Path, help=output)
    record = "also keep every robot's values, every STEPS steps (default: only the scores)"
    parser.add_argument("--record", metavar="STEPS", type=int, default=0, help=record)
    add_workers(parser)
    add_common_parameters(parser, Experiment, "experiment (values replace those of FILE)")
    add_limits(parser)
    add_further_parameters(parser, Experiment)


def experiments_of(args: argparse.Namespace) -> list[Experiment]:
    """The experiments of FILE, by default one, with the parameters that were given.

    Raises UsageError for a value out of range, and if ``--record`` is longer than a trial.
    """
    bases = [{}] if args.file is None else [each.parameters() for each in read_experiments(args.file)]
    given = [settings_from(args, Experiment, base) for base in bases]
    most = min(experiment.steps for experiment in given)
    if not 0 <= args.record <= most:
        raise UsageError(f"--record is {args.record}; choose 1 to {most} steps, or 0 for none")
    return given


def add_workers(parser: argparse.ArgumentParser) -> None:
    """The option for parallel work."""
    text = "processes (default %(default)s: one per processor)"
    parser.add_argument("--workers", type=int, metavar="N", default=default_workers(), help=text)


def check_workers(workers: int) -> int:
    """Return ``workers``. Raises UsageError if there are none."""
    if not 1 <= workers <= 1024:
        raise UsageError(f"--workers is {workers}; choose 1 to 1024")
    return workers


def add_limits(parser: argparse.ArgumentParser) -> None:
    """The options for K_max and e_max."""
    add = parser.add_argument_group("scores").add_argument
    add("--k-max", type=float, metavar="STEPS", help="K that scores 0 (default: the length of a trial)")
    add("--e-max", type=float, metavar="ERROR", help=f"e that scores 0 (default: {E_MAX})")


def limits_of(args: argparse.Namespace) -> Limits:
    """The limits given, or else the paper's. Raises UsageError for limits of 0 or less."""
    return Limits(args.k_max, E_MAX if args.e_max is None else args.e_max)


def limits_given(args: argparse.Namespace) -> list[str]:
    """Return the options for K_max and e_max that the user has typed."""
    values = {"--k-max": args.k_max, "--e-max": args.e_max}
    return [option for option, value in values.items() if value is not None]


def add_where(parser: argparse._ActionsContainer) -> None:
    """The option; ``chosen`` obeys it."""
    parser.add_argument(
        "--where",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="only experiments with this parameter, such as filter=none; repeatable",
    )


def chosen(args: argparse.Namespace) -> list[Trials]:
    """Return the experiments of the file ``args.file`` that meet all conditions.

    Raises UsageError, with the existing values, for a condition on no parameter and one that nothing meets.
    """
    from mcp_asdf_tools.experiments.result_files import read_table  # noqa: PLC0415 (pyarrow loads slowly)
    from mcp_asdf_tools.experiments.result_tables import experiments_in  # noqa: PLC0415

    experiments = experiments_in(read_table(args.file))
    for condition in args.where:
        name, equals, value = condition.partition("=")
        if not equals:
            differences = describe_differences(experiments)
            raise UsageError(
                f"--where {condition}: write NAME=VALUE; the experiments differ in {differences}"
            )
        experiments = select_experiments(experiments, {name: value})
    return experiments


def summary(experiments: Iterable[Trials], limits: Limits) -> list[dict[str, Any]]:
    """For each experiment its parameters, and medians and quartiles over the trials, as plain values."""
    return [
        {
            "parameters": trials.experiment.parameters(),
            "filter": trials.experiment.filter_description,
            "trials": len(trials.numbers),
            "limits": dict(zip(("k_max", "e_max"), limits.of(trials.experiment), strict=True)),
            **_quartiles(trials, limits),
        }
        for trials in experiments
    ]


def _quartiles(trials: Trials, limits: Limits) -> dict[str, Any]:
    import numpy as np  # noqa: PLC0415

    ends = ("q25", "median", "q75")
    return {
        name: dict(zip(ends, np.percentile(value, [25, 50, 75]).tolist(), strict=True))
        for name, value in trials.measures(limits).items()
    }


def show(rows: Sequence[dict[str, Any]], title: str) -> None:
    """Print a summary: a row for each experiment, a column for each parameter in which they differ."""
    varying = [name for name in rows[0]["parameters"] if len({row["parameters"][name] for row in rows}) > 1]
    k_max, e_max = (sorted({row["limits"][name] for row in rows}) for name in ("k_max", "e_max"))
    words = f"{k_max[0]:g}" if len(k_max) == 1 else "the length of a trial"
    filters = sorted({row["filter"] for row in rows})
    limits = f"K_max {words}, e_max {e_max[0]:.6g}; medians over the trials, H with quartiles"
    caption = "\n".join([*filters, limits])
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    formats = {"h_K": ".2f", "h_e": ".2f", "K": "g", "e": ".5f", "updates": "g"}
    for name in (*varying, "trials", "H", *formats):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        found, wanted, h = row["trials"], row["parameters"]["trials"], row["H"]
        table.add_row(
            *(f"{row['parameters'][name]}" for name in varying),
            f"{found}" if found >= wanted else f"{found} of {wanted}",
            f"{h['median']:.2f} [{h['q25']:.2f}, {h['q75']:.2f}]",
            *(format(row[name]["median"], layout) for name, layout in formats.items()),
        )
    # Lines longer than a terminal wrap; columns that shrink to fit would lose figures.
    width = Console(width=10_000).measure(table).maximum
    Console(width=width).print(table)


def checked_output(path: Path) -> Path:
    """Return ``path``. Raises UsageError if it does not end as results do."""
    if path.suffix != ".parquet":
        raise UsageError(f"cannot write results to {path}: choose a name that ends in .parquet")
    return path
