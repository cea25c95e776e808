"""Results of the paper's study: the trials of each cell, and the measures by which claims compare cells."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import SCORES
from mcp_asdf_tools.studies.bootstrap import (
    Resampled,
    Sample,
    resample_interquartile_range,
    resample_median,
    resample_quantile,
    resample_rank_correlation,
)
from mcp_asdf_tools.studies.cells import Cell, StudyPart

SAMPLES = (*SCORES, "b_hat")
"""Values of a trial: its scores, and b_hat at the end, averaged over the robots that started with b."""

MEASURES = (*SAMPLES, "spread of H", "best H of 30", "loss of H", "rank correlation of h_K and h_e")
"""Measures of a cell: medians of SAMPLES, and four more, which ``StudyResults.measure`` describes."""

BEST_OF_30_QUANTILE = 0.5 ** (1 / 30)
"""Quantile that the best of 30 independent trials, as many as the paper has, exceeds in half of all cases."""


class StudyResults:
    """Trials of the study by cell. Methods raise KeyError for a cell that has not been run."""

    def __init__(self, trials_by_cell: Mapping[Cell, Trials]) -> None:
        """Keep the trials of cells, which must be normal ones."""
        self._trials_by_cell = dict(trials_by_cell)
        self._scores = {cell: trials.scores() for cell, trials in trials_by_cell.items()}
        self._measured: dict[tuple[Cell, str], Resampled] = {}

    @property
    def parts(self) -> list[StudyPart]:
        """The parts of which there are results, in the paper's order."""
        parts_run = {cell.study_part for cell in self._trials_by_cell}
        return [study_part for study_part in StudyPart if study_part in parts_run]

    def trials_of(self, study_part: StudyPart) -> list[Trials]:
        """Return the trials of all cells of a part, a list entry for each cell."""
        return [trials for cell, trials in self._trials_by_cell.items() if cell.study_part is study_part]

    def sample(self, cell: Cell, name: str) -> Sample:
        """Return one of SAMPLES: a value for each trial of a cell."""
        if name == "b_hat":
            return final_b_hat_of_healthy_robots(self._trials_by_cell[cell.normal])
        return self._scores[cell.normal][name]

    def measure(self, cell: Cell, name: str) -> Resampled:
        """Return one of MEASURES of a cell, resampled; it is computed once.

        - a name of SAMPLES: the median over the trials
        - "spread of H": the interquartile range of H over the trials
        - "best H of 30": the H that the best of 30 trials reaches or misses equally often
        - "loss of H": the median H of the same swarm without flawed robots, less that of this one
        - "rank correlation of h_K and h_e": Spearman's coefficient over the trials
        """
        # Many claims compare the same cells, and resampling is what takes long.
        key = (cell.normal, name)
        if key not in self._measured:
            self._measured[key] = self._compute_measure(cell.normal, name)
        return self._measured[key]

    def _compute_measure(self, cell: Cell, name: str) -> Resampled:
        """Compute one of MEASURES of a normal cell."""
        match name:
            case "spread of H":
                return resample_interquartile_range(self.sample(cell, "H"))
            case "best H of 30":
                return resample_quantile(self.sample(cell, "H"), BEST_OF_30_QUANTILE)
            case "loss of H":
                return self.measure(cell.without_flawed_robots, "H") - self.measure(cell, "H")
            case "rank correlation of h_K and h_e":
                return resample_rank_correlation(self.sample(cell, "h_K"), self.sample(cell, "h_e"))
            case _:
                return resample_median(self.sample(cell, name))

    def largest_differences_between_robots(self, study_part: StudyPart) -> dict[str, float]:
        """Return by how much K and e of the robots of one trial differ at most, over all trials of a part."""
        k_differences = [
            np.ptp(trials.convergence_steps, axis=1).max() for trials in self.trials_of(study_part)
        ]
        e_differences = [np.ptp(trials.errors, axis=1).max() for trials in self.trials_of(study_part)]
        return {"K": float(max(k_differences)), "e": float(max(e_differences))}


def final_b_hat_of_healthy_robots(trials: Trials) -> Sample:
    """Return b_hat after the last filter step, averaged over the robots that started with the right one."""
    healthy_robots = slice(trials.experiment.flawed, None)  # the first robots are the flawed ones
    final_b_hat: Sample = trials.b_hat[:, -1, healthy_robots].mean(axis=1)
    return final_b_hat
