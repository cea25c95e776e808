"""Tidy tables have a row for each trial, step and robot, and files of them are complete or not there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.csv  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_files import RowGroup, write_tables
from mcp_asdf_tools.experiments.result_tables import trials_to_table
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials
from mcp_asdf_tools.experiments.tidy_tables import stream_tidy_results, tidy_results, write_tidy_tables
from mcp_asdf_tools.experiments.trials import run_trials
from support import limited_file_size

SHORT = Experiment(robots=3, flawed=1, filter="asdf-plus", steps=40, filter_period=10, trials=2)
FORMAT_5_FILE = Path(__file__).with_name("results_format_5.parquet")


@pytest.fixture(scope="module")
def trials() -> Trials:
    """Two trials of three robots, recorded at the steps 0, 20 and 40."""
    return run_trials(SHORT, 0, 2, sampling_interval=20)


@pytest.fixture(scope="module")
def tidy(trials: Trials) -> pa.Table:
    """The tidy table of these trials."""
    return tidy_results(trials_to_table(trials))


# --- Rows and columns ------------------------------------------------------------------------------------


def test_a_table_of_one_experiment_has_no_parameters(tidy: pa.Table) -> None:
    """They would be the same in all rows."""
    assert tidy.column_names == ["trial", "step", "robot", "is_flawed", *QUANTITIES]


def test_rows_are_in_the_order_of_trials_steps_and_robots(tidy: pa.Table) -> None:
    assert tidy["trial"].to_pylist() == [0] * 9 + [1] * 9
    assert tidy["step"].to_pylist() == [0, 0, 0, 20, 20, 20, 40, 40, 40] * 2
    assert tidy["robot"].to_pylist() == [0, 1, 2] * 6


def test_the_first_robots_are_the_flawed_ones(tidy: pa.Table) -> None:
    assert tidy["is_flawed"].to_pylist() == [True, False, False] * 6


@pytest.mark.parametrize("name", QUANTITIES)
def test_a_row_has_the_recorded_values_of_its_trial_step_and_robot(
    name: str, tidy: pa.Table, trials: Trials
) -> None:
    """Rows are ordered by trial, then by the three recorded steps, then by the three robots."""
    assert tidy[name].type == pa.float64()
    trial, sample, robot = 1, 2, 1
    row_index = trial * 3 * 3 + sample * 3 + robot

    assert tidy[name][row_index].as_py() == trials.records[name][trial, sample, robot]


def test_parameters_that_vary_have_columns_behind_the_trial(trials: Trials) -> None:
    other = replace(SHORT, filter="none", robots=2)
    other_trials = run_trials(other, 0, 1, sampling_interval=20)
    tidy = tidy_results(pa.concat_tables([trials_to_table(trials), trials_to_table(other_trials)]))

    assert tidy.column_names[:5] == ["trial", "robots", "filter", "step", "robot"]
    assert tidy.slice(17, 2).select(["robots", "filter"]).to_pylist() == [
        {"robots": 3, "filter": "asdf-plus"},
        {"robots": 2, "filter": "none"},
    ]


def test_every_column_has_a_unit_and_a_meaning(tidy: pa.Table) -> None:
    for field in tidy.schema:
        assert field.metadata[b"unit"] == (b"step" if field.name == "step" else b"1")
        assert field.metadata[b"meaning"]


def test_results_without_records_are_refused_with_the_option_that_records() -> None:
    table = trials_to_table(run_trials(SHORT, 0, 1))
    with pytest.raises(UsageError, match=r"no values of robots .* were recorded; run .* --record 100"):
        tidy_results(table)


def test_results_of_an_earlier_version_become_tidy_tables() -> None:
    """Two trials of 3 robots and two of 2, recorded after 0, 10 and 20 observations of each robot."""
    tidy = pa.concat_tables(stream_tidy_results(FORMAT_5_FILE))

    rows_of_3_robots, rows_of_2_robots = 2 * 3 * 3, 2 * 3 * 2
    assert tidy["robots"].to_pylist() == [3] * rows_of_3_robots + [2] * rows_of_2_robots
    first_trial_of_2_robots = tidy.slice(rows_of_3_robots, 6)
    assert first_trial_of_2_robots["t"].to_pylist() == [0, 0, 10, 10, 20, 20]


# --- Streams ---------------------------------------------------------------------------------------------


@pytest.fixture
def folder_of_two(trials: Trials, tmp_path: Path) -> Path:
    """A folder with two files of results, whose experiments differ in their seed."""
    table = trials_to_table(trials)
    other_table = trials_to_table(run_trials(replace(SHORT, seed=2), 0, 2, sampling_interval=20))
    folder = tmp_path / "parts"
    folder.mkdir()
    write_tables(folder / "1.parquet", [table])
    write_tables(folder / "2.parquet", [other_table])
    return folder


def test_files_of_a_folder_have_columns_for_parameters_that_differ_between_them(folder_of_two: Path) -> None:
    first_table, second_table = stream_tidy_results(folder_of_two)
    assert set(first_table["seed"].to_pylist()) == {1}
    assert set(second_table["seed"].to_pylist()) == {2}


def test_files_of_results_are_read_one_by_one_as_their_rows_are_needed(
    folder_of_two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So results may be larger than the memory.

    The first table is asked for, and the second file is not read.
    """
    complete_reads = []
    read = RowGroup.read

    def read_and_note(row_group: RowGroup, columns: object = None) -> pa.Table:
        if columns is None:
            complete_reads.append(row_group.path.name)
        return read(row_group, columns)  # type: ignore[arg-type]

    monkeypatch.setattr(RowGroup, "read", read_and_note)
    next(stream_tidy_results(folder_of_two))
    assert complete_reads == ["1.parquet"]


# --- Files -----------------------------------------------------------------------------------------------


def test_parquet_keeps_values_types_and_meanings(tidy: pa.Table, tmp_path: Path) -> None:
    write_tidy_tables(tmp_path / "robots.parquet", [tidy])
    read_back = pq.read_table(tmp_path / "robots.parquet")
    assert read_back.equals(tidy)
    assert read_back.schema.field("x").metadata == tidy.schema.field("x").metadata


def test_csv_keeps_every_bit_of_the_values(tidy: pa.Table, tmp_path: Path) -> None:
    write_tidy_tables(tmp_path / "robots.csv", [tidy])
    read_back = pyarrow.csv.read_csv(tmp_path / "robots.csv")
    assert read_back["alpha"].to_pylist() == tidy["alpha"].to_pylist()
    assert read_back["b_hat"].to_pylist() == tidy["b_hat"].to_pylist()


def test_csv_has_a_header_and_numbers_for_truth_values(tidy: pa.Table, tmp_path: Path) -> None:
    write_tidy_tables(tmp_path / "robots.csv", [tidy.slice(0, 2)])
    header, flawed_row, healthy_row = (tmp_path / "robots.csv").read_text(encoding="utf-8").splitlines()

    assert header.startswith('"trial","step","robot","is_flawed","t",')
    assert flawed_row.startswith("0,0,0,1,0,0,0.5,")
    assert healthy_row.startswith("0,0,1,0,0,0,0.5,")


def test_the_number_of_rows_written_is_returned(tidy: pa.Table, tmp_path: Path) -> None:
    assert len(tidy) == 2 * 3 * 3  # trials, steps and robots
    assert write_tidy_tables(tmp_path / "robots.csv", [tidy, tidy]) == 2 * len(tidy)


def test_many_small_tables_become_one_row_group(tidy: pa.Table, tmp_path: Path) -> None:
    write_tidy_tables(tmp_path / "robots.parquet", [tidy] * 20)
    assert pq.ParquetFile(tmp_path / "robots.parquet").num_row_groups == 1


def test_a_table_is_exported_to_csv_or_parquet_and_nothing_else(tidy: pa.Table, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot export to robots\.xlsx: .* \.csv or \.parquet"):
        write_tidy_tables(tmp_path / "robots.xlsx", [tidy])


def test_an_exported_table_does_not_replace_a_file_of_results(tidy: pa.Table, tmp_path: Path) -> None:
    results = tmp_path / "run.parquet"
    results.write_bytes(FORMAT_5_FILE.read_bytes())

    with pytest.raises(UsageError, match=r"run\.parquet has results, which would be lost"):
        write_tidy_tables(results, [tidy])
    assert results.read_bytes() == FORMAT_5_FILE.read_bytes()


def test_a_table_replaces_an_earlier_table(tidy: pa.Table, tmp_path: Path) -> None:
    write_tidy_tables(tmp_path / "robots.parquet", [tidy])
    write_tidy_tables(tmp_path / "robots.parquet", [tidy.slice(0, 1)])
    assert len(pq.read_table(tmp_path / "robots.parquet")) == 1


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("max_bytes", [0, 2000])
def test_a_full_disk_leaves_the_earlier_file_alone(
    max_bytes: int, suffix: str, tidy: pa.Table, tmp_path: Path
) -> None:
    path = tmp_path / f"robots{suffix}"
    path.write_bytes(b"earlier")
    with limited_file_size(max_bytes), pytest.raises(UsageError, match=f"cannot write {path}: .*make room"):
        write_tidy_tables(path, [tidy] * 50)

    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"earlier"


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_an_interruption_leaves_no_file(
    suffix: str, tidy: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tables_until_ctrl_c() -> Iterator[pa.Table]:
        yield tidy
        raise KeyboardInterrupt

    monkeypatch.setattr("mcp_asdf_tools.experiments.tidy_tables._MIN_ROWS_WRITTEN", 1)
    with pytest.raises(KeyboardInterrupt):
        write_tidy_tables(tmp_path / f"robots{suffix}", tables_until_ctrl_c())
    assert list(tmp_path.iterdir()) == []
