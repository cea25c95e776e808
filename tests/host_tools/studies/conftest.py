"""What tests of the studies share: fewer resamples, planted results, short trials, and tables of pages."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mcp_asdf_tools as m
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import SCORES
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import bootstrap
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.cells import Cell, StudyPart, cells_of
from mcp_asdf_tools.studies.study_results import StudyResults
from support import ROOT, cells_of_line

PLANTED_TRIALS = 30
STUDY_CELLS = {cell for study_part in StudyPart for cell in cells_of(study_part)}


@contextmanager
def rare_resampling() -> Iterator[None]:
    """Draw 100 resamples instead of 20,000: enough where results are far from any limit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bootstrap, "RESAMPLES", 100)
        bootstrap.resample_indices.cache_clear()
        yield
    bootstrap.resample_indices.cache_clear()


@pytest.fixture
def few_resamples() -> Iterator[None]:
    """Draw 100 resamples instead of 20,000: enough where results are far from any limit."""
    with rare_resampling():
        yield


class PlantedResults(StudyResults):
    """Results of parts of the study by an expression: the median of a cell's trials, or (median, spread).

    ``names_in_expression`` says which names it may have.
    """

    def __init__(self, expression: str, parts: Collection[StudyPart] = tuple(StudyPart)) -> None:
        super().__init__({})
        self._expression = compile(expression, "planted", "eval")
        self._parts = [study_part for study_part in StudyPart if study_part in parts]

    @property
    def parts(self) -> list[StudyPart]:
        return self._parts

    def sample(self, cell: Cell, name: str) -> Sample:
        """Return values of trials that spread evenly around the planted median of a cell."""
        cell = cell.normal
        assert cell in STUDY_CELLS, f"the study does not run {cell}"
        assert cell.study_part in self._parts, f"the claim needs {cell.study_part}, which it does not say"
        assert name in (*SCORES, "b_hat")
        planted = eval(self._expression, names_in_expression(cell, name))
        median, spread = planted if isinstance(planted, tuple) else (planted, 0.01)
        values = np.linspace(median - spread, median + spread, PLANTED_TRIALS)
        # Cells with another P have another order of trials, so that differences vary.
        return np.random.default_rng(cell.flawed_percent).permutation(values)


def names_in_expression(cell: Cell, measure: str) -> dict[str, Any]:
    """Return the values of all names that an expression of ``PlantedResults`` may contain.

    The expression is that of one cell and one measure.
    """
    return {
        "f": cell.fill_ratio,
        "b": cell.true_accuracy,
        "b_hat": cell.flawed_accuracy,
        "P": cell.flawed_percent,
        "filter": cell.filter,
        "tau": cell.filter_period,
        "part": cell.study_part.value,
        "measure": measure,
    }


# --- Trials ----------------------------------------------------------------------------------------------


def run_two_short_trials(**parameters: Any) -> list[Trials]:
    """Run the experiments of a grid for two short trials, recorded every 100 steps."""
    settings: dict[str, Any] = {"robots": 4, "flawed": 1, "steps": 400, "filter_period": 100, "trials": 2}
    return [
        run_trials(experiment, first=0, trials=2, sampling_interval=100)
        for experiment in m.grid(**settings | parameters)
    ]


def two_trials_with(*, x: Any = 0.5, b_hat: Any = 0.9, **changes: Any) -> Trials:
    """Make two trials with these values of x and b_hat, without running them: f = 0.5 and b = 0.9.

    There are four robots, the first of them flawed. ``x`` may be one number, which all robots have at all
    times. It may be a list with one number per robot, which the robot has at all times. Or it may be a list
    of such lists, one per sample. ``b_hat`` is given likewise, with one list per step of the filter.
    Both trials have the same values. All robots have converged at step 0, without an error.
    """
    settings = {"robots": 4, "flawed": 1, "steps": 4000, "fill_ratio": 0.5, "true_accuracy": 0.9, "trials": 2}
    experiment = Experiment(**settings | changes)
    robots = experiment.robots
    return Trials(
        experiment=experiment,
        numbers=[0, 1],
        convergence_steps=np.zeros((2, robots), np.int64),
        errors=np.zeros((2, robots)),
        b_hat=_of_two_trials(b_hat, robots),
        tests=np.zeros((2, robots), np.int64),
        updates=np.zeros((2, robots), np.int64),
        records={"x": _of_two_trials(x, robots)},
    )


def _of_two_trials(values: Any, robots: int) -> Sample:
    """Return an array of the shape (2, samples, robots), in which both trials have the same values.

    ``values`` is a number, one sample, or a list of samples.
    """
    array = np.atleast_2d(np.asarray(values, np.float64))
    return np.broadcast_to(array, (2, len(array), robots)).copy()


# --- Experiments of a study's rows -----------------------------------------------------------------------


def values_of(experiments: Iterable[Experiment], parameter: str) -> set[Any]:
    """Return the different values that experiments have for a parameter."""
    return {getattr(experiment, parameter) for experiment in experiments}


# --- Tables in Markdown ----------------------------------------------------------------------------------


Table = dict[str, dict[str, str]]
"""The cells of a table in Markdown by row and column. A row has its first cell as its name."""


def tables_in(path: Path) -> dict[str, Table]:
    """Return the tables of a Markdown file that stand between marks, by these."""
    text = path.read_text(encoding="utf-8")
    marked_tables = re.findall(r"<!-- (\w+) -->\n(\|.*?)\n<!-- end -->", text, re.DOTALL)
    return {mark: parse_table(table) for mark, table in marked_tables}


def parse_table(markdown: str) -> Table:
    """Read a table: a line with the heads of its columns, a line that only separates, and lines with rows."""
    head, _separator, *rows = [cells_of_line(line) for line in markdown.splitlines()]
    _corner, *columns = head
    return {row: dict(zip(columns, cells, strict=True)) for row, *cells in rows}


def page_path(name: str) -> Path:
    """Return the path of a page of docs/internals/."""
    return ROOT / f"docs/internals/{name}.md"
