"""The results of a sweep on disk, finished or not: no trial that has run is lost, and none runs twice.

While the sweep goes on, results are collected in memory and written now and then as a part: a file in the
folder ``OUTPUT.parts``. When all trials have run, all results are written to the file OUTPUT in the order of
the experiments, and the folder is removed. A short sweep writes no part. So a sweep that was interrupted goes
on where it stopped, and one with more trials runs only those that are new. A store without an output writes
nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, remove_abandoned_drafts
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment, without_repetitions
from mcp_asdf_tools.experiments.output_lock import lock_file, unlock_file
from mcp_asdf_tools.experiments.result_files import (
    ROW_GROUP_BYTES,
    RowGroups,
    parts_folder,
    read_table,
    write_tables,
)
from mcp_asdf_tools.experiments.result_tables import (
    read_metadata,
    replace_column,
    rows_by_experiment,
    trials_to_table,
)
from mcp_asdf_tools.experiments.results import PARAMETER_NAMES, QUANTITIES, Trials

_SECONDS_BETWEEN_PARTS = 1.0
"""Shortest time from one part to the next; a process that is killed loses the results since the last part."""
_SHARE_BETWEEN_PARTS = 0.01
"""Shortest time as a share of the time that the sweep has taken so far, if that is more. So a sweep of a day
writes hundreds of parts, not tens of thousands."""

_BYTES_PER_VALUE = 8
"""Size of a value in a row, that is at most of a double."""

_ResultKey = tuple[Any, ...]
"""Values of the parameters that decide the results of a trial."""


def _result_key(experiment: Experiment) -> _ResultKey:
    """Return the values of all parameters but the number of trials.

    Experiments with the same key have the same results in trials of the same number.
    """
    return tuple(value for name, value in experiment.parameters().items() if name != "trials")


def _rows_without_results(experiments: Iterable[Experiment]) -> dict[_ResultKey, NDArray[np.int64]]:
    """Return arrays by ``_result_key``. Each trial has a -1: no row of results belongs to it yet.

    Experiments that differ only in their number of trials share an array, as long as the largest number.
    """
    trial_counts: dict[_ResultKey, int] = {}
    for experiment in experiments:
        key = _result_key(experiment)
        trial_counts[key] = max(experiment.trials, trial_counts.get(key, 0))
    return {key: np.full(trial_count, -1) for key, trial_count in trial_counts.items()}


class Store:
    """The results of a sweep on disk and in memory, finished or not.

    Attributes:
        experiments: The experiments of the sweep, each once.
        sampling_interval: Steps from one recorded value to the next; 0 if none is recorded.
    """

    def __init__(
        self, output: Path | None, experiments: Iterable[Experiment], sampling_interval: int = 0
    ) -> None:
        """Find the results of ``experiments`` that exist already.

        An ``output`` of None keeps all results in memory. An unfinished sweep is reserved for this process.
        Raises UsageError if the files have other results, which would be lost, if they cannot be written, or
        if another process is at work on them.
        """
        self._output = output
        self.experiments = without_repetitions(experiments)
        self.sampling_interval = sampling_interval
        # A part, and a row group of the output, has room for this many trials of any of the experiments.
        self._rows_per_part = min(map(self._rows_that_fit, self.experiments))
        self._row_groups = RowGroups()
        self._unwritten: list[pa.Table] = []
        self._unwritten_row_count = 0
        self._start_time = time.monotonic()
        self._last_write_time = self._start_time
        # For each trial, the number of its row. Rows are numbered consecutively, first those of all files,
        # then those of tables that are not written yet.
        self._row_of_trial = _rows_without_results(self.experiments)
        if output is not None:
            self._open_files()

    def _rows_that_fit(self, experiment: Experiment) -> int:
        """Return how many rows, which are trials of an experiment, fit ROW_GROUP_BYTES, at least 1.

        The number follows from the parameters alone, since the same results must always give the same file.
        The size of tables in memory would not do: it differs a little by where their rows come from.
        """
        filter_steps = experiment.steps // experiment.filter_period
        values_per_robot = 4 + filter_steps  # K, e, tests and updates, and b_hat after each filter step
        if self.sampling_interval:
            samples = 1 + experiment.steps // self.sampling_interval
            values_per_robot += len(QUANTITIES) * samples
        values_per_row = len(PARAMETER_NAMES) + experiment.robots * values_per_robot
        return max(1, ROW_GROUP_BYTES // (_BYTES_PER_VALUE * values_per_row))

    @property
    def output(self) -> Path:
        """File of all results, which exists when the sweep is finished. The store must have an output."""
        assert self._output is not None
        return self._output

    @property
    def parts(self) -> Path:
        """Folder of the results so far. The store must have an output."""
        return parts_folder(self.output)

    # --- Existing results --------------------------------------------------------------------------------

    def _open_files(self) -> None:
        """Open the output and the parts that exist, and find out which trials have results there.

        Raises UsageError as the constructor does.
        """
        check_target(self.output)
        # A folder of parts means an unfinished sweep, which another process may be running right now.
        if self.parts.is_dir():
            self.reserve()
        for path in [self.output, *sorted(self.parts.glob("*.parquet"))]:
            if path.exists():
                self._row_groups.add(path)
        self._find_existing_trials()

    def _find_existing_trials(self) -> None:
        """Find out which trials have results in the files, and in which rows.

        Raises UsageError if the files have results of other experiments, recordings or versions.
        """
        for row_group in self._row_groups:
            table = row_group.read([*PARAMETER_NAMES, "trial"])
            if not self._can_continue(read_metadata(table)):
                raise self._other_results_error()
            trial_numbers = table["trial"].to_numpy()
            for experiment, rows in rows_by_experiment(table).items():
                rows_in_all_files = row_group.first_row + rows
                self._set_rows(experiment, trial_numbers[rows], rows_in_all_files)

    def _set_rows(self, experiment: Experiment, numbers: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
        """Note that the trials of these numbers have their results in these rows.

        Raises UsageError if the sweep lacks the experiment, or one of these trials of it.
        """
        row_of_trial = self._row_of_trial.get(_result_key(experiment))
        if row_of_trial is None or numbers.max() >= len(row_of_trial):
            raise self._other_results_error()
        row_of_trial[numbers] = rows

    def _other_results_error(self) -> UsageError:
        """Return the error that says that the files have results which this sweep would not have."""
        return UsageError(
            f"{self.output} or its parts hold results of other experiments, recordings or "
            "versions; choose another name or move it away"
        )

    def _can_continue(self, metadata: Mapping[str, Any]) -> bool:
        """Return whether this sweep can continue the results in a file with this metadata.

        They must have been recorded as often, by the same version of this program. Results of another program
        have a "source".
        """
        has_same_interval = metadata["sampling_interval"] == self.sampling_interval
        has_same_version = metadata["versions"]["mcp-asdf"] == software_versions()["mcp-asdf"]
        return has_same_interval and has_same_version and "source" not in metadata

    def missing(self, experiment: Experiment) -> NDArray[np.int64]:
        """Return the numbers of the trials of an experiment that have no results yet."""
        return np.flatnonzero(self._rows_of(experiment) < 0)

    @property
    def missing_count(self) -> int:
        """The number of trials of all experiments that have no results yet."""
        return sum(len(self.missing(experiment)) for experiment in self.experiments)

    def _rows_of(self, experiment: Experiment) -> NDArray[np.int64]:
        """Return the row of each trial of an experiment, -1 for those without results."""
        return self._row_of_trial[_result_key(experiment)][: experiment.trials]

    # --- New results -------------------------------------------------------------------------------------

    def reserve(self) -> None:
        """Create the folder of parts, and keep other processes from this output until it is finished.

        Does nothing without an output. Raises UsageError if another process is at work on it, or if the
        folder cannot be created.
        """
        if self._output is None:
            return
        try:
            # The folder may be left of an interrupted run: what keeps others out is the lock in it.
            self.parts.mkdir(exist_ok=True)
            owner_id = lock_file(self._lock_path)
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.parts}: {error.strerror}") from error
        if owner_id is not None:
            raise UsageError(
                f"process {owner_id} is at work on {self.output}; wait for it or choose another name"
            )

    @property
    def _lock_path(self) -> Path:
        """The lock file, by its absolute path: the same file has one name, wherever the process is."""
        return self.parts.resolve() / ".lock"

    def add(self, trials: Trials) -> None:
        """Add the results of some trials of an experiment.

        All that is in memory is written as a part if it has enough rows, or if the last part is old enough.
        Raises UsageError if the part cannot be written.
        """
        table = trials_to_table(trials)
        # Rows are numbered through the parts on disk and the tables in memory.
        first_row = self._row_groups.row_count + self._unwritten_row_count
        new_rows = np.arange(first_row, first_row + len(table))
        self._set_rows(trials.experiment, np.array(trials.numbers), new_rows)
        self._unwritten.append(table)
        self._unwritten_row_count += len(table)
        if self._unwritten_row_count >= self._rows_per_part or self._is_part_due():
            self.flush()

    def _is_part_due(self) -> bool:
        """Return whether the last part is so old that results since then have to be written.

        A kill may lose the work of _SECONDS_BETWEEN_PARTS or, if this is more, of a share of the time since
        the start.
        """
        now = time.monotonic()
        seconds_since_start = now - self._start_time
        allowed_seconds = max(_SECONDS_BETWEEN_PARTS, _SHARE_BETWEEN_PARTS * seconds_since_start)
        return now - self._last_write_time >= allowed_seconds

    def flush(self) -> None:
        """Write the results that are only in memory, if any, into a file of their own: a part.

        The time until the next part is due begins anew. Without an output they stay in memory. Raises
        UsageError if writing fails.
        """
        if self._unwritten and self._output is not None:
            self.reserve()  # creates the folder for this part, if it is the first
            part_table = pa.concat_tables(self._unwritten)
            # Sorted by their names, parts are in the order of their rows.
            part_path = self.parts / f"{self._row_groups.row_count:012}-{len(part_table)}.parquet"
            write_tables(part_path, [part_table])
            self._row_groups.add(part_path)
            self._unwritten = []
            self._unwritten_row_count = 0
        self._last_write_time = time.monotonic()

    # --- The finished file -------------------------------------------------------------------------------

    def finish(self) -> None:
        """Write the output file, remove the parts and release the output. Nothing can be added afterwards.

        All trials must have results. Does nothing without an output. Raises UsageError if the file cannot be
        written. The output is complete before the first part is removed: a kill in between loses nothing.
        """
        if self._output is None:
            return
        write_tables(self.output, self._tables_in_order())
        self._unwritten = []
        for part_path in self.parts.glob("*.parquet"):
            part_path.unlink(missing_ok=True)
        # An earlier process may have been killed while it wrote a part.
        remove_abandoned_drafts(self.parts)
        unlock_file(self._lock_path)
        with suppress(OSError):  # there is no folder, or somebody has put other files into it
            self.parts.rmdir()

    def read_table(self) -> pa.Table:
        """Return all results of a finished sweep in the order of experiments and trials.

        Raises UsageError if the output cannot be read.
        """
        if self._output is not None:
            return read_table(self.output)
        return pa.concat_tables(self._tables_in_order()).combine_chunks()

    def _tables_in_order(self) -> Iterator[pa.Table]:
        """Yield all results in the order of experiments and trials, in tables of the size of a row group."""
        if self._unwritten:
            self._row_groups.add(pa.concat_tables(self._unwritten))
        rows = np.concatenate([self._rows_of(experiment) for experiment in self.experiments])
        # An experiment has as many rows as trials, and each row has this number in the column "trials". It is
        # written anew, since a row from a sweep with fewer trials has another number there.
        trial_counts = [experiment.trials for experiment in self.experiments]
        trials_column = np.repeat(trial_counts, repeats=trial_counts)
        for start in range(0, len(rows), self._rows_per_part):
            rows_of_table = slice(start, start + self._rows_per_part)
            table = self._row_groups.take(rows[rows_of_table])
            yield replace_column(table, "trials", trials_column[rows_of_table])
