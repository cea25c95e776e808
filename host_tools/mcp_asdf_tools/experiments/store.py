"""The results of a sweep on disk, finished or not, so that no finished trial is lost or run twice.

Results are gathered into parts in the folder ``OUTPUT.parts``, the newest written at least every second, and
joined until each has ``_ROWS`` rows. Once all trials are there, the parts become the row groups of the file
OUTPUT, and the folder is removed. An interrupted sweep therefore resumes where it stopped, and a larger one
runs only the trials that are new. Nothing that is on disk is kept in memory but where each trial's row is.
"""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import (
    INDEX,
    Pieces,
    Trials,
    metadata_of,
    parts_of,
    read_table,
    require_arrow,
    stretches_of,
    table_of,
    write_tables,
)

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
else:
    from mcp_asdf_tools.experiments import arrow as pa

_ROWS = 20_000
"""Rows of a part, and of a row group of the output."""

_BYTES = 50_000_000
"""Most bytes of a part's lists, where those of so many rows would be more."""

_SMALL_PARTS = 200
"""Most parts that wait to be joined."""

_SECONDS = 1.0
"""Work that may be lost when the process is killed."""


def _once(experiment: Experiment) -> tuple[Any, ...]:
    """What decides the results of an experiment's trials: all but how many there are."""
    return tuple((experiment.parameters() | {"trials": 1}).values())


class Store:
    """The results of a sweep on disk, finished or not, with values over time if it has a
    ``sampling_interval``."""

    def __init__(
        self, output: Path, experiments: Iterable[Experiment], sampling_interval: int = 0, most: int = 0
    ) -> None:
        """Find the results of ``experiments`` that exist already, also of further trials up to ``most``.

        Raises UsageError if the files hold other results, which would be lost, or cannot be written, or
        another process is at work on them.
        """
        require_arrow()  # before anything is run
        self.output = output
        self.parts = parts_of(output)
        self.sampling_interval = sampling_interval
        self._most = most
        self._rows: dict[tuple[Any, ...], NDArray[np.int64]] = {}  # of each trial; -1 if it has none
        self.want(experiments)
        self._pieces = Pieces()
        self._fresh: list[pa.Table] = []  # not yet written
        self._small: list[Path] = []  # parts that are to be joined
        self._written = time.monotonic()
        check_target(output)
        if self.parts.is_dir():
            self.reserve()
        for path in [output, *sorted(self.parts.glob("*.parquet"))]:
            if path.exists():
                self._take_file(path)

    # --- What is there -----------------------------------------------------------------------------------

    def want(self, experiments: Iterable[Experiment]) -> None:
        """Choose the experiments whose results it is for."""
        self.experiments = list(dict.fromkeys(experiments))
        self._size = max(1, min([_ROWS, *(_BYTES // self._bytes_of(each) for each in self.experiments)]))
        self._keys = {each: _once(each) for each in self.experiments}
        for experiment, key in self._keys.items():
            known = self._rows.get(key, np.empty(0, np.int64))
            more = max(self._most, experiment.trials) - len(known)
            self._rows[key] = np.concatenate([known, np.full(max(0, more), -1)])

    def _bytes_of(self, experiment: Experiment) -> int:
        """Size of the lists in a row."""
        values = 4 + experiment.steps // experiment.filter_period
        if self.sampling_interval:
            values += 8 * (1 + experiment.steps // self.sampling_interval)
        return 8 * experiment.robots * values

    def missing(self, experiment: Experiment) -> list[int]:
        """The trials of an experiment that have no results yet."""
        found: list[int] = np.flatnonzero(self._wanted(experiment) < 0).tolist()
        return found

    @property
    def left(self) -> int:
        """How many trials have no results yet."""
        return sum(int((self._wanted(experiment) < 0).sum()) for experiment in self.experiments)

    def _wanted(self, experiment: Experiment) -> NDArray[np.int64]:
        """The rows of an experiment's trials."""
        return self._rows[self._keys[experiment]][: experiment.trials]

    def _take_file(self, path: Path) -> None:
        """Find the trials of a file."""
        none = np.empty(0, np.int64)
        known: dict[str, tuple[Any, ...]] = {}
        for first, table in self._pieces.add(path, INDEX):
            said = metadata_of(table)
            is_own = (
                said["sampling_interval"] == self.sampling_interval
                and said["versions"]["mcp-asdf"] == software_versions()["mcp-asdf"]
            )
            trials = table["trial"].to_numpy()
            for parameters, start, stop in stretches_of(table):
                if parameters not in known:
                    known[parameters] = _once(Experiment.from_recording(json.loads(parameters)))
                rows, numbers = self._rows.get(known[parameters], none), trials[start:stop]
                if not is_own or numbers.max() >= len(rows):
                    raise UsageError(
                        f"{path} holds results of other experiments, recordings or versions; "
                        "choose another name or move it away"
                    )
                rows[numbers] = np.arange(first + start, first + stop)

    # --- What is added -----------------------------------------------------------------------------------

    def reserve(self) -> None:
        """Keep other processes from this output until it is finished. Raises UsageError if one has it."""
        try:
            self.parts.mkdir(exist_ok=True)
            holder = _lock(self.parts.resolve() / ".lock")
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.parts}: {error.strerror}") from error
        if holder is not None:
            raise UsageError(
                f"process {holder} is at work on {self.output}; wait for it or choose another name"
            )

    def add(self, trials: Trials) -> None:
        """Take a job's results, and write them to disk soon. Raises UsageError if that fails."""
        table = table_of(trials, self.sampling_interval)
        first = self._pieces.rows + sum(map(len, self._fresh))
        self._rows[self._keys[trials.experiment]][trials.numbers] = np.arange(first, first + len(table))
        self._fresh.append(table)
        waiting = first + len(table) - self._pieces.rows
        if waiting >= self._size or time.monotonic() - self._written >= _SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write what has not been written. Raises UsageError if that fails."""
        if self._fresh:
            self.reserve()
            self._small.append(self._part(self._pieces.rows, self._fresh))
            self._pieces.append(self._small[-1], sum(map(len, self._fresh)))
            self._fresh = []
            waiting = self._pieces.rows_of_last(len(self._small))
            if waiting >= self._size or len(self._small) >= _SMALL_PARTS:
                self._join()
        self._written = time.monotonic()

    def _join(self) -> None:
        """Make one part of those that are small."""
        if len(self._small) > 1:
            first = self._pieces.rows - self._pieces.rows_of_last(len(self._small))
            path = self._part(first, [read_table(each) for each in self._small])
            self._pieces.join(len(self._small), path)
            for each in self._small:
                each.unlink()
        self._small = []

    def _part(self, first: int, tables: Sequence[pa.Table]) -> Path:
        """Write a part, under a name by which parts are in the order of their rows."""
        table = pa.concat_tables(tables)
        path = self.parts / f"{first:012}-{len(table)}.parquet"
        write_tables(path, [table])
        return path

    # --- What comes out ----------------------------------------------------------------------------------

    def table(self) -> pa.Table:
        """All trials, in the order of the experiments. Needs all of them."""
        return pa.concat_tables(list(self._batches())).combine_chunks()

    def _batches(self) -> Iterator[pa.Table]:
        """The table, a row group at a time."""
        self.flush()
        rows = np.concatenate([self._wanted(experiment) for experiment in self.experiments])
        counts = [experiment.trials for experiment in self.experiments]
        trials = np.repeat(np.array(counts, np.uint64), counts)  # fewer, perhaps, when a row was made
        for start in range(0, len(rows), self._size):
            table = self._pieces.take(rows[start : start + self._size])
            place = table.column_names.index("trials")
            yield table.set_column(place, "trials", pa.array(trials[start : start + self._size]))

    def finish(self) -> None:
        """Write the one file and remove the parts. Needs all trials."""
        write_tables(self.output, self._batches())
        for path in [*self.parts.glob("*.parquet"), *self.parts.glob(".*.tmp")]:  # halves that a kill left
            path.unlink(missing_ok=True)
        _unlock(self.parts.resolve() / ".lock")
        with suppress(OSError):  # absent, or it holds other files
            self.parts.rmdir()
        self._pieces, self._small = Pieces(), []
        for rows in self._rows.values():
            rows[:] = -1
        self._take_file(self.output)


# --- One process at a time -------------------------------------------------------------------------------

_LOCKS: dict[Path, int] = {}
"""Descriptors of the files that this process has locked; they unlock when it ends, however it does."""


def _lock(path: Path) -> str | None:
    """Lock a file for this process; returns the number of the one that has locked it, if another has."""
    try:
        import fcntl  # noqa: PLC0415
    except ImportError:  # Windows
        return None
    while path not in _LOCKS:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(file, 20).decode("ascii", "replace")
            os.close(file)
            is_held = error.errno in (errno.EACCES, errno.EAGAIN)  # or else the file system has no locks
            return holder if is_held else None
        if not path.exists() or not os.path.samestat(os.fstat(file), path.stat()):
            os.close(file)  # who had it has removed it
            continue
        os.ftruncate(file, 0)
        os.write(file, str(os.getpid()).encode())
        _LOCKS[path] = file
    return None


def _unlock(path: Path) -> None:
    """Remove a lock of this process."""
    if path in _LOCKS:
        path.unlink(missing_ok=True)
        os.close(_LOCKS.pop(path))
