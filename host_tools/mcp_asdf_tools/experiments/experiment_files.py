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
from mcp_asdf_tools.world.topology import is_text_of_edges

STUDIES = Path(__file__).with_name("studies")
GRID = "grid"

_HEADER = re.compile(r"\s*\[\[\s*grid\s*\]\]")
_KEY = re.compile(r"""(?:^|[{,])\s*["']?([A-Za-z0-9_-]+)["']?\s*=""")


def read_experiments(path: Path | str) -> list[Experiment]:
    """Return the experiments of a file, in its order.

    Raises UsageError, naming the line, for anything invalid, and for a file that names no parameter.
    """
    path = Path(path)
    if not path.suffix and not path.exists():
        path = _shipped(path)
    if path.suffix != ".toml":
        raise UsageError(f"{path}: unknown format; describe experiments in TOML and name it .toml")
    try:
        text = read_at_most(path).decode("utf-8-sig")
        content = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # bad UTF-8, a number with thousands of digits, deep lists
        raise UsageError(f"{path}: {error}") from error
    grids = content.pop(GRID, [{}])
    if not (isinstance(grids, list) and grids and all(isinstance(grid, dict) for grid in grids)):
        raise UsageError(f"{path}: grid is not a table; write [[grid]] above its keys")
    if not content and not any(grids):
        raise UsageError(f"{path} names no parameter; give at least one, such as trials = 30")
    lines = _TomlLines(path, text)
    experiments: list[Experiment] = []
    for number, grid in enumerate(grids, start=1):
        try:
            for choice in combinations({**content, **grid}):
                experiments.append(Experiment.from_parameters(_from_folder(choice, path.parent)))
                if max(len(grids), len(experiments)) > MAX_EXPERIMENTS:
                    raise UsageError(f"{path} makes more than {MAX_EXPERIMENTS} experiments; give fewer")
        except ParameterError as error:
            raise lines.error(number, error.key, str(error)) from error
    return experiments


def _shipped(name: Path) -> Path:
    shipped = {path.stem: path for path in sorted(STUDIES.glob("*.toml"))}
    if str(name) not in shipped:
        raise UsageError(
            f"there is no file {name}; those that come with the program are {', '.join(shipped)}"
        )
    return shipped[str(name)]


class _TomlLines:
    """Line numbers of the keys in a file."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._of: dict[tuple[int, str], list[str]] = {}
        grid = 0
        for number, line in enumerate(text.splitlines(), start=1):
            grid += bool(_HEADER.match(line))
            for key in _KEY.findall(line):
                self._of.setdefault((grid, key), []).append(f"{number}")

    def error(self, grid: int, key: str, message: str) -> UsageError:
        """An error at ``key`` of the ``grid``-th grid, or above the grids if it stands there."""
        lines = " or ".join(self._of.get((grid, key), self._of.get((0, key), ())))
        return UsageError(f"{self.path}{lines and f', line {lines}'}: {message}")


def _from_folder(parameters: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the parameters, a graph that is a file with its path from where this process runs.

    Raises ParameterError for a path that leads to no regular file: a pipe or a device might never end.
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
