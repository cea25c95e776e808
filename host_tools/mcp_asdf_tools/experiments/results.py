"""Results of trials, and their files: self-describing Parquet, and CSV.

A Parquet file has a row for every trial: the experiment's parameters, a column each, and

- ``trial``, its number;
- ``H``, ``h_K`` and ``h_e``, its scores with the paper's K_max and e_max;
- ``k`` and ``e``, lists over the robots: convergence steps and errors;
- ``b_hat``, the assumed accuracies after each filter step, one robot after the other within a step;
- ``tests`` and ``updates``, lists over the robots;
- ``record_t`` to ``record_b_hat``, lists in the same order: values at step 0 and every ``sampling_interval``
  steps, where recorded.

The file's metadata hold, under the key ``mcp-asdf``, JSON with the format's version, the versions of the
software, the threshold delta, ``sampling_interval``, and unit and meaning of each of ``columns``. Rows of
equal parameters belong to one experiment. A parameter without a column has its default: a file from before
there was such a parameter can be read.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError, offer
from mcp_asdf_tools.common.extras import naming_extras
from mcp_asdf_tools.common.files import draft_of, write_atomically
from mcp_asdf_tools.common.parameters import parameters_of
from mcp_asdf_tools.common.versions import software_versions
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import DELTA, PAPERS, SCORES, Limits, score
from mcp_asdf_tools.world.settings import FORMER_PARAMETERS

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]
else:
    from mcp_asdf_tools.experiments import arrow as pa

QUANTITIES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")
"""Recorded values of a robot, named as the attributes of ``Robot``."""

FORMAT = 5
_KEY = b"mcp-asdf"
_LISTS = {
    "k": ("convergence_steps", "int32"),
    "e": ("errors", "float64"),
    "b_hat": ("b_hat", "float64"),
    "tests": ("tests", "int32"),
    "updates": ("updates", "int32"),
}
"""Columns of lists: the attribute of ``Trials`` that each holds, and the type of its elements."""
_PARAMETERS = tuple(Experiment().parameters())
INDEX = (*_PARAMETERS, "trial")
"""Columns that say which trial a row is of."""

_UNITS = {
    **dict.fromkeys(("drift_rate",), "1/step"),
    **dict.fromkeys(("width", "height", "radio_range", "tile"), "m"),
    **dict.fromkeys(("observation_period", "steps", "comms_period"), "step"),
    **dict.fromkeys(("filter_period", "latency", "k"), "step"),
    **dict.fromkeys(SCORES, "point of 100"),
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
        sampling_interval: In steps; 0 without recording.
    """

    experiment: Experiment
    numbers: list[int]
    convergence_steps: NDArray[np.int64]
    errors: NDArray[np.float64]
    b_hat: NDArray[np.float64]
    tests: NDArray[np.int64]
    updates: NDArray[np.int64]
    records: dict[str, NDArray[np.float64]]
    sampling_interval: int = 0

    def scores(self, limits: Limits = PAPERS) -> dict[str, NDArray[np.float64]]:
        """SCORES of each trial by name."""
        return score(self.convergence_steps, self.errors, *limits.of(self.experiment))

    def measures(self, limits: Limits = PAPERS) -> dict[str, NDArray[np.float64 | np.signedinteger]]:
        """A value for each trial by name: the scores, means of K and e over the robots, sum of updates."""
        return {
            **self.scores(limits),
            "K": self.convergence_steps.mean(axis=1),
            "e": self.errors.mean(axis=1),
            "updates": self.updates.sum(axis=1),
        }


# --- Tables ----------------------------------------------------------------------------------------------


def require_arrow() -> None:
    """Load the library that results need. Raises ModuleNotFoundError where it is not installed."""
    pa.array([])


def table_of(trials: Trials, sampling_interval: int = 0) -> pa.Table:
    """Trials of an experiment as rows."""
    count = len(trials.numbers)
    arrays = {name: getattr(trials, attribute) for name, (attribute, _) in _LISTS.items()}
    for name in QUANTITIES:
        arrays[f"record_{name}"] = trials.records.get(name, np.empty((count, 0)))
    parameters = trials.experiment.parameters()
    columns: dict[str, Any] = {name: [value] * count for name, value in parameters.items()}
    columns |= {"trial": trials.numbers, **trials.scores()}
    columns |= {name: [trial.ravel() for trial in array] for name, array in arrays.items()}
    description = {
        "format": FORMAT,
        "versions": software_versions(),
        "delta": DELTA,
        "sampling_interval": sampling_interval,
        "columns": columns_in_words(),
    }
    typed = {name: pa.array(columns[name], kind) for name, kind in _column_types().items()}
    return pa.table(typed, metadata={_KEY: json.dumps(description)})


@cache
def columns_in_words() -> dict[str, dict[str, str]]:
    """Unit, "1" for none, and meaning of every column."""
    meanings = {name: each.text for name, each in parameters_of(Experiment).items()} | _MEANINGS
    return {name: {"unit": _UNITS.get(name, "1"), "meaning": words} for name, words in meanings.items()}


@cache
def _column_types() -> dict[str, Any]:
    """The type of each column."""
    numbers = {int: pa.uint64(), float: pa.float64(), Decimal: pa.float64()}
    kinds = {name: numbers.get(type(getattr(Experiment(), name)), pa.string()) for name in _PARAMETERS}
    kinds |= {"trial": pa.int64(), **dict.fromkeys(SCORES, pa.float64())}
    lists = {name: getattr(pa, kind)() for name, (_, kind) in _LISTS.items()}
    lists |= {f"record_{name}": pa.float64() for name in QUANTITIES}
    # Elements are named as in a file that was read: equal rows give equal files.
    return kinds | {name: pa.list_(pa.field("element", kind)) for name, kind in lists.items()}


class Stretch(NamedTuple):
    """Rows of one experiment that follow each other: its parameters as JSON, first row, one past the last."""

    parameters: str
    start: int
    stop: int


def stretches_of(table: pa.Table) -> list[Stretch]:
    """The stretches of a table. O(rows), and slow only for each stretch."""
    begins = np.zeros(len(table), bool)
    begins[:1] = True
    for name in _PARAMETERS:
        codes = table[name].combine_chunks().dictionary_encode("encode").indices.to_numpy()
        begins[1:] |= codes[1:] != codes[:-1]
    starts = np.flatnonzero(begins)
    heads = table.select(_PARAMETERS).take(starts).to_pylist()
    stops = [*starts[1:].tolist(), len(table)]
    return [
        Stretch(json.dumps(head), *each) for head, *each in zip(heads, starts.tolist(), stops, strict=True)
    ]


def _by_experiment(stretches: Iterable[Stretch]) -> dict[str, NDArray[np.int64]]:
    """The rows of each experiment, by its parameters."""
    found: dict[str, list[NDArray[np.int64]]] = {}
    for each in stretches:
        found.setdefault(each.parameters, []).append(np.arange(each.start, each.stop))
    return {key: np.concatenate(rows) for key, rows in found.items()}


def _with_all_parameters(table: pa.Table, rows: int) -> pa.Table:
    """Return the table with its columns in order; a parameter it lacks has its default in all ``rows``."""
    defaults, kinds = Experiment().parameters(), _column_types()
    columns = {}
    for name, kind in kinds.items():
        if name in table.column_names:
            columns[name] = table[name]
        elif name in defaults:
            columns[name] = pa.repeat(pa.scalar(defaults[name], kind), rows)
    columns |= {name: table[name] for name in table.column_names if name not in kinds}
    return pa.table(columns, metadata=table.schema.metadata)


def experiments_in(table: pa.Table) -> list[Trials]:
    """The experiments of a table in the order of their first rows. O(rows)."""
    table = _with_all_parameters(table, len(table))
    groups = _by_experiment(stretches_of(table))
    whole = table.combine_chunks()  # rows picked from many small pieces take long
    return [_trials(key, whole.take(rows)) for key, rows in groups.items()]


def experiments_at(path: Path) -> Iterator[Trials]:
    """The experiments of a file, or of a folder of them, as ``experiments_in``, but one after the other.

    No more than one is in memory. Raises UsageError as ``read_table``.
    """
    pieces, stretches = Pieces(), []
    for first, table in pieces.add(path, _PARAMETERS):
        stretches += [
            each._replace(start=first + each.start, stop=first + each.stop) for each in stretches_of(table)
        ]
    columns = [name for name in pieces.column_names if name not in _PARAMETERS]
    for key, rows in _by_experiment(stretches).items():
        yield _trials(key, pieces.take(rows, columns))


def _trials(parameters: str, table: pa.Table) -> Trials:
    """The trials of rows that belong to one experiment, whose lists in a column are all of one length."""
    experiment = Experiment.from_recording(json.loads(parameters))
    _check_values(experiment, table)
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
        sampling_interval=metadata_of(table)["sampling_interval"],
    )


def rescored(table: pa.Table, limits: Limits) -> pa.Table:
    """The table with scores for other limits. O(rows)."""
    table = _with_all_parameters(table, len(table))
    rows = table.select([*_PARAMETERS, "k", "e"]).to_pylist()
    scores = np.empty((len(SCORES), len(rows)))
    for index, row in enumerate(rows):
        experiment = Experiment.from_recording(row)
        own = score([row["k"]], [row["e"]], *limits.of(experiment))
        scores[:, index] = [values[0] for values in own.values()]
    for name, values in zip(SCORES, scores, strict=True):
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    return table


def matching(experiments: Sequence[Trials], where: Mapping[str, Any]) -> list[Trials]:
    """The experiments with these parameters, a number in any of its spellings.

    Raises UsageError, with what there is, for what is no parameter, and if no experiment is left.
    """
    found = list(experiments)
    for name, value in where.items():
        if name not in _PARAMETERS:
            fix = f"{offer(name, _PARAMETERS)}; the experiments differ in {differing(found)}"
            raise UsageError(f"where {name}={value}: no parameter is called so{fix}")
        held = {str(each.experiment.parameters()[name]) for each in found}
        found = [each for each in found if _is(each.experiment.parameters()[name], value)]
        if not found:
            there = " or ".join(sorted(held))
            raise UsageError(f"where {name}={value}: no experiment has it; {name} is {there}")
    return found


def only(found: Sequence[Trials]) -> Trials:
    """The only experiment. Raises UsageError, with what would choose one, if there are several."""
    if len(found) > 1:
        raise UsageError(f"{len(found)} experiments match; choose one with where {differing(found)}")
    return found[0]


def differing(found: Sequence[Trials]) -> str:
    """The parameters in which experiments differ, with their values."""
    parameters = [each.experiment.parameters() for each in found]
    values = {name: sorted({str(each[name]) for each in parameters}) for name in _PARAMETERS}
    lines = (f"{name}={'|'.join(each)}" for name, each in values.items() if len(each) > 1)
    return ", ".join(lines) or "no parameters"


def _is(held: object, value: Any) -> bool:
    """True if a parameter has the value that was given, a number in any of its spellings."""
    with suppress(TypeError, ValueError):
        return str(held) == str(value) or (isinstance(held, int | float) and float(value) == held)
    return False


# --- Parquet ---------------------------------------------------------------------------------------------


def write_tables(path: Path, tables: Iterable[pa.Table]) -> None:
    """Write tables of the same columns, at least one, as row groups of one Parquet file, whole or not at all.

    Raises UsageError if that cannot be done.
    """
    given = iter(tables)
    first = next(given)
    with (
        draft_of(path) as draft,
        pa.parquet.ParquetWriter(draft, first.schema, compression="zstd") as writer,
    ):
        for table in chain([first], given):
            writer.write_table(table, row_group_size=len(table))


def parts_of(output: Path) -> Path:
    """Folder of the finished jobs of a sweep with this output."""
    return output.with_name(f"{output.name}.parts")


@naming_extras()
def read_table(path: Path | str, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a table that ``write_tables`` wrote, or all of a folder, such as the parts of a sweep.

    Raises UsageError for any other file.
    """
    return pa.concat_tables([table for _, table in Pieces().add(Path(path), columns)])


def _open(path: Path) -> Any:
    """A file that ``write_tables`` wrote, to be read in row groups. Raises UsageError for any other."""
    with _reading(path):
        file = pa.parquet.ParquetFile(path)
        _check(path, file.schema_arrow, file.metadata.num_rows)
    return file


def _row_group(path: Path, file: Any, group: int, columns: Sequence[str] | None) -> pa.Table:
    """Read some columns of a row group, or all; a parameter without a column has its default."""
    stored_names = file.schema_arrow.names
    stored_columns = None
    if columns is not None:
        stored_columns = [name for name in columns if name in stored_names]
    with _reading(path):
        table = file.read_row_group(group, columns=stored_columns)
        table.validate(full=True)
    table = table.replace_schema_metadata(file.schema_arrow.metadata)  # that were checked; a file has two
    table = _with_all_parameters(table, file.metadata.row_group(group).num_rows)
    return table if columns is None else table.select(columns)


def _check_former_parameters(path: Path, file: Any, group: int) -> None:
    """Raise UsageError if a row group has a parameter of earlier versions with a value that had an effect."""
    for name, value_without_effect in FORMER_PARAMETERS.items():
        if name not in file.schema_arrow.names:
            continue
        with _reading(path):
            values = file.read_row_group(group, columns=[name])[name].unique().to_pylist()
        if values != [value_without_effect]:
            raise UsageError(
                f"{path} has results with {name}, a parameter of earlier versions; use one of these versions"
            )


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn what goes wrong while ``path`` is read into a UsageError that names it."""
    try:
        yield
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        parts = parts_of(path)
        hint = f"; its sweep is not finished, partial data is in {parts}" if parts.is_dir() else ""
        reason = error if path.exists() else "there is no such file"
        raise UsageError(f"cannot read {path}: {reason}{hint}") from error


def _check(path: Path, schema: Any, rows: int) -> None:
    """Raise UsageError if a file with this schema is not one of results."""
    try:
        known = json.loads((schema.metadata or {}).get(_KEY, b"{}"))
    except (ValueError, RecursionError):  # it may be another program's
        known = {}
    known = known if isinstance(known, dict) else {}
    if known.get("format") != FORMAT:
        holds = "no results" if "format" not in known else f"results in format {known['format']}"
        raise UsageError(f"{path} holds {holds}; format {FORMAT} is needed: run mcp-asdf sweep again")
    if not rows:
        raise UsageError(f"{path} holds no trials; run mcp-asdf sweep again")
    interval = known.get("sampling_interval")
    if not (isinstance(interval, int) and interval >= 0 and isinstance(known.get("versions"), dict)):
        raise UsageError(f"{path} is damaged: its metadata lack versions or sampling_interval; run it again")
    kinds = _column_types()
    if absent := set(kinds) - set(_PARAMETERS) - set(schema.names):
        raise UsageError(
            f"{path} is damaged: it has no {', '.join(sorted(absent))}; run mcp-asdf sweep again"
        )
    for name, kind in kinds.items():
        if name not in schema.names:
            continue  # a parameter that is newer than the file
        if schema.names.count(name) > 1 or schema.field(name).type != kind:
            raise UsageError(f"{path} is damaged: column {name} is not {kind}; run mcp-asdf sweep again")


def _check_values(experiment: Experiment, table: pa.Table) -> None:
    """Raise UsageError if rows are none that ``table_of`` makes of the experiment. O(values)."""
    robots = experiment.robots
    samples = pa.compute.list_value_length(table["record_t"])[0].as_py() or 0
    lengths = dict.fromkeys(_LISTS, robots)
    lengths["b_hat"] *= experiment.steps // experiment.filter_period
    lengths |= {f"record_{name}": samples - samples % robots for name in QUANTITIES}
    for name, length in lengths.items():
        found = pa.compute.list_value_length(table[name])
        gaps = found.null_count + pa.compute.list_flatten(table[name]).null_count + table["trial"].null_count
        if gaps or set(found.unique().to_pylist()) != {length}:
            wrong = f"column {name} has gaps, or lists that have not {length} values"
            raise UsageError(f"the results are damaged: {wrong}; run mcp-asdf sweep again")


class _Piece(NamedTuple):
    """A row group of a file, and how many rows stand before it."""

    path: Path
    group: int
    first: int


class Pieces:
    """Rows of many files as one sequence, of which only a few row groups are in memory."""

    def __init__(self) -> None:
        self._pieces: list[_Piece] = []
        self._row_group = lru_cache(maxsize=4)(self._read)  # rows that are taken together stand close
        self.column_names: list[str] = []
        self.rows = 0

    def add(self, path: Path, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.Table]]:
        """Append the rows of a file, or of the files in a folder; yields for each row group the number of its
        first row, and these columns. Raises UsageError as ``read_table``."""
        for each in sorted(path.glob("*.parquet")) or [path]:
            file = _open(each)
            self.column_names = list(_column_types())
            for group in range(file.num_row_groups):
                table = _row_group(each, file, group, columns)
                _check_former_parameters(each, file, group)
                first = self.rows
                self._pieces.append(_Piece(each, group, first))
                self.rows += len(table)
                yield first, table

    def append(self, path: Path, rows: int) -> None:
        """Append the only row group of a file that has just been written."""
        self._pieces.append(_Piece(path, 0, self.rows))
        self.rows += rows

    def join(self, count: int, path: Path) -> None:
        """Let the only row group of ``path`` stand for that of the last ``count`` files, which it holds."""
        self._pieces[-count:] = [self._pieces[-count]._replace(path=path)]

    def rows_of_last(self, count: int) -> int:
        """Number of rows of the last ``count`` row groups, 1 or more."""
        return self.rows - self._pieces[-count].first

    @staticmethod
    def _read(path: Path, group: int, columns: tuple[str, ...] | None) -> pa.Table:
        return _row_group(path, _open(path), group, columns).combine_chunks()

    def take(self, rows: NDArray[np.int64], columns: Sequence[str] | None = None) -> pa.Table:
        """Some rows in this order."""
        wanted = None if columns is None else tuple(columns)
        firsts = [piece.first for piece in self._pieces]
        owners = np.searchsorted(firsts, rows, side="right") - 1
        tables, places = [], []
        for owner in np.unique(owners):
            places.append(np.flatnonzero(owners == owner))
            path, group, first = self._pieces[owner]
            tables.append(self._row_group(path, group, wanted).take(rows[places[-1]] - first))
        order = np.argsort(np.concatenate(places))
        return pa.concat_tables(tables).combine_chunks().take(order)


def metadata_of(table: pa.Table) -> dict[str, Any]:
    """Format, versions, delta and sampling interval of a table."""
    metadata: dict[str, Any] = json.loads(table.schema.metadata[_KEY])
    metadata.pop("columns", None)  # as ``columns_in_words``
    return metadata


# --- CSV -------------------------------------------------------------------------------------------------


def write_csv(path: Path, experiments: Iterable[Trials], limits: Limits = PAPERS) -> None:
    """Write one line per trial: parameters, scores, means over the robots, sums of tests and updates.

    Raises UsageError if that cannot be done.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = ("mean_K", "mean_e", "mean_b_hat", "tests", "updates")
    writer.writerow([*_PARAMETERS, "trial", *SCORES, *names, "K_max", "e_max"])
    for trials in experiments:
        parameters = list(trials.experiment.parameters().values())
        *scores_and_means, updates = trials.measures(limits).values()
        b_hat = trials.b_hat[:, -1].mean(axis=1) if trials.b_hat.shape[1] else np.full(len(updates), np.nan)
        columns = (*scores_and_means, b_hat, trials.tests.sum(axis=1), updates)
        for number, *values in zip(trials.numbers, *columns, strict=True):
            shown = (f"{value:.10g}" for value in (*values, *limits.of(trials.experiment)))
            writer.writerow([*parameters, number, *shown])
    write_atomically(path, text.getvalue())
