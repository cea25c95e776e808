"""Parquet files of results: how they are written, read, checked, and read a few rows at a time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import drafts_for, explaining_write_errors
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.result_tables import (
    FLAT_RECORD,
    METADATA_KEY,
    PRESENT_FORMAT,
    READABLE_FORMATS,
    RECORD_COLUMNS,
    column_types,
    rows_by_experiment,
    to_present_format,
    trials_from_rows,
)
from mcp_asdf_tools.experiments.results import PARAMETER_NAMES, Trials
from mcp_asdf_tools.world.settings import FORMER_PARAMETERS

ROW_GROUP_BYTES = 50_000_000
"""Size of a row group in memory for which rows are collected: a file should have few row groups, since each
is found and read by itself, but one at a time has to fit into memory."""

_ROW_GROUPS_IN_MEMORY = 4
"""Number of row groups that are kept after they were read. Rows that are needed together usually stand close
to each other, so few are enough."""


def _open_parquet_writer(path: Path, schema: pa.Schema) -> Any:
    """Return pyarrow's writer of a Parquet file with these columns; it is a context manager."""
    return pq.ParquetWriter(path, schema, compression="zstd")


def write_tables(
    path: Path,
    tables: Iterable[pa.Table],
    open_writer: Callable[[Path, pa.Schema], Any] = _open_parquet_writer,
) -> int:
    """Write tables of the same columns, at least one, to a file, and return its number of rows.

    It is a Parquet file, in which each table is a row group (several if it has more than 2**20 rows), unless
    ``open_writer`` returns another writer of pyarrow for a path and columns. The file has its name only once
    it is complete. Raises UsageError if it cannot be written.
    """
    row_count = 0
    # The writer needs the columns before the first row, and the tables may be made one by one.
    remaining_tables = iter(tables)
    first_table = next(remaining_tables)
    with (
        explaining_write_errors(path),
        drafts_for([path]) as [draft],
        open_writer(draft, first_table.schema) as writer,
    ):
        for table in chain([first_table], remaining_tables):
            writer.write_table(table)
            row_count += len(table)
    return row_count


def collect_rows(tables: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the rows of tables of the same columns in fewer, larger tables, of the size of a row group.

    Each has at least ROW_GROUP_BYTES, but for the last.
    """
    collected_tables: list[pa.Table] = []
    byte_count = 0
    for table in tables:
        collected_tables.append(table)
        byte_count += table.nbytes
        if byte_count >= ROW_GROUP_BYTES:
            yield pa.concat_tables(collected_tables)
            collected_tables = []
            byte_count = 0
    if collected_tables:
        yield pa.concat_tables(collected_tables)


def parts_folder(output: Path) -> Path:
    """Return the folder where a sweep keeps its parts until it can write ``output``."""
    return output.with_name(f"{output.name}.parts")


def read_table(path: Path | str, columns: Sequence[str] | None = None) -> pa.Table:
    """Return the rows of a file that ``write_tables`` wrote, or of all files in a folder.

    ``columns`` names the columns to be read; None stands for all. Raises UsageError if a file cannot be read
    or has anything but results in one of READABLE_FORMATS.
    """
    return pa.concat_tables([row_group.read(columns) for row_group in RowGroups(Path(path))])


def stream_experiments(source: Path | pa.Table) -> Iterator[Trials]:
    """Yield the experiments of a table, of a file, or of all files in a folder, each with its trials.

    They are in the order of their first rows, and the trials in that of their numbers. Only one experiment of
    a file at a time is in memory. Raises UsageError if a file cannot be read or has anything but results in
    one of READABLE_FORMATS, and if lists have another length than they must have.
    """
    row_groups = RowGroups(source)
    result_columns = tuple(name for name in column_types() if name not in PARAMETER_NAMES)
    # Parameters, which say what rows an experiment has, are read first. All else, which is far more, is read
    # for one experiment at a time.
    for experiment, rows in row_groups.rows_by_experiment().items():
        yield trials_from_rows(experiment, row_groups.take(rows, result_columns))


# --- Rows of many files ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class RowGroup:
    """Consecutive rows of a ``RowGroups``: a row group of a file, or a table in memory.

    Attributes:
        first_row: Number of rows before it in ``RowGroups``.
        read: Returns the rows in the present format, with the columns of these names, or all for None.
            Raises UsageError if the file cannot be read.
    """

    first_row: int
    read: Callable[[Sequence[str] | None], pa.Table]


class RowGroups:
    """The rows of many files and tables as one sequence, with only a few row groups of files in memory.

    Attributes:
        row_count: Number of rows.
    """

    def __init__(self, source: Path | pa.Table | None = None) -> None:
        """Create a sequence of the rows of a file, folder or table, as ``add`` does; for None it is empty.

        Its cache is for the row groups that ``take`` read last.
        """
        self._row_groups: list[RowGroup] = []
        # A cache of this object alone: one that decorates the method would keep every object alive.
        self._read_cached = lru_cache(maxsize=_ROW_GROUPS_IN_MEMORY)(self._read)
        self.row_count = 0
        if source is not None:
            self.add(source)

    def __iter__(self) -> Iterator[RowGroup]:
        return iter(self._row_groups)

    def add(self, source: Path | pa.Table) -> None:
        """Append rows: those of a table, of a file, or of all Parquet files in a folder in name order.

        A table is converted to the present format, since another program may have read it from an old file.
        Of files only what describes the rows is read here. Raises UsageError if a file cannot be read, or has
        anything but results in one of READABLE_FORMATS.
        """
        if isinstance(source, pa.Table):
            self._append(len(source), partial(_select_columns, to_present_format(source)))
            return
        files_in_folder = sorted(source.glob("*.parquet"))
        # In a path that is itself a file, no files are found.
        for path in files_in_folder or [source]:
            file = _open_checked(path)
            for index in range(file.num_row_groups):
                row_count = file.metadata.row_group(index).num_rows
                self._append(row_count, partial(_read_row_group, path, index))

    def _append(self, row_count: int, read: Callable[[Sequence[str] | None], pa.Table]) -> None:
        """Append ``row_count`` rows, which ``read`` returns; they begin where the sequence has ended."""
        self._row_groups.append(RowGroup(self.row_count, read))
        self.row_count += row_count

    def rows_by_experiment(self) -> dict[Experiment, NDArray[np.int64]]:
        """Return the numbers of the rows of each experiment, in the order of the experiments' first rows.

        Only columns of parameters are read. Raises UsageError if a file cannot be read.
        """
        row_arrays: dict[Experiment, list[NDArray[np.int64]]] = {}
        for row_group in self._row_groups:
            parameters = row_group.read(PARAMETER_NAMES)
            for experiment, rows_in_group in rows_by_experiment(parameters).items():
                # Trials are written as they end, so that an experiment may have rows in several groups.
                row_arrays.setdefault(experiment, []).append(row_group.first_row + rows_in_group)
        return {experiment: np.concatenate(arrays) for experiment, arrays in row_arrays.items()}

    def take(self, rows: NDArray[np.int64], columns: tuple[str, ...] | None = None) -> pa.Table:
        """Return the rows of these numbers, in the order of ``rows``, with some columns or all.

        Each row group that has one of them is read once. Raises UsageError if a file cannot be read.
        """
        first_rows = [row_group.first_row for row_group in self._row_groups]
        sorted_rows = np.sort(rows)
        # A row is in the last row group that begins at or before it.
        group_of_row = np.searchsorted(first_rows, sorted_rows, side="right") - 1
        tables = []
        for group_index in np.unique(group_of_row):
            rows_in_group = sorted_rows[group_of_row == group_index] - first_rows[group_index]
            tables.append(_take_rows(self._read_cached(group_index, columns), rows_in_group))
        sorted_table = pa.concat_tables(tables).combine_chunks()
        return _take_rows(sorted_table, np.searchsorted(sorted_rows, rows))

    def _read(self, group_index: int, columns: tuple[str, ...] | None) -> pa.Table:
        """Return a row group with some columns or all; ``_read_cached`` calls this and keeps the result.

        It is in one chunk of memory, since rows are taken slowly from many.
        """
        return self._row_groups[group_index].read(columns).combine_chunks()


def _take_rows(table: pa.Table, rows: NDArray[np.int64]) -> pa.Table:
    """Return a table with the rows of these numbers, in the order of ``rows``, which has at least one."""
    first = rows[0]
    if np.array_equal(rows, np.arange(first, first + len(rows))):
        # Consecutive rows, such as those of a sweep on one process, need no copy, which would be slow.
        return table.slice(first, len(rows))
    return table.take(rows)


def _select_columns(table: pa.Table, columns: Sequence[str] | None) -> pa.Table:
    """Return a table with the columns of these names, or with all for None."""
    return table if columns is None else table.select(columns)


def _read_row_group(path: Path, index: int, columns: Sequence[str] | None) -> pa.Table:
    """Return the rows of a file's row group in the present format, with some columns or all.

    A parameter without a column has its default. Raises UsageError if the file cannot be read, has records
    that cannot be converted to the present format, or trials that this version cannot repeat.
    """
    file = _open_checked(path)
    stored_columns = None
    if columns is not None:
        # To convert an earlier format, the number of robots is needed. The column "trial" gives the table its
        # number of rows, if no other column is stored.
        needed_columns = {*columns, "robots", "trial", *FORMER_PARAMETERS}
        stored_columns = [name for name in file.schema_arrow.names if name in needed_columns]
    with _name_file_in_errors(path):
        table = file.read_row_group(index, columns=stored_columns)
        # A damaged or hostile file may hold lists that end beyond their values.
        table.validate(full=True)
        _check_former_parameters(path, table)
    # A file has its metadata twice, and the two may differ; these are the ones that were checked.
    table = table.replace_schema_metadata(file.schema_arrow.metadata)
    return _select_columns(to_present_format(table), columns)


# --- Checks ----------------------------------------------------------------------------------------------


def _open_checked(path: Path) -> pq.ParquetFile:
    """Open a file of results. Raises UsageError unless it is one in READABLE_FORMATS, and has rows."""
    with _name_file_in_errors(path):
        file = pq.ParquetFile(path)
        schema = file.schema_arrow
        file_format = _check_metadata(path, schema.metadata or {})
        _check_schema(path, schema, file_format)
        if not file.metadata.num_rows:
            raise UsageError(f"{path} holds no trials; run mcp-asdf sweep again")
    return file


@contextmanager
def _name_file_in_errors(path: Path) -> Iterator[None]:
    """Raise UsageError, which names ``path``, where reading that file in this context has failed.

    Errors of the system, of pyarrow and of the encoding of texts are replaced; a UsageError passes unchanged.
    If the file is missing since its sweep is not finished, the message says so.
    """
    try:
        yield
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        parts_path = parts_folder(path)
        hint = ""
        if parts_path.is_dir():
            hint = f"; its sweep is not finished, partial data is in {parts_path}"
        reason = error if path.exists() else "there is no such file"
        raise UsageError(f"cannot read {path}: {reason}{hint}") from error


def _check_metadata(path: Path, file_metadata: dict[bytes, bytes]) -> int:
    """Return the format of a file, one of READABLE_FORMATS, as its metadata state it.

    Raises UsageError if the metadata are not those of results, or state another format.
    """
    try:
        metadata = json.loads(file_metadata.get(METADATA_KEY, b"{}"))
    except (ValueError, RecursionError):  # another program may use the same key
        metadata = {}
    if not isinstance(metadata, dict) or "format" not in metadata:
        raise UsageError(
            f"{path} holds no results; format {PRESENT_FORMAT} is needed: run mcp-asdf sweep again"
        )
    if metadata["format"] not in READABLE_FORMATS:
        content = f"results in format {metadata['format']}"
        raise UsageError(
            f"{path} holds {content}; format {PRESENT_FORMAT} is needed: run mcp-asdf sweep again"
        )
    # Later code relies on these, whatever program has written the file.
    sampling_interval = metadata.get("sampling_interval")
    has_interval = isinstance(sampling_interval, int) and sampling_interval >= 0
    if not (has_interval and isinstance(metadata.get("versions"), dict)):
        raise UsageError(f"{path} is damaged: its metadata lack versions or sampling_interval; run it again")
    if not isinstance(metadata.get("source", ""), str):
        raise UsageError(f"{path} is damaged: source in its metadata is no text; make the file again")
    file_format: int = metadata["format"]
    return file_format


def _check_former_parameters(path: Path, table: pa.Table) -> None:
    """Raise UsageError if a parameter that only earlier versions had changed trials in a table from ``path``.

    FORMER_PARAMETERS names these parameters, and the value with which each had no effect. Trials that have
    another value cannot be repeated by this version.
    """
    for parameter_name, value_without_effect in FORMER_PARAMETERS.items():
        if parameter_name not in table.column_names:
            continue
        # An old file may have the column, as long as the parameter did nothing in any row.
        if table[parameter_name].unique().to_pylist() != [value_without_effect]:
            raise UsageError(
                f"{path} has results with {parameter_name}, a parameter of earlier versions; "
                "use one of these versions"
            )


def _check_schema(path: Path, schema: pa.Schema, file_format: int) -> None:
    """Raise UsageError if a column of results is missing, is there twice, or has a wrong type.

    The types are those of ``file_format``. A parameter may be missing, since it may be newer than the file.
    """
    types = column_types()
    if file_format != PRESENT_FORMAT:
        types = types | dict.fromkeys(RECORD_COLUMNS.values(), FLAT_RECORD)
    missing_columns = set(types) - set(PARAMETER_NAMES) - set(schema.names)
    if missing_columns:
        missing_names = ", ".join(sorted(missing_columns))
        raise UsageError(f"{path} is damaged: it has no {missing_names}; run mcp-asdf sweep again")
    for column in schema:
        if column.name not in types:
            continue  # another program may have added it
        # Parquet allows two columns of one name, which could not be told apart.
        is_there_twice = schema.names.count(column.name) > 1
        if is_there_twice or column.type != types[column.name]:
            problem = f"column {column.name} is not {types[column.name]}"
            raise UsageError(f"{path} is damaged: {problem}; run mcp-asdf sweep again")
