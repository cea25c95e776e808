"""Tidy tables: a row for each trial, step and robot, with the robot's values then, for data analysis.

Results have a row for each trial, and lists in it. Here no cell is a list, so that a table can be a CSV file,
and a data frame of any program. The columns are

- ``trial``;
- the parameters that differ between the experiments of the table;
- ``step``, ``robot`` and ``is_flawed``;
- QUANTITIES, as plain numbers. They are missing where a robot was dead.

The metadata of each column has its ``unit`` and its ``meaning``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.csv  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import check_target
from mcp_asdf_tools.experiments.result_files import (
    RowGroups,
    collect_rows,
    stream_experiments,
    write_tables,
)
from mcp_asdf_tools.experiments.result_tables import METADATA_KEY, column_types, describe_columns
from mcp_asdf_tools.experiments.results import QUANTITIES, Trials, find_differences
from mcp_asdf_tools.robots.population import Population

SUFFIXES = (".csv", ".parquet")
"""Suffixes of the files that a tidy table can be written to."""

_TYPE_BY_COLUMN = {"trial": pa.int64(), "step": pa.int64(), "robot": pa.int32(), "is_flawed": pa.bool_()}
"""Types of the columns that are neither parameters nor QUANTITIES, which are doubles."""

_UNITS_AND_MEANINGS = {
    "trial": ("1", "number of the trial; the first is 0, as in a swarm's log"),
    "step": ("step", "steps so far; values at 0 are those before the first observation"),
    "robot": ("1", "id of the robot, from 0"),
    "is_flawed": ("1", "whether the robot assumed a wrong accuracy at step 0"),
    "t": ("1", "observations so far, halved together with n whenever they reach memory"),
    "n": ("1", "black observations among them"),
    "x_hat": ("1", "local estimate of the fill ratio"),
    "alpha": ("1", "confidence of x_hat"),
    "x_bar": ("1", "social estimate of the fill ratio"),
    "beta": ("1", "confidence of x_bar"),
    "x": ("1", "informed estimate of the fill ratio"),
    "b_hat": ("1", "accuracy that the robot assumes of its sensor"),
}
"""Unit and meaning of the columns that are not parameters."""


# --- Rows ------------------------------------------------------------------------------------------------


def tidy_trials(trials: Trials, parameter_names: Sequence[str]) -> pa.Table:
    """Return the recorded values of trials as a tidy table, with a column for each of these parameters.

    Raises UsageError, with the fix, if nothing was recorded.
    """
    if not trials.records:
        raise UsageError(
            "no values of robots over time were recorded; run simulate or sweep again with --record 100, or "
            "in Python with record=100, into another file"
        )
    sample_count = trials.records["x"].shape[1]
    steps = np.arange(sample_count) * trials.sampling_interval
    return tidy_table(trials.experiment, parameter_names, trials.numbers, steps, trials.records)


def tidy_table(
    population: Population,
    parameter_names: Sequence[str],
    trial_numbers: Sequence[int],
    steps: NDArray[np.int64],
    values: Mapping[str, NDArray[np.float64]],
) -> pa.Table:
    """Return values of robots over time as a tidy table, in the order of trials, steps and robots.

    Args:
        population: The robots and their parameters, the same in all trials.
        parameter_names: Parameters with a column.
        trial_numbers: Numbers of the trials.
        steps: Numbers of the steps.
        values: QUANTITIES by name, shape (trials, steps, N); NaN where one is missing.
    """
    columns = {**_columns_of_rows(population, trial_numbers, steps), **values}
    row_count = columns["robot"].size
    parameters = population.parameters()
    schema = _schema_with(tuple(parameter_names))
    arrays = []
    for field in schema:
        if field.name in parameter_names:  # the same in all rows
            arrays.append(pa.repeat(pa.scalar(parameters[field.name], field.type), row_count))
        else:
            column = columns[field.name].ravel()
            # With this option NaN becomes a missing value, which all programs know, also in CSV.
            arrays.append(pa.array(column, field.type, from_pandas=True))
    return pa.table(arrays, schema=schema)


def _columns_of_rows(
    population: Population, trial_numbers: Sequence[int], steps: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the columns trial, step, robot and is_flawed of a tidy table, by name.

    Each is an array of the shape (trials, steps, N), and each row of the table has one element of it.
    """
    robots = range(population.robots)
    trial_column, step_column, robot_column = np.meshgrid(trial_numbers, steps, robots, indexing="ij")
    is_flawed = np.array([population.is_flawed(robot) for robot in robots])[robot_column]
    return {"trial": trial_column, "step": step_column, "robot": robot_column, "is_flawed": is_flawed}


@cache
def _schema_with(parameter_names: tuple[str, ...]) -> pa.Schema:
    """Return the columns of a tidy table that has these parameters: names, types, units and meanings."""
    column_names = ("trial", *parameter_names, "step", "robot", "is_flawed", *QUANTITIES)
    fields = []
    for name in column_names:
        if name in parameter_names:
            column_type = column_types()[name]
            description = describe_columns()[name]
        else:
            column_type = _TYPE_BY_COLUMN.get(name, pa.float64())
            unit, meaning = _UNITS_AND_MEANINGS[name]
            description = {"unit": unit, "meaning": meaning}
        fields.append(pa.field(name, column_type, metadata=description))
    return pa.schema(fields)


# --- Results ---------------------------------------------------------------------------------------------


def stream_tidy_results(source: Path | pa.Table) -> Iterator[pa.Table]:
    """Yield the recorded values in a table or file of results, or all files in a folder, as tidy tables.

    They have the same columns, and are in the order of the rows. One row group of a file at a time is in
    memory. Raises UsageError if a file cannot be read or has anything but results, and, with the fix, if
    nothing was recorded.
    """
    row_groups = RowGroups(source)
    # The tables have a column for each parameter in which any experiments differ, so all parameters are read
    # before the first table.
    experiments = row_groups.rows_by_experiment()
    differing_names = list(find_differences(experiment.parameters() for experiment in experiments))
    for row_group in row_groups:
        for trials in stream_experiments(row_group.read(None)):  # with all columns
            yield tidy_trials(trials, differing_names)


# --- Files -----------------------------------------------------------------------------------------------


def check_tidy_path(path: Path) -> None:
    """Raise UsageError if a tidy table cannot be written to a path, or would replace results there."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"cannot export to {path.name}: choose a name that ends in {' or '.join(SUFFIXES)}")
    if check_target(path).exists() and _has_results(path):
        raise UsageError(f"{path} has results, which would be lost; choose another name")


def _has_results(path: Path) -> bool:
    """Return whether an existing file is a Parquet file of results, in any format of them."""
    try:
        return METADATA_KEY in (pq.read_schema(path).metadata or {})
    except (OSError, pa.ArrowException):  # no Parquet file, or one that cannot be read
        return False


def write_tidy_tables(path: Path, tables: Iterable[pa.Table]) -> int:
    """Write tidy tables of the same columns, at least one, to a file, and return its number of rows.

    The suffix of the path, CSV or Parquet, gives the format. In CSV ``is_flawed`` is 0 or 1. The file has its
    name only once it is complete. Raises UsageError if it cannot be written, or would replace results.
    """
    check_tidy_path(path)
    # The tables of experiments may have few rows each, and writing many small ones takes long.
    larger_tables = collect_rows(tables)
    if path.suffix.lower() == ".csv":
        csv_tables = map(_replace_truth_by_number, larger_tables)
        return write_tables(path, csv_tables, open_writer=pyarrow.csv.CSVWriter)
    return write_tables(path, larger_tables)  # by default in Parquet


def _replace_truth_by_number(table: pa.Table) -> pa.Table:
    """Return a tidy table with 0 or 1 in ``is_flawed``: R and Octave would take "true" for a text."""
    index = table.column_names.index("is_flawed")
    field = table.schema.field("is_flawed").with_type(pa.int8())
    return table.set_column(index, field, table["is_flawed"].cast(pa.int8()))
