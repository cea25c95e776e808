"""What tests of the studies share: fewer resamples, planted results, and short trials."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
import pytest

import mcp_asdf_tools as m
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import bootstrap
from mcp_asdf_tools.studies.bootstrap import Sample
from mcp_asdf_tools.studies.cells import Cell, StudyPart, cells_of
from mcp_asdf_tools.studies.study_results import SAMPLES, StudyResults

PLANTED_TRIALS = 30
STUDY_CELLS = {cell for study_part in StudyPart for cell in cells_of(study_part)}


@pytest.fixture
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Draw 100 resamples instead of 20,000: enough where results are far from any limit."""
    monkeypatch.setattr(bootstrap, "RESAMPLES", 100)
    bootstrap.resample_indices.cache_clear()
    yield
    bootstrap.resample_indices.cache_clear()


class PlantedResults(StudyResults):
    """Results of parts of the study by an expression: the median of a cell's trials, or (median, spread).

    Names in the expression are f, b, b_hat, P, filter, tau, part and measure.
    """

    def __init__(self, expression: str, parts: Collection[StudyPart] = tuple(StudyPart)) -> None:
        super().__init__({})
        self._expression = compile(expression, "planted", "eval")
        self._parts = [study_part for study_part in StudyPart if study_part in parts]

    @property
    def parts(self) -> list[StudyPart]:
        return self._parts

    def sample(self, cell: Cell, name: str) -> Sample:
        cell = cell.normal
        assert cell in STUDY_CELLS, f"the study does not run {cell}"
        assert cell.study_part in self._parts, f"the claim needs {cell.study_part}, which it does not say"
        assert name in SAMPLES
        values: dict[str, Any] = {
            "f": cell.fill_ratio,
            "b": cell.true_accuracy,
            "b_hat": cell.flawed_accuracy,
            "P": cell.flawed_percent,
            "filter": cell.filter,
            "tau": cell.filter_period,
            "part": cell.study_part.value,
            "measure": name,
        }
        planted = eval(self._expression, values)
        median, spread = planted if isinstance(planted, tuple) else (planted, 0.01)
        # Cells with another P have another order of trials, so that differences vary.
        order = np.random.default_rng(cell.flawed_percent).permutation(PLANTED_TRIALS)
        return np.asarray(median + 2 * spread * (order / (PLANTED_TRIALS - 1) - 0.5))


def short_trials(**parameters: Any) -> list[Trials]:
    """Run the experiments of a grid for two short trials, recorded every 100 steps."""
    settings: dict[str, Any] = {"robots": 4, "flawed": 1, "steps": 400, "filter_period": 100, "trials": 2}
    return [
        run_trials(experiment, first=0, trials=2, sampling_interval=100)
        for experiment in m.grid(**settings | parameters)
    ]
