"""The results of a sweep on disk, finished or not, so that no finished trial is lost or run twice.

Results are gathered in memory and written as parts into the folder ``OUTPUT.parts``. Once all trials are
there, they are written to the file OUTPUT in the order of the experiments, and the folder is removed; a sweep
that ends before its first part is due writes that file alone. A sweep that was interrupted therefore resumes
where it stopped, and a larger one runs only the trials that are new.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target, remove_abandoned_drafts
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.output_lock import lock_file, unlock_file
from mcp_asdf_tools.experiments.result_files import RowGroups, parts_folder, write_tables
from mcp_asdf_tools.experiments.result_tables import (
    INDEX_COLUMNS,
    read_metadata,
    rows_by_experiment,
    trials_to_table,
)
from mcp_asdf_tools.experiments.results import Trials

_MAX_ROWS = 20_000
"""Rows of a part, and of a row group of the output."""

_MAX_BYTES = 50_000_000
"""Size of the lists in a part, where those of so many rows would be larger."""

_SECONDS_BETWEEN_PARTS = 1.0
_SHARE_BETWEEN_PARTS = 0.01
"""Work that may be lost when the process is killed: this time, or this share of the sweep's time so far if
that is more. So a sweep of a day writes hundreds of parts, not tens of thousands."""

_ResultKey = tuple[Any, ...]
"""The parameters that decide the results of a trial, so all but the number of trials."""


def _result_key(experiment: Experiment) -> _ResultKey:
    """Return what experiments have alike whose trials of one number have the same results."""
    return tuple(value for name, value in experiment.parameters().items() if name != "trials")


class Store:
    """The results of a sweep on disk, finished or not.

    Attributes:
        output: The file of a finished sweep.
        parts: The folder of an unfinished one.
        experiments: What the sweep consists of, without repetitions.
        sampling_interval: Steps between recorded values; 0 for none.
    """

    def __init__(self, output: Path, experiments: Iterable[Experiment], sampling_interval: int = 0) -> None:
        """Open the results of ``experiments`` that exist already.

        Raises UsageError if the files contain other results, which would be lost, or cannot be written, or
        another process is at work on them.
        """
        self.output = output
        self.parts = parts_folder(output)
        self.experiments = list(dict.fromkeys(experiments))
        self.sampling_interval = sampling_interval
        self._rows_per_part = min([_MAX_ROWS, *map(self._rows_that_fit, self.experiments)])
        self._row_groups = RowGroups()
        self._unwritten: list[pa.Table] = []
        self._started = self._last_written = time.monotonic()
        # For each trial the number of its row, or -1. Rows are numbered through files, then unwritten tables.
        self._row_of_trial: dict[_ResultKey, NDArray[np.int64]] = {}
        for experiment in self.experiments:
            key = _result_key(experiment)
            trial_count = max(experiment.trials, len(self._row_of_trial.get(key, ())))
            self._row_of_trial[key] = np.full(trial_count, -1)
        check_target(output)
        if self.parts.is_dir():
            self.reserve()
        for path in [output, *sorted(self.parts.glob("*.parquet"))]:
            if path.exists():
                self._row_groups.add(path)
        self._find_existing_trials()

    def _rows_that_fit(self, experiment: Experiment) -> int:
        """Return how many trials of an experiment have lists of at most _MAX_BYTES; at least 1."""
        values_of_robot = 4 + experiment.steps // experiment.filter_period  # K, e, tests, updates and b_hat
        if self.sampling_interval:
            values_of_robot += 8 * (1 + experiment.steps // self.sampling_interval)
        return max(1, _MAX_BYTES // (8 * experiment.robots * values_of_robot))

    # --- Existing results --------------------------------------------------------------------------------

    def _find_existing_trials(self) -> None:
        """Set the row of each trial in the files. Raises UsageError if they have results of others."""
        for row_group in self._row_groups:
            table = row_group.read(INDEX_COLUMNS)
            numbers = table["trial"].to_numpy()
            metadata = read_metadata(table)
            is_like_ours = (
                metadata["sampling_interval"] == self.sampling_interval
                and metadata["versions"]["mcp-asdf"] == software_versions()["mcp-asdf"]
            )
            for experiment, rows in rows_by_experiment(table).items():
                row_of_trial = self._row_of_trial.get(_result_key(experiment), np.empty(0, np.int64))
                if not is_like_ours or numbers[rows].max() >= len(row_of_trial):
                    raise UsageError(
                        f"{self.output} or its parts hold results of other experiments, recordings or "
                        "versions; choose another name or move it away"
                    )
                row_of_trial[numbers[rows]] = row_group.first_row + rows

    def missing(self, experiment: Experiment) -> list[int]:
        """Return the numbers of the trials of an experiment that have no results yet."""
        trial_numbers: list[int] = np.flatnonzero(self._rows_of(experiment) < 0).tolist()
        return trial_numbers

    @property
    def missing_count(self) -> int:
        """Return how many trials of all experiments have no results yet."""
        return sum(int((self._rows_of(experiment) < 0).sum()) for experiment in self.experiments)

    def _rows_of(self, experiment: Experiment) -> NDArray[np.int64]:
        """Return the row of each trial of an experiment, -1 for those without results."""
        return self._row_of_trial[_result_key(experiment)][: experiment.trials]

    # --- New results -------------------------------------------------------------------------------------

    def reserve(self) -> None:
        """Keep other processes from this output until it is finished. Raises UsageError if one has it."""
        try:
            self.parts.mkdir(exist_ok=True)
            holder = lock_file(self._lock_path)
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.parts}: {error.strerror}") from error
        if holder is not None:
            raise UsageError(
                f"process {holder} is at work on {self.output}; wait for it or choose another name"
            )

    @property
    def _lock_path(self) -> Path:
        return self.parts.resolve() / ".lock"

    def add(self, trials: Trials) -> None:
        """Add the results of a job; a part is written if there is enough for one, or the last is long ago.

        Raises UsageError if a part cannot be written.
        """
        table = trials_to_table(trials)
        first_row = self._row_groups.row_count + self._unwritten_row_count()
        new_rows = np.arange(first_row, first_row + len(table))
        self._row_of_trial[_result_key(trials.experiment)][trials.numbers] = new_rows
        self._unwritten.append(table)
        if self._unwritten_row_count() >= self._rows_per_part or self._is_part_due():
            self.flush()

    def _unwritten_row_count(self) -> int:
        """Return how many finished trials are only in memory."""
        return sum(len(table) for table in self._unwritten)

    def _is_part_due(self) -> bool:
        """Return whether more work would be lost in a kill than the constants above allow."""
        now = time.monotonic()
        allowed_seconds = max(_SECONDS_BETWEEN_PARTS, _SHARE_BETWEEN_PARTS * (now - self._started))
        return now - self._last_written >= allowed_seconds

    def flush(self) -> None:
        """Write all that has not been written as a part, if there is any. Raises UsageError if that fails."""
        if self._unwritten:
            self.reserve()
            table = pa.concat_tables(self._unwritten)
            # By name, parts are in the order of their rows.
            part = self.parts / f"{self._row_groups.row_count:012}-{len(table)}.parquet"
            write_tables(part, [table])
            self._row_groups.add(part)
            self._unwritten = []
        self._last_written = time.monotonic()

    # --- The finished file -------------------------------------------------------------------------------

    def finish(self) -> None:
        """Write the output file and remove the parts; nothing can be added after that.

        All trials have to be there. Raises UsageError if the file cannot be written.
        """
        write_tables(self.output, self._tables_in_order())
        self._unwritten = []
        for part in self.parts.glob("*.parquet"):
            part.unlink(missing_ok=True)
        remove_abandoned_drafts(self.parts)
        unlock_file(self._lock_path)
        with suppress(OSError):  # there is no folder, or it has files of others
            self.parts.rmdir()

    def _tables_in_order(self) -> Iterator[pa.Table]:
        """Yield all rows in the order of experiments and trials, as tables of the size of a row group."""
        if self._unwritten:
            self._row_groups.add_table(pa.concat_tables(self._unwritten))
        rows = np.concatenate([self._rows_of(experiment) for experiment in self.experiments])
        # A row that was made for a smaller sweep states fewer trials than its experiment has now.
        counts = [experiment.trials for experiment in self.experiments]
        stated_trials = np.repeat(np.array(counts, np.uint64), counts)
        for start in range(0, len(rows), self._rows_per_part):
            stop = start + self._rows_per_part
            table = self._row_groups.take(rows[start:stop])
            column_index = table.column_names.index("trials")
            yield table.set_column(column_index, "trials", pa.array(stated_trials[start:stop]))
