"""The library: experiments, swarms, scores and pictures in a few lines; docs/library.md has examples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, select_experiments, single_experiment
from mcp_asdf_tools.experiments.scores import E_MAX, PAPERS, SCORES, Limits
from mcp_asdf_tools.experiments.sweep import run_in_memory, run_sweep
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mcp_asdf_tools.experiments.plots import Measure


@naming_extras()
def start_swarm(settings: SwarmSettings, channel: str | None = None) -> Swarm:
    """A swarm in this process, before its first step: a context manager, in which ``tick`` takes a step.

    With a ``channel`` it is on python-can's virtual bus of that name, for others in this process to join.
    Without, which is faster, frames go from robot to robot; the robots end in the same bits.
    """
    if channel is None:
        return Swarm(settings, Wiring())
    options: dict[str, Any] = {"preserve_timestamps": True, "receive_own_messages": True}
    return Swarm(settings, Wiring(lambda robot: can.Bus(channel, "virtual", **options)))


@naming_extras()
def emulate(settings: SwarmSettings) -> SwarmRun:
    """Run a swarm with its CAN frames to its end. Ctrl-C ends it early and keeps what was done."""
    with start_swarm(settings) as swarm:
        return run_swarm(swarm)


@naming_extras()
def simulate(
    experiments: Experiment | Iterable[Experiment],
    output: Path | str | None = None,
    *,
    workers: int = 1,
    record: int = 0,
    quiet: bool = False,
) -> pa.Table:
    """Run all trials of one or many experiments, and return a table with a row for each trial.

    With an ``output`` file finished trials are kept, and the same call resumes where it was interrupted;
    without one, nothing is written. With ``record`` the robots' values are kept every so many steps. A
    terminal shows progress unless ``quiet``. In a script, code that asks for several ``workers`` belongs
    under ``if __name__ == "__main__":``, since they are processes that import it. Raises UsageError for what
    cannot be run or written.
    """
    experiment_list = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    _check_run(experiment_list, workers, record)
    if output is None:
        return _simulate_in_memory(experiment_list, workers, record, quiet)

    from mcp_asdf_tools.experiments.result_files import read_table  # noqa: PLC0415 (pyarrow loads slowly)
    from mcp_asdf_tools.experiments.store import Store  # noqa: PLC0415

    store = Store(Path(output), experiment_list, record)
    with progress("trials", store.missing_count, quiet) as report:
        run_sweep(store, workers, report)
    return read_table(output)


def _check_run(experiments: list[Experiment], workers: int, record: int) -> None:
    """Raise UsageError, with the fix, for arguments of ``simulate`` that cannot be run."""
    if not experiments:
        raise UsageError("there is no experiment to run; give one or more")
    for experiment in experiments:
        if not isinstance(experiment, Experiment):
            raise UsageError(f"{experiment!r} is no experiment; give what Experiment or grid makes")
        if not 0 <= record <= experiment.steps:
            raise UsageError(f"record is {record}; choose 1 to {experiment.steps} steps, or 0 for none")
    if workers < 1:
        raise UsageError(f"workers is {workers}; give 1 or more")


def _simulate_in_memory(experiments: list[Experiment], workers: int, record: int, quiet: bool) -> pa.Table:
    """Run experiments, and return the table of their trials without a file."""
    import pyarrow as pa  # noqa: PLC0415 (loads slowly)

    from mcp_asdf_tools.experiments.result_tables import trials_to_table  # noqa: PLC0415

    trial_count = sum(experiment.trials for experiment in dict.fromkeys(experiments))
    with progress("trials", trial_count, quiet) as report:
        results = run_in_memory(experiments, record, workers, report)
    return pa.concat_tables([trials_to_table(trials) for trials in results]).combine_chunks()


@naming_extras()
def score(table: pa.Table, k_max: float | None = None, e_max: float | None = None) -> pa.Table:
    """Return the table with H, h_K and h_e for other limits; by default they are the paper's, T and 0.45.

    Raises UsageError for limits of 0 or less.
    """
    from mcp_asdf_tools.experiments.result_tables import score_table  # noqa: PLC0415 (pyarrow loads slowly)

    return score_table(table, Limits(k_max, E_MAX if e_max is None else e_max))


PLOTS: dict[str, tuple[str, ...]] = {
    "boxes": ("limits",),
    "scatter": ("limits",),
    "curve": ("x", "hue", "y", "facet", "ax", "limits"),
    "bands": (),
    "series": ("trial",),
}
"""The options that each kind of picture has. Series are of one experiment."""


def check_plot_options(kind: str, options: Iterable[tuple[str, str]], y: str | Measure | None = None) -> None:
    """Refuse options that a kind of picture does not have, and limits of what has none.

    Each option is its name in ``plot`` and what the user knows it as. Raises UsageError, naming the first
    option that would do nothing.
    """
    if kind not in PLOTS:
        raise UsageError(f"kind is {kind!r}; choose one of {', '.join(PLOTS)}")
    for name, shown_name in options:
        if name not in PLOTS[kind]:
            kinds = " and ".join(other for other, names in PLOTS.items() if name in names)
            raise UsageError(
                f"{shown_name} would do nothing: it is for {kinds}, and kind is {kind}; leave it out"
            )
        if name == "limits" and kind == "curve" and y not in (None, *SCORES):
            raise UsageError(f"{shown_name} would do nothing: it is for scores, and y is none; leave it out")


@naming_extras()
def plot(  # noqa: PLR0913 (each is given by name, and most pictures need none)
    results: pa.Table | list[Trials],
    kind: str = "boxes",
    *,
    trial: int | None = None,
    x: str = "",
    hue: str = "",
    y: str | Measure | None = None,
    facet: str = "",
    where: Mapping[str, Any] | None = None,
    ax: Axes | None = None,
    limits: Limits | None = None,
) -> Figure:
    """A picture of results; its method ``savefig`` writes a file.

    Kinds: ``boxes`` and ``scatter`` show scores relative to ``limits``, by default the paper's; ``curve``
    the measure ``y`` (H by default, h_K, h_e, K, e, or a function of ``Trials`` with a number for each trial)
    over a parameter ``x``, with a curve for each value of a parameter ``hue`` and a panel for each of
    ``facet``, or into the axes ``ax``; ``bands`` b_hat of all trials over time; ``series`` a ``trial``, by
    default 0, over time, which needs ``record``. ``where`` chooses experiments by their parameters. Raises
    UsageError if the results do not have what it shows, and for an option that the kind does not have.
    """
    from mcp_asdf_tools.experiments import plots  # noqa: PLC0415 (matplotlib loads slowly)

    experiments = _experiments_to_plot(results, where)
    options = {"trial": trial, "x": x, "hue": hue, "y": y, "facet": facet, "ax": ax, "limits": limits}
    given_names = [name for name, value in options.items() if value is not None and value != ""]
    check_plot_options(kind, [(name, name) for name in given_names], y)
    score_limits = limits or PAPERS
    match kind:
        case "boxes":
            return plots.boxes(experiments, score_limits)
        case "scatter":
            return plots.scatter(experiments, score_limits)
        case "curve":
            return plots.curve(experiments, x, hue, y or "H", score_limits, facet=facet, ax=ax)
        case "bands":
            return plots.bands(experiments)
        case _:
            return plots.series_beside([single_experiment(experiments)], trial or 0)


def _experiments_to_plot(results: pa.Table | list[Trials], where: Mapping[str, Any] | None) -> list[Trials]:
    """Return the experiments of results whose parameters have the values in ``where``.

    Raises UsageError if there is none.
    """
    if isinstance(results, list):
        experiments = results
    else:
        from mcp_asdf_tools.experiments.result_tables import experiments_in  # noqa: PLC0415

        experiments = experiments_in(results)
    selected = select_experiments(experiments, where or {})
    if not selected:
        raise UsageError("there is no experiment to draw; give results of one or more")
    return selected
