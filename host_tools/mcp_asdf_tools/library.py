"""The library: experiments, swarms, scores and plots in a few lines; docs/library.md has examples."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import can

from mcp_asdf_tools.common import UsageError, progress
from mcp_asdf_tools.experiments import (
    Experiment,
    LimitsOf,
    Store,
    Trials,
    chosen_limits,
    experiments_in,
    paper_limits,
    rescored,
    run_sweep,
)
from mcp_asdf_tools.swarm import Swarm, SwarmRun, SwarmSettings, Wiring, run_swarm

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
    from matplotlib.figure import Figure

PLOTS = ("boxes", "scatter", "series", "trajectories", "network")
"""Kinds of pictures of results; the first two are of scores, the others of one experiment."""


def start_swarm(settings: SwarmSettings, channel: str | None = None) -> Swarm:
    """A swarm in this process, before its first step: a context manager, in which ``tick`` takes a step.

    With a ``channel`` it is on python-can's virtual bus of that name, for others in this process to join.
    Without, which is faster, frames go from robot to robot; the robots end in the same bits.
    """
    if channel is None:
        return Swarm(settings, Wiring())
    return Swarm(settings, Wiring(lambda robot: can.Bus(channel, "virtual", preserve_timestamps=True)))


def emulate(settings: SwarmSettings) -> SwarmRun:
    """Run a swarm with its CAN frames to its end. Ctrl-C ends it early and keeps what was done."""
    with start_swarm(settings) as swarm:
        return run_swarm(swarm)


def simulate(
    experiments: Experiment | Iterable[Experiment],
    output: Path | str | None = None,
    *,
    workers: int = 1,
    record: int = 0,
    quiet: bool = False,
) -> pa.Table:
    """Run all trials of one or many experiments; returns a table with a row for each trial.

    With an ``output`` file finished trials are kept, and the same call resumes where it was interrupted. With
    ``record`` the robots' values are kept every so many steps. A terminal shows progress unless ``quiet``. In
    a script, code that asks for several ``workers`` belongs under ``if __name__ == "__main__":``, since they
    are processes that import it. Raises UsageError for what cannot be run or written.
    """
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(output or Path(folder, "results.parquet")), given, record)
        with progress("trials", store.left, quiet) as report:
            return run_sweep(store, workers, record, report)


def score(table: pa.Table, k_max: float | None = None, e_max: float | None = None) -> pa.Table:
    """The table with H, h_K and h_e for other limits; by default they are the paper's, T and 0.45.

    Raises UsageError for limits of 0 or less.
    """
    return rescored(table, chosen_limits(k_max, e_max))


def plot(results: pa.Table | SwarmRun, kind: str = PLOTS[0], *, trial: int = 0, step: int = 600) -> Figure:
    """A picture of results or of a swarm's run; its method ``savefig`` writes a file.

    Kinds for results: ``boxes`` and ``scatter`` show scores; ``series`` a ``trial`` over time, which needs
    ``record``; ``trajectories`` and ``network`` robots that move, up to or at a ``step``. Raises UsageError
    if the results do not have what it shows.
    """
    if isinstance(results, SwarmRun):
        from mcp_asdf_tools.swarm import draw  # noqa: PLC0415 (matplotlib loads slowly)

        return draw(results)
    return plot_trials(experiments_in(results), kind, trial, step)


def plot_trials(
    experiments: Sequence[Trials], kind: str, trial: int, step: int, limits: LimitsOf = paper_limits
) -> Figure:
    """``plot`` of trials that are read already, with scores for any ``limits``."""
    from mcp_asdf_tools.experiments import arena_plots, plots  # noqa: PLC0415 (matplotlib loads slowly)

    if kind not in PLOTS:
        raise UsageError(f"kind is {kind!r}; choose one of {', '.join(PLOTS)}")
    if kind in PLOTS[:2]:
        return (plots.boxes if kind == "boxes" else plots.scatter)(experiments, limits)
    if len(experiments) != 1:
        raise UsageError(f"there are {len(experiments)} experiments; {kind} shows one: choose it")
    if kind == "series":
        return plots.series(experiments[0], trial)
    draw = arena_plots.network if kind == "network" else arena_plots.trajectories
    return draw(experiments[0].experiment, trial, step)
