"""Tidy tables have a row for each trial, step and robot, and files of them are complete or not there."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.csv  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import result_files
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.tidy_tables import stream_tidy_results, write_tidy_tables
from mcp_asdf_tools.experiments.trials import run_trials
from support import limited_file_size

SHORT_EXPERIMENT = Experiment(robots=3, flawed=1, filter="asdf-plus", steps=40, filter_period=10, trials=2)
FORMAT_5_FILE = Path(__file__).with_name("results_format_5.parquet")


@pytest.fixture(scope="module")
def trials() -> Trials:
    """Two trials of three robots, recorded at the steps 0, 20 and 40."""
    return run_trials(SHORT_EXPERIMENT, first=0, trials=2, sampling_interval=20)


def tidied(table: pa.Table) -> pa.Table:
    """Return the recorded values in a table of results as one tidy table."""
    return pa.concat_tables(stream_tidy_results(table))


@pytest.fixture(scope="module")
def tidy(trials: Trials) -> pa.Table:
    """The table of these trials with a row for each trial, recorded step and robot."""
    return tidied(trials_to_table(trials))


# --- Rows and columns ------------------------------------------------------------------------------------


def test_a_tidy_table_of_one_experiment_has_no_columns_of_parameters(tidy: pa.Table) -> None:
    """Such columns would be the same in all rows. Behind the first four, a column has what was recorded."""
    assert tidy.column_names == ["trial", "step", "robot", "is_flawed", *QUANTITIES]


def test_rows_of_a_tidy_table_are_in_the_order_of_trials_steps_and_robots(tidy: pa.Table) -> None:
    """Two trials of three robots were recorded at three steps."""
    assert tidy["trial"].to_pylist() == [0] * 9 + [1] * 9
    assert tidy["step"].to_pylist() == [0, 0, 0, 20, 20, 20, 40, 40, 40] * 2
    assert tidy["robot"].to_pylist() == [0, 1, 2] * 6


def test_a_tidy_table_says_in_each_row_whether_the_robot_is_flawed(tidy: pa.Table) -> None:
    """The first of three robots is. There are two trials with three recorded steps."""
    assert tidy["is_flawed"].to_pylist() == [True, False, False] * (2 * 3)


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_row_of_a_tidy_table_has_what_was_recorded_of_its_robot(
    name: str, tidy: pa.Table, trials: Trials
) -> None:
    """Rows are in the order of trials, steps and robots, which are the axes of the records' array."""
    values_in_the_order_of_rows = trials.records[name].ravel()
    assert tidy[name].type == pa.float64()
    assert tidy[name].to_pylist() == values_in_the_order_of_rows.tolist()


def test_parameters_that_differ_between_experiments_have_columns_behind_the_trial(trials: Trials) -> None:
    """One experiment has two trials of 3 robots with the filter ASDF+.

    The other one, without a filter, has one trial of 2 robots. Both are recorded at three steps.
    """
    two_unfiltered_robots = replace(SHORT_EXPERIMENT, filter="none", robots=2)
    other_trials = run_trials(two_unfiltered_robots, first=0, trials=1, sampling_interval=20)
    tidy = tidied(pa.concat_tables([trials_to_table(trials), trials_to_table(other_trials)]))

    assert tidy.column_names[:5] == ["trial", "robots", "filter", "step", "robot"]
    row_count = 2 * 3 * 3  # trials * recorded steps * robots
    other_row_count = 1 * 3 * 2
    assert tidy["robots"].to_pylist() == [3] * row_count + [2] * other_row_count
    assert tidy["filter"].to_pylist() == ["asdf-plus"] * row_count + ["none"] * other_row_count


def test_every_column_of_a_tidy_table_has_a_unit_and_a_meaning(tidy: pa.Table) -> None:
    """Parquet keeps them as bytes in the metadata of a column. The unit is 1 where a number has none."""
    for column in tidy.schema:
        expected_unit = b"step" if column.name == "step" else b"1"
        assert column.metadata[b"unit"] == expected_unit
        assert column.metadata[b"meaning"] != b""


# --- Streams ---------------------------------------------------------------------------------------------


@pytest.fixture
def folder_of_two(trials: Trials, tmp_path: Path) -> Path:
    """A folder with two files of results, whose experiments differ in their seed."""
    table = trials_to_table(trials)
    other_table = trials_to_table(
        run_trials(replace(SHORT_EXPERIMENT, seed=2), first=0, trials=2, sampling_interval=20)
    )
    folder = tmp_path / "parts"
    folder.mkdir()
    write_tables(folder / "1.parquet", [table])
    write_tables(folder / "2.parquet", [other_table])
    return folder


def test_tables_of_a_folder_s_files_have_a_column_for_a_parameter_that_differs_between_files(
    folder_of_two: Path,
) -> None:
    """The folder has two files of results with the seeds 1 and 2. In each file alone there is one seed."""
    first_table, second_table = stream_tidy_results(folder_of_two)
    assert set(first_table["seed"].to_pylist()) == {1}
    assert set(second_table["seed"].to_pylist()) == {2}


def test_a_file_of_results_is_not_read_before_its_rows_are_needed(
    folder_of_two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So results may be larger than the memory.

    When the first table is there, only the first of two files has been read with all of its columns.
    """
    read = Mock(side_effect=result_files._read_row_group)
    monkeypatch.setattr(result_files, "_read_row_group", read)
    next(stream_tidy_results(folder_of_two))

    files_read_completely = []
    for path, _index, columns in [call.args for call in read.call_args_list]:
        if columns is None:  # all of them: the columns of parameters are read first
            files_read_completely.append(path.name)
    assert files_read_completely == ["1.parquet"]


# --- Files -----------------------------------------------------------------------------------------------


def test_a_tidy_table_written_as_parquet_keeps_values_types_and_meanings(
    tidy: pa.Table, tmp_path: Path
) -> None:
    """The metadata of a column have its meaning."""
    write_tidy_tables(tmp_path / "robots.parquet", [tidy])
    table_from_file = pq.read_table(tmp_path / "robots.parquet")
    assert table_from_file.equals(tidy)
    for column, column_from_file in zip(tidy.schema, table_from_file.schema, strict=True):
        assert column_from_file.metadata == column.metadata


def test_a_tidy_table_written_as_csv_keeps_every_bit_of_the_values(tidy: pa.Table, tmp_path: Path) -> None:
    """The values are those of every quantity that is recorded of robots, such as x."""
    write_tidy_tables(tmp_path / "robots.csv", [tidy])
    table_from_file = pyarrow.csv.read_csv(tmp_path / "robots.csv")
    for quantity in QUANTITIES:
        assert table_from_file[quantity].to_pylist() == tidy[quantity].to_pylist()


def test_a_tidy_table_as_csv_has_a_header_and_writes_true_and_false_as_1_and_0(
    tidy: pa.Table, tmp_path: Path
) -> None:
    """The first row is of a flawed robot, the second of a healthy one; ``is_flawed`` is the fourth column."""
    first_two_rows = tidy.slice(0, 2)
    write_tidy_tables(tmp_path / "robots.csv", [first_two_rows])
    header, flawed_row, healthy_row = (tmp_path / "robots.csv").read_text(encoding="utf-8").splitlines()

    assert header.startswith('"trial","step","robot","is_flawed","t",')
    assert flawed_row.startswith("0,0,0,1,0,0,0.5,")
    assert healthy_row.startswith("0,0,1,0,0,0,0.5,")


def test_many_small_tidy_tables_become_one_row_group_of_a_parquet_file(
    tidy: pa.Table, tmp_path: Path
) -> None:
    """A file of many row groups, which are its units of reading, would be slow to read.

    There are 20 tables with a row for each of 2 trials, 3 recorded steps and 3 robots.
    """
    rows_written = write_tidy_tables(tmp_path / "robots.parquet", [tidy] * 20)
    rows_of_a_table = 2 * 3 * 3
    assert rows_written == 20 * rows_of_a_table
    assert pq.ParquetFile(tmp_path / "robots.parquet").num_row_groups == 1


def test_an_exported_table_does_not_replace_a_file_of_results(tidy: pa.Table, tmp_path: Path) -> None:
    """The file is a copy of results that an earlier version has written. It stays as it was."""
    results = tmp_path / "run.parquet"
    shutil.copy(FORMAT_5_FILE, results)

    with pytest.raises(UsageError, match=r"run\.parquet has results, which would be lost"):
        write_tidy_tables(results, [tidy])
    assert results.read_bytes() == FORMAT_5_FILE.read_bytes()


def test_a_tidy_table_replaces_the_one_that_an_earlier_export_has_written(
    tidy: pa.Table, tmp_path: Path
) -> None:
    """The second export has only the first row of the table."""
    path = tmp_path / "robots.parquet"
    write_tidy_tables(path, [tidy])
    first_row = tidy.slice(0, 1)
    write_tidy_tables(path, [first_row])
    assert pq.read_table(path).equals(first_row)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("max_bytes", [0, 2000])
def test_an_export_to_a_full_disk_fails_and_leaves_the_earlier_file_alone(
    max_bytes: int, suffix: str, tidy: pa.Table, tmp_path: Path
) -> None:
    """The disk is full at once, or in the middle of the new file, after 2000 bytes.

    Instead of the disk, the size of files is limited. No other file is left behind.
    """
    path = tmp_path / f"robots{suffix}"
    path.write_bytes(b"earlier")
    with limited_file_size(max_bytes), pytest.raises(UsageError, match=f"cannot write {path}: .*make room"):
        write_tidy_tables(path, [tidy] * 50)

    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"earlier"
