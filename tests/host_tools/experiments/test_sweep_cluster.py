"""Sweeps on a Dask cluster: the same bits as here, also when a worker dies."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common import versions
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import cluster as cluster_module
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import read_table
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.sweep import jobs_of, run_sweep
from support import ROOT

pytestmark = pytest.mark.slow

SLOW_EXPERIMENT = Experiment(firmware="mirror", robots=4, flawed=1, steps=200, filter_period=50, trials=12)
"""Each of its trials is a job of its own, as robots of the mirror, which is in Python, take long."""

PROGRAM_OF_A_CLUSTER = """\
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    workers = int(sys.argv[1])
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""
"""A scheduler and its worker processes, which end with the program's input."""


@contextmanager
def cluster_of(workers: int, folder: Path) -> Iterator[tuple[str, IO[str]]]:
    """Run a cluster of worker processes; gives the scheduler's address, and an input whose end ends it."""
    (folder / "cluster.py").write_text(PROGRAM_OF_A_CLUSTER, encoding="utf-8")
    command = [sys.executable, str(folder / "cluster.py"), str(workers)]
    pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=quiet, text=True, cwd=ROOT) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process.stdin
        finally:
            process.stdin.close()


@pytest.fixture(autouse=True, scope="module")
def skip_without_distributed() -> None:
    pytest.importorskip("distributed", reason="distributed is not installed: make setup")


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler that has one worker process; it outlives the tests that use it."""
    with cluster_of(workers=1, folder=tmp_path_factory.mktemp("cluster")) as (address, _):
        yield address


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A sweep of 12 jobs. No job has been run."""
    return Store(tmp_path / "x.parquet", [SLOW_EXPERIMENT])


def run_sweep_command(output: Path, *options: str, trials: int) -> None:
    """Run ``mcp-asdf sweep`` on a file of one experiment with so many trials; it must succeed."""
    path = output.with_suffix(".toml")
    path.write_text(f"robots = 4\nsteps = 300\nfilter_period = 100\ntrials = {trials}\n")
    assert cli.main(["sweep", str(path), "--output", str(output), *options]) == 0


def test_a_sweep_that_goes_on_on_a_cluster_gives_the_results_of_this_computer(
    scheduler: str, tmp_path: Path
) -> None:
    """The first 20 of 50 trials were run on this computer."""
    cluster_output = tmp_path / "cluster.parquet"
    local_output = tmp_path / "local.parquet"
    run_sweep_command(cluster_output, "--workers", "1", trials=20)
    run_sweep_command(cluster_output, "--scheduler", scheduler, trials=50)
    run_sweep_command(local_output, "--workers", "1", trials=50)

    assert read_table(cluster_output).equals(read_table(local_output))


def test_a_cluster_whose_workers_have_another_version_is_refused(
    store: Store, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This program takes itself for version 9.9.9, which the workers are not. It can run the jobs itself."""
    # The cached function itself is replaced: it may know the true version, and must not keep this one.
    monkeypatch.setattr(versions, "_version", lambda name: "9.9.9")
    first_job = next(jobs_of(store))
    assert first_job.run().experiment == SLOW_EXPERIMENT

    with pytest.raises(UsageError, match="install the same on all"):
        run_sweep(store, workers=1, scheduler=scheduler)


def test_trials_that_a_cluster_has_finished_are_kept_if_it_is_lost(tmp_path: Path) -> None:
    """The cluster ends when the sweep reports the first of 500 trials, each of which is a job."""
    experiment = replace(SLOW_EXPERIMENT, trials=500)
    store = Store(tmp_path / "long.parquet", [experiment])
    with cluster_of(workers=1, folder=tmp_path) as (scheduler, cluster_input):

        def end_cluster(_finished_trials: int) -> None:
            cluster_input.close()  # the cluster's program ends with its input

        with pytest.raises(UsageError, match="what was finished is kept"):
            run_sweep(store, workers=1, report=end_cluster, scheduler=scheduler)

    missing_on_disk = Store(store.output, [experiment]).missing_count
    assert missing_on_disk == store.missing_count
    assert 0 < missing_on_disk < 500


@pytest.mark.parametrize("error", [OSError("Timed out trying to connect"), TimeoutError("no answer")])
def test_a_scheduler_that_does_not_answer_any_more_is_reported_as_a_usage_error(
    error: OSError, scheduler: str
) -> None:
    """Dask raises these errors where a sweep asks a scheduler that is gone for its number of threads.

    Here the error is raised while the sweep is connected to a scheduler that is still there.
    """
    with (
        pytest.raises(UsageError, match="what was finished is kept"),
        cluster_module.connect_cluster(scheduler),
    ):
        raise error


def test_a_result_that_dask_loses_with_the_cluster_is_reported_as_a_usage_error(tmp_path: Path) -> None:
    """If a result comes just when the cluster is lost, Dask raises a TypeError in its place.

    Here the test raises this error itself, when the cluster is lost.
    """
    with (
        cluster_of(workers=1, folder=tmp_path) as (scheduler, cluster_input),
        pytest.raises(UsageError, match="what was finished is kept"),
        cluster_module.connect_cluster(scheduler) as (executor, _thread_count),
    ):
        cluster_input.close()  # the cluster's program ends with its input
        while executor._client.status == "running":  # type: ignore[attr-defined]
            time.sleep(0.01)  # until Dask notices
        raise TypeError("cannot unpack non-iterable Trials object")


def test_a_type_error_of_a_job_is_not_taken_for_a_lost_cluster(scheduler: str) -> None:
    """The error is in an extension of the user's. The user has to see where, so it is not replaced."""
    with (
        pytest.raises(TypeError, match="unsupported operand"),
        cluster_module.connect_cluster(scheduler),
    ):
        raise TypeError("unsupported operand")


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "nonsense://x", "", "127.0.0.1:b", "tls://127.0.0.1:1", "inproc://x"]
)
def test_an_address_at_which_there_is_no_scheduler_is_refused(
    address: str, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program waits for an answer, here only for a second."""
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with pytest.raises(UsageError, match="no Dask scheduler at"):
        run_sweep(store, workers=1, scheduler=address)


def test_a_cluster_without_workers_is_refused_with_the_command_that_starts_some(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program waits for workers, here only for a second."""
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with (
        cluster_of(workers=0, folder=tmp_path) as (scheduler, _cluster_input),
        pytest.raises(UsageError) as refusal,
    ):
        run_sweep(store, workers=1, scheduler=scheduler)
    assert f"at {scheduler} has no workers; start some: dask worker {scheduler}" in str(refusal.value)
