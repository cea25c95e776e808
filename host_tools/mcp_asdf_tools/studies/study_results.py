"""Results of the paper's study: the trials of each cell, and the measures by which claims compare cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.studies.bootstrap import (
    Resampled,
    Sample,
    resample_interquartile_range,
    resample_median,
    resample_quantile,
    resample_rank_correlation,
)
from mcp_asdf_tools.studies.cells import PAPERS_FILTERS, PAPERS_FIRMWARE, Cell, StudyPart

BEST_OF_30_QUANTILE = 0.5 ** (1 / 30)
"""Quantile that the best of 30 independent trials, as many as the paper has, exceeds in half of all cases."""


class StudyResults:
    """Trials of the study by cell, where a cell is one combination of what the paper varies.

    Methods that take a cell raise KeyError if it has not been run.
    """

    def __init__(
        self,
        trials_by_cell: Mapping[Cell, Trials],
        users_trials: Mapping[StudyPart, Sequence[Trials]] | None = None,
    ) -> None:
        """Keep trials by cell; every cell must be a normal one, equal to its ``Cell.normal``.

        ``users_trials`` are those of ``users_experiments_of``, which stand beside them in pictures; no claim
        is about them.
        """
        self._trials_by_cell = dict(trials_by_cell)
        self._users_trials = dict(users_trials or {})
        self._computed_measures: dict[tuple[Cell, str], Resampled] = {}

    @property
    def parts(self) -> list[StudyPart]:
        """The parts of which there are results, in the paper's order."""
        parts_run = {cell.study_part for cell in self._trials_by_cell}
        return [study_part for study_part in StudyPart if study_part in parts_run]

    def trials_of(self, study_part: StudyPart) -> list[Trials]:
        """Return the trials of all cells of a part, a list entry for each cell."""
        return [trials for cell, trials in self._trials_by_cell.items() if cell.study_part is study_part]

    def users_trials_of(self, study_part: StudyPart) -> Sequence[Trials]:
        """Return the trials of a firmware or filter of the user's in a part, if there is one."""
        return self._users_trials.get(study_part, ())

    @property
    def users_name(self) -> str:
        """The name of the user's firmware or filter in these results, such as "beta"; empty without one."""
        for users_trials in self._users_trials.values():
            # All trials have the same name, so that of the first ones will do.
            if users_trials:
                return users_name_of(users_trials[0].experiment)
        return ""

    def sample(self, cell: Cell, name: str) -> Sample:
        """Return the values of a cell, which is one kind of swarm: one value per trial.

        ``name`` says which value: a score from 0 to 100, which is h_K for speed of convergence, h_e for
        accuracy, or H, their mean; or "b_hat", the accuracy that robots which are not flawed assume at the
        end, averaged over them. Raises KeyError if the cell has not been run, and for another name.
        """
        trials = self._trials_by_cell[cell.normal]
        if name == "b_hat":
            return final_b_hat_of_healthy_robots(trials)
        return trials.scores()[name]

    def measure(self, cell: Cell, name: str) -> Resampled:
        """Return a measure of a cell, one kind of swarm, with its bootstrap resamples. It is computed once.

        - a score, "H", "h_K" or "h_e", or "b_hat": the median over the trials
        - "spread of H": the interquartile range of H over the trials
        - "best H of 30": the H that the best of 30 trials reaches or misses equally often
        - "loss of H": the median H of the same swarm without flawed robots, less that of this one
        - "rank correlation of h_K and h_e": Spearman's coefficient over the trials
        """
        key = (cell.normal, name)  # many claims compare the same cells, and resampling is what takes long
        if key not in self._computed_measures:
            self._computed_measures[key] = self._compute_measure(cell.normal, name)
        return self._computed_measures[key]

    def _compute_measure(self, cell: Cell, name: str) -> Resampled:
        """Compute the measure called ``name`` of a cell, one kind of swarm, with its bootstrap resamples."""
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
        """Return the largest differences between two robots of one trial, over all trials of a part.

        "K" has the difference of their convergence steps, "e" the difference of their errors at these steps.
        """
        k_differences: list[float] = []
        e_differences: list[float] = []
        for trials in self.trials_of(study_part):
            robot_axis = 1  # of the shape (trials, robots)
            # ptp is the largest value less the smallest.
            k_differences.append(float(np.ptp(trials.convergence_steps, axis=robot_axis).max()))
            e_differences.append(float(np.ptp(trials.errors, axis=robot_axis).max()))
        return {"K": max(k_differences), "e": max(e_differences)}


def users_name_of(experiment: Experiment) -> str:
    """Return the name of an experiment's firmware, or filter, that is not the paper's, such as "beta".

    The name is "beta_robust" if neither is the paper's, and an empty text if both are.
    """
    names: list[str] = []
    if experiment.firmware != PAPERS_FIRMWARE:
        names.append(experiment.firmware)
    if experiment.filter not in PAPERS_FILTERS:
        names.append(experiment.filter)
    return "_".join(names)


def final_b_hat_of_healthy_robots(trials: Trials) -> Sample:
    """Return each trial's b_hat after the last filter step, averaged over the robots that are not flawed.

    b_hat is the accuracy that a robot assumes for its sensor.
    """
    first_healthy_robot = trials.experiment.flawed  # the robots before it are the flawed ones
    means: Sample = trials.final_b_hat[:, first_healthy_robot:].mean(axis=1)
    return means
