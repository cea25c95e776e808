"""Sweeps: nothing is lost or run twice, however they end; and the commands around them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common import progress_bar
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import result_files, sweep
from mcp_asdf_tools.experiments import store as store_module
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import read_table, stream_experiments
from mcp_asdf_tools.experiments.result_tables import experiments_in, trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.sweep import jobs_of, run_sweep
from mcp_asdf_tools.experiments.trials import Job
from mcp_asdf_tools.robots.filters import FILTERS
from support import PATIENCE, ROOT, interruptible, slow, wait_until
from trials import record_jobs

GRID = [
    Experiment(robots=4, flawed=flawed, filter=filter_name, steps=8000, trials=40)
    for flawed in (1, 2)
    for filter_name in FILTERS
]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "grid.parquet"


@pytest.fixture
def jobs_run(monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """The jobs that this process runs; Ctrl-C interrupts the sixth unless the list is cleared before."""
    return record_jobs(monkeypatch, max_jobs=5)


# --- Jobs ------------------------------------------------------------------------------------------------


def test_every_trial_of_a_sweep_is_in_one_job(output: Path) -> None:
    """A job is a number of trials that a worker process runs together."""
    jobs = list(jobs_of(Store(output, GRID, sampling_interval=7)))
    trials = [(job.experiment, job.first + index) for job in jobs for index in range(job.count)]
    assert trials == [(experiment, trial) for experiment in GRID for trial in range(40)]
    assert {job.sampling_interval for job in jobs} == {7}


@pytest.mark.parametrize(
    ("changes", "trials_of_jobs"),
    [
        ({}, [32, 8]),  # 40 trials of 8,000 steps
        ({"firmware": "mirror", "trials": 2}, [1, 1]),  # slow, as it runs in Python
        ({"steps": 10**7, "trials": 2}, [1, 1]),
        ({"steps": 300, "filter_period": 100, "trials": 1200}, [833, 367]),  # 833 * 300 are 250,000 steps
        ({"steps": 2_500_000, "trials": 3}, [2, 1]),
    ],
)
def test_jobs_have_more_trials_the_shorter_these_are(
    changes: dict[str, Any], trials_of_jobs: list[int]
) -> None:
    """A job is what a worker process runs at once: one trial at least, and more where they are short."""
    experiment = replace(GRID[0], **changes)
    jobs = sweep.jobs_of_experiment(experiment, range(experiment.trials), sampling_interval=0)
    assert [job.count for job in jobs] == trials_of_jobs


def test_jobs_leave_out_the_trials_between_missing_ones() -> None:
    missing_trials = [0, 1, 5, 7, 8, 9]
    jobs = sweep.jobs_of_experiment(GRID[0], missing_trials, sampling_interval=0)
    assert [(job.first, job.count) for job in jobs] == [(0, 2), (5, 1), (7, 3)]


def test_a_job_of_another_version_is_refused() -> None:
    with pytest.raises(UsageError, match=r"a worker has mcp-asdf .*, this is 9\.9\.9; install the same"):
        Job(GRID[0], 0, 1, version="9.9.9").run()


# --- Nothing lost, nothing twice ---------------------------------------------------------------------------


@pytest.fixture
def interrupted_sweep(output: Path, jobs_run: list[Job]) -> Store:
    """A sweep of three experiments whose last job was interrupted, opened again."""
    with pytest.raises(KeyboardInterrupt):
        run_sweep(Store(output, GRID[:3]), 1)
    jobs_run.clear()
    return Store(output, GRID[:3])


def test_the_parts_of_an_interrupted_sweep_can_be_scored(
    interrupted_sweep: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    """It had run 32 trials of the third experiment when Ctrl-C came."""
    assert cli.main(["score", str(interrupted_sweep.parts)]) == 0
    assert "32 of 40" in capsys.readouterr().out


def test_the_missing_output_of_an_interrupted_sweep_is_explained(
    interrupted_sweep: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["score", str(interrupted_sweep.output)]) == 2
    parts = interrupted_sweep.parts
    assert f"its sweep is not finished, partial data is in {parts}" in capsys.readouterr().err


def test_an_interrupted_sweep_runs_only_what_is_missing(
    interrupted_sweep: Store, jobs_run: list[Job]
) -> None:
    """Of its last experiment 32 of 40 trials were run: those from 32 on are missing."""
    run_sweep(interrupted_sweep, 1)

    assert [(job.first, job.count) for job in jobs_run] == [(32, 8)]
    experiments = experiments_in(read_table(interrupted_sweep.output))
    for trials, experiment in zip(experiments, GRID[:3], strict=True):
        assert trials.experiment == experiment
        assert (trials.errors == Job(experiment, first=0, count=40).run().errors).all()


def test_a_finished_sweep_leaves_its_output_alone_in_the_folder(
    interrupted_sweep: Store, tmp_path: Path
) -> None:
    """Neither parts nor the draft of a file, which a killed process left there."""
    cut_off_draft = interrupted_sweep.parts / ".0123abcd.tmp"
    cut_off_draft.write_bytes(b"PAR1")
    run_sweep(interrupted_sweep, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["grid.parquet"]


def test_a_sweep_with_gaps_runs_the_trials_in_the_gaps(output: Path, jobs_run: list[Job]) -> None:
    """Trials 2 to 4 and 7 of 10 are there."""
    store = Store(output, GRID[:1])
    store.add(Job(GRID[0], first=2, count=3).run())
    store.add(Job(GRID[0], first=7, count=1).run())
    store.flush()
    jobs_run.clear()

    run_sweep(Store(output, [replace(GRID[0], trials=10)]), 1)

    assert [(job.first, job.count) for job in jobs_run] == [(0, 2), (5, 2), (8, 2)]


def test_a_finished_sweep_is_not_run_again(output: Path, jobs_run: list[Job]) -> None:
    run_sweep(Store(output, GRID[:1]), 1)
    table = read_table(output)
    jobs_run.clear()
    run_sweep(Store(output, GRID[:1]), 1)

    assert jobs_run == []
    assert read_table(output).equals(table)


def test_a_larger_sweep_runs_only_new_trials_and_experiments(output: Path, jobs_run: list[Job]) -> None:
    """Ten trials of one experiment are there; then 15 are wanted, and 33 of another one."""
    run_sweep(Store(output, [replace(GRID[0], trials=10)]), 1)
    jobs_run.clear()
    larger = [replace(GRID[0], trials=15), replace(GRID[1], trials=33)]
    run_sweep(Store(output, larger), 1)

    assert [(job.first, job.count) for job in jobs_run] == [(10, 5), (0, 32), (32, 1)]
    assert [trials.experiment for trials in experiments_in(read_table(output))] == larger


@pytest.mark.parametrize(
    ("experiments", "sampling_interval"),
    [
        (GRID[:1], 0),
        ([replace(experiment, seed=2) for experiment in GRID[:2]], 0),
        ([replace(GRID[0], trials=39), GRID[1]], 0),
        (GRID[:2], 5),
    ],
    ids=["fewer experiments", "another seed", "fewer trials", "with records"],
)
def test_results_of_another_sweep_are_never_overwritten(
    experiments: list[Experiment], sampling_interval: int, output: Path
) -> None:
    run_sweep(Store(output, GRID[:2]), 1)
    before = output.read_bytes()

    with pytest.raises(UsageError, match="choose another name"):
        Store(output, experiments, sampling_interval)
    assert output.read_bytes() == before


def test_results_of_another_version_are_never_overwritten(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_sweep(Store(output, GRID[:2]), 1)
    monkeypatch.setattr(store_module, "software_versions", lambda: {"mcp-asdf": "9.9.9"})
    with pytest.raises(UsageError, match="other experiments, recordings or versions"):
        Store(output, GRID[:2])


def test_worker_processes_started_from_a_thread_give_the_results_of_one_process(
    output: Path, tmp_path: Path
) -> None:
    reported_trials: list[int] = []
    with ThreadPoolExecutor(1) as thread:
        thread.submit(run_sweep, Store(output, GRID), workers=2, report=reported_trials.append).result()
    run_sweep(Store(tmp_path / "one.parquet", GRID), workers=1)

    assert read_table(output).equals(read_table(tmp_path / "one.parquet"))
    assert sum(reported_trials) == 40 * len(GRID)


def test_results_in_memory_are_those_of_a_file(output: Path) -> None:
    run_sweep(Store(output, GRID[:2]), 1)
    tables = [trials_to_table(trials) for trials in sweep.run_in_memory(GRID[:2])]
    assert pa.concat_tables(tables).combine_chunks().equals(read_table(output).combine_chunks())


class DeadlyJob(Job):
    """A job that kills the process that runs it."""

    def run(self) -> Trials:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


def test_a_worker_that_is_killed_ends_the_sweep_with_an_error(output: Path) -> None:
    deadly_jobs = (DeadlyJob(job.experiment, job.first, job.count) for job in jobs_of(Store(output, GRID)))
    with pytest.raises(UsageError, match="a worker process was killed"):
        list(sweep.run_jobs(deadly_jobs, workers=2))


# --- The store -------------------------------------------------------------------------------------------


def row_counts(folder: Path) -> list[int]:
    """Return the number of rows of each file of results in a folder."""
    return [pq.read_metadata(path).num_rows for path in sorted(folder.glob("*.parquet"))]


def test_a_short_sweep_writes_its_output_and_no_parts(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts keep what is finished of a long one; none is due here before the end."""
    written: list[str] = []
    write_tables = result_files.write_tables

    def record_and_write(path: Path, tables: Any) -> None:
        written.append(path.name)
        write_tables(path, tables)

    monkeypatch.setattr(store_module, "write_tables", record_and_write)
    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 1e9)
    run_sweep(Store(output, GRID[:2]), 1)
    assert written == ["grid.parquet"]


def test_a_part_is_written_when_the_last_one_is_a_second_old(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock begins at 100 s. A part is a file of the results so far, and its count that of its rows."""
    now = 100.0
    monkeypatch.setattr(store_module, "time", SimpleNamespace(monotonic=lambda: now))
    store = Store(output, GRID[:1])
    counts = []
    for trial, now in enumerate((100.9, 101.0, 101.9, 102.0)):  # noqa: B007 (the clock)
        store.add(Job(GRID[0], trial, 1).run())
        counts.append(row_counts(store.parts))

    assert counts == [[], [2], [2], [2, 2]]


def test_parts_of_a_long_sweep_are_a_hundredth_of_its_time_apart(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After 1000 s that is 10 s, so that writing never takes long beside the work."""
    now = 0.0
    monkeypatch.setattr(store_module, "time", SimpleNamespace(monotonic=lambda: now))
    store = Store(output, GRID[:1])
    counts = []
    for trial, now in enumerate((1000.0, 1009.0, 1011.0)):  # noqa: B007 (the clock)
        store.add(Job(GRID[0], trial, 1).run())
        counts.append(row_counts(store.parts))

    assert counts == [[1], [1], [1, 2]]


def test_a_part_is_written_when_ten_rows_wait(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit, which bounds the memory, is set to 10, and time to never."""
    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 1e9)
    monkeypatch.setattr(store_module, "_MAX_ROWS", 10)
    store = Store(output, GRID[:1])
    store.add(Job(GRID[0], 0, 9).run())
    assert row_counts(store.parts) == []
    store.add(Job(GRID[0], 9, 1).run())

    assert row_counts(store.parts) == [10]


def test_the_output_has_row_groups_in_the_order_of_the_experiments(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The jobs of two experiments come in turn, and their parts are of other sizes."""
    monkeypatch.setattr(store_module, "_MAX_ROWS", 50)
    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 0.0)
    store = Store(output, GRID[:2])
    for first in range(0, 40, 10):
        for experiment in GRID[:2]:
            store.add(Job(experiment, first, 10).run())
    store.finish()
    metadata = pq.read_metadata(output)
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [50, 30]
    table = read_table(output)
    assert table["trial"].to_pylist() == [*range(40), *range(40)]
    for streamed, at_once in zip(stream_experiments(output), experiments_in(table), strict=True):
        assert (streamed.experiment, streamed.numbers) == (at_once.experiment, at_once.numbers)
        assert (streamed.errors == at_once.errors).all()


def test_a_part_has_fewer_rows_the_longer_their_lists_are(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is set to the bytes of a thousand rows here: each value takes eight."""
    (row,) = trials_to_table(Job(GRID[0], 0, 1, 400).run()).to_pylist()
    value_count = sum(np.size(values) for values in row.values() if isinstance(values, list))
    monkeypatch.setattr(store_module, "ROW_GROUP_BYTES", 1000 * 8 * value_count)

    assert Store(output, GRID[:1], 400)._rows_per_part == 1000
    assert Store(output, [replace(GRID[0], steps=10**7)], 400)._rows_per_part == 1


@pytest.fixture
def other_process(output: Path) -> Iterator[int]:
    """A process that works on the output until this fixture ends."""
    (is_ready, report_ready), (released, release) = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        Store(output, GRID).reserve()
        os.write(report_ready, b"x")
        os.close(release)
        os.read(released, 1)
        os._exit(0)
    os.read(is_ready, 1)
    yield child
    os.close(release)
    os.waitpid(child, 0)


def test_a_second_process_on_one_output_is_refused(output: Path, other_process: int) -> None:
    with pytest.raises(UsageError, match=rf"process {other_process} is at work on {output}; wait for it"):
        Store(output, GRID)


def test_an_output_can_be_continued_when_the_other_process_has_ended(output: Path) -> None:
    """A process that works on an output locks it, and leaves a folder of parts if it ends too early.

    The lock ends with the process. The next sweep finishes the output, and removes the folder.
    """
    child = os.fork()
    if child == 0:
        Store(output, GRID).reserve()
        os._exit(0)
    os.waitpid(child, 0)

    one_experiment = GRID[:1]
    run_sweep(Store(output, one_experiment), workers=1)

    files_that_are_left = [path.name for path in output.parent.iterdir()]
    assert files_that_are_left == ["grid.parquet"]


def test_a_process_does_not_lock_itself_out_of_its_output(output: Path) -> None:
    Store(output, GRID).reserve()
    assert Store(output, GRID).missing_count == 40 * len(GRID)


# --- Progress --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("finished", "total", "seconds", "text"),
    [
        (30, 120, 60.0, "0.5/s, 0:03:00 left"),
        (1, 10_001, 2.0, "0.5/s, 5:33:20 left"),
        (9, 9, 3.0, "3/s, 0:00:00 left"),
        (0, 9, 3.0, ""),
    ],
)
def test_progress_is_a_rate_and_the_time_left(finished: int, total: int, seconds: float, text: str) -> None:
    assert progress_bar.format_rate(finished, total, seconds) == text


def test_a_bar_shows_the_rate() -> None:
    task: Any = SimpleNamespace(completed=30, total=120, elapsed=60.0)
    assert progress_bar._Rate().render(task).plain == "0.5/s, 0:03:00 left"


def report_slow_progress(monkeypatch: pytest.MonkeyPatch, *, quiet: bool) -> None:
    """Report six of eight trials in two minutes, from 30 s on."""
    now = [100.0]
    monkeypatch.setattr(progress_bar, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with progress_bar.progress("trials", 8, quiet) as report:
        for seconds in (130.0, 160.0, 219.0, 220.0):
            now[0] = seconds
            report(1.5)


def test_progress_is_a_line_a_minute_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "")
    report_slow_progress(monkeypatch, quiet=False)

    assert capsys.readouterr().err.splitlines() == [
        "trials: 3 of 8, 0.05/s, 0:01:40 left",
        "trials: 6 of 8, 0.05/s, 0:00:40 left",
    ]


def test_progress_is_a_bar_in_a_terminal_and_is_erased_in_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # which rich takes for a terminal
    report_slow_progress(monkeypatch, quiet=False)
    errors = capsys.readouterr().err
    erase_line = "\x1b[2K"

    assert "6/8" in errors
    assert errors.endswith(erase_line)


def test_quiet_progress_is_not_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "")
    report_slow_progress(monkeypatch, quiet=True)
    assert capsys.readouterr().err == ""


# --- Commands --------------------------------------------------------------------------------------------


GRID_OF_TWO = "robots = 4\nsteps = 300\nfilter_period = 100\ntrials = 3\nflawed = [1, 2]\n"


@pytest.fixture
def grid_file(tmp_path: Path) -> Path:
    """A file that describes two experiments of three trials."""
    path = tmp_path / "grid.toml"
    path.write_text(GRID_OF_TWO)
    return path


@pytest.fixture
def run_for_json(capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, Any]]:
    """A function that runs a command, which must succeed, and returns its answer in JSON."""

    def run(*arguments: str | Path) -> dict[str, Any]:
        assert cli.main([*map(str, arguments), "--json"]) == 0
        answer: dict[str, Any] = json.loads(capsys.readouterr().out)
        return answer

    return run


def test_sweep_runs_a_file_into_results_beside_it(
    grid_file: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    answer = run_for_json("sweep", grid_file, "--workers", "1")
    assert answer["run"] == 2 * 3  # trials
    assert answer["output"] == str(grid_file.with_suffix(".parquet"))


def test_sweep_of_finished_results_runs_nothing(
    grid_file: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    run_for_json("sweep", grid_file, "--workers", "1")
    assert run_for_json("sweep", grid_file, "--workers", "1")["run"] == 0


def test_score_reports_what_sweep_does(grid_file: Path, run_for_json: Callable[..., dict[str, Any]]) -> None:
    answer = run_for_json("sweep", grid_file, "--workers", "1")
    scored = run_for_json("score", grid_file.with_suffix(".parquet"))
    assert scored["experiments"] == answer["experiments"]


def test_score_writes_a_line_of_csv_for_each_trial(
    grid_file: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    run_for_json("sweep", grid_file, "--workers", "1")
    csv_file = grid_file.with_suffix(".csv")
    run_for_json("score", grid_file.with_suffix(".parquet"), "--csv", csv_file)
    header, trials = 1, 6
    assert len(csv_file.read_text().splitlines()) == header + trials


def test_score_takes_other_limits(grid_file: Path, run_for_json: Callable[..., dict[str, Any]]) -> None:
    run_for_json("sweep", grid_file, "--workers", "1")
    results = grid_file.with_suffix(".parquet")
    scored = run_for_json("score", results, "--k-max", "300", "--e-max", "0.5")
    limits = [experiment["limits"] for experiment in scored["experiments"]]

    assert limits == [{"k_max": 300, "e_max": 0.5}] * 2


def table_of(output: str) -> list[list[str]]:
    """Return the cells of the table that a command has printed, row by row."""
    lines = [line for line in output.splitlines() if line[0] in "│┃"]
    return [re.split(" *[│┃] *", line)[1:-1] for line in lines]


def test_sweep_prints_what_its_table_is_of(grid_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sweep", str(grid_file), "--workers", "1"]) == 0
    output = capsys.readouterr().out
    assert "K_max 300, e_max 0.45; medians over the trials, H with quartiles" in output
    assert "again:" in output


def test_sweep_prints_medians_of_each_experiment(
    grid_file: Path, run_for_json: Callable[..., dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    experiments = run_for_json("sweep", grid_file, "--workers", "1")["experiments"]
    cli.main(["sweep", str(grid_file), "--workers", "1"])
    head, *rows = table_of(capsys.readouterr().out)
    assert head == ["flawed", "trials", "H", "h_K", "h_e", "K", "e", "updates"]
    for experiment, row in zip(experiments, rows, strict=True):
        h_k, h_e, k, e, updates = (experiment[name]["median"] for name in ("h_K", "h_e", "K", "e", "updates"))
        assert row[3:] == [f"{h_k:.2f}", f"{h_e:.2f}", f"{k:g}", f"{e:.5f}", f"{updates:g}"]


def test_sweep_prints_the_score_with_its_quartiles(
    grid_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cli.main(["sweep", str(grid_file), "--workers", "1"])
    _, *rows = table_of(capsys.readouterr().out)
    scores = np.split(read_table(grid_file.with_suffix(".parquet"))["H"].to_numpy(), 2)
    for flawed, row, h in zip((1, 2), rows, scores, strict=True):
        lower_quartile, median, upper_quartile = np.percentile(h, (25, 50, 75))
        assert row[:3] == [str(flawed), "3", f"{median:.2f} [{lower_quartile:.2f}, {upper_quartile:.2f}]"]


@pytest.fixture
def one_experiment(tmp_path: Path) -> Path:
    """A file that describes one short experiment."""
    path = tmp_path / "one.toml"
    path.write_text("steps = 100\nrobots = 3\nflawed = 1\n")
    return path


def test_simulate_takes_options_over_a_file(
    one_experiment: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    """The file's experiment has 100 steps, for which there is no option here, and other robots and trials."""
    options = ["--robots", "6", "--flawed", "50%", "--trials", "4", "--omega", "0.1"]
    answer = run_for_json("simulate", one_experiment, *options)
    parameters = answer["parameters"]

    assert parameters["steps"] == 100
    assert parameters["robots"] == 6
    assert parameters["flawed"] == 3  # 50 % of 6
    assert parameters["omega"] == 0.1
    assert answer["trials"] == 4
    assert answer["limits"] == {"k_max": 100, "e_max": 0.45}


def test_simulate_writes_results_if_it_is_asked_to(
    one_experiment: Path, tmp_path: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    run_for_json("simulate", one_experiment)
    assert list(tmp_path.iterdir()) == [one_experiment]
    run_for_json("simulate", one_experiment, "--output", tmp_path / "one.parquet", "--record", "100")
    assert len(read_table(tmp_path / "one.parquet")) == 30


def workers_used(monkeypatch: pytest.MonkeyPatch, options: str) -> int:
    """Return the number of processes on which the command ``simulate`` runs 5 trials of 20 robots.

    The user asks for 1024 processes. The trials themselves are not run.
    """
    simulate = Mock(side_effect=UsageError("the command ends here"))
    monkeypatch.setattr("mcp_asdf_tools.library.simulate", simulate)
    exit_code = cli.main(["simulate", "--robots=20", "--trials=5", "--workers=1024", *options.split()])
    exit_code_of_usage_error = 2
    assert exit_code == exit_code_of_usage_error
    workers: int = simulate.call_args.kwargs["workers"]
    return workers


def test_simulate_runs_a_short_experiment_in_its_own_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short is less than 10**8 steps of robots: 20 robots * 5 trials * 999,999 steps."""
    assert workers_used(monkeypatch, "--steps 999999") == 1


def test_simulate_runs_a_long_experiment_on_as_many_processes_as_it_is_asked_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """20 robots * 5 trials * 1,000,000 steps are 10**8 steps of robots."""
    assert workers_used(monkeypatch, "--steps 1000000") == 1024


def test_simulate_runs_even_a_short_experiment_of_the_mirror_on_processes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The mirror runs in Python, which takes far longer than starting a process."""
    assert workers_used(monkeypatch, "--steps 1000 --firmware mirror") == 1024


A_THOUSAND_ROBOTS = "--robots 1000 --trials 1 --steps 20"


def test_a_thousand_robots_are_simulated_where_they_move(
    run_for_json: Callable[..., dict[str, Any]],
) -> None:
    answer = run_for_json(
        "simulate", *A_THOUSAND_ROBOTS.split(), "--topology", "dynamic", "--filter-period", "20"
    )
    assert (answer["parameters"]["robots"], answer["trials"]) == (1000, 1)


def test_a_thousand_robots_are_simulated_in_a_graph(
    tmp_path: Path, run_for_json: Callable[..., dict[str, Any]]
) -> None:
    ring = tmp_path / "ring"
    ring.write_text("".join(f"{robot} {(robot + 1) % 1000}\n" for robot in range(1000)))
    answer = run_for_json(
        "simulate",
        *A_THOUSAND_ROBOTS.split(),
        "--topology",
        "graph",
        "--graph",
        ring,
        "--filter-period",
        "20",
    )

    assert (answer["parameters"]["robots"], answer["trials"]) == (1000, 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("simulate --robots 0", "--robots is 0; it must be 1 to 65536"),
        (
            f"simulate {A_THOUSAND_ROBOTS}",
            "--robots is 1000, but each would hear 999 others, and a round of the firmware",
        ),
        (
            f"simulate {A_THOUSAND_ROBOTS} --topology dynamic --radio-range 2",
            "--radio-range: robots is 1000, but with",
        ),
        (
            f"simulate {A_THOUSAND_ROBOTS} --topology dynamic --firmware mirror",
            "--firmware: robots is 1000, but firmware is",
        ),
        (
            f"simulate {A_THOUSAND_ROBOTS} --topology dynamic --white-offset 0.1",
            "--white-offset: robots is 1000, but",
        ),
        ("simulate --filter none --omega 0.1", "--omega would do nothing: filter is none"),
        ("simulate --lowest-accuracy 0.4", "--lowest-accuracy would do nothing: drift is none"),
        ("simulate --workers 0", "--workers is 0"),
        ("simulate --workers 1025", "--workers is 1025"),
        ("simulate --record -1", "--record is -1"),
        ("simulate --steps 10 --record 11", "--record is 11; choose 1 to 10 steps"),
        ("simulate --output results.csv", "ends in .parquet"),
        ("simulate --steps 10 --k-max 0", "K_max is 0"),
        ("simulate dynamic", "run it with mcp-asdf sweep"),
        ("plot absent.parquet x.gif", "ends in"),
    ],
)
def test_bad_usage_is_reported(arguments: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments.split()) == 2
    assert message in capsys.readouterr().err


# --- Signals ---------------------------------------------------------------------------------------------

SHORT_SWEEP = Experiment(firmware="mirror", steps=20, trials=100, robots=4)
LONG_SWEEP = Experiment(firmware="mirror", steps=400, trials=400, robots=4)


@pytest.fixture
def slow_sweep(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A sweep that takes long, in a process group of its own as in a terminal."""
    (tmp_path / "slow.toml").write_text("firmware = 'mirror'\nsteps = 400\ntrials = 400\nrobots = 4\n")
    command = [sys.executable, "-m", "mcp_asdf_tools.cli.main", "sweep", str(tmp_path / "slow.toml")]
    with interruptible():
        process = subprocess.Popen(
            [*command, "--workers", "2"], cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
    yield process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def workers_of(process: subprocess.Popen[str]) -> list[str]:
    """Return the ids of the worker processes of a sweep."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    if not children.exists():
        pytest.skip("the kernel does not list the children of a process")
    return list(filter(is_worker, children.read_text().split()))


def is_worker(process: str) -> bool:
    """Return whether a process, given by its id, is a worker that has not ended."""
    try:
        return b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:  # it has ended
        return False


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, *slow([signal.SIGINT])])
def test_a_signal_keeps_what_is_finished(
    number: signal.Signals, slow_sweep: subprocess.Popen[str], tmp_path: Path
) -> None:
    parts = tmp_path / "slow.parquet.parts"
    wait_until(lambda: any(parts.glob("*.parquet")))
    os.killpg(slow_sweep.pid, number)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)
    assert slow_sweep.returncode == 128 + number
    assert "the same command goes on" in errors
    assert "Traceback" not in errors

    finished_trials = sum(len(read_table(path)) for path in parts.glob("*.parquet"))
    missing_trials = Store(tmp_path / "slow.parquet", [LONG_SWEEP]).missing_count
    assert finished_trials > 0
    assert finished_trials + missing_trials == LONG_SWEEP.trials


def test_ctrl_c_while_a_part_is_written_loses_nothing(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(output, [SHORT_SWEEP])
    write_tables = result_files.write_tables

    def write_and_interrupt(path: Path, tables: Any) -> None:
        write_tables(path, tables)
        if path != output and len(row_counts(store.parts)) == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 0.0)
    monkeypatch.setattr(store_module, "write_tables", write_and_interrupt)
    with interruptible(), pytest.raises(KeyboardInterrupt):
        run_sweep(store, workers=1)

    missing_on_disk = Store(output, [SHORT_SWEEP]).missing_count
    assert missing_on_disk == store.missing_count
    assert 0 < missing_on_disk < SHORT_SWEEP.trials


@pytest.mark.slow
def test_ctrl_c_does_not_disturb_workers_that_start(slow_sweep: subprocess.Popen[str]) -> None:
    """Ctrl-C in a terminal reaches all processes of a group, also those that are still importing."""
    wait_until(lambda: bool(workers_of(slow_sweep)))
    os.killpg(slow_sweep.pid, signal.SIGINT)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)

    assert slow_sweep.returncode == 128 + signal.SIGINT
    assert "Traceback" not in errors


@pytest.mark.slow
def test_workers_end_with_a_sweep_that_is_killed(slow_sweep: subprocess.Popen[str]) -> None:
    wait_until(lambda: len(workers_of(slow_sweep)) == 2)
    workers = workers_of(slow_sweep)
    slow_sweep.kill()
    wait_until(lambda: not any(map(is_worker, workers)))
