"""Run many experiments on all processors or a cluster, in jobs whose results come in as they are finished.

A job is some consecutive trials of one experiment, which one process runs at a time.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.signals import ENDING_SIGNALS, stopping
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.trials import Job

if TYPE_CHECKING:
    from mcp_asdf_tools.experiments.store import Store

_logger = logging.getLogger(__name__)

_TRIALS_OF_LONG_JOB = 32
"""Trials of a job whose trials are long: twice as many as the engine runs side by side."""

_MAX_TRIALS_OF_JOB = 1000
"""Largest number of trials in a job, however short they are."""

_ROBOT_STEPS_OF_SHORT_JOB = 1_000_000
"""Robot steps (robots times steps times trials) that a job of short trials has. So it has more trials than a
job of long ones, as starting a job takes time, too."""

_MAX_BYTES_OF_JOB = 80_000_000
"""Largest size of the estimates and the recorded values in a job of several trials."""

_BYTES_OF_ESTIMATE = 4
"""Bytes that the engine keeps of each robot in each step until the trials are measured."""

_BYTES_OF_SAMPLE = 8 * len(QUANTITIES)
"""Bytes of all quantities of a robot in a recorded step."""

Report = Callable[[int], None]
"""Called with the number of trials that have just been finished."""


def _ignore_progress(finished_trials: int) -> None:
    """Do nothing: the Report of a caller that wants none."""


def run_sweep(
    store: Store, workers: int, report: Report = _ignore_progress, scheduler: str | None = None
) -> None:
    """Run the trials that are missing in the store, and write its output file if it has one.

    They run on ``workers`` processes, 1 being this one, or with the address of a ``scheduler`` on that Dask
    cluster. ``report`` is called after each job with the number of its trials. KeyboardInterrupt ends it at
    once; as after any error, what was finished is on disk. Raises UsageError if a job cannot be run, a worker
    process of this machine dies, or another process is at work on the output. Interrupts are delayed while
    the store changes, so that it is never left in between.
    """
    try:
        if store.missing_count:
            runners = f"{workers} processes" if workers > 1 else "this process"
            if scheduler is not None:
                runners = f"the cluster {scheduler}"
            _logger.info("%d trials to run on %s", store.missing_count, runners)
            store.reserve()
            for trials in run_jobs(jobs_of(store), workers, scheduler):
                with _interrupts_delayed():
                    store.add(trials)
                first, last = trials.numbers[0], trials.numbers[-1]
                _logger.debug("finished trials %d to %d of %s", first, last, trials.experiment)
                report(len(trials.numbers))
        store.finish()
    except BaseException:  # Ctrl-C must not lose what was finished, either
        with _interrupts_delayed():
            store.flush()
        raise


# --- Jobs ------------------------------------------------------------------------------------------------


def jobs_of(store: Store) -> Iterator[Job]:
    """Yield jobs that together run the trials that are missing in the store, experiment by experiment."""
    for experiment in store.experiments:
        yield from jobs_of_experiment(experiment, store.missing(experiment), store.sampling_interval)


def jobs_of_experiment(
    experiment: Experiment, trial_numbers: NDArray[np.int64], sampling_interval: int
) -> Iterator[Job]:
    """Yield jobs that together run the trials of these numbers, which are ascending.

    A job's trials have consecutive numbers, as many as one job may run. Values of robots are recorded every
    ``sampling_interval`` steps, or never if it is 0.
    """
    max_count = _max_trials_of_job(experiment, sampling_interval)
    # Where the difference of two neighbours is not 1, numbers are missing between them, and the second of the
    # two begins a new piece.
    has_gap_behind = np.diff(trial_numbers) != 1
    piece_starts = np.flatnonzero(has_gap_behind) + 1  # as indices
    for consecutive_numbers in np.split(trial_numbers, piece_starts):
        for start in range(0, len(consecutive_numbers), max_count):
            numbers = consecutive_numbers[start : start + max_count]
            yield Job(experiment, int(numbers[0]), len(numbers), sampling_interval)


def _max_trials_of_job(experiment: Experiment, sampling_interval: int) -> int:
    """Return the largest number of trials, 1 or more, that one job of the experiment runs.

    It is smaller the more robots, steps and recorded values a trial has. On any firmware but
    "native" it is 1, as these trials run in Python and each takes long.
    """
    if experiment.firmware != "native":
        return 1
    trials_of_short_job = _ROBOT_STEPS_OF_SHORT_JOB // (experiment.robots * experiment.steps)
    samples = experiment.steps // sampling_interval if sampling_interval else 0
    bytes_of_robot = _BYTES_OF_ESTIMATE * experiment.steps + _BYTES_OF_SAMPLE * samples
    trials_in_memory = _MAX_BYTES_OF_JOB // (experiment.robots * bytes_of_robot)
    # A job has as many trials as make a short job, but at least as many as a long job.
    preferred_trials = max(_TRIALS_OF_LONG_JOB, trials_of_short_job)
    allowed_trials = min(_MAX_TRIALS_OF_JOB, trials_in_memory)
    return max(1, min(preferred_trials, allowed_trials))


def run_jobs(jobs: Iterator[Job], workers: int, scheduler: str | None = None) -> Iterator[Trials]:
    """Run jobs in this process, on ``workers`` processes or on a cluster, and yield results as they come.

    With the address of a Dask ``scheduler`` they run on its cluster, whatever ``workers`` is; with one worker
    they run in this process, in their order. Raises UsageError if a job cannot be run, a worker process is
    killed, or the cluster cannot be reached or is lost.
    """
    if scheduler is not None:
        from mcp_asdf_tools.experiments.cluster import connect_cluster  # noqa: PLC0415 (Dask loads slowly)

        # The cluster is asked again and again for its threads: workers may join and leave meanwhile.
        with connect_cluster(scheduler) as (executor, count_threads):
            yield from _run_on_executor(executor, count_threads, jobs)
    elif workers == 1:
        for job in jobs:
            yield job.run()
    else:
        with _worker_processes(workers) as executor:
            yield from _run_on_executor(executor, lambda: workers, jobs)


def _run_on_executor(
    executor: Executor, count_workers: Callable[[], int], jobs: Iterator[Job]
) -> Iterator[Trials]:
    """Run jobs on an executor and yield results as they come.

    ``count_workers`` returns how many jobs run at once at present; as many again are queued, so that no
    worker waits for the next job. What a job raises is raised here.
    """
    submitted: set[Future[Trials]] = set()
    while True:
        # Submitting may start worker processes, which must not receive interrupts.
        with _interrupts_delayed():
            wanted_jobs = 2 * count_workers()
            # The difference is negative if a cluster has lost workers since the last jobs were submitted.
            missing_jobs = max(0, wanted_jobs - len(submitted))
            next_jobs = islice(jobs, missing_jobs)  # or fewer, if these are the last ones
            submitted |= {executor.submit(job.run) for job in next_jobs}
        if not submitted:
            return
        done, submitted = wait(submitted, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


# --- Processes -------------------------------------------------------------------------------------------


@contextmanager
def _worker_processes(workers: int) -> Iterator[Executor]:
    """Start processes of this machine, which end with this context, or with this process however it dies.

    Raises UsageError if one of them is killed.
    """
    other_children = set(active_children())  # the caller's own, which must not be killed below
    # Workers are started anew, not forked: a fork copies locks that another thread may hold at that moment.
    context = get_context("spawn")
    pool = ProcessPoolExecutor(max_workers=workers, mp_context=context, initializer=end_with_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise UsageError(
            "a worker process was killed; what was finished is kept: run the same again"
        ) from error
    finally:
        for process in set(active_children()) - other_children:
            # terminate() would send a signal that workers delay; they have nothing to save.
            process.kill()
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """Let this worker process end with the one that started it, however that dies.

    Starts a thread that waits for the parent's end. Must be called in a process that multiprocessing started.
    """
    parent = parent_process()
    assert parent is not None

    def wait_for_parent() -> None:
        """Wait until the parent has ended, and end this process."""
        parent.join()
        # sys.exit would end this thread alone.
        os._exit(1)

    Thread(target=wait_for_parent, daemon=True).start()


@contextmanager
def _interrupts_delayed() -> Iterator[None]:
    """Delay Ctrl-C and the like until this context ends, and keep them from processes that start in it.

    If a signal came meanwhile, it takes effect at the end, as Ctrl-C.
    """
    with stopping() as is_stop_requested:  # a signal is only noted, whichever thread receives it
        # This thread receives none: processes that it starts inherit that, from their first moment.
        previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)
    if is_stop_requested():
        # Now the interrupt that was delayed takes place.
        signal.raise_signal(signal.SIGINT)
