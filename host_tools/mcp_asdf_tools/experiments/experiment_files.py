"""Files that describe experiments, in TOML.

A line ``key = value`` stands for every parameter of Experiment that differs from its default. A list in place
of a value makes a grid: one experiment for each combination. So does a list of tables under any name: each
holds parameters that vary together. Tables ``[[grid]]`` hold grids of their own, each on top of the keys
above them. Paths of graphs are relative to the file's folder.

Every error names file and line. A name without a suffix is that of a file that comes with the program, in the
folder ``studies``.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_at_most
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import MAX_EXPERIMENTS, Experiment, combinations
from mcp_asdf_tools.world.graph import is_text_of_edges

STUDIES = Path(__file__).with_name("studies")
GRID = "grid"

_HEADER = re.compile(r"\s*\[\[\s*grid\s*\]\]")
_KEY = re.compile(r"""(?:^|[{,])\s*["']?([A-Za-z0-9_-]+)["']?\s*=""")


def read_experiments(path: Path | str) -> list[Experiment]:
    """Return the experiments of a TOML file, in its order.

    Raises UsageError, naming the line, for anything invalid, and for a file that names no parameter.
    """
    path = Path(path)
    if not path.suffix and not path.exists():
        path = _shipped_file(path)
    if path.suffix != ".toml":
        raise UsageError(f"{path}: unknown format; describe experiments in TOML and name it .toml")
    text = _read_toml_text(path)
    common_parameters, grids = _parse_grids(path, text)
    key_lines = _KeyLines(path, text)
    experiments: list[Experiment] = []
    for grid_number, grid in enumerate(grids, start=1):
        try:
            for combination in combinations({**common_parameters, **grid}):
                parameters = _with_graph_from_folder(combination, path.parent)
                experiments.append(Experiment.from_parameters(parameters))
                if max(len(grids), len(experiments)) > MAX_EXPERIMENTS:
                    raise UsageError(f"{path} makes more than {MAX_EXPERIMENTS} experiments; give fewer")
        except ParameterError as error:
            raise key_lines.error_at(grid_number, error.key, str(error)) from error
    return experiments


def _read_toml_text(path: Path) -> str:
    """Return the text of a file. Raises UsageError if it cannot be read or is not UTF-8."""
    try:
        return read_at_most(path).decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:  # bad UTF-8, or too long
        raise UsageError(f"{path}: {error}") from error


def _parse_grids(path: Path, text: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the parameters above the grids of a file, and those of each grid, at least one.

    Raises UsageError for what is no TOML, and for a file that names no parameter.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number with thousands of digits, deep lists
        raise UsageError(f"{path}: {error}") from error
    grids = content.pop(GRID, [{}])
    is_list_of_tables = isinstance(grids, list) and all(isinstance(grid, dict) for grid in grids)
    if not (is_list_of_tables and grids):
        raise UsageError(f"{path}: grid is not a table; write [[grid]] above its keys")
    if not content and not any(grids):
        raise UsageError(f"{path} names no parameter; give at least one, such as trials = 30")
    return content, grids


def _shipped_file(name: Path) -> Path:
    """Return the file of that name that comes with the program. Raises UsageError if there is none."""
    shipped_files = {path.stem: path for path in sorted(STUDIES.glob("*.toml"))}
    if str(name) not in shipped_files:
        names = ", ".join(shipped_files)
        raise UsageError(f"there is no file {name}; those that come with the program are {names}")
    return shipped_files[str(name)]


class _KeyLines:
    """Line numbers of the keys in a TOML file, for error messages.

    They are found by a search for ``key =``, so a key in a string may be taken for one, too.
    """

    def __init__(self, path: Path, text: str) -> None:
        """Find the lines of each key. Grids are numbered from 1; keys above them are in grid 0."""
        self._path = path
        self._lines: dict[tuple[int, str], list[str]] = {}
        grid_number = 0
        for line_number, line in enumerate(text.splitlines(), start=1):
            if _HEADER.match(line):
                grid_number += 1
            for key in _KEY.findall(line):
                self._lines.setdefault((grid_number, key), []).append(str(line_number))

    def error_at(self, grid_number: int, key: str, message: str) -> UsageError:
        """Return an error that names the lines of ``key`` in a grid, or else above the grids."""
        lines = self._lines.get((grid_number, key)) or self._lines.get((0, key), [])
        place = f", line {' or '.join(lines)}" if lines else ""
        return UsageError(f"{self._path}{place}: {message}")


def _with_graph_from_folder(parameters: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the parameters, with the path of a graph's file from where this process runs.

    Paths in a file of experiments are relative to its folder. Raises ParameterError for a path that leads to
    no regular file: a pipe or a device might never end.
    """
    graph = parameters.get("graph", "")
    if not isinstance(graph, str) or is_text_of_edges(graph):
        return parameters
    path = folder / graph
    try:
        is_regular = path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        is_regular = False
    if not is_regular:
        fix = "give edges, or the path of a file with them from this file's folder"
        raise ParameterError("graph", f"graph is {graph!r}, which is no regular file; {fix}")
    return parameters | {"graph": str(path)}
