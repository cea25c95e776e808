"""Run many experiments on all cores, so that no finished trial is lost or run twice.

Trials run in jobs. Each job writes its results to a file in the folder ``OUTPUT.parts`` when it ends; once
all are complete they are merged into the file OUTPUT and the folder is removed. An interrupted sweep
therefore resumes where it stopped, and a larger sweep runs only the trials that are new.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import groupby, islice
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target
from mcp_asdf_tools.common.signals import ENDING_SIGNALS, stopping
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import (
    Trials,
    metadata_of,
    parts_of,
    read_table,
    require_arrow,
    table_of,
    write_table,
)
from mcp_asdf_tools.experiments.trials import Job

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
else:
    from mcp_asdf_tools.experiments import arrow as pa

_MOST_TRIALS = 32
"""Most trials of a job: twice as many as the engine runs side by side."""

_MOST_ROBOT_STEPS = 20_000_000
"""Most steps of all robots in a job of several trials, which bounds its memory."""

Report = Callable[[int], None]
"""Called with the number of trials that have just been finished."""


def identity(experiment: Experiment, sampling_interval: int) -> str:
    """Digest of everything that decides a trial's result, given its number."""
    parameters = {
        **replace(experiment, trials=1).parameters(),
        "sampling_interval": sampling_interval,
        "version": software_versions()["mcp-asdf"],
    }
    return hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()[:20]


class Store:
    """The results of a sweep on disk, finished or not."""

    def __init__(
        self, output: Path, experiments: Iterable[Experiment], sampling_interval: int = 0, most: int = 0
    ) -> None:
        """Read the results of ``experiments`` that exist already, also of further trials up to ``most``.

        Raises UsageError if the files hold other results, which would be lost, or cannot be written.
        """
        require_arrow()  # before anything is run
        self.output = output
        self.parts = parts_of(output)
        self._interval = sampling_interval
        self._most = most
        self.want(experiments)
        self._tables: list[pa.Table] = []
        self._rows: dict[tuple[str, int], int] = {}  # of all tables together, by identity and trial
        check_target(output)
        for path in [*sorted(self.parts.glob("*.parquet")), output]:
            if path.exists():
                self._take_file(path)

    def want(self, experiments: Iterable[Experiment]) -> None:
        """Choose the experiments whose results it is for."""
        self.experiments = list(dict.fromkeys(experiments))
        self._names = {each: identity(each, self._interval) for each in self.experiments}

    def missing(self, experiment: Experiment) -> list[int]:
        """The trials of an experiment that have no results yet."""
        return [
            trial for trial in range(experiment.trials) if (self._names[experiment], trial) not in self._rows
        ]

    @property
    def left(self) -> int:
        """How many trials have no results yet."""
        return sum(len(self.missing(experiment)) for experiment in self.experiments)

    def add(self, trials: Trials) -> None:
        """Write a job's results to disk. Raises UsageError if that fails."""
        table = table_of(trials, self._interval)
        name = self._names[trials.experiment]
        try:
            self.parts.mkdir(exist_ok=True)
        except OSError as error:
            raise UsageError(f"cannot make the folder {self.parts}: {error.strerror}") from error
        write_table(self.parts / f"{name}-{trials.numbers[0]}-{len(table)}.parquet", table)
        self._take(table, [name] * len(table))

    def table(self) -> pa.Table:
        """All trials, in the order of the experiments. Needs all of them."""
        wanted = [(each, trial) for each in self.experiments for trial in range(each.trials)]
        rows = [self._rows[self._names[experiment], trial] for experiment, trial in wanted]
        table = pa.concat_tables(self._tables).combine_chunks().take(rows)
        column = table.column_names.index("trials")  # there may have been fewer when a row was made
        trials = pa.array([experiment.trials for experiment, _ in wanted], pa.uint64())
        return table.set_column(column, "trials", trials)

    def finish(self) -> pa.Table:
        """Write the one file and remove the parts; returns the table. Needs all trials."""
        table = self.table()
        write_table(self.output, table)
        for path in [*self.parts.glob("*.parquet"), *self.parts.glob(".*.tmp")]:  # halves that a kill left
            path.unlink(missing_ok=True)
        with suppress(OSError):  # absent, or it holds other files
            self.parts.rmdir()
        return table

    def _take_file(self, path: Path) -> None:
        table = read_table(path)
        said = metadata_of(table)
        rows = [json.dumps(row) for row in table.select(list(Experiment().parameters())).to_pylist()]
        own = {
            row: identity(Experiment.from_parameters(json.loads(row)), self._interval) for row in set(rows)
        }
        wanted = {
            (name, trial)
            for experiment, name in self._names.items()
            for trial in range(max(self._most, experiment.trials))
        }
        found = zip([own[row] for row in rows], table["trial"].to_pylist(), strict=True)
        is_same = (
            said["sampling_interval"] == self._interval
            and said["versions"]["mcp-asdf"] == software_versions()["mcp-asdf"]
        )
        if not is_same or not wanted.issuperset(found):
            raise UsageError(
                f"{path} holds results of other experiments, recordings or versions; "
                "choose another name or move it away"
            )
        self._take(table, [own[row] for row in rows])

    def _take(self, table: pa.Table, names: Sequence[str]) -> None:
        """Remember each row of a table."""
        start = sum(map(len, self._tables))
        self._tables.append(table)
        for index, (name, trial) in enumerate(zip(names, table["trial"].to_pylist(), strict=True)):
            self._rows[name, trial] = start + index


def jobs_of(store: Store, sampling_interval: int = 0) -> Iterator[Job]:
    """Jobs for the trials that are missing."""
    for experiment in store.experiments:
        is_native = experiment.firmware == "native"
        size = (
            min(_MOST_TRIALS, _MOST_ROBOT_STEPS // (experiment.robots * experiment.steps)) if is_native else 1
        )
        # Numbers less their places are equal within a run without gaps.
        for _, gapless in groupby(enumerate(store.missing(experiment)), lambda pair: pair[1] - pair[0]):
            trials = (trial for _, trial in gapless)
            while batch := list(islice(trials, max(1, size))):
                yield Job(experiment, batch[0], len(batch), sampling_interval)


def run_sweep(
    store: Store,
    workers: int,
    sampling_interval: int = 0,
    report: Report = lambda trials: None,
    scheduler: str | None = None,
) -> pa.Table:
    """Run what is missing, as ``run_missing``, and return the finished table."""
    run_missing(store, workers, sampling_interval, report, scheduler)
    return store.finish()


def run_missing(
    store: Store,
    workers: int,
    sampling_interval: int = 0,
    report: Report = lambda trials: None,
    scheduler: str | None = None,
) -> None:
    """Run what is missing on ``workers`` processes, 1 being this one. With the address of a ``scheduler`` run
    it on that Dask cluster instead.

    KeyboardInterrupt ends it at once; what was finished is on disk. Raises UsageError if a job cannot be run
    or a worker process of this machine dies.
    """
    for trials in _results_of(jobs_of(store, sampling_interval), workers, scheduler):
        store.add(trials)
        report(len(trials.numbers))


def _results_of(jobs: Iterator[Job], workers: int, scheduler: str | None) -> Iterator[Trials]:
    """Results as they come."""
    if scheduler is not None:
        from mcp_asdf_tools.experiments.cluster import cluster  # noqa: PLC0415 (Dask loads slowly)

        with cluster(scheduler) as (executor, threads):
            yield from _run_on(executor, threads, jobs)
    elif workers == 1:
        yield from (job.run() for job in jobs)
    else:
        with _processes(workers) as executor:
            yield from _run_on(executor, lambda: workers, jobs)


def _run_on(executor: Executor, width: Callable[[], int], jobs: Iterator[Job]) -> Iterator[Trials]:
    """Run jobs on an executor that runs ``width`` at once; one for each of these is queued."""
    running: set[Future[Trials]] = set()
    while True:
        with _interrupts_held():
            running |= {executor.submit(job.run) for job in islice(jobs, max(0, 2 * width() - len(running)))}
        if not running:
            return
        done, running = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


@contextmanager
def _processes(workers: int) -> Iterator[Executor]:
    """Processes of this machine, which end when this is left, or with this process however that dies."""
    others = set(active_children())
    pool = ProcessPoolExecutor(workers, get_context("spawn"), end_with_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise UsageError(
            "a worker process was killed; what was finished is kept: run the same again"
        ) from error
    finally:
        for process in set(active_children()) - others:
            process.kill()  # the signal of terminate() is among those held back; it has nothing to save
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """Let this worker process end with the one that started it, however that dies."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Keep Ctrl-C and the like from processes that are started in here; this process handles them afterwards.

    They inherit the signal mask before Python starts in them. In this process another thread may still
    receive the signal, so its handler waits, too.
    """
    with stopping() as is_asked:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    if is_asked():
        signal.raise_signal(signal.SIGINT)


def default_workers() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0))
