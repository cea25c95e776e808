"""Reader of TOML files that describe experiments.

A line ``key = value`` sets a parameter of Experiment; all others have their defaults. A list in place of a
value makes a grid: an experiment for each combination of values. So does a list of tables under any name, of
which each has parameters that vary together. A table ``[[grid]]`` is a grid of its own, to which the keys
above all these tables are added. Paths of graphs are relative to the folder of the file.

Every error names the file and the line. A name without a suffix is that of a file that comes with the
program, in the folder ``studies``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.common.files import read_text
from mcp_asdf_tools.common.parameters import ParameterError
from mcp_asdf_tools.experiments.experiment import MAX_EXPERIMENTS, Experiment, combinations
from mcp_asdf_tools.world.graph import is_text_of_edges

SHIPPED_STUDIES = Path(__file__).with_name("studies")
GRID_KEY = "grid"
_ABOVE_GRIDS = 0
"""Number that stands for the lines above the first grid; grids are numbered from 1."""

_GRID_LINE_PATTERN = re.compile(r"\s*\[\[\s*grid\s*\]\]")
# A key stands at the beginning of a line, or in an inline table behind its brace or a comma.
_KEY_PATTERN = re.compile(r"""(?:^|[{,])\s*["']?([A-Za-z0-9_-]+)["']?\s*=""")


def read_experiments(path: Path | str) -> list[Experiment]:
    """Return the experiments that a TOML file describes, in its order.

    A path without a suffix that does not exist is the name of a file that comes with the program. Paths of
    graphs in the file begin at the file's folder. Raises UsageError, which names the line if it can, if
    anything is invalid, the file sets no parameter, or there are more than MAX_EXPERIMENTS.
    """
    path = Path(path)
    if not path.suffix and not path.exists():
        path = _shipped_file(path)
    if path.suffix != ".toml":
        raise UsageError(f"{path}: unknown format; describe experiments in TOML and name it .toml")
    text = read_text(path)
    common_parameters, grids = _parse_grids(path, text)
    experiments: list[Experiment] = []
    for grid_number, grid in enumerate(grids, start=1):
        try:
            for experiment in _experiments_of_grid({**common_parameters, **grid}, path.parent):
                experiments.append(experiment)
                # Each grid makes at least one experiment, so too many grids are refused at the first one.
                fewest_experiments = max(len(grids), len(experiments))
                if fewest_experiments > MAX_EXPERIMENTS:
                    raise UsageError(f"{path} makes more than {MAX_EXPERIMENTS} experiments; give fewer")
        except ParameterError as error:
            raise _error_with_line(path, text, grid_number, error) from error
    return experiments


def _experiments_of_grid(grid: dict[str, Any], folder: Path) -> Iterator[Experiment]:
    """Yield the experiments of a grid. Files of graphs are searched for in ``folder``.

    Raises ParameterError for anything invalid.
    """
    for combination in combinations(grid):
        yield Experiment.from_parameters(_with_graph_from_folder(combination, folder))


def _parse_grids(path: Path, text: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the keys above the grids of a file, and the keys of each grid.

    A file without a grid has one without keys. Raises UsageError if the text is not TOML or has no key.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number with thousands of digits, deep lists
        raise UsageError(f"{path}: {error}") from error
    grids = content.pop(GRID_KEY, [{}])
    is_list_of_tables = isinstance(grids, list) and all(isinstance(grid, dict) for grid in grids)
    if not (is_list_of_tables and grids):
        raise UsageError(f"{path}: grid is not a table; write [[grid]] above its keys")
    if not content and not any(grids):
        raise UsageError(f"{path} names no parameter; give at least one, such as trials = 30")
    return content, grids


def _shipped_file(name: Path) -> Path:
    """Return the path of a file that comes with the program, by its name without a suffix.

    Raises UsageError if there is none of that name. Names of files alone are compared, so that no name leads
    out of this folder.
    """
    shipped_files = {path.stem: path for path in sorted(SHIPPED_STUDIES.glob("*.toml"))}
    if str(name) not in shipped_files:
        names = ", ".join(shipped_files)
        raise UsageError(f"there is no file {name}; those that come with the program are {names}")
    return shipped_files[str(name)]


def _error_with_line(path: Path, text: str, grid_number: int, error: ParameterError) -> UsageError:
    """Return an error that names the lines of its key in a grid, or above the grids if it is not there.

    Grids are numbered from 1; a key above them holds in each of them. The parser of TOML does not give lines,
    so they are found by a search for ``key =``. Such a text within a string is found, too; then the error
    names one line too many. It names no line for a key that has none.
    """
    line_numbers_by_grid = _lines_with_key(text, error.key)
    line_numbers = line_numbers_by_grid.get(grid_number) or line_numbers_by_grid.get(_ABOVE_GRIDS)
    position = ""
    if line_numbers:
        position = f", line {' or '.join(line_numbers)}"
    return UsageError(f"{path}{position}: {error}")


def _lines_with_key(text: str, key: str) -> dict[int, list[str]]:
    """Return the numbers of the lines that have a key.

    The result has a list of them under the number of their grid, or under _ABOVE_GRIDS.
    """
    line_numbers_by_grid: dict[int, list[str]] = {}
    current_grid = _ABOVE_GRIDS
    for line_number, line in enumerate(text.splitlines(), start=1):
        if _GRID_LINE_PATTERN.match(line):
            current_grid += 1
        if key in _KEY_PATTERN.findall(line):
            line_numbers_by_grid.setdefault(current_grid, []).append(str(line_number))
    return line_numbers_by_grid


def _with_graph_from_folder(parameters: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return parameters with the path of their graph joined to ``folder``, where the file of experiments is.

    Without a graph, or with edges in place of a path, they are returned unchanged. Raises ParameterError for
    a path of anything but a regular file: a pipe or a device might never end.
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
