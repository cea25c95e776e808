"""Results of trials as tables of pyarrow, which files of results contain.

A table has a row for each trial, with a column for each parameter of the experiment and

- ``trial``, the number of the trial;
- ``H``, ``h_K`` and ``h_e``, the paper's scores (0 to 100) with its limits K_max and e_max;
- ``k`` and ``e``, lists with a value of each robot: convergence steps and errors;
- ``b_hat``, a list of the accuracies that robots assume: those of all robots after the first filter step,
  then those after the second, and so on;
- ``tests`` and ``updates``, lists with a value of each robot: hypothesis tests, and re-estimates of b_hat;
- ``record_t`` to ``record_b_hat``, lists with a list for each recorded step, in which each robot has a value.
  Steps are recorded from step 0 on, every ``sampling_interval`` steps; empty if nothing was recorded.

The metadata have JSON under the key ``mcp-asdf``: the version of the format, the versions of the software,
the threshold delta, ``sampling_interval``, unit and meaning of each of ``columns``, and ``source`` if another
program has run the trials. Rows with the same parameters belong to one experiment. A parameter without a
column has its default, so that a table can be read which was written before the parameter existed. A table in
format 5, whose records are flat lists in the order of ``b_hat``, is converted when it is read.
"""

from __future__ import annotations

import json
from decimal import Decimal
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.compute as pc  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import PARAMETER_NAMES, QUANTITIES, Trials
from mcp_asdf_tools.experiments.scores import DELTA, SCORES, Limits, score

PRESENT_FORMAT = 6
FLAT_RECORDS_FORMAT = 5
"""The format before the present one. The record of a trial was one list in it: the values of all robots at
step 0, then those at the next recorded step, and so on."""
READABLE_FORMATS = (FLAT_RECORDS_FORMAT, PRESENT_FORMAT)

METADATA_KEY = b"mcp-asdf"

_LIST_COLUMNS = {
    "k": ("convergence_steps", "int32"),
    "e": ("errors", "float64"),
    "b_hat": ("b_hat", "float64"),
    "tests": ("tests", "int32"),
    "updates": ("updates", "int32"),
}
"""Columns of lists, with the attribute of ``Trials`` that each contains and the type of its elements."""

INDEX_COLUMNS = (*PARAMETER_NAMES, "trial")
"""Columns that tell which trial of which experiment a row is."""

RECORD_COLUMNS = {name: f"record_{name}" for name in QUANTITIES}
"""Name of the column of each recorded quantity."""

# In tables read from files pyarrow calls the elements of lists "element". New tables use the same name, so
# that equal rows give equal files.
_VALUES_OF_ROBOTS = pa.list_(pa.field("element", pa.float64()))
"""Type of a list with a value of each robot."""
_RECORD_OF_TRIAL = pa.list_(pa.field("element", _VALUES_OF_ROBOTS))
"""Type of a list with such a list for each recorded step."""

_UNITS = {
    **dict.fromkeys(("width", "height", "radio_range", "tile"), "m"),
    **dict.fromkeys(("observation_period", "steps", "comms_period"), "step"),
    **dict.fromkeys(("filter_period", "latency", "k"), "step"),
    **dict.fromkeys(SCORES, "point of 100"),
    "drift_rate": "1/step",
    "speed": "m/s",
    "steps_per_second": "1/s",
}
"""Units of the columns that have one."""

_MEANINGS = {
    "trial": "number of the trial, from 0",
    "H": "score, mean of h_K and h_e, with the paper's K_max and e_max",
    "h_K": "score of convergence",
    "h_e": "score of accuracy",
    "k": "K: step from which on x stays within delta, by robot",
    "e": "|x - f| at K, by robot",
    "b_hat": "assumed accuracy after each filter step, robot by robot within a step",
    "tests": "hypothesis tests modulo 65536, by robot",
    "updates": "re-estimates of b_hat modulo 65536, by robot",
    **{
        column: f"{name} every sampling_interval steps from step 0 on: a list by robot for each of them"
        for name, column in RECORD_COLUMNS.items()
    },
}
"""Meanings of the columns that are not parameters."""


# --- Columns ---------------------------------------------------------------------------------------------


@cache
def describe_columns() -> dict[str, dict[str, str]]:
    """Return the unit and the meaning of each column by its name. The unit is "1" if there is none."""
    meanings = {name: parameter.meaning for name, parameter in parameters_of(Experiment).items()}
    meanings |= _MEANINGS
    return {name: {"unit": _UNITS.get(name, "1"), "meaning": meaning} for name, meaning in meanings.items()}


@cache
def column_types() -> dict[str, Any]:
    """Return the pyarrow type of each column by its name, in the order of a table's columns.

    Whole numbers have no sign, since seeds take all values of 64 bits.
    """
    number_types = {int: pa.uint64(), float: pa.float64(), Decimal: pa.float64()}
    default_experiment = Experiment()
    types: dict[str, Any] = {}
    for name in PARAMETER_NAMES:
        default = getattr(default_experiment, name)
        types[name] = number_types.get(type(default), pa.string())  # what is no number is a text
    types["trial"] = pa.int64()
    for score_name in SCORES:
        types[score_name] = pa.float64()
    for name, (_attribute, element_type_name) in _LIST_COLUMNS.items():
        make_element_type = getattr(pa, element_type_name)  # such as pa.float64
        types[name] = pa.list_(pa.field("element", make_element_type()))
    for record_name in RECORD_COLUMNS.values():
        types[record_name] = _RECORD_OF_TRIAL
    return types


def column_types_of_format(table_format: int) -> dict[str, Any]:
    """Return the pyarrow type of each column by its name in one of READABLE_FORMATS.

    In FLAT_RECORDS_FORMAT a record is one list of numbers, in the present format a list of such lists.
    """
    types = dict(column_types())
    if table_format == FLAT_RECORDS_FORMAT:
        for record_name in RECORD_COLUMNS.values():
            types[record_name] = _VALUES_OF_ROBOTS
    return types


def to_present_format(table: pa.Table, row_count: int) -> pa.Table:
    """Return a table of READABLE_FORMATS, with some columns or all, in the present format.

    Missing parameters have their defaults, and columns are in the usual order; those of other names come
    last. ``row_count`` is the number of rows, which a table without columns does not know. A table in format
    5 with records must have a column ``robots``, unless all experiments have the default. Raises UsageError
    for a flat record that has not a value of each robot at each step.
    """
    complete_table = _add_missing_parameters(table, row_count)
    flat_columns = [
        column
        for column in RECORD_COLUMNS.values()
        if column in complete_table.column_names and complete_table[column].type == _VALUES_OF_ROBOTS
    ]
    for column in flat_columns:
        index = complete_table.column_names.index(column)
        nested_record = _nest_flat_record(complete_table, column)
        complete_table = complete_table.set_column(index, column, nested_record)
    return _describe_as_present_format(complete_table)


def _describe_as_present_format(table: pa.Table) -> pa.Table:
    """Return a table whose metadata name the present format and its columns; it may have no metadata."""
    metadata = table.schema.metadata or {}
    if METADATA_KEY not in metadata:
        return table
    description = json.loads(metadata[METADATA_KEY])
    if description.get("format") == PRESENT_FORMAT:
        return table
    present_description = description | {"format": PRESENT_FORMAT, "columns": describe_columns()}
    return table.replace_schema_metadata({**metadata, METADATA_KEY: json.dumps(present_description)})


def _nest_flat_record(table: pa.Table, column: str) -> pa.ChunkedArray:
    """Return a column of flat records, as in format 5, as lists with a list by robot for each recorded step.

    Raises UsageError for a record that has not a value of each robot at each step.
    """
    nested_chunks: list[pa.Array] = []
    # Chunk by chunk: the lists of a chunk have at most 2^31 values together, those of a column may have more.
    for batch in table.select(["robots", column]).to_batches():
        flat_records = batch[column]
        robot_counts = _robot_counts(batch)
        value_counts = pc.fill_null(pc.list_value_length(flat_records), 0).to_numpy()  # by trial
        divisors = np.maximum(robot_counts, 1)  # so that none is 0
        step_counts = value_counts // divisors  # complete steps, by trial
        are_all_complete = np.array_equal(step_counts * robot_counts, value_counts)
        if flat_records.null_count > 0 or not are_all_complete:
            raise _damage_error(f"column {column} has gaps, or not a value of each robot at each step")
        # The values become lists by robot for each step, and these become a list for each trial.
        robot_counts_by_step = np.repeat(robot_counts, step_counts)
        values_of_robots = _group_in_lists(flat_records.flatten(), robot_counts_by_step, _VALUES_OF_ROBOTS)
        nested_chunks.append(_group_in_lists(values_of_robots, step_counts, _RECORD_OF_TRIAL))
    return pa.chunked_array(nested_chunks, _RECORD_OF_TRIAL)


def _robot_counts(batch: pa.RecordBatch) -> NDArray[np.int64]:
    """Return the number of robots in each row of a batch of trials; 0 where it is missing.

    In a damaged file any number of 64 bits may stand there. Numbers above 2**31 - 1 become 2**31 - 1, as the
    results are signed.
    """
    stated_counts = pc.fill_null(batch["robots"], 0).to_numpy()
    limited_counts: NDArray[np.int64] = np.clip(stated_counts, 0, np.iinfo(np.int32).max).astype(np.int64)
    return limited_counts


def _group_in_lists(values: pa.Array, lengths: NDArray[np.int64], list_type: Any) -> pa.Array:
    """Return consecutive ``values`` as lists of these lengths, whose sum is the number of values."""
    offsets = np.concatenate([[0], np.cumsum(lengths)])  # where each list begins, and the last one ends
    return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), values, type=list_type)


def _add_missing_parameters(table: pa.Table, row_count: int) -> pa.Table:
    """Return a table with its columns in the usual order, in which missing parameters have their defaults.

    Columns of other names come last.
    """
    defaults = Experiment().parameters()
    arrays_by_column = {}
    for column_name, column_type in column_types().items():
        if column_name in table.column_names:
            arrays_by_column[column_name] = table[column_name]
        elif column_name in defaults:
            arrays_by_column[column_name] = pa.repeat(
                pa.scalar(defaults[column_name], column_type), row_count
            )
    # Columns that this version does not know stay, behind the others.
    arrays_by_column |= {
        column_name: table[column_name]
        for column_name in table.column_names
        if column_name not in column_types()
    }
    return pa.table(arrays_by_column, metadata=table.schema.metadata)


def read_metadata(table: pa.Table) -> dict[str, Any]:
    """Return the metadata of a table, without ``columns``, the units and meanings of its columns.

    They are format, versions, delta and sampling_interval, and source if another program ran the trials.
    """
    metadata: dict[str, Any] = json.loads(table.schema.metadata[METADATA_KEY])
    metadata.pop("columns", None)
    return metadata


# --- Trials as rows, and back ----------------------------------------------------------------------------


def trials_to_table(trials: Trials) -> pa.Table:
    """Return trials as a table with one row a trial.

    The columns are the parameters of the experiment, the number of the trial, its scores, and lists of the
    robots' values. The metadata have, as JSON, versions, units and meanings of the columns, and how often
    values were recorded.
    """
    trial_count = len(trials.numbers)
    columns: dict[str, Any] = {
        name: [value] * trial_count for name, value in trials.experiment.parameters().items()
    }
    columns |= {"trial": trials.numbers, **trials.scores()}
    for name, (attribute, _element_type_name) in _LIST_COLUMNS.items():
        columns[name] = _flatten_trials(getattr(trials, attribute))
    # Files have the same columns whether anything was recorded or not.
    nothing_recorded = np.empty((trial_count, 0, trials.experiment.robots))
    for name, column in RECORD_COLUMNS.items():
        columns[column] = _nest_records(trials.records.get(name, nothing_recorded))
    metadata = {
        "format": PRESENT_FORMAT,
        "versions": software_versions(),
        "delta": DELTA,
        "sampling_interval": trials.sampling_interval,
        "columns": describe_columns(),
    }
    if trials.source:
        metadata["source"] = trials.source
    arrays = {name: pa.array(columns[name], column_type) for name, column_type in column_types().items()}
    return pa.table(arrays, metadata={METADATA_KEY: json.dumps(metadata)})


def _flatten_trials(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the values of each trial as a flat array; trials are the first axis of ``values``."""
    return [values_of_trial.ravel() for values_of_trial in values]


def _nest_records(values: NDArray[np.float64]) -> pa.Array:
    """Return records, shape (trials, samples, N), as an array with a list of lists for each trial."""
    trial_count, sample_count, robots = values.shape
    # The values become lists by robot for each sample, and these become a list for each trial.
    lengths_of_samples = np.full(trial_count * sample_count, robots)
    lengths_of_trials = np.full(trial_count, sample_count)
    values_of_robots = _group_in_lists(pa.array(values.ravel()), lengths_of_samples, _VALUES_OF_ROBOTS)
    return _group_in_lists(values_of_robots, lengths_of_trials, _RECORD_OF_TRIAL)


def experiments_in(table: pa.Table) -> list[Trials]:
    """Return the trials in a table by experiment, in the order of the experiments' first rows. O(rows)."""
    complete_table = to_present_format(table, len(table)).combine_chunks()
    return [
        trials_from_rows(experiment, complete_table.take(rows))
        for experiment, rows in rows_by_experiment(complete_table).items()
    ]


def rows_by_experiment(table: pa.Table) -> dict[Experiment, NDArray[np.int64]]:
    """Return the indices of the rows of each experiment, in the order of the experiments' first rows.

    The table must have a column for each parameter. O(rows). Raises ParameterError for a value that no
    experiment can have.
    """
    parameters = table.select(PARAMETER_NAMES)
    numbered_rows = parameters.append_column("row", pa.array(np.arange(len(table))))
    # A group has the rows of equal parameters, with their indices under "row_list". With threads, pyarrow
    # returns groups in any order; without, in that of their first rows.
    groups = numbered_rows.group_by([*PARAMETER_NAMES], use_threads=False).aggregate([("row", "list")])
    rows: dict[Experiment, list[NDArray[np.int64]]] = {}
    for group in groups.to_pylist():
        # pyarrow tells 0.0 from -0.0, which are equal parameters: so two groups may be one experiment.
        experiment = Experiment.from_recording(group)
        rows.setdefault(experiment, []).append(np.array(group["row_list"]))
    return {experiment: np.concatenate(row_lists) for experiment, row_lists in rows.items()}


def trials_from_rows(experiment: Experiment, table: pa.Table) -> Trials:
    """Return the rows of a table as trials of an experiment, sorted by their numbers.

    A row is a trial. In the columns "k", convergence steps, "e", errors, "tests" and "updates" it has a list
    with a value for each robot. "b_hat" has such values for one filter step after the other, and each column
    of RECORD_COLUMNS a list of them for each recorded step. All rows must be of the experiment. Raises
    UsageError if a list has another length than it must have.
    """
    _check_list_lengths(experiment, table)
    table = table.sort_by("trial")

    robots = experiment.robots
    filter_steps = experiment.steps // experiment.filter_period
    metadata = read_metadata(table)
    return Trials(
        experiment=experiment,
        numbers=table["trial"].to_pylist(),
        convergence_steps=_read_lists(table, "k", (robots,)),
        errors=_read_lists(table, "e", (robots,)),
        b_hat=_read_lists(table, "b_hat", (filter_steps, robots)),
        tests=_read_lists(table, "tests", (robots,)),
        updates=_read_lists(table, "updates", (robots,)),
        records=_read_records(table, robots),
        sampling_interval=metadata["sampling_interval"],
        source=metadata.get("source", ""),
    )


def _read_lists(table: pa.Table, column: str, shape_of_trial: tuple[int, ...]) -> NDArray[Any]:
    """Return the values in a column of lists, with an axis of the trials before those of a trial."""
    flat_values: NDArray[Any] = pc.list_flatten(table[column]).to_numpy()
    return flat_values.reshape(len(table), *shape_of_trial)


def _read_records(table: pa.Table, robots: int) -> dict[str, NDArray[Any]]:
    """Return the recorded values by quantity, shape (trials, samples, N) each; none if nothing was recorded.

    The lists of all trials must be equally long.
    """
    records: dict[str, NDArray[Any]] = {}
    for name, column in RECORD_COLUMNS.items():
        sample_count = len(table[column][0])
        if sample_count > 0:
            values_of_robots = pc.list_flatten(table[column])  # a list for each sample of each trial
            values: NDArray[Any] = pc.list_flatten(values_of_robots).to_numpy()
            records[name] = values.reshape(len(table), sample_count, robots)
    return records


def _check_list_lengths(experiment: Experiment, table: pa.Table) -> None:
    """Raise UsageError if a column has missing values, or lists of another length than they must have.

    O(values).
    """
    if table["trial"].null_count > 0:
        raise _damage_error("column trial has gaps")
    robots = experiment.robots
    length_by_column = dict.fromkeys(_LIST_COLUMNS, robots)
    length_by_column["b_hat"] = robots * (experiment.steps // experiment.filter_period)
    for column, length in length_by_column.items():
        _check_lists(column, table[column], length)
        _check_no_gaps(column, pc.list_flatten(table[column]))
    # How often values were recorded is not a parameter. So the first list gives the length of all of them. If
    # it is missing, which the check below refuses, it has no length.
    first_length = pc.list_value_length(table[RECORD_COLUMNS["t"]])[0].as_py()
    sample_count = 0 if first_length is None else first_length
    for column in RECORD_COLUMNS.values():
        values_of_robots = pc.list_flatten(table[column])
        _check_lists(column, table[column], sample_count)
        _check_lists(column, values_of_robots, robots)
        _check_no_gaps(column, pc.list_flatten(values_of_robots))


def _check_lists(column: str, lists: pa.ChunkedArray, length: int) -> None:
    """Raise UsageError, with the name of the column, if one of its lists is missing or has another length."""
    _check_no_gaps(column, lists)
    different_lengths = pc.list_value_length(lists).unique().to_pylist()
    if any(list_length != length for list_length in different_lengths):
        raise _damage_error(f"column {column} has lists that have not {length} values")


def _check_no_gaps(column: str, values: pa.ChunkedArray) -> None:
    """Raise UsageError, with the name of the column, if one of its values is missing."""
    if values.null_count > 0:
        raise _damage_error(f"column {column} has gaps")


def _damage_error(problem: str) -> UsageError:
    """Return the error for results that this program cannot have written, with the problem and the fix."""
    return UsageError(f"the results are damaged: {problem}; run mcp-asdf sweep again")


def score_table(table: pa.Table, limits: Limits) -> pa.Table:
    """Return a table with its scores H, h_K and h_e computed anew with other limits K_max and e_max.

    O(rows).
    """
    table = to_present_format(table, len(table))
    rows = table.select([*PARAMETER_NAMES, "k", "e"]).to_pylist()
    scores_by_row = [_score_row(row, limits) for row in rows]
    for score_name in SCORES:
        column = pa.array([scores[score_name] for scores in scores_by_row], pa.float64())
        table = table.set_column(table.column_names.index(score_name), score_name, column)
    return table


def _score_row(row: dict[str, Any], limits: Limits) -> dict[str, float]:
    """Return the scores H, h_K and h_e of the trial in a row, by their names."""
    k_max, e_max = limits.of(Experiment.from_recording(row))
    # The function takes and returns arrays with an entry of each trial; here there is a single one.
    scores = score([row["k"]], [row["e"]], k_max, e_max)
    return {name: float(score_by_trial[0]) for name, score_by_trial in scores.items()}
