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
from mcp_asdf_tools.experiments.metrics import DELTA, score
from mcp_asdf_tools.experiments.results import PARAMETER_NAMES, QUANTITIES, Trials
from mcp_asdf_tools.experiments.scores import SCORES, Limits

PRESENT_FORMAT = 6
READABLE_FORMATS = (5, PRESENT_FORMAT)
"""In format 5 the record of a trial was one flat list: the values of all robots at step 0, then those at the
next recorded step, and so on."""

METADATA_KEY = b"mcp-asdf"


def _list_of(element_type: pa.DataType) -> pa.DataType:
    """Return the type of lists of an element type.

    In tables read from files pyarrow calls the elements of lists "element". New tables use the same name, so
    that equal rows give equal files.
    """
    return pa.list_(pa.field("element", element_type))


_COUNTS_OF_ROBOTS = _list_of(pa.int32())
"""Type of a list with a whole number of each robot."""
_VALUES_OF_ROBOTS = _list_of(pa.float64())
"""Type of a list with a value of each robot."""
_RECORD_OF_TRIAL = _list_of(_VALUES_OF_ROBOTS)
"""Type of a list with such a list for each recorded step."""
FLAT_RECORD = _VALUES_OF_ROBOTS
"""Type of a record in format 5."""

_ATTRIBUTE_BY_LIST_COLUMN = {
    "k": "convergence_steps",
    "e": "errors",
    "b_hat": "b_hat",
    "tests": "tests",
    "updates": "updates",
}
"""Attributes of ``Trials`` by the names of the columns that contain them, without those of records."""

RECORD_COLUMNS = {name: f"record_{name}" for name in QUANTITIES}
"""Name of the column of each recorded quantity."""

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
    types |= dict.fromkeys(SCORES, pa.float64())
    types |= {"k": _COUNTS_OF_ROBOTS, "e": _VALUES_OF_ROBOTS, "b_hat": _VALUES_OF_ROBOTS}
    types |= {"tests": _COUNTS_OF_ROBOTS, "updates": _COUNTS_OF_ROBOTS}
    types |= dict.fromkeys(RECORD_COLUMNS.values(), _RECORD_OF_TRIAL)
    return types


def to_present_format(table: pa.Table) -> pa.Table:
    """Return a table of READABLE_FORMATS, with some columns or all, in the present format.

    Missing parameters have their defaults, and columns are in the usual order; those of other names come
    last. A table in format 5 with records must have a column ``robots``, unless all experiments have the
    default. Raises UsageError for a flat record that has not a value of each robot at each step.
    """
    defaults = Experiment().parameters()
    existing_columns = {name: table[name] for name in table.column_names}
    columns = {}
    for name, column_type in column_types().items():
        if name in existing_columns:
            columns[name] = existing_columns.pop(name)
        elif name in defaults:
            columns[name] = pa.repeat(pa.scalar(defaults[name], column_type), len(table))
    # Records are the only columns that format 5 had in another form.
    for name in RECORD_COLUMNS.values():
        if name in columns and columns[name].type == FLAT_RECORD:
            columns[name] = _nest_flat_records(name, columns[name], columns["robots"])
    # Columns that this version does not know stay, behind the others.
    complete_table = pa.table(columns | existing_columns, metadata=table.schema.metadata)
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


def _nest_flat_records(column: str, records: pa.ChunkedArray, robots: pa.ChunkedArray) -> pa.Array:
    """Return flat records, as in format 5, as lists with a list by robot for each recorded step.

    ``robots`` has the number of robots of each record, and ``column`` is the name for errors. Raises
    UsageError for a record that has not a value of each robot at each step.
    """
    nested_records = []
    for record, robot_count in zip(records, robots.to_pylist(), strict=True):
        values = record.values  # None where the record is missing
        has_all_values = values is not None and values.null_count == 0
        fits_robots = has_all_values and robot_count and len(values) % robot_count == 0
        if not fits_robots:
            raise _damage_error(f"column {column} has gaps, or not a value of each robot at each step")
        step_count = len(values) // robot_count
        values_by_step = values.to_numpy().reshape(step_count, robot_count)
        nested_records.append(list(values_by_step))
    return pa.array(nested_records, _RECORD_OF_TRIAL)


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
    columns: dict[str, Any] = {}
    for name, value in trials.experiment.parameters().items():
        columns[name] = [value] * len(trials.numbers)  # the same in all rows
    columns["trial"] = trials.numbers
    columns |= trials.scores()
    columns |= _lists_of_robots(trials)
    arrays = {name: pa.array(columns[name], column_type) for name, column_type in column_types().items()}
    return pa.table(arrays, metadata={METADATA_KEY: json.dumps(_metadata_of(trials))})


def _lists_of_robots(trials: Trials) -> dict[str, Any]:
    """Return the columns that have a list in each row, by name: results of the robots, and records.

    If nothing was recorded, there are columns of records, too, with empty lists.
    """
    columns: dict[str, Any] = {}
    for name, attribute in _ATTRIBUTE_BY_LIST_COLUMN.items():
        values = getattr(trials, attribute)  # such as b_hat, whose first axis is the trial
        columns[name] = [values_of_trial.ravel() for values_of_trial in values]
    nothing_recorded = np.empty((len(trials.numbers), 0, trials.experiment.robots))
    for name, column in RECORD_COLUMNS.items():
        columns[column] = _nest_records(trials.records.get(name, nothing_recorded))
    return columns


def _metadata_of(trials: Trials) -> dict[str, Any]:
    """Return the metadata of a table of trials: format, versions, recording, columns, and source if any."""
    metadata = {
        "format": PRESENT_FORMAT,
        "versions": software_versions(),
        "delta": DELTA,
        "sampling_interval": trials.sampling_interval,
        "columns": describe_columns(),
    }
    if trials.source:
        metadata["source"] = trials.source
    return metadata


def _nest_records(values: NDArray[np.float64]) -> pa.Array:
    """Return records, shape (trials, samples, N), as an array in which each trial has a list of lists."""
    trial_count, sample_count, robots = values.shape
    # pyarrow makes lists of one long array and of offsets: where each list begins, and where the last ends.
    # Each sample has a list of N values.
    list_count = trial_count * sample_count
    sample_offsets = pa.array(robots * np.arange(list_count + 1), pa.int32())
    samples = pa.ListArray.from_arrays(sample_offsets, pa.array(values.ravel()), type=_VALUES_OF_ROBOTS)
    # Each trial has a list of these lists.
    trial_offsets = pa.array(sample_count * np.arange(trial_count + 1), pa.int32())
    return pa.ListArray.from_arrays(trial_offsets, samples, type=_RECORD_OF_TRIAL)


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
    rows: dict[Experiment, list[int]] = {}
    for group in groups.to_pylist():
        # pyarrow tells 0.0 from -0.0, which are equal parameters: so two groups may be one experiment.
        experiment = Experiment.from_recording(group)
        rows.setdefault(experiment, []).extend(group["row_list"])
    return {experiment: np.array(indices) for experiment, indices in rows.items()}


def trials_from_rows(experiment: Experiment, table: pa.Table) -> Trials:
    """Return the rows of a table as trials of an experiment, sorted by their numbers.

    A row is a trial. In the columns "k", convergence steps, "e", errors, "tests" and "updates" it has a list
    with a value for each robot. "b_hat" has such values for one filter step after the other, and each column
    of RECORD_COLUMNS a list of them for each recorded step. All rows must be of the experiment. Raises
    UsageError if a list has another length than it must have.
    """
    table = table.sort_by("trial")
    _check_no_gaps("trial", table["trial"])
    metadata = read_metadata(table)

    robots = experiment.robots
    filter_steps = experiment.steps // experiment.filter_period
    b_hat = _read_lists(table, "b_hat", (filter_steps * robots,))
    # How often values were recorded is not a parameter. So the first list gives the length of all of them. If
    # it is missing, which is refused when it is read, it has no length.
    sample_count = pc.list_value_length(table[RECORD_COLUMNS["t"]])[0].as_py() or 0
    records = {
        name: _read_lists(table, column, (sample_count, robots)) for name, column in RECORD_COLUMNS.items()
    }
    return Trials(
        experiment=experiment,
        numbers=table["trial"].to_pylist(),
        convergence_steps=_read_lists(table, "k", (robots,)),
        errors=_read_lists(table, "e", (robots,)),
        b_hat=b_hat.reshape(len(table), filter_steps, robots),
        tests=_read_lists(table, "tests", (robots,)),
        updates=_read_lists(table, "updates", (robots,)),
        records=records if sample_count else {},
        sampling_interval=metadata["sampling_interval"],
        source=metadata.get("source", ""),
    )


def _read_lists(table: pa.Table, column: str, shape_of_trial: tuple[int, ...]) -> NDArray[Any]:
    """Return the values in a column of lists, with an axis of the trials before those of a trial.

    Raises UsageError, with the name of the column, if values are missing, or lists have another length than
    they must have. O(values).
    """
    values = table[column]
    # Each turn checks the lists of one level, beginning with the outermost, and goes on with what they hold.
    for length in shape_of_trial:
        _check_no_gaps(column, values)
        existing_lengths = pc.list_value_length(values).unique().to_pylist()
        if any(existing_length != length for existing_length in existing_lengths):
            raise _damage_error(f"column {column} has lists that have not {length} values")
        values = pc.list_flatten(values)
    _check_no_gaps(column, values)
    array: NDArray[Any] = values.to_numpy()
    return array.reshape(len(table), *shape_of_trial)


def _check_no_gaps(column: str, values: pa.ChunkedArray) -> None:
    """Raise UsageError, with the name of the column, if one of its values is missing."""
    if values.null_count > 0:
        raise _damage_error(f"column {column} has gaps")


def _damage_error(problem: str) -> UsageError:
    """Return the error for results that this program cannot have written, with the problem and the fix."""
    return UsageError(f"the results are damaged: {problem}; run mcp-asdf sweep again")


def score_table(table: pa.Table, limits: Limits) -> pa.Table:
    """Return a table with its scores H, h_K and h_e computed anew with other limits K_max and e_max.

    O(rows). Raises UsageError if a list does not have exactly one value of each robot.
    """
    table = to_present_format(table)
    lists = table.select(["k", "e"]).combine_chunks()  # rows are taken slowly from many chunks
    scores_by_name = {name: np.empty(len(table)) for name in SCORES}
    for experiment, rows in rows_by_experiment(table).items():
        rows_of_experiment = lists.take(rows)
        convergence_steps = _read_lists(rows_of_experiment, "k", (experiment.robots,))
        errors = _read_lists(rows_of_experiment, "e", (experiment.robots,))
        for name, scores in score(convergence_steps, errors, *limits.of(experiment)).items():
            scores_by_name[name][rows] = scores
    for name, scores in scores_by_name.items():
        table = replace_column(table, name, scores)
    return table


def replace_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    """Return a table with other values in the column of this name, converted to its type in results."""
    column = pa.array(values, column_types()[name])
    return table.set_column(table.column_names.index(name), name, column)
