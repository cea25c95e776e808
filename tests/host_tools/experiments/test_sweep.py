"""Sweeps: nothing is lost or run twice, however they end; and the commands around them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import sweep
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials, experiments_in, read_table
from mcp_asdf_tools.experiments.sweep import Store, identity, jobs_of, run_sweep
from mcp_asdf_tools.experiments.trials import Job
from mcp_asdf_tools.robots.population import Filtering
from support import PATIENCE, ROOT, interruptible, slow

GRID = [
    Experiment(robots=4, flawed=flawed, filter=mode, steps=300, filter_period=100, trials=40)
    for flawed in (1, 2)
    for mode in get_args(Filtering)
]
FILE = """\
robots = 4
steps = 300
filter_period = 100
trials = 3
flawed = [1, 2]
filter = ["none", "asdf-minus", "asdf-plus"]
"""


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "grid.parquet"


@pytest.fixture
def jobs_run(monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """The jobs that are run in this process, as they start."""
    started: list[Job] = []
    run = Job.run

    def noted(job: Job) -> Trials:
        started.append(job)
        return run(job)

    monkeypatch.setattr(Job, "run", noted)
    return started


def interrupt_after(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Make the job after ``count`` jobs end in Ctrl-C."""
    run, left = Job.run, iter(range(count))

    def interrupted(job: Job) -> Trials:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return run(job)

    monkeypatch.setattr(Job, "run", interrupted)


# --- Jobs ------------------------------------------------------------------------------------------------


def test_jobs_are_every_trial_once(output: Path) -> None:
    jobs = list(jobs_of(Store(output, GRID)))
    trials = [(job.experiment, job.first + i) for job in jobs for i in range(job.count)]
    assert trials == [(experiment, trial) for experiment in GRID for trial in range(40)]
    assert max(job.count for job in jobs) == 32


def test_jobs_of_slow_firmwares_and_long_trials_are_single_trials(output: Path) -> None:
    for change in (replace(GRID[0], firmware="mirror"), replace(GRID[0], steps=10**7)):
        assert {job.count for job in jobs_of(Store(output, [change]))} == {1}


def test_identity_is_all_that_a_trial_depends_on() -> None:
    base = GRID[0]
    assert identity(base, 0) == identity(replace(base, trials=99), 0)
    changed = [replace(base, seed=2), replace(base, fill_ratio=0.56), replace(base, firmware="mirror")]
    assert len({identity(base, 0), identity(base, 10), *(identity(each, 0) for each in changed)}) == 5


# --- Nothing lost, nothing twice ---------------------------------------------------------------------------


def test_a_sweep_that_was_interrupted_can_be_read_and_goes_on(
    output: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = run_sweep(Store(tmp_path / "whole.parquet", GRID), 1)
    with monkeypatch.context() as patch:
        interrupt_after(patch, 5)
        with pytest.raises(KeyboardInterrupt):
            run_sweep(Store(output, GRID), 1)
    assert not output.exists()
    store = Store(output, GRID)
    assert cli.main(["score", str(store.parts)]) == 0
    assert "32 of 40" in capsys.readouterr().out
    assert cli.main(["score", str(output)]) == 2
    assert f"its sweep is not finished, partial data is in {store.parts}" in capsys.readouterr().err
    assert len(list(jobs_of(store))) == 12 - 5
    assert run_sweep(store, 1).equals(whole)
    assert read_table(output).equals(read_table(tmp_path / "whole.parquet"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["grid.parquet", "whole.parquet"]


def test_a_finished_sweep_runs_nothing(output: Path, jobs_run: list[Job]) -> None:
    first = run_sweep(Store(output, GRID), 1)
    jobs_run.clear()
    assert run_sweep(Store(output, GRID), 1).equals(first)
    assert jobs_run == []


def test_more_trials_and_experiments_run_what_is_new(output: Path, jobs_run: list[Job]) -> None:
    run_sweep(Store(output, GRID[:1]), 1)
    jobs_run.clear()
    more = [replace(GRID[0], trials=45), GRID[1]]
    table = run_sweep(Store(output, more), 1)
    assert [(job.first, job.count) for job in jobs_run] == [(40, 5), (0, 32), (32, 8)]
    assert [trials.experiment for trials in experiments_in(table)] == more


def test_gaps_are_filled(output: Path, jobs_run: list[Job]) -> None:
    experiment = replace(GRID[0], trials=10)
    store = Store(output, [experiment])
    for first, count in ((2, 3), (7, 1)):
        job = Job(experiment, first, count)
        store.add(job.run())
    jobs_run.clear()
    run_sweep(Store(output, [experiment]), 1)
    assert [(job.first, job.count) for job in jobs_run] == [(0, 2), (5, 2), (8, 2)]


def test_half_a_file_that_a_kill_left_does_no_harm(output: Path) -> None:
    parts = output.with_name("grid.parquet.parts")
    parts.mkdir()
    (parts / ".x-0-32.parquet.0123abcd.tmp").write_bytes(b"PAR1")
    assert len(run_sweep(Store(output, GRID[:1]), 1)) == 40
    assert not parts.exists()


def test_results_of_others_are_never_overwritten(output: Path) -> None:
    run_sweep(Store(output, GRID[:2]), 1)
    before = output.read_bytes()
    for others, sampling_interval in (
        (GRID[:1], 0),
        (GRID[2:3], 0),
        ([replace(GRID[0], trials=39), GRID[1]], 0),
        (GRID[:2], 5),
    ):
        with pytest.raises(UsageError, match="choose another name"):
            Store(output, others, sampling_interval)
    assert output.read_bytes() == before


def test_workers_give_what_one_process_gives(output: Path, tmp_path: Path) -> None:
    reported: list[int] = []
    many = run_sweep(Store(output, GRID), 2, report=reported.append)
    assert many.equals(run_sweep(Store(tmp_path / "one.parquet", GRID), 1))
    assert sum(reported) == 40 * len(GRID)


def test_an_error_in_a_worker_is_told(output: Path) -> None:
    with pytest.raises(UsageError, match="a worker process was killed"):
        run_sweep_of_deaths(output)
    assert len(list(jobs_of(Store(output, GRID)))) == 12


class Deadly(Job):
    """A job that kills the process that runs it."""

    def run(self) -> Trials:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


def run_sweep_of_deaths(output: Path) -> None:
    store = Store(output, GRID)
    deadly = (Deadly(job.experiment, job.first, job.count) for job in jobs_of(store))
    with sweep._processes(2) as executor:
        for trials in sweep._run_on(executor, lambda: 2, deadly):
            store.add(trials)


# --- Commands --------------------------------------------------------------------------------------------


@pytest.fixture
def grid_file(tmp_path: Path) -> Path:
    path = tmp_path / "grid.toml"
    path.write_text(FILE, encoding="utf-8")
    return path


def answer(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict[str, object]:
    assert cli.main([*map(str, arguments), "--json"]) == 0
    content: dict[str, object] = json.loads(capsys.readouterr().out)
    return content


def test_sweep_score_and_plot(grid_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "sweep", grid_file, "--workers", "1")
    assert found["run"] == 18
    assert answer(capsys, "sweep", grid_file, "--workers", "1")["run"] == 0
    results = grid_file.with_suffix(".parquet")
    scored = answer(capsys, "score", results, "--csv", results.with_suffix(".csv"))
    assert scored["experiments"] == found["experiments"]
    other = answer(capsys, "score", results, "--k-max", "300", "--e-max", "0.5")["experiments"]
    assert isinstance(other, list)
    assert all(each["limits"] == {"k_max": 300, "e_max": 0.5} for each in other)
    assert len(results.with_suffix(".csv").read_text().splitlines()) == 19


def test_simulate_is_the_sweep_of_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--steps", "200", "--trials", "4", "--robots", "5", "--flawed", "40%"]
    found = answer(capsys, "simulate", *options, "--filter-period", "50", "--omega", "0.1")
    parameters = found["parameters"]
    assert isinstance(parameters, dict)
    assert (parameters["flawed"], parameters["filter_period"], parameters["omega"]) == (2, 50, 0.1)
    assert found["limits"] == {"k_max": 200, "e_max": 0.45}
    assert list(tmp_path.iterdir()) == []


def test_simulate_takes_a_file_and_options_over_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.toml"
    path.write_text("steps = 100\nrobots = 3\nflawed = 1\n")
    found = answer(capsys, "simulate", path, "--robots", "6", "--output", tmp_path / "one.parquet")
    parameters = found["parameters"]
    assert isinstance(parameters, dict)
    assert (parameters["steps"], parameters["robots"], parameters["flawed"]) == (100, 6, 1)
    assert len(read_table(tmp_path / "one.parquet")) == 30


def test_tables_for_people_name_what_varies(grid_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sweep", str(grid_file), "--workers", "1"]) == 0
    out = capsys.readouterr().out
    for word in ("flawed", "filter", "asdf-minus", "h_K", "e_max"):
        assert word in out
    assert "robots" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "--robots", "0"], "--robots is 0; it must be 1 to 128"),
        (["simulate", "--omega", "2"], "omega is 2"),
        (["simulate", "--flawed", "2.5"], "--flawed is '2.5'; give a count"),
        (["simulate", "--filter", "none", "--omega", "0.1"], "--omega would do nothing: filter is none"),
        (["simulate", "--workers", "0"], "--workers is 0"),
        (["simulate", "--record", "-1"], "--record is -1"),
        (["simulate", "--output", "results.csv"], "ends in .parquet"),
        (["simulate", "--output", "no/such/folder/r.parquet"], "its folder does not exist"),
        (["simulate", "--steps", "10", "--k-max", "0"], "K_max is 0"),
        (["simulate", "dynamic"], "run it with mcp-asdf sweep"),
        (["sweep", "absent.toml"], "cannot read"),
        (["score", "absent.parquet"], "cannot read"),
        (["plot", "absent.parquet", "x.gif"], "ends in"),
    ],
)
def test_bad_usage_is_told(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments) == 2
    assert words in capsys.readouterr().err


@pytest.fixture
def slow_sweep(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A sweep that takes long, in a process group of its own as in a terminal."""
    (tmp_path / "slow.toml").write_text("firmware = 'mirror'\nsteps = 400\ntrials = 400\nrobots = 4\n")
    command = [
        sys.executable,
        "-m",
        "mcp_asdf_tools.cli.main",
        "sweep",
        str(tmp_path / "slow.toml"),
        "--workers",
        "2",
    ]
    with interruptible():
        process = subprocess.Popen(
            command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
    yield process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


@pytest.mark.parametrize("number", [signal.SIGTERM, *slow([signal.SIGINT])])
def test_a_signal_keeps_what_is_finished(
    number: signal.Signals, slow_sweep: subprocess.Popen[str], tmp_path: Path
) -> None:
    parts = tmp_path / "slow.parquet.parts"
    deadline = time.monotonic() + PATIENCE
    while len(list(parts.glob("*.parquet"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(slow_sweep.pid, number)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)
    assert slow_sweep.returncode == 128 + number
    assert "the same command goes on" in errors
    assert "Traceback" not in errors
    done = sum(len(read_table(path)) for path in parts.glob("*.parquet"))
    (experiment,) = {job.experiment for job in jobs_of(Store(tmp_path / "slow.parquet", [slow_experiment()]))}
    assert 400 - done == len(Store(tmp_path / "slow.parquet", [experiment]).missing(experiment))
    assert done >= 3


def test_ctrl_c_does_not_disturb_workers_that_start(slow_sweep: subprocess.Popen[str]) -> None:
    children = Path(f"/proc/{slow_sweep.pid}/task/{slow_sweep.pid}/children")
    if not children.exists():
        pytest.skip("the kernel does not list the children of a process")
    deadline = time.monotonic() + PATIENCE
    while not any(map(is_worker, children.read_text().split())) and time.monotonic() < deadline:
        time.sleep(0.001)
    os.killpg(slow_sweep.pid, signal.SIGINT)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)
    assert slow_sweep.returncode == 130
    assert "Traceback" not in errors


@pytest.mark.slow
def test_workers_end_with_a_sweep_that_is_killed(slow_sweep: subprocess.Popen[str]) -> None:
    children = Path(f"/proc/{slow_sweep.pid}/task/{slow_sweep.pid}/children")
    if not children.exists():
        pytest.skip("the kernel does not list the children of a process")
    deadline = time.monotonic() + PATIENCE
    while len(workers := list(filter(is_worker, children.read_text().split()))) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    slow_sweep.kill()
    while any(map(is_worker, workers)) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not any(map(is_worker, workers))


def test_workers_start_from_another_thread_too(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as thread:
        table = thread.submit(run_sweep, Store(tmp_path / "grid.parquet", GRID), 2).result()
    assert table.equals(run_sweep(Store(tmp_path / "again.parquet", GRID), 1))


def is_worker(process: str) -> bool:
    try:
        return b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:  # it has ended
        return False


def slow_experiment() -> Experiment:
    return Experiment(firmware="mirror", steps=400, trials=400, robots=4)
