"""Run many experiments on all cores, in jobs whose results a store keeps as they come."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import groupby, islice
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import TYPE_CHECKING

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import ENDING_SIGNALS, stopping
from mcp_asdf_tools.experiments.results import Trials, read_table
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.trials import Job

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]

_TRIALS = 32, 1000
"""Most trials of a job: twice as many as the engine runs side by side; more if they are short, as each job
has its price."""

_SHORT_ROBOT_STEPS = 1_000_000
"""Steps of all robots in a job up to which its trials are short."""

_MOST_ROBOT_STEPS = 20_000_000
"""Most steps of all robots in a job of several trials, which bounds its memory."""

Report = Callable[[int], None]
"""Called with the number of trials that have just been finished."""


def jobs_of(store: Store) -> Iterator[Job]:
    """Jobs for the trials that are missing."""
    for experiment in store.experiments:
        is_native = experiment.firmware == "native"
        robot_steps = experiment.robots * experiment.steps
        few, many = _TRIALS
        size = min(max(few, _SHORT_ROBOT_STEPS // robot_steps), many, _MOST_ROBOT_STEPS // robot_steps)
        # Numbers less their places are equal within a run without gaps.
        for _, gapless in groupby(enumerate(store.missing(experiment)), lambda pair: pair[1] - pair[0]):
            trials = (trial for _, trial in gapless)
            while batch := list(islice(trials, max(1, size) if is_native else 1)):
                yield Job(experiment, batch[0], len(batch), store.sampling_interval)


def run_sweep(
    store: Store,
    workers: int,
    report: Report = lambda trials: None,
    scheduler: str | None = None,
) -> pa.Table:
    """Run what is missing, as ``run_missing``, and return the finished table."""
    run_missing(store, workers, report, scheduler)
    store.finish()
    return read_table(store.output)


def run_missing(
    store: Store,
    workers: int,
    report: Report = lambda trials: None,
    scheduler: str | None = None,
) -> None:
    """Run what is missing on ``workers`` processes, 1 being this one. With the address of a ``scheduler`` run
    it on that Dask cluster instead.

    KeyboardInterrupt ends it at once; what was finished is on disk. Raises UsageError if a job cannot be run,
    a worker process of this machine dies, or another process is at work on the output.
    """
    if not store.left:
        return
    store.reserve()
    try:
        for trials in _results_of(jobs_of(store), workers, scheduler):
            with _interrupts_held():
                store.add(trials)
            report(len(trials.numbers))
    finally:
        with _interrupts_held():
            store.flush()


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
            more = zip(range(len(running), 2 * width()), jobs, strict=False)
            running |= {executor.submit(job.run) for _, job in more}
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
    """Keep Ctrl-C and the like from what is done in here, and from processes that are started in here; this
    process handles them afterwards.

    Processes inherit the signal mask before Python starts in them. In this process another thread may still
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
