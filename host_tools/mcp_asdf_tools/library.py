"""The library: experiments, swarms, scores and pictures in a few lines; docs/api.md has examples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extensions import check_for_workers
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.experiments.experiment import Experiment, grid
from mcp_asdf_tools.experiments.experiment_files import read_experiments
from mcp_asdf_tools.experiments.plots import KINDS, load_plot
from mcp_asdf_tools.experiments.scores import E_MAX, Limits
from mcp_asdf_tools.swarm.settings import SwarmSettings

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa  # type: ignore[import-untyped]
    from numpy.typing import NDArray

    from mcp_asdf_tools.experiments.results import Trials
    from mcp_asdf_tools.swarm.run import SwarmRun
    from mcp_asdf_tools.swarm.swarm import Swarm

__all__ = [
    "Experiment",
    "SwarmSettings",
    "UsageError",
    "emulate",
    "experiments_in",
    "grid",
    "read_experiments",
    "read_table",
    "score",
    "simulate",
    "start_swarm",
    "to_frame",
]
__all__ += [f"plot_{kind}" for kind in KINDS]

_ROWS_AT_ONCE = 2**16
"""Rows of a tidy table that are made at once when a log is replayed."""


# --- Swarms ----------------------------------------------------------------------------------------------


@naming_extras()
def start_swarm(settings: SwarmSettings, channel: str | None = None) -> Swarm:
    """Return a swarm before its first step: a context manager, in which its method ``tick`` takes a step.

    With a ``channel`` it is on python-can's virtual bus of that name, for others in this process to join.
    Without, which is faster, frames go from robot to robot, and every robot ends with the same numbers.
    """
    import can

    from mcp_asdf_tools.swarm.carrier import Wiring
    from mcp_asdf_tools.swarm.swarm import Swarm

    if channel is None:
        return Swarm(settings, Wiring())
    # Frames keep the time that their sender gives them, as with the command ``mcp-asdf swarm``. All robots
    # have the same bus, so the swarm opens one connection for all, which has to return what they send.
    options: dict[str, Any] = {"preserve_timestamps": True, "receive_own_messages": True}

    def open_bus(robot: int) -> can.BusABC:
        """Open the bus, which all robots share; ``robot`` is not used."""
        return can.Bus(channel, "virtual", **options)

    return Swarm(settings, Wiring(open_bus))


@naming_extras()
def emulate(settings: SwarmSettings) -> SwarmRun:
    """Run a swarm with its CAN frames to its end, and return its results.

    Ctrl-C ends it early, and the results are of what was done.
    """
    from mcp_asdf_tools.swarm.run import run_swarm

    with start_swarm(settings) as swarm:
        return run_swarm(swarm)


# --- Experiments and their results -----------------------------------------------------------------------


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

    from mcp_asdf_tools.common.progress_bar import progress
    from mcp_asdf_tools.experiments.store import Store
    from mcp_asdf_tools.experiments.sweep import run_sweep

    # The store finds what earlier calls have finished, so that only the rest is run.
    store = Store(None if output is None else Path(output), experiment_list, record)
    with progress("trials", store.missing_count, quiet) as report:
        run_sweep(store, workers, report)
    return store.read_table()


def _check_run(experiments: list[Experiment], workers: int, record: int) -> None:
    """Raise UsageError, with the fix, for arguments of ``simulate`` that cannot be run.

    These are no experiments at all, an item that is no Experiment, a ``record`` below 0 or above the steps of
    an experiment, ``workers`` below 1, and extensions that `_check_extension_objects` refuses.
    """
    if not experiments:
        raise UsageError("there is no experiment to run; give one or more")
    for experiment in experiments:
        if not isinstance(experiment, Experiment):
            raise UsageError(f"{experiment!r} is no experiment; give what Experiment or grid makes")
        if not 0 <= record <= experiment.steps:
            raise UsageError(f"record is {record}; choose 1 to {experiment.steps} steps, or 0 for none")
    if workers < 1:
        raise UsageError(f"workers is {workers}; give 1 or more")
    _check_extension_objects(experiments, workers)


def _check_extension_objects(experiments: list[Experiment], workers: int) -> None:
    """Raise UsageError for two objects with one name, or an object that worker processes cannot import.

    Objects are the user's own firmwares, sensors and topologies. An experiment has them as `ObjectName`, the
    object's name with the object, where it otherwise has the name of a built-in or installed one. Whether
    they can be imported is checked for ``workers`` > 1 only.
    """
    first_name_by_text: dict[str, str] = {}
    for experiment in experiments:
        for name in (experiment.firmware, experiment.sensor, experiment.topology):
            # Results have only the text of a name, so that two objects with the same text would be mixed up.
            text = str(name)
            if text not in first_name_by_text:
                first_name_by_text[text] = name
            elif name != first_name_by_text[text]:  # names of objects are equal if the objects are the same
                raise UsageError(f"two objects are called {name}; give them different names")
            if workers > 1:
                check_for_workers(name)


@naming_extras()
def read_table(path: Path | str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a results file, or all files of a folder, such as the parts of a sweep, into one table.

    Returns all columns if ``columns`` is None. Raises UsageError for any other file.
    """
    from mcp_asdf_tools.experiments import result_files

    return result_files.read_table(path, columns)


@naming_extras()
def experiments_in(table: pa.Table) -> list[Trials]:
    """Return the experiments of a table, each with its trials, in the order of their first rows. O(rows)."""
    from mcp_asdf_tools.experiments.result_files import stream_experiments

    return list(stream_experiments(table))


@naming_extras()
def score(table: pa.Table, k_max: float | None = None, e_max: float | None = None) -> pa.Table:
    """Return the table with the scores H, h_K and h_e anew, for other limits.

    The limits are the convergence time K and the error e that score 0; by default they are the paper's, the
    length of a trial and 0.45. Raises UsageError for limits of 0 or less.
    """
    from mcp_asdf_tools.experiments.result_tables import score_table

    if e_max is None:
        e_max = E_MAX
    return score_table(table, Limits(k_max, e_max))


# --- Tidy tables -----------------------------------------------------------------------------------------


@naming_extras()
def to_frame(source: pa.Table | Path | str) -> pa.Table:
    """Return the values of robots over time as a tidy table: a row for each trial, step and robot.

    The columns are ``trial``, the parameters that vary, ``step``, ``robot``, ``is_flawed``, ``t``, ``n``,
    ``x_hat``, ``alpha``, ``x_bar``, ``beta``, ``x`` and ``b_hat``; ``to_pandas()`` of the table returns a
    DataFrame. ``source`` is a table of results, their file or folder, or the log of a swarm, whose robots run
    again from the events beside it. Raises UsageError if it cannot be read, or if no values were recorded
    (``record`` of ``simulate``).
    """
    import pyarrow as pa

    from mcp_asdf_tools.experiments.tidy_tables import stream_tidy_results

    if isinstance(source, pa.Table):
        return pa.concat_tables(stream_tidy_results(source))
    return pa.concat_tables(stream_tidy_tables(Path(source)))


def stream_tidy_tables(path: Path) -> Iterator[pa.Table]:
    """Yield what ``to_frame`` returns for a file or folder of results or for a log, some rows at a time.

    Raises UsageError as ``to_frame``.
    """
    from mcp_asdf_tools.experiments.results import is_results_path
    from mcp_asdf_tools.experiments.tidy_tables import stream_tidy_results

    if is_results_path(path) or path.is_dir():
        yield from stream_tidy_results(path)
    else:
        yield from _replay_to_tidy_tables(path)


def _replay_to_tidy_tables(log: Path) -> Iterator[pa.Table]:
    """Run the robots of a swarm's log again, and yield their values in tidy tables, from tick 0 on.

    Raises UsageError if the log has no events beside it or is not of a swarm, or if the events are damaged.
    """
    from mcp_asdf_tools.experiments.results import QUANTITIES
    from mcp_asdf_tools.recording.events import EventsReader, events_path
    from mcp_asdf_tools.swarm.log_replay import read_swarm_settings, replay_values

    events_file = events_path(log)
    if not events_file.exists():
        raise UsageError(
            f"there is no {events_file}, from which robots could run again; give results (.parquet), or the "
            "log of a swarm with the file .events beside it"
        )
    with EventsReader(events_file) as events:
        settings = read_swarm_settings(log, events.header)
        yield from _tidy_tables_of_ticks(settings, replay_values(events, settings.steps, QUANTITIES))


def _tidy_tables_of_ticks(
    settings: SwarmSettings, values_by_tick: Iterator[NDArray[np.float64]]
) -> Iterator[pa.Table]:
    """Yield the values of a swarm's robots in tidy tables, each of which has many ticks.

    ``values_by_tick`` has the values at tick 0 and at all ticks after it, with the shape (quantities, N) at
    each tick.
    """
    import numpy as np

    from mcp_asdf_tools.experiments.results import QUANTITIES
    from mcp_asdf_tools.experiments.tidy_tables import tidy_table

    ticks_at_once = max(1, _ROWS_AT_ONCE // settings.robots)
    first_tick = 0
    # In each turn the next ticks are taken; when none is left, the list is empty and ends the loop.
    while values_of_ticks := list(islice(values_by_tick, ticks_at_once)):
        ticks = first_tick + np.arange(len(values_of_ticks))
        series_by_quantity = np.stack(values_of_ticks, axis=1)  # shape (quantities, ticks, N)
        # The table wants an axis for trials, too: of one trial, the shape (1, ticks, N).
        values = {
            name: series[np.newaxis] for name, series in zip(QUANTITIES, series_by_quantity, strict=True)
        }
        yield tidy_table(settings, parameter_names=(), trial_numbers=[0], steps=ticks, values=values)
        first_tick += len(values_of_ticks)


# --- Pictures --------------------------------------------------------------------------------------------


def __getattr__(name: str) -> Any:
    """Return the function of this name that draws pictures, such as ``plot_boxes``; it loads matplotlib.

    Raises UsageError, with the fix, if matplotlib is not installed.
    """
    kind = name.removeprefix("plot_")
    # Python asks a module for names that it lacks, and expects AttributeError where there is none.
    if not name.startswith("plot_") or kind not in KINDS:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return load_plot(kind)
