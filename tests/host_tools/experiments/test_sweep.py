"""Sweeps: nothing is lost or run twice, however they end; and the commands around them."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.cli import main as cli
from mcp_asdf_tools.common import progress_bar
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import result_files, sweep
from mcp_asdf_tools.experiments import store as store_module
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import read_table, stream_experiments
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.experiments.sweep import run_sweep
from mcp_asdf_tools.experiments.trials import Job
from support import PATIENCE, ROOT, interruptible, wait_until
from trials import record_jobs

EXPERIMENT = Experiment(robots=4, flawed=1, filter="none", steps=8000, trials=40)
OTHER_EXPERIMENT = replace(EXPERIMENT, filter="asdf-plus")
TWO_EXPERIMENTS = [EXPERIMENT, OTHER_EXPERIMENT]
THREE_EXPERIMENTS = [EXPERIMENT, OTHER_EXPERIMENT, replace(EXPERIMENT, filter="robust")]
"""Each has 40 trials. A job, which a worker runs at once, is the first 32 or the last 8 of these."""


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "grid.parquet"


@pytest.fixture
def jobs_run(monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """The jobs that this process runs; Ctrl-C interrupts the sixth unless the list is cleared before."""
    return record_jobs(monkeypatch, max_jobs=5)


def trials_of(jobs: Iterable[Job]) -> list[range]:
    """Return the numbers of the trials that each job runs."""
    return [range(job.first, job.first + job.count) for job in jobs]


# --- Jobs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "sampling_interval", "trial_counts_of_jobs"),
    [
        ({}, 0, [32, 8]),  # 40 trials of 8,000 steps of 4 robots
        ({"firmware": "mirror", "trials": 2}, 0, [1, 1]),  # slow, as it runs in Python
        ({"steps": 10**7, "trials": 2}, 0, [1, 1]),
        # 833 trials of 300 steps of 4 robots are just below a million steps of robots.
        ({"steps": 300, "filter_period": 100, "trials": 1200}, 0, [833, 1200 - 833]),
        # 10^7 steps of robots in a trial have 4 * 10^7 bytes.
        ({"steps": 2_500_000, "trials": 3}, 0, [2, 1]),
        # In every 16th step 64 bytes are recorded, so each step has 8 bytes.
        ({"steps": 1_250_000, "trials": 3}, 16, [2, 1]),
    ],
)
def test_a_job_has_more_trials_the_shorter_these_are_and_the_less_is_recorded(
    changes: dict[str, Any], sampling_interval: int, trial_counts_of_jobs: list[int]
) -> None:
    """A job, which a worker process runs at once, has a million steps of robots if its trials are short.

    It has up to 32 longer trials if their estimates and records have at most 80 MB together, and one at
    least. Unless it is changed, the experiment has 40 trials of 8,000 steps of 4 robots.
    """
    experiment = replace(EXPERIMENT, **changes)
    jobs = sweep.jobs_of_experiment(experiment, np.arange(experiment.trials), sampling_interval)
    assert [job.count for job in jobs] == trial_counts_of_jobs


def test_a_worker_with_another_version_than_its_job_is_refused() -> None:
    """This process is the worker. The version of a job is that of the program that has made it."""
    job = Job(EXPERIMENT, first=0, count=1, version="9.9.9")
    with pytest.raises(UsageError, match=r"a worker has mcp-asdf .*, this is 9\.9\.9; install the same"):
        job.run()


# --- Nothing lost, nothing twice ---------------------------------------------------------------------------


@pytest.fixture
def interrupted_sweep(output: Path, jobs_run: list[Job]) -> Store:
    """A sweep of three experiments, opened again after an interrupt: the last 8 trials of 40 are missing."""
    with pytest.raises(KeyboardInterrupt):
        run_sweep(Store(output, THREE_EXPERIMENTS), workers=1)
    jobs_run.clear()
    return Store(output, THREE_EXPERIMENTS)


def test_the_folder_of_parts_of_an_interrupted_sweep_can_be_scored(
    interrupted_sweep: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    """Parts are files of the results so far. Of the third experiment 32 of 40 trials had been run."""
    assert cli.main(["score", str(interrupted_sweep.parts)]) == 0
    assert "32 of 40" in capsys.readouterr().out


def test_an_attempt_to_score_an_interrupted_sweep_is_answered_with_where_its_data_is(
    interrupted_sweep: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    """The output is written only in the end. Until then results are in a folder of parts."""
    exit_code = cli.main(["score", str(interrupted_sweep.output)])
    assert exit_code == EXIT_CODE_OF_USAGE_ERROR
    parts = interrupted_sweep.parts
    assert f"its sweep is not finished, partial data is in {parts}" in capsys.readouterr().err


def test_an_interrupted_sweep_that_goes_on_runs_only_the_missing_trials(
    interrupted_sweep: Store, jobs_run: list[Job]
) -> None:
    """It was interrupted after 32 of the 40 trials of its last experiment, so trials 32 to 39 are missing."""
    run_sweep(interrupted_sweep, workers=1)
    assert trials_of(jobs_run) == [range(32, 40)]


def test_an_interrupted_sweep_that_goes_on_gives_the_results_of_one_without_an_interrupt(
    interrupted_sweep: Store,
) -> None:
    """The results are compared with an uninterrupted run of all 40 trials of each experiment."""
    run_sweep(interrupted_sweep, workers=1)
    experiments = stream_experiments(interrupted_sweep.output)

    for trials, experiment in zip(experiments, THREE_EXPERIMENTS, strict=True):
        uninterrupted_trials = Job(experiment, first=0, count=40).run()
        assert trials.experiment == experiment
        assert np.array_equal(trials.errors, uninterrupted_trials.errors)


def test_a_finished_sweep_leaves_nothing_but_its_output(interrupted_sweep: Store, tmp_path: Path) -> None:
    """It removes its parts, and the beginning of a file there that a killed process has left."""
    cut_off_file = interrupted_sweep.parts / ".0123abcd.tmp"
    cut_off_file.write_bytes(b"PAR1")
    run_sweep(interrupted_sweep, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["grid.parquet"]


def test_a_sweep_that_lacks_trials_between_finished_ones_runs_these(
    output: Path, jobs_run: list[Job]
) -> None:
    """Trials 2 to 4 and 7 of 10 are there; 0 and 1, 5 and 6, and 8 and 9 are missing."""
    experiment = replace(EXPERIMENT, trials=10)
    store = Store(output, [experiment])
    store.add(Job(experiment, first=2, count=3).run())
    store.add(Job(experiment, first=7, count=1).run())
    store.flush()
    jobs_run.clear()  # so that it has only the jobs of the sweep

    run_sweep(Store(output, [experiment]), workers=1)

    assert trials_of(jobs_run) == [range(0, 2), range(5, 7), range(8, 10)]


def test_a_finished_sweep_is_not_run_again(output: Path, jobs_run: list[Job]) -> None:
    """The second sweep into the same output runs no job, and leaves the results as they are."""
    run_sweep(Store(output, [EXPERIMENT]), workers=1)
    table_of_first_sweep = read_table(output)
    jobs_run.clear()  # so that it has only the jobs of the second sweep
    run_sweep(Store(output, [EXPERIMENT]), workers=1)

    assert jobs_run == []
    assert read_table(output).equals(table_of_first_sweep)


def test_a_sweep_that_was_enlarged_runs_only_new_trials_and_experiments(
    output: Path, jobs_run: list[Job]
) -> None:
    """The first sweep runs 10 trials of one experiment. The second wants 15, and 33 of another experiment.

    A job runs at most 32 of these trials.
    """
    run_sweep(Store(output, [replace(EXPERIMENT, trials=10)]), workers=1)
    jobs_run.clear()  # so that it has only the jobs of the second sweep
    enlarged_experiments = [replace(EXPERIMENT, trials=15), replace(OTHER_EXPERIMENT, trials=33)]
    run_sweep(Store(output, enlarged_experiments), workers=1)

    trials_added_to_experiment = [range(10, 15)]
    trials_of_added_experiment = [range(0, 32), range(32, 33)]
    assert trials_of(jobs_run) == trials_added_to_experiment + trials_of_added_experiment
    assert [trials.experiment for trials in stream_experiments(output)] == enlarged_experiments


@pytest.mark.parametrize(
    ("experiments", "sampling_interval"),
    [
        ([EXPERIMENT], 0),
        ([replace(experiment, seed=2) for experiment in TWO_EXPERIMENTS], 0),
        ([replace(EXPERIMENT, trials=39), OTHER_EXPERIMENT], 0),
        (TWO_EXPERIMENTS, 5),
    ],
    ids=["fewer experiments", "another seed", "fewer trials", "with records"],
)
def test_a_sweep_into_the_results_of_another_one_is_refused_and_leaves_them_alone(
    experiments: list[Experiment], sampling_interval: int, output: Path
) -> None:
    """The output has the results of two experiments of 40 trials, with nothing recorded over time."""
    run_sweep(Store(output, TWO_EXPERIMENTS), workers=1)
    content_before = output.read_bytes()

    with pytest.raises(UsageError, match="choose another name"):
        Store(output, experiments, sampling_interval=sampling_interval)
    assert output.read_bytes() == content_before


def test_a_sweep_into_results_of_another_version_of_the_program_is_refused(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results of two versions must not be mixed. This program takes itself for version 9.9.9."""
    run_sweep(Store(output, [EXPERIMENT]), workers=1)
    other_version = Mock(return_value={"mcp-asdf": "9.9.9"})
    monkeypatch.setattr(store_module, "software_versions", other_version)
    with pytest.raises(UsageError, match="other experiments, recordings or versions"):
        Store(output, [EXPERIMENT])


def test_worker_processes_started_from_a_thread_give_the_results_of_one_process(
    output: Path, tmp_path: Path
) -> None:
    """Programs with a window or a server start sweeps from threads.

    The sweep reports how many trials have been finished, together 40 of each of two experiments.
    """
    reported_trials: list[int] = []
    with ThreadPoolExecutor(max_workers=1) as thread:
        store = Store(output, TWO_EXPERIMENTS)
        sweep_in_thread = thread.submit(run_sweep, store, workers=2, report=reported_trials.append)
        sweep_in_thread.result()  # waits for its end
    output_of_one_process = tmp_path / "one.parquet"
    run_sweep(Store(output_of_one_process, TWO_EXPERIMENTS), workers=1)

    assert read_table(output).equals(read_table(output_of_one_process))
    assert sum(reported_trials) == 2 * 40


def test_a_sweep_in_memory_gives_the_table_that_one_into_a_file_gives(output: Path) -> None:
    """Without an output a store keeps all results in memory, and writes no file."""
    run_sweep(Store(output, TWO_EXPERIMENTS), workers=1)
    store_in_memory = Store(None, TWO_EXPERIMENTS)
    run_sweep(store_in_memory, workers=1)

    table_in_memory = store_in_memory.read_table()
    table_in_file = read_table(output)
    # Tables may be cut into chunks of different sizes.
    assert table_in_memory.combine_chunks().equals(table_in_file.combine_chunks())


def test_experiments_that_are_given_twice_are_run_once(output: Path, jobs_run: list[Job]) -> None:
    """Grids overlap easily. Twice the same trials would count as more evidence than they are."""
    experiment = replace(EXPERIMENT, trials=3)
    other_experiment = replace(OTHER_EXPERIMENT, trials=2)
    overlapping_experiments = [experiment, other_experiment, experiment]

    run_sweep(Store(output, overlapping_experiments), workers=1)

    trials_of_experiment = [0, 1, 2]
    trials_of_other_experiment = [0, 1]
    assert read_table(output)["trial"].to_pylist() == trials_of_experiment + trials_of_other_experiment
    assert [job.experiment for job in jobs_run] == [experiment, other_experiment]


class DeadlyJob(Job):
    """A job that kills the process that runs it."""

    def run(self) -> Trials:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


def test_a_worker_process_that_is_killed_ends_the_sweep_with_an_error() -> None:
    """An operating system that is out of memory kills processes. Here each job kills the process it is in."""
    deadly_jobs = [DeadlyJob(EXPERIMENT, first=0, count=1), DeadlyJob(EXPERIMENT, first=1, count=1)]
    with pytest.raises(UsageError, match="a worker process was killed"):
        list(sweep.run_jobs(iter(deadly_jobs), workers=2))


# --- The store -------------------------------------------------------------------------------------------


# Parts of a sweep are files of the results so far, in a folder beside the output that there will be.


def bytes_of_row(experiment: Experiment, sampling_interval: int = 0) -> int:
    """Return how many bytes a row of results takes: eight for each parameter and each value of its lists."""
    trials = Job(experiment, first=0, count=1, sampling_interval=sampling_interval).run()
    (row,) = trials_to_table(trials).to_pylist()
    values_of_lists = sum(np.size(values) for values in row.values() if isinstance(values, list))
    return 8 * (len(experiment.parameters()) + values_of_lists)


def row_count_of_each_part(folder: Path) -> list[int]:
    """Return the number of rows, which are trials, of each file of results in a folder of parts."""
    return [pq.read_metadata(path).num_rows for path in sorted(folder.glob("*.parquet"))]


@pytest.fixture
def set_clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """A function that sets the time, in seconds, that the store reads; it is 0 at first."""
    now = Mock(return_value=0.0)
    monkeypatch.setattr(store_module, "time", SimpleNamespace(monotonic=now))

    def set_time(seconds: float) -> None:
        now.return_value = seconds

    return set_time


def record_files_written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that grows when a store writes a file: the name of the file is added."""
    files_written: list[str] = []
    write_tables = result_files.write_tables

    def record_and_write(path: Path, tables: Any) -> None:
        files_written.append(path.name)
        write_tables(path, tables)

    monkeypatch.setattr(store_module, "write_tables", record_and_write)
    return files_written


def test_a_short_sweep_writes_its_output_and_no_parts(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time between parts is set so long that none is due before the end."""
    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 1e9)
    files_written = record_files_written(monkeypatch)
    run_sweep(Store(output, TWO_EXPERIMENTS), workers=1)
    assert files_written == [output.name]


@pytest.mark.parametrize(
    ("times", "expected_row_counts"),
    [
        ([0.9, 1.0, 1.9, 2.0], [[], [2], [2], [2, 2]]),
        ([1000.0, 1009.0, 1011.0], [[1], [1], [1, 2]]),
    ],
    ids=["short sweep", "long sweep"],
)
def test_parts_of_a_sweep_are_a_hundredth_of_its_time_apart_but_at_least_a_second(
    times: list[float],
    expected_row_counts: list[list[int]],
    output: Path,
    set_clock: Callable[[float], None],
) -> None:
    """So writing takes little time in comparison with the work. After 1000 s a hundredth is 10 s.

    One trial is finished at each of the times, which are in seconds. A part has a row for each trial since
    the part before. ``expected_row_counts`` has a list for each time, with the rows of each part by then.
    """
    store = Store(output, [EXPERIMENT])
    for trial, seconds in enumerate(times):
        set_clock(seconds)
        store.add(Job(EXPERIMENT, first=trial, count=1).run())
        assert row_count_of_each_part(store.parts) == expected_row_counts[trial]


def test_a_part_is_written_when_as_many_rows_wait_as_a_part_may_have(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This bounds the memory. The limit is set to 10 rows, and the time between parts to never."""
    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 1e9)
    monkeypatch.setattr(store_module, "ROW_GROUP_BYTES", 10 * bytes_of_row(EXPERIMENT))
    store = Store(output, [EXPERIMENT])
    store.add(Job(EXPERIMENT, first=0, count=9).run())
    assert row_count_of_each_part(store.parts) == []  # there is no part yet

    store.add(Job(EXPERIMENT, first=9, count=1).run())
    assert row_count_of_each_part(store.parts) == [10]  # there is one with ten rows


@pytest.fixture(scope="module")
def output_of_mixed_jobs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output of two experiments of 40 trials, whose jobs of 10 trials have ended in turns.

    A part was written after each job. The output has its rows in groups of at most 50.
    """
    output = tmp_path_factory.mktemp("mixed") / "grid.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store_module, "ROW_GROUP_BYTES", 50 * bytes_of_row(EXPERIMENT))
        patch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 0.0)
        store = Store(output, TWO_EXPERIMENTS)
        for first_trial in (0, 10, 20, 30):
            for experiment in TWO_EXPERIMENTS:
                store.add(Job(experiment, first_trial, count=10).run())
        store.finish()
    return output


def test_the_output_has_the_trials_of_each_experiment_in_order_whatever_the_order_of_jobs(
    output_of_mixed_jobs: Path,
) -> None:
    """Jobs of two experiments of 40 trials have ended in turns.

    A group of rows has 50 of them, so the first 10 trials of the second experiment are in the first group.
    Trials are read in the order of their numbers in any case, so the order of rows is checked as well.
    """
    assert read_table(output_of_mixed_jobs)["trial"].to_pylist() == [*range(40), *range(40)]

    experiments = stream_experiments(output_of_mixed_jobs)
    for trials, experiment in zip(experiments, TWO_EXPERIMENTS, strict=True):
        trials_in_order = Job(experiment, first=0, count=40).run()
        assert trials.experiment == experiment
        assert np.array_equal(trials.errors, trials_in_order.errors)


def test_the_output_has_as_many_rows_in_a_group_as_it_may(output_of_mixed_jobs: Path) -> None:
    """The limit was 50 of the 80 rows. A reader has one group in memory at a time."""
    metadata = pq.read_metadata(output_of_mixed_jobs)
    row_groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    assert [row_group.num_rows for row_group in row_groups] == [50, 30]


def test_a_part_has_fewer_rows_the_longer_their_lists_are(
    output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is set to the bytes of a thousand rows, with values recorded every 400 of 8,000 steps.

    The lists of a trial of 10 million steps take more than that. A part has one row at least.
    """
    experiment = replace(EXPERIMENT, steps=8000)
    long_experiment = replace(EXPERIMENT, steps=10_000_000)
    monkeypatch.setattr(store_module, "ROW_GROUP_BYTES", 1000 * bytes_of_row(experiment, 400))

    # Parts are written by rows, so the limit of bytes is converted when a store is made.
    assert Store(output, [experiment], sampling_interval=400)._rows_per_part == 1000
    assert Store(output, [long_experiment], sampling_interval=400)._rows_per_part == 1


@contextmanager
def process_at_work_on(output: Path) -> Iterator[int]:
    """Let another process work on an output until the context ends; gives its id."""
    ready_read_end, ready_write_end = os.pipe()
    release_read_end, release_write_end = os.pipe()
    child = os.fork()
    if child == 0:
        Store(output, THREE_EXPERIMENTS).reserve()
        os.write(ready_write_end, b"x")
        os.close(release_write_end)
        os.read(release_read_end, 1)  # returns when the parent closes its end, too
        os._exit(0)
    os.read(ready_read_end, 1)
    try:
        yield child
    finally:
        os.close(release_write_end)
        os.waitpid(child, 0)


def test_a_sweep_into_an_output_on_which_another_process_works_is_refused(output: Path) -> None:
    """Two processes would overwrite each other's parts. The message has the id of the process."""
    with process_at_work_on(output) as process_id, pytest.raises(UsageError) as refusal:
        Store(output, [EXPERIMENT])
    assert f"process {process_id} is at work on {output}; wait for it" in str(refusal.value)


def test_a_sweep_goes_on_with_an_output_when_the_other_process_has_ended(output: Path) -> None:
    """A process that works on an output locks it, and leaves a folder of parts if it ends too early.

    The lock ends with the process. The next sweep finishes the output, and removes the folder.
    """
    with process_at_work_on(output):
        pass  # at the end of the context, the other process ends
    store = Store(output, [EXPERIMENT])
    assert store.parts.exists()

    run_sweep(store, workers=1)

    assert list(output.parent.iterdir()) == [output]


def test_a_process_does_not_lock_itself_out_of_its_output(output: Path) -> None:
    """It locks an output to work on it, and opens it a second time: all 40 trials are missing."""
    Store(output, [EXPERIMENT]).reserve()  # locks the output
    opened_again = Store(output, [EXPERIMENT])
    assert opened_again.missing_count == 40


# --- Progress --------------------------------------------------------------------------------------------


def report_six_of_eight_trials_in_two_minutes(monkeypatch: pytest.MonkeyPatch, *, quiet: bool) -> None:
    """Report 1.5 trials after 30, 60, 119 and 120 s of a clock that is set."""
    now = Mock(return_value=0.0)
    monkeypatch.setattr(progress_bar, "time", SimpleNamespace(monotonic=now))
    with progress_bar.progress("trials", 8, quiet) as report:
        for now.return_value in (30.0, 60.0, 119.0, 120.0):
            report(1.5)


def test_progress_is_a_bar_with_the_time_left_in_a_terminal_and_is_erased_in_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of eight trials have ended after 60 and 120 s: the other six take 6 minutes.

    With FORCE_COLOR rich, which draws the bar by a clock of its own, takes any output for a terminal.
    """
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    clock = Mock(return_value=0.0)
    monkeypatch.setattr("rich.console.monotonic", clock)
    with progress_bar.progress("trials", 8) as report:
        for clock.return_value in (60.0, 120.0):
            report(1)

    output = capsys.readouterr().err
    assert "2/8 0:06:00" in re.sub(r"\x1b\[[^A-Za-z]*[A-Za-z]", "", output)
    code_that_erases_a_line = "\x1b[2K"
    assert output.endswith(code_that_erases_a_line)


def test_progress_is_a_line_a_minute_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three of the eight trials are finished after a minute, and six of them after two minutes.

    So a trial takes 20 s: the five that are left take 100 s, and the last two 40 s. FORCE_COLOR is emptied.
    With it rich, which draws a bar in terminals, would take any output for a terminal.
    """
    monkeypatch.setenv("FORCE_COLOR", "")
    report_six_of_eight_trials_in_two_minutes(monkeypatch, quiet=False)

    assert capsys.readouterr().err.splitlines() == [
        "trials: 3 of 8, 0:01:40 left",
        "trials: 6 of 8, 0:00:40 left",
    ]


def test_a_line_of_progress_has_no_time_left_before_the_first_trial_is_finished(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After a minute no trial is finished, so there is no rate. FORCE_COLOR is emptied as above."""
    monkeypatch.setenv("FORCE_COLOR", "")
    now = Mock(return_value=0.0)
    monkeypatch.setattr(progress_bar, "time", SimpleNamespace(monotonic=now))

    with progress_bar.progress("trials", 8) as report:
        now.return_value = 60.0
        report(0)

    assert capsys.readouterr().err == "trials: 0 of 8\n"


def test_quiet_progress_is_not_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where there is no terminal, progress would else be a line a minute."""
    monkeypatch.setenv("FORCE_COLOR", "")
    report_six_of_eight_trials_in_two_minutes(monkeypatch, quiet=True)
    assert capsys.readouterr().err == ""


# --- Commands --------------------------------------------------------------------------------------------


EXIT_CODE_OF_USAGE_ERROR = 2


@pytest.fixture(scope="module")
def grid_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that describes two experiments of three trials, with 1 and with 2 flawed robots."""
    path = tmp_path_factory.mktemp("sweep") / "grid.toml"
    path.write_text("robots = 4\nsteps = 300\nfilter_period = 100\ntrials = 3\nflawed = [1, 2]\n")
    return path


def run_for_json(*arguments: str | Path) -> dict[str, Any]:
    """Run a command, which must succeed, and return its answer in JSON."""
    with redirect_stdout(StringIO()) as output:
        assert cli.main([*map(str, arguments), "--json"]) == 0
    answer: dict[str, Any] = json.loads(output.getvalue())
    return answer


@pytest.fixture(scope="module")
def sweep_answer(grid_file: Path) -> dict[str, Any]:
    """Answer of ``sweep grid.toml`` after it has run these experiments."""
    return run_for_json("sweep", grid_file, "--workers", "1")


@pytest.fixture(scope="module")
def results_file(grid_file: Path, sweep_answer: dict[str, Any]) -> Path:
    """The file of results of this sweep."""
    return grid_file.with_suffix(".parquet")


@pytest.fixture(scope="module")
def sweep_text(grid_file: Path, results_file: Path) -> str:
    """Text that ``sweep grid.toml`` prints for people; all trials have been run before."""
    assert results_file.exists()
    with redirect_stdout(StringIO()) as output:
        assert cli.main(["sweep", str(grid_file), "--workers", "1"]) == 0
    return output.getvalue()


def test_the_command_sweep_runs_the_experiments_of_a_file_into_results_beside_it(
    grid_file: Path, sweep_answer: dict[str, Any]
) -> None:
    """The file has two experiments of three trials. The command answers how many trials it has run."""
    results_file = grid_file.with_suffix(".parquet")
    assert sweep_answer["run"] == 2 * 3
    assert sweep_answer["output"] == str(results_file)
    assert results_file.exists()


def test_the_command_sweep_writes_the_results_into_the_file_that_output_names(
    grid_file: Path, tmp_path: Path
) -> None:
    """Without --output they go to grid.parquet, where earlier results may be: that file is not written now.

    The file of experiments has two experiments of three trials.
    """
    shutil.copy(grid_file, tmp_path / "grid.toml")
    output = tmp_path / "new.parquet"
    answer = run_for_json("sweep", tmp_path / "grid.toml", "--workers", "1", "--output", output)

    assert answer["output"] == str(output)
    assert len(read_table(output)) == 2 * 3
    assert not (tmp_path / "grid.parquet").exists()


def test_the_command_score_reports_the_scores_that_sweep_does(
    results_file: Path, sweep_answer: dict[str, Any]
) -> None:
    """Both answer with a list of experiments, which has their parameters and scores."""
    score_answer = run_for_json("score", results_file)
    assert score_answer["experiments"] == sweep_answer["experiments"]


def test_the_command_score_takes_limits_that_the_user_chooses(results_file: Path) -> None:
    """Scores are relative to a limit of convergence, K_max, and one of errors, e_max."""
    answer = run_for_json("score", results_file, "--k-max", "300", "--e-max", "0.5")
    for experiment in answer["experiments"]:
        assert experiment["limits"] == {"k_max": 300, "e_max": 0.5}


def test_the_command_score_writes_scores_for_limits_that_the_user_chooses_into_the_csv(
    results_file: Path, tmp_path: Path
) -> None:
    """Each line has the limits of its scores, by which others can compare them with scores of their own."""
    csv_path = tmp_path / "grid.csv"
    run_for_json("score", results_file, "--csv", csv_path, "--k-max", "250", "--e-max", "0.5")
    with csv_path.open(encoding="utf-8", newline="") as file:
        limits = [(row["K_max"], row["e_max"]) for row in csv.DictReader(file)]

    assert limits == [("250", "0.5")] * 6  # of two experiments of three trials


def table_of(output: str) -> list[list[str]]:
    """Return the cells of the table that a command has printed, row by row."""
    lines = [line for line in output.splitlines() if line[0] in "│┃"]
    return [re.split(" *[│┃] *", line)[1:-1] for line in lines]


def test_the_command_sweep_prints_limits_the_meaning_of_its_table_and_how_to_see_it_again(
    sweep_text: str, grid_file: Path
) -> None:
    """K_max and e_max are the limits of scores. The command for the same table has the seed."""
    assert "K_max 300, e_max 0.45; medians over the trials, H with quartiles" in sweep_text
    assert f"again: mcp-asdf sweep --seed=1 {grid_file} --workers 1" in sweep_text


def test_the_command_sweep_prints_medians_over_the_trials_of_each_experiment(
    sweep_text: str, sweep_answer: dict[str, Any]
) -> None:
    """The same medians are in its answer in JSON. The score H, with its quartiles, has a test of its own.

    h_K and h_e are the scores of convergence and of accuracy, K is the step of convergence and e the error in
    that step, and updates are how often robots have updated b_hat.
    """
    head, *rows = table_of(sweep_text)
    assert head == ["flawed", "trials", "H", "h_K", "h_e", "K", "e", "updates"]
    for experiment, row in zip(sweep_answer["experiments"], rows, strict=True):
        flawed, _trials, _score_with_quartiles, h_k, h_e, k, e, updates = row
        assert flawed == str(experiment["parameters"]["flawed"])
        assert h_k == f"{experiment['h_K']['median']:.2f}"
        assert h_e == f"{experiment['h_e']['median']:.2f}"
        assert k == f"{experiment['K']['median']:g}"
        assert e == f"{experiment['e']['median']:.5f}"
        assert updates == f"{experiment['updates']['median']:g}"


def test_the_command_sweep_prints_the_score_h_of_each_experiment_with_its_quartiles(
    sweep_text: str, results_file: Path
) -> None:
    """The table has a row for each of two experiments, which have three trials each."""
    _head, *rows = table_of(sweep_text)
    experiments = stream_experiments(results_file)
    for row, experiment in zip(rows, experiments, strict=True):
        _flawed, trials, printed_score, *_ = row
        scores = experiment.scores()["H"]
        lower_quartile, median, upper_quartile = np.percentile(scores, (25, 50, 75))
        assert trials == "3"
        assert printed_score == f"{median:.2f} [{lower_quartile:.2f}, {upper_quartile:.2f}]"


@pytest.fixture
def file_of_one_experiment(tmp_path: Path) -> Path:
    """A file that describes one short experiment."""
    path = tmp_path / "one.toml"
    path.write_text("steps = 100\nrobots = 3\nflawed = 1\n")
    return path


def test_options_of_the_command_simulate_change_the_experiment_of_a_file(
    file_of_one_experiment: Path,
) -> None:
    """The file's experiment has 100 steps, for which no option is given, and other robots and trials."""
    options = "--robots 6 --flawed 50% --trials 4 --omega 0.1"
    answer = run_for_json("simulate", file_of_one_experiment, *options.split())
    parameters = answer["parameters"]

    assert parameters["steps"] == 100
    assert parameters["robots"] == 6
    assert parameters["flawed"] == 3  # 50 % of 6
    assert parameters["omega"] == 0.1
    assert answer["trials"] == 4


@pytest.mark.parametrize(
    ("options", "expected_limits"),
    [("", {"k_max": 100, "e_max": 0.45}), ("--k-max 50 --e-max 0.5", {"k_max": 50, "e_max": 0.5})],
    ids=["paper", "user"],
)
def test_the_command_simulate_scores_with_the_paper_s_limits_or_with_those_of_the_user(
    options: str, expected_limits: dict[str, float], file_of_one_experiment: Path
) -> None:
    """The paper's limits are the length of a trial, here 100 steps, and an error of 0.45."""
    answer = run_for_json("simulate", file_of_one_experiment, "--trials", "1", *options.split())
    assert answer["limits"] == expected_limits


def test_the_command_simulate_writes_results_only_if_it_is_given_an_output(
    file_of_one_experiment: Path, tmp_path: Path
) -> None:
    """The output has a row for each trial, 30 by default. --record is an option of such an output."""
    run_for_json("simulate", file_of_one_experiment)
    assert list(tmp_path.iterdir()) == [file_of_one_experiment]

    run_for_json("simulate", file_of_one_experiment, "--output", tmp_path / "one.parquet", "--record", "100")
    assert len(read_table(tmp_path / "one.parquet")) == 30


@pytest.mark.parametrize(
    ("options", "expected_workers"),
    [
        ("--steps 999999", 1),  # short: 20 robots * 5 trials * 999,999 steps are less than 10**8
        ("--steps 1000000", 1024),
        ("--steps 1000 --firmware mirror", 1024),  # the firmware in Python, which is slow
    ],
)
def test_the_command_simulate_runs_only_a_short_experiment_in_its_own_process(
    options: str, expected_workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Starting others would take longer. The user asks for 1024 processes, and gets them for longer ones.

    No trial is run here, as the command is ended by an error where it calls the library.
    """
    library_function = Mock(side_effect=UsageError("the command ends here"))
    monkeypatch.setattr("mcp_asdf_tools.library.simulate", library_function)

    cli.main(f"simulate --robots 20 --trials 5 --workers 1024 {options}".split())

    assert library_function.call_args.kwargs["workers"] == expected_workers


A_THOUSAND_ROBOTS = "--robots 1000 --trials 1 --steps 20"


@pytest.mark.parametrize(
    ("arguments", "expected_message"),
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
def test_commands_on_experiments_refuse_bad_options_and_say_what_is_wrong(
    arguments: str, expected_message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """An option is refused if its value is impossible, or if it would have no effect."""
    assert cli.main(arguments.split()) == EXIT_CODE_OF_USAGE_ERROR
    assert expected_message in capsys.readouterr().err


# --- Signals ---------------------------------------------------------------------------------------------


@pytest.fixture
def slow_sweep(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The command ``sweep`` on two worker processes, which takes long, as a terminal starts it.

    It has 400 trials of one experiment.
    """
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


def test_ctrl_c_ends_a_sweep_with_the_number_of_trials_that_are_left(
    grid_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file has two experiments of three trials, and a job is the trials of one of them.

    Ctrl-C comes after the first job. The exit code is 128 and the number of the signal, as in shells.
    """
    record_jobs(monkeypatch, max_jobs=1)  # raises KeyboardInterrupt, as Ctrl-C does, in the second job
    output = str(tmp_path / "grid.parquet")
    exit_code = cli.main(["sweep", str(grid_file), "--workers", "1", "--output", output])

    assert exit_code == 128 + signal.SIGINT
    assert "3 of 6 trials left; the same command goes on" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("sent_signal", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_sweep_with_advice_and_keeps_the_finished_trials(
    sent_signal: signal.Signals, slow_sweep: subprocess.Popen[str], tmp_path: Path
) -> None:
    """The advice is that the same command goes on with the sweep, which has written a part before.

    Each of its 400 trials is either in a part, or is missing when the sweep is opened again.
    """
    parts = tmp_path / "slow.parquet.parts"
    wait_until(lambda: any(parts.glob("*.parquet")))
    os.killpg(slow_sweep.pid, sent_signal)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)

    assert slow_sweep.returncode == 128 + sent_signal  # as shells report the end by a signal
    assert "the same command goes on" in errors
    assert "Traceback" not in errors
    finished_trials = sum(row_count_of_each_part(parts))
    assert finished_trials > 0
    experiment_of_the_sweep = Experiment(firmware="mirror", steps=400, trials=400, robots=4)
    missing_trials = Store(tmp_path / "slow.parquet", [experiment_of_the_sweep]).missing_count
    assert finished_trials + missing_trials == 400


@pytest.fixture
def ctrl_c_in_the_first_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let Ctrl-C come while the first part of a sweep is written; a part is due after each job."""
    write_tables = result_files.write_tables

    def write_and_interrupt(path: Path, tables: Any) -> None:
        write_tables(path, tables)
        if len(row_count_of_each_part(path.parent)) == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(store_module, "_SECONDS_BETWEEN_PARTS", 0.0)
    monkeypatch.setattr(store_module, "write_tables", write_and_interrupt)


@pytest.mark.usefixtures("ctrl_c_in_the_first_part")
def test_ctrl_c_while_a_part_of_the_results_is_written_loses_no_finished_trial(output: Path) -> None:
    """The files lack exactly the trials that the interrupted sweep counts as missing.

    Each trial is a job, after which a part is written. A fixture sends Ctrl-C when the first of 100 parts is
    there.
    """
    experiment = Experiment(firmware="mirror", steps=20, trials=100, robots=4)
    store = Store(output, [experiment])
    with interruptible(), pytest.raises(KeyboardInterrupt):
        run_sweep(store, workers=1)

    missing_on_disk = Store(output, [experiment]).missing_count
    assert missing_on_disk == store.missing_count
    assert 0 < missing_on_disk < 100


@pytest.mark.slow
def test_ctrl_c_while_worker_processes_start_ends_a_sweep_without_a_traceback(
    slow_sweep: subprocess.Popen[str],
) -> None:
    """Ctrl-C in a terminal reaches all processes of a group, also those that are still importing."""
    wait_until(lambda: len(workers_of(slow_sweep)) > 0)
    os.killpg(slow_sweep.pid, signal.SIGINT)
    _, errors = slow_sweep.communicate(timeout=PATIENCE)

    assert slow_sweep.returncode == 128 + signal.SIGINT
    assert "Traceback" not in errors


@pytest.mark.slow
def test_worker_processes_end_with_a_sweep_that_is_killed(slow_sweep: subprocess.Popen[str]) -> None:
    """A process that is killed cannot end its two workers, so these have to notice it themselves."""
    wait_until(lambda: len(workers_of(slow_sweep)) == 2)
    workers = workers_of(slow_sweep)
    slow_sweep.kill()
    wait_until(lambda: not any(is_worker(worker) for worker in workers))  # or fails after some minutes
