"""The library: experiments, swarms and scores in a few lines; docs/library.md has examples."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.progress_bar import progress
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import rescored
from mcp_asdf_tools.experiments.scores import E_MAX, Limits
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.sweep import run_sweep
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm, SwarmRun, run_swarm

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]


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
    """Run all trials of one or many experiments; returns a table with a row for each trial.

    With an ``output`` file finished trials are kept, and the same call resumes where it was interrupted. With
    ``record`` the robots' values are kept every so many steps. A terminal shows progress unless ``quiet``. In
    a script, code that asks for several ``workers`` belongs under ``if __name__ == "__main__":``, since they
    are processes that import it. Raises UsageError for what cannot be run or written.
    """
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    for each in given:
        if not isinstance(each, Experiment):
            raise UsageError(f"{each!r} is no experiment; give what Experiment or grid makes")
        if not 0 <= record <= each.steps:
            raise UsageError(f"record is {record}; choose 1 to {each.steps} steps, or 0 for none")
    if workers < 1:
        raise UsageError(f"workers is {workers}; give 1 or more")
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(output or Path(folder, "results.parquet")), given, record)
        with progress("trials", store.left, quiet) as report:
            return run_sweep(store, workers, report)


@naming_extras()
def score(table: pa.Table, k_max: float | None = None, e_max: float | None = None) -> pa.Table:
    """The table with H, h_K and h_e for other limits; by default they are the paper's, T and 0.45.

    Raises UsageError for limits of 0 or less.
    """
    return rescored(table, Limits(k_max, E_MAX if e_max is None else e_max))
