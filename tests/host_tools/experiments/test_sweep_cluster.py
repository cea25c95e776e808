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


def test_the_cluster_runs_what_is_missing_and_keeps_it_when_lost(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sweep(count: int, output: Path, *arguments: str) -> None:
        path = tmp_path / "grid.toml"
        path.write_text(f"robots = 4\nsteps = 300\nfilter_period = 100\ntrials = {count}\n")
        assert cli.main(["sweep", str(path), "--output", str(output), *arguments]) == 0

    here, there = tmp_path / "here.parquet", tmp_path / "there.parquet"
    with cluster_of(1, tmp_path) as (address, end):
        sweep(20, there, "--workers", "1")
        sweep(50, there, "--scheduler", address)
        sweep(50, here, "--workers", "1")
        assert read_table(there).equals(read_table(here))
        with monkeypatch.context() as patch:
            patch.setattr(versions, "metadata", SimpleNamespace(version=lambda name: "9.9.9"))
            assert next(jobs_of(store)).run().experiment == SLOW
            with pytest.raises(UsageError, match="install the same on all"):
                run_sweep(store, 1, scheduler=address)
        long = replace(SLOW, trials=500)
        long_sweep = Store(tmp_path / "long.parquet", [long])
        with pytest.raises(UsageError, match="what was finished is kept"):
            run_sweep(long_sweep, 1, report=lambda _: end.close(), scheduler=address)
    assert 0 < Store(long_sweep.output, [long]).missing_count == long_sweep.missing_count < long.trials


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
def test_no_scheduler_is_told(address: str, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with pytest.raises(UsageError, match="no Dask scheduler at"):
        run_sweep(store, 1, scheduler=address)


def test_no_workers_are_told(store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1)
    with cluster_of(0, tmp_path) as (address, _):
        words = f"at {address} has no workers; start some: dask worker {address}"
        with pytest.raises(UsageError, match=words):
            run_sweep(store, 1, scheduler=address)
