"""Results of trials as tables of pyarrow, which files of results contain.

A table has a row for each trial, with a column for each parameter of the experiment and

- ``trial``, the number of the trial;
- ``H``, ``h_K`` and ``h_e``, the paper's scores (0 to 100) with its limits K_max and e_max;
- ``k`` and ``e``, lists with a value of each robot: convergence steps and errors;
- ``b_hat``, a list of the accuracies that robots assume: those of all robots after the first filter step,
  then those after the second, and so on;
- ``tests`` and ``updates``, lists with a value of each robot: hypothesis tests, and re-estimates of b_hat;
- ``record_t`` to ``record_b_hat``, lists in the order of ``b_hat``: values at step 0 and then every
  ``sampling_interval`` steps; empty if nothing was recorded.

The metadata have JSON under the key ``mcp-asdf``: the version of the format, the versions of the software,
the threshold delta, ``sampling_interval``, and unit and meaning of each of ``columns``. Rows with the same
parameters belong to one experiment. A parameter without a column has its default, so that a table can be
read which was written before the parameter existed.
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

FORMAT = 5
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
    **{f"record_{name}": f"{name} every sampling_interval steps, robot by robot" for name in QUANTITIES},
}
"""Meanings of the columns that are not parameters."""


# --- Columns ---------------------------------------------------------------------------------------------


@cache
def describe_columns() -> dict[str, dict[str, str]]:
    """Return the unit and the meaning of each column by its name. The unit is "1" if there is none."""
    meanings = {name: declared.meaning for name, declared in parameters_of(Experiment).items()} | _MEANINGS
    return {name: {"unit": _UNITS.get(name, "1"), "meaning": meaning} for name, meaning in meanings.items()}


@cache
def column_types() -> dict[str, Any]:
    """Return the pyarrow type of each column by its name, in the order of a table's columns."""
    # Seeds take all values of 64 bits without a sign.
    number_types = {int: pa.uint64(), float: pa.float64(), Decimal: pa.float64()}
    default_experiment = Experiment()
    types = {
        name: number_types.get(type(getattr(default_experiment, name)), pa.string())
        for name in PARAMETER_NAMES
    }
    types["trial"] = pa.int64()
    types |= dict.fromkeys(SCORES, pa.float64())
    element_types = {name: getattr(pa, type_name)() for name, (_, type_name) in _LIST_COLUMNS.items()}
    element_types |= {f"record_{name}": pa.float64() for name in QUANTITIES}
    for name, element_type in element_types.items():
        # This is the name that elements have when a file has been read: so equal rows give equal files,
        # whether they were read or not.
        types[name] = pa.list_(pa.field("element", element_type))
    return types


def add_missing_parameters(table: pa.Table, row_count: int) -> pa.Table:
    """Return a table with its columns in the usual order, in which missing parameters have their defaults.

    Columns of other names come last. ``row_count`` is the number of rows, which a table without columns does
    not know.
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
    """Return the metadata of a table: format, versions, delta and sampling_interval."""
    metadata: dict[str, Any] = json.loads(table.schema.metadata[METADATA_KEY])
    metadata.pop("columns", None)
    return metadata


# --- Trials as rows, and back ----------------------------------------------------------------------------


def trials_to_table(trials: Trials) -> pa.Table:
    """Return trials as the rows of a table with the columns and metadata that this file's head lists."""
    trial_count = len(trials.numbers)
    columns: dict[str, Any] = {
        name: [value] * trial_count for name, value in trials.experiment.parameters().items()
    }
    columns |= {"trial": trials.numbers, **trials.scores()}
    for name, (attribute, _) in _LIST_COLUMNS.items():
        columns[name] = _flatten_trials(getattr(trials, attribute))
    # Files have the same columns whether anything was recorded or not.
    nothing_recorded = np.empty((trial_count, 0))
    for name in QUANTITIES:
        columns[f"record_{name}"] = _flatten_trials(trials.records.get(name, nothing_recorded))
    metadata = {
        "format": FORMAT,
        "versions": software_versions(),
        "delta": DELTA,
        "sampling_interval": trials.sampling_interval,
        "columns": describe_columns(),
    }
    arrays = {name: pa.array(columns[name], column_type) for name, column_type in column_types().items()}
    return pa.table(arrays, metadata={METADATA_KEY: json.dumps(metadata)})


def _flatten_trials(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the values of each trial as a flat array; trials are the first axis of ``values``."""
    return [values_of_trial.ravel() for values_of_trial in values]


def experiments_in(table: pa.Table) -> list[Trials]:
    """Return the trials in a table by experiment, in the order of the experiments' first rows. O(rows)."""
    complete_table = add_missing_parameters(table, len(table)).combine_chunks()
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
    # With threads, pyarrow returns groups in any order; without, in that of their first rows.
    groups = numbered_rows.group_by([*PARAMETER_NAMES], use_threads=False).aggregate([("row", "list")])
    rows: dict[Experiment, list[NDArray[np.int64]]] = {}
    for group in groups.to_pylist():
        # Groups that differ in the sign of a zero are one experiment.
        experiment = Experiment.from_recording(group)
        rows.setdefault(experiment, []).append(np.array(group["row_list"]))
    return {experiment: np.concatenate(row_lists) for experiment, row_lists in rows.items()}


def trials_from_rows(experiment: Experiment, table: pa.Table) -> Trials:
    """Return the rows of a table as trials of an experiment, sorted by their numbers.

    All rows must be of the experiment. Raises UsageError if a list has another length than it must have.
    """
    _check_list_lengths(experiment, table)
    table = table.sort_by("trial")

    def read_lists(column: str, *shape: int) -> NDArray[Any]:
        """Return a column of lists as an array with the axes trial, and then ``shape``."""
        flat_values: NDArray[Any] = pc.list_flatten(table[column]).to_numpy()
        return flat_values.reshape(len(table), *shape)

    records = {}
    for name in QUANTITIES:
        # All lists have the same length, as was checked above.
        is_recorded = len(table[f"record_{name}"][0]) > 0
        if is_recorded:
            records[name] = read_lists(f"record_{name}", -1, experiment.robots)
    return Trials(
        experiment,
        table["trial"].to_pylist(),
        convergence_steps=read_lists("k", -1),
        errors=read_lists("e", -1),
        b_hat=read_lists("b_hat", -1, experiment.robots),
        tests=read_lists("tests", -1),
        updates=read_lists("updates", -1),
        records=records,
        sampling_interval=read_metadata(table)["sampling_interval"],
    )


def _check_list_lengths(experiment: Experiment, table: pa.Table) -> None:
    """Raise UsageError if a column has missing values, or lists of another length than they must have.

    O(values).
    """
    robots = experiment.robots
    length_by_column = dict.fromkeys(_LIST_COLUMNS, robots)
    length_by_column["b_hat"] = robots * (experiment.steps // experiment.filter_period)
    # How often values were recorded is not a parameter. So the first list gives the length of all of them,
    # rounded down to complete samples of all robots.
    first_length = pc.list_value_length(table["record_t"])[0].as_py() or 0
    record_length = first_length - first_length % robots
    length_by_column |= {f"record_{quantity}": record_length for quantity in QUANTITIES}
    has_gaps_in_numbers = table["trial"].null_count > 0
    for column_name, length in length_by_column.items():
        list_lengths = pc.list_value_length(table[column_name])
        gap_count = list_lengths.null_count + pc.list_flatten(table[column_name]).null_count
        if has_gaps_in_numbers or gap_count or set(list_lengths.unique().to_pylist()) != {length}:
            problem = f"column {column_name} has gaps, or lists that have not {length} values"
            raise UsageError(f"the results are damaged: {problem}; run mcp-asdf sweep again")


def score_table(table: pa.Table, limits: Limits) -> pa.Table:
    """Return a table with its scores H, h_K and h_e computed anew with other limits K_max and e_max.

    O(rows).
    """
    table = add_missing_parameters(table, len(table))
    rows = table.select([*PARAMETER_NAMES, "k", "e"]).to_pylist()
    scores_by_row = [_score_row(row, limits) for row in rows]
    for score_name in SCORES:
        scores = pa.array([scores[score_name] for scores in scores_by_row], pa.float64())
        table = table.set_column(table.column_names.index(score_name), score_name, scores)
    return table


def _score_row(row: dict[str, Any], limits: Limits) -> dict[str, float]:
    """Return the scores H, h_K and h_e of the trial in a row, by their names."""
    k_max, e_max = limits.of(Experiment.from_recording(row))
    # The function takes and returns arrays with an entry of each trial; here there is a single one.
    scores = score([row["k"]], [row["e"]], k_max, e_max)
    return {name: float(score_of_trial) for name, (score_of_trial,) in scores.items()}
