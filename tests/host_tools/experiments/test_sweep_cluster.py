"""Sweeps on a Dask cluster: the same bits as here, also when a worker dies."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
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

SLOW = Experiment(firmware="mirror", robots=4, flawed=1, steps=200, filter_period=50, trials=12)
"""Its jobs are single trials."""

CLUSTER = """\
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    workers = int(sys.argv[1])
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""
"""Worker processes, until the input ends."""


@contextmanager
def cluster_of(workers: int, folder: Path) -> Iterator[tuple[str, IO[str]]]:
    """A cluster of this many processes; gives the scheduler's address and what ends it when closed."""
    (folder / "cluster_module.py").write_text(CLUSTER, encoding="utf-8")
    command = [sys.executable, str(folder / "cluster_module.py"), str(workers)]
    pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=quiet, text=True, cwd=ROOT) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process.stdin
        finally:
            process.stdin.close()


@pytest.fixture
def store(tmp_path: Path) -> Store:
    pytest.importorskip("distributed", reason="distributed is not installed: make setup")
    return Store(tmp_path / "x.parquet", [SLOW])


def run_sweep_command(trials: int, output: Path, *options: str) -> None:
    """Run ``mcp-asdf sweep`` on a file of one experiment with so many trials."""
    path = output.with_suffix(".toml")
    path.write_text(f"robots = 4\nsteps = 300\nfilter_period = 100\ntrials = {trials}\n")
    assert cli.main(["sweep", str(path), "--output", str(output), *options]) == 0


@pytest.mark.usefixtures("store")
def test_a_cluster_goes_on_with_a_sweep_and_gives_the_same_bits_as_this_computer(tmp_path: Path) -> None:
    here, there = tmp_path / "here.parquet", tmp_path / "there.parquet"
    with cluster_of(1, tmp_path) as (address, _):
        run_sweep_command(20, there, "--workers", "1")
        run_sweep_command(50, there, "--scheduler", address)
    run_sweep_command(50, here, "--workers", "1")

    assert read_table(there).equals(read_table(here))


def test_a_cluster_with_another_version_is_refused(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This program takes itself for version 9.9.9, which the workers are not."""
    with cluster_of(1, tmp_path) as (address, _):
        monkeypatch.setattr(versions, "metadata", SimpleNamespace(version=lambda name: "9.9.9"))
        assert next(jobs_of(store)).run().experiment == SLOW

        with pytest.raises(UsageError, match="install the same on all"):
            run_sweep(store, 1, scheduler=address)


def test_what_a_cluster_has_finished_is_kept_when_it_is_lost(tmp_path: Path, store: Store) -> None:
    """The cluster ends when the first trials have come back."""
    long = replace(SLOW, trials=500)
    long_sweep = Store(tmp_path / "long.parquet", [long])
    with (
        cluster_of(1, tmp_path) as (address, end),
        pytest.raises(UsageError, match="what was finished is kept"),
    ):
        run_sweep(long_sweep, 1, report=lambda _: end.close(), scheduler=address)

    missing_count = Store(long_sweep.output, [long]).missing_count
    assert 0 < missing_count < long.trials
    assert missing_count == long_sweep.missing_count


@pytest.mark.parametrize("error", [OSError("Timed out trying to connect"), TimeoutError("no answer")])
def test_a_scheduler_that_does_not_answer_any_more_is_a_lost_cluster(
    error: OSError, store: Store, tmp_path: Path
) -> None:
    """Dask raises these where it asks a scheduler that is gone for its number of threads."""
    with (
        cluster_of(1, tmp_path) as (address, _),
        pytest.raises(UsageError, match="what was finished is kept"),
        cluster_module.connect_cluster(address),
    ):
        raise error


@pytest.mark.parametrize(
    "address",
    ["tcp://127.0.0.1:1", "nonsense://x", "", "127.0.0.1:b", "tls://127.0.0.1:1", "inproc://x"],
)
def test_an_address_without_a_scheduler_is_refused(
    address: str, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with pytest.raises(UsageError, match="no Dask scheduler at"):
        run_sweep(store, 1, scheduler=address)


def test_a_cluster_without_workers_is_refused_with_the_command_that_starts_some(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with cluster_of(0, tmp_path) as (address, _):
        words = f"at {address} has no workers; start some: dask worker {address}"
        with pytest.raises(UsageError, match=words):
            run_sweep(store, 1, scheduler=address)
