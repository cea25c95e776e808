"""The paper's three sets of experiments, the parts of the study, and the cells of which they consist.

A ``Cell`` is one combination of what the paper varies. Some combinations are the same experiment: without
flawed robots it does not matter what these would assume, nor whether only they filter; where all robots are
flawed, ASDF- is ASDF+; and without a filter there is no filtering period. ``Cell.normal`` chooses one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cache

from mcp_asdf_tools.experiments.experiment import Experiment, without_repetitions
from mcp_asdf_tools.experiments.experiment_files import SHIPPED_STUDIES, read_experiments

FLAWED_ACCURACIES = (0.55, 0.75, 0.95)
"""b_hat, the accuracy that flawed robots assume for their sensors at the start."""

FLAWED_PERCENTS = (0, 10, 30, 50, 100)
"""P, the percentage of robots that are flawed."""

FILTER_PERIODS = (1000, 2000, 4000)
"""tau, the steps from one filter step of a robot to the next."""
SHORTEST_FILTER_PERIOD = FILTER_PERIODS[0]

PAPERS_FIRMWARE, PAPERS_FILTERS = "native", ("none", "asdf-minus", "asdf-plus")
"""Firmware that runs the paper's filter here, and the paper's choices of ``Experiment.filter``."""

PAPER_TRIALS = 30
PAPER_STEPS = 40_000


class StudyPart(Enum):
    """A set of experiments of the paper; its value is the name of the file that describes it."""

    FULLY_CONNECTED = "fully_connected"
    DYNAMIC = "dynamic"
    PHYSICAL = "physical"

    @property
    def label(self) -> str:
        """The name for people to read: without the underscore."""
        return self.value.replace("_", " ")


@dataclass(frozen=True)
class Cell:
    """A combination of what the paper varies.

    Attributes:
        study_part: Set of experiments that it belongs to.
        fill_ratio: f, the share of black floor, which the robots estimate.
        true_accuracy: b, the accuracy of all sensors.
        flawed_accuracy: b_hat, the accuracy that flawed robots assume for their sensors at the start.
        flawed_percent: P, the percentage of robots that are flawed.
        filter: Which robots filter, that is, correct their b_hat: a value of ``Experiment.filter``.
        filter_period: tau, the steps from one filter step to the next.
    """

    study_part: StudyPart
    fill_ratio: float
    true_accuracy: float
    flawed_accuracy: float
    flawed_percent: int
    filter: str = "none"
    filter_period: int = SHORTEST_FILTER_PERIOD

    @property
    def normal(self) -> Cell:
        """The cell that stands for all cells that are the same experiment as this one.

        Without flawed robots it does not matter what these would assume; where all are flawed, ASDF- is
        ASDF+; and without a filter there is no filter period.
        """
        filter_name = self.filter
        flawed_accuracy = self.flawed_accuracy
        filter_period = self.filter_period
        if self.flawed_percent == 0:
            # No robot starts with this value, so any one stands for all.
            flawed_accuracy = self.true_accuracy
            if filter_name == "asdf-minus":
                # Only flawed robots would filter, and there are none.
                filter_name = "none"
        elif self.flawed_percent == 100 and filter_name == "asdf-minus":
            # All robots are flawed, so all filter.
            filter_name = "asdf-plus"
        if filter_name == "none":
            filter_period = SHORTEST_FILTER_PERIOD
        return replace(self, filter=filter_name, flawed_accuracy=flawed_accuracy, filter_period=filter_period)

    @property
    def without_flawed_robots(self) -> Cell:
        """The cell of the same swarm without flawed robots, with P = 0."""
        return replace(self, flawed_percent=0)


@dataclass(frozen=True)
class StudySize:
    """How much of the study is run.

    Attributes:
        trials: Number of trials of each experiment.
        steps: Largest number of steps of a trial; an experiment of the paper that is shorter stays so.
        seed: Seed of all experiments.
    """

    trials: int = PAPER_TRIALS
    steps: int = PAPER_STEPS
    seed: int = 1

    @property
    def allows_verdicts(self) -> bool:
        """True if trials are at least as many and as long as the paper's."""
        return self.trials >= PAPER_TRIALS and self.steps >= PAPER_STEPS


@cache
def _shipped_experiments(study_part: StudyPart) -> list[Experiment]:
    """Return the experiments of a part of the study, read from the file that comes with the program."""
    return read_experiments(SHIPPED_STUDIES / f"{study_part.value}.toml")


@cache
def cells_of(study_part: StudyPart) -> tuple[Cell, ...]:
    """Return the cells of a part of the study, its kinds of swarms, in the order of the part's file.

    If several cells are the same experiment, only the one that ``Cell.normal`` chooses is returned.
    """
    cells: list[Cell] = []
    for experiment in _shipped_experiments(study_part):
        cell = cell_of(study_part, experiment)
        # The files are grids, which have the same experiment under several cells.
        if cell not in cells:
            cells.append(cell)
    return tuple(cells)


def cell_of(study_part: StudyPart, experiment: Experiment) -> Cell:
    """Return the cell, the kind of swarm, to which an experiment of a part belongs.

    Several cells may be the same experiment. The result is the one that ``Cell.normal`` chooses.
    """
    cell = Cell(
        study_part=study_part,
        fill_ratio=experiment.fill_ratio,
        true_accuracy=experiment.true_accuracy,
        flawed_accuracy=experiment.flawed_accuracy,
        # An experiment has a number of flawed robots, the paper a percentage.
        flawed_percent=round(100 * experiment.flawed / experiment.robots),
        filter=experiment.filter,
        filter_period=experiment.filter_period,
    )
    return cell.normal


def users_experiments_of(
    study_part: StudyPart, study_size: StudySize, firmware: str, filter_name: str | None
) -> list[Experiment]:
    """Return the experiments of a part of the study that are run with a firmware or filter of the user's.

    They are the part's experiments with a filter and the shortest filter period, but with this firmware. A
    filter of the user's takes the place of ASDF- and ASDF+; None leaves both. Raises ParameterError for
    trials, steps or a seed of ``study_size`` that are out of range.
    """
    cells = [
        cell
        for cell in cells_of(study_part)
        if cell.filter != "none" and cell.filter_period == SHORTEST_FILTER_PERIOD
    ]
    if filter_name is not None:
        cells = [replace(cell, filter=filter_name) for cell in cells]
    experiments = [replace(experiment_of(cell, study_size), firmware=firmware) for cell in cells]
    # Cells with ASDF- and with ASDF+ are the same with another filter.
    return without_repetitions(experiments)


def experiment_of(cell: Cell, study_size: StudySize) -> Experiment:
    """Return the experiment of a cell with the trials, steps and seed of ``study_size``.

    A cell says in what one experiment differs from the others of its part of the study. All other parameters
    are those of the experiments that this package ships for the part. If these have fewer steps than
    ``study_size``, their number of steps is taken. Raises ParameterError for trials, steps or a seed out of
    range.
    """
    common = _shipped_experiments(cell.study_part)[0]
    return replace(
        common,
        fill_ratio=cell.fill_ratio,
        true_accuracy=cell.true_accuracy,
        flawed_accuracy=cell.flawed_accuracy,
        flawed=round(cell.flawed_percent * common.robots / 100),
        filter=cell.filter,
        filter_period=cell.filter_period,
        trials=study_size.trials,
        steps=min(common.steps, study_size.steps),
        seed=study_size.seed,
    )
