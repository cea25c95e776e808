"""Results of trials, and their files: self-describing Parquet, and CSV.

A Parquet file has a row for every trial: the experiment's parameters, a column each, and

- ``trial``, its number;
- ``H``, ``h_K`` and ``h_e``, its scores with the paper's K_max and e_max (``scores.paper_limits``);
- ``k`` and ``e``, lists over the robots: convergence steps and errors;
- ``b_hat``, the assumed accuracies after each filter step, one robot after the other within a step;
- ``tests`` and ``updates``, lists over the robots;
- ``record_t`` to ``record_b_hat``, lists in the same order: values at step 0 and every ``sampling_interval``
  steps, where recorded.

The file's metadata hold, under the key ``mcp-asdf``, JSON with the format's version, the versions of the
software, the threshold delta and ``sampling_interval``. Rows of equal parameters belong to one experiment.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.files import write_atomically
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import DELTA, LimitsOf, Scores, paper_limits, score

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
else:
    from mcp_asdf_tools.experiments import arrow as pa

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""Recorded values of a robot, named as the attributes of ``Robot``."""

FORMAT = 5
_KEY = b"mcp-asdf"
SCORES = ("H", "h_K", "h_e")
_LISTS = {
    "k": ("convergence_steps", "int32"),
    "e": ("errors", "float64"),
    "b_hat": ("b_hat", "float64"),
    "tests": ("tests", "int32"),
    "updates": ("updates", "int32"),
}
"""Columns of lists: the attribute of ``Trials`` that each holds, and the type of its elements."""
_PARAMETERS = tuple(Experiment().parameters())


@dataclass(frozen=True)
class Trials:
    """Some or all trials of one experiment; the first axis of each array is the trial.

    Attributes:
        experiment: The definition; its ``trials`` may be more than these.
        numbers: The trials' numbers.
        convergence_steps: K of each robot, shape (trials, N).
        errors: e of each robot, shape (trials, N).
        b_hat: Assumed accuracies after each filter step, shape (trials, T // filter_period, N).
        tests: Hypothesis tests run by each robot, shape (trials, N), modulo 65536, as ``updates``.
        updates: Re-estimates of b_hat by each robot, shape (trials, N).
        records: QUANTITIES by name, at step 0 and every ``sampling_interval`` steps, shape
            (trials, T // sampling_interval + 1, N); empty without recording.
    """

    experiment: Experiment
    numbers: list[int]
    convergence_steps: NDArray[np.int64]
    errors: NDArray[np.float64]
    b_hat: NDArray[np.float64]
    tests: NDArray[np.int64]
    updates: NDArray[np.int64]
    records: dict[str, NDArray[np.float64]]

    def scores(self, limits_of: LimitsOf = paper_limits) -> Scores:
        """Scores of each trial."""
        return score(self.convergence_steps, self.errors, limits_of(self.experiment))


# --- Tables ----------------------------------------------------------------------------------------------


def require_arrow() -> None:
    """Load the library that results need. Raises ModuleNotFoundError where it is not installed."""
    pa.array([])


def table_of(trials: Trials, sampling_interval: int = 0) -> pa.Table:
    """Trials of an experiment as rows."""
    count = len(trials.numbers)
    columns: dict[str, Any] = {
        name: pa.array([value] * count, _kind(name)) for name, value in trials.experiment.parameters().items()
    }
    columns["trial"] = pa.array(trials.numbers, pa.int64())
    columns |= dict(zip(SCORES, trials.scores().values, strict=True))
    for name, (attribute, kind) in _LISTS.items():
        columns[name] = _rows(getattr(trials, attribute), getattr(pa, kind)())
    for name in QUANTITIES:
        columns[f"record_{name}"] = _rows(trials.records.get(name, np.empty((count, 0))), pa.float64())
    description = {
        "format": FORMAT,
        "versions": software_versions(),
        "delta": DELTA,
        "sampling_interval": sampling_interval,
    }
    return pa.table(columns).replace_schema_metadata({_KEY: json.dumps(description)})


def _kind(name: str) -> Any:
    default = getattr(Experiment(), name)
    kinds = {int: pa.uint64(), float: pa.float64()}
    return kinds.get(type(default), pa.float64() if name == "omega" else pa.string())


def _rows(array: NDArray[Any], kind: Any) -> Any:
    """One list per trial with all of its values."""
    named = pa.field("element", kind)  # as in a file that was read, so that equal rows give equal files
    return pa.array([trial.ravel() for trial in array], pa.list_(named))


def experiments_in(table: pa.Table) -> list[Trials]:
    """The experiments of a table in the order of their first rows. O(rows)."""
    groups: dict[str, list[int]] = {}
    for index, row in enumerate(table.select(_PARAMETERS).to_pylist()):
        groups.setdefault(json.dumps(row), []).append(index)
    whole = table.combine_chunks()  # rows picked from many small pieces take long
    return [_trials(json.loads(key), whole.take(indices)) for key, indices in groups.items()]


def _trials(parameters: dict[str, Any], table: pa.Table) -> Trials:
    """The trials of rows that belong to one experiment, whose lists in a column are all of one length."""
    experiment = Experiment.from_parameters(parameters)
    table = table.sort_by("trial")

    def values(name: str, *shape: int) -> NDArray[Any]:
        flat: NDArray[Any] = pa.compute.list_flatten(table[name]).to_numpy()
        return flat.reshape(len(table), *shape)

    return Trials(
        experiment,
        table["trial"].to_pylist(),
        **{
            attribute: values(name, -1, experiment.robots) if name == "b_hat" else values(name, -1)
            for name, (attribute, _) in _LISTS.items()
        },
        records={
            name: values(f"record_{name}", -1, experiment.robots)
            for name in QUANTITIES
            if len(table[f"record_{name}"][0])
        },
    )


def rescored(table: pa.Table, limits_of: LimitsOf) -> pa.Table:
    """The table with scores for other limits. O(rows)."""
    rows = table.select([*_PARAMETERS, "k", "e"]).to_pylist()
    scores = np.empty((len(SCORES), len(rows)))
    for index, row in enumerate(rows):
        experiment = Experiment.from_parameters({name: row[name] for name in _PARAMETERS})
        own = score([row["k"]], [row["e"]], limits_of(experiment))
        scores[:, index] = [values[0] for values in own.values]
    for name, values in zip(SCORES, scores, strict=True):
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    return table


# --- Parquet ---------------------------------------------------------------------------------------------


def write_table(path: Path, table: pa.Table) -> None:
    """Write a table as Parquet, whole or not at all. Raises UsageError if that cannot be done."""
    sink = io.BytesIO()
    pa.parquet.write_table(table, sink, compression="zstd")
    write_atomically(path, sink.getvalue())


def parts_of(output: Path) -> Path:
    """Folder of the finished jobs of a sweep with this output."""
    return output.with_name(f"{output.name}.parts")


@naming_extras()
def read_table(path: Path | str) -> pa.Table:
    """Read a table that ``write_table`` wrote, or all of a folder, such as the parts of a sweep.

    Raises UsageError for any other file.
    """
    path = Path(path)
    try:
        table = pa.parquet.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        parts = parts_of(path)
        hint = f"; its sweep is not finished, partial data is in {parts}" if parts.is_dir() else ""
        reason = error if path.exists() else "there is no such file"
        raise UsageError(f"cannot read {path}: {reason}{hint}") from error
    known = json.loads((table.schema.metadata or {}).get(_KEY, b"{}"))
    if known.get("format") != FORMAT:
        holds = "no results" if "format" not in known else f"results in format {known['format']}"
        raise UsageError(f"{path} holds {holds}; format {FORMAT} is needed: run mcp-asdf sweep again")
    if not len(table):
        raise UsageError(f"{path} holds no trials; run mcp-asdf sweep again")
    return table


def metadata_of(table: pa.Table) -> dict[str, Any]:
    """Format, versions, delta and sampling interval of a table."""
    metadata: dict[str, Any] = json.loads(table.schema.metadata[_KEY])
    return metadata


# --- CSV -------------------------------------------------------------------------------------------------

_MEANS = ("mean_K", "mean_e", "mean_b_hat", "tests", "updates")


def write_csv(path: Path, experiments: Iterable[Trials], limits_of: LimitsOf = paper_limits) -> None:
    """Write one line per trial: parameters, scores, means over the robots, sums of tests and updates.

    Raises UsageError if that cannot be done.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_PARAMETERS, "trial", *SCORES, *_MEANS, "K_max", "e_max"])
    for trials in experiments:
        scores, limits = trials.scores(limits_of), limits_of(trials.experiment)
        parameters = list(trials.experiment.parameters().values())
        for index, number in enumerate(trials.numbers):
            values = (*(score[index] for score in scores.values), *_means(trials, index), *limits)
            writer.writerow([*parameters, number, *(f"{value:.10g}" for value in values)])
    write_atomically(path, text.getvalue())


def _means(trials: Trials, index: int) -> Sequence[float]:
    last = trials.b_hat[index][-1:].mean() if trials.b_hat.shape[1] else float("nan")
    return (
        float(trials.convergence_steps[index].mean()),
        float(trials.errors[index].mean()),
        float(last),
        float(trials.tests[index].sum()),
        float(trials.updates[index].sum()),
    )
