"""The paper's whole study as experiments, and their results by what was varied.

A ``Cell`` is one combination of what the paper varies. Cells that are the same experiment have one normal
form: without flawed robots it does not matter what they would assume, nor whether only they filter; where all
are flawed, all filter or none; and without a filter there is no filtering period. What is run stands in the
folder ``studies``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.experiment_files import STUDIES, read_experiments
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.scores import SCORES
from mcp_asdf_tools.reproduction.resampling import Sample, Summarized, Summary, falls_apart, summarized

FLAWED_ACCURACIES = (0.55, 0.75, 0.95)
PERIODS = (1000, 2000, 4000)


class Part(Enum):
    """The paper's three sets of experiments."""

    FULLY_CONNECTED = "fully_connected"
    DYNAMIC = "dynamic"
    PHYSICAL = "physical"


PART_NAMES = {part: part.value.replace("_", " ") for part in Part}


@dataclass(frozen=True)
class Cell:
    """One combination of what the paper varies.

    Attributes:
        part: Set of experiments.
        fill_ratio: f.
        true_accuracy: b.
        flawed_accuracy: b_hat of flawed robots at the start.
        percent: P, how many of 100 robots are flawed.
        filter: The robots that filter.
        period: tau in steps.
    """

    part: Part
    fill_ratio: float
    true_accuracy: float
    flawed_accuracy: float
    percent: int
    filter: str = "none"
    period: int = PERIODS[0]

    def but(self, **changes: Any) -> Cell:
        """A cell that differs in ``changes``."""
        return replace(self, **changes)

    @property
    def normal(self) -> Cell:
        """The normal form of the same experiment."""
        changes: dict[str, Any] = {}
        chosen = self.filter
        if self.percent == 0:
            changes["flawed_accuracy"] = self.true_accuracy
            chosen = "none" if chosen == "asdf-minus" else chosen
        elif self.percent == 100 and chosen == "asdf-minus":
            chosen = "asdf-plus"
        if chosen == "none":
            changes["period"] = PERIODS[0]
        return replace(self, filter=chosen, **changes)


@cache
def _experiments_of(part: Part) -> list[Experiment]:
    return read_experiments(STUDIES / f"{part.value}.toml")


@cache
def cells_of(part: Part) -> tuple[Cell, ...]:
    """The cells of a part in their normal form, each once."""
    return tuple(dict.fromkeys(cell_of(part, each) for each in _experiments_of(part)))


def cell_of(part: Part, experiment: Experiment) -> Cell:
    """The cell of an experiment of a part, in its normal form."""
    return Cell(
        part,
        experiment.fill_ratio,
        experiment.true_accuracy,
        experiment.flawed_accuracy,
        round(100 * experiment.flawed / experiment.robots),
        experiment.filter,
        experiment.filter_period,
    ).normal


class Effort(NamedTuple):
    """How much is run of a part.

    Attributes:
        trials: Number for each experiment.
        most: Number for one whose comparisons are open, after being doubled again and again.
        seeds: How often the part is run, each time with another seed.
    """

    trials: int
    most: int
    seeds: int

    @property
    def looks(self) -> int:
        """How often comparisons are looked at while trials are added."""
        return (self.most // self.trials).bit_length()


ENOUGH = {
    Part.FULLY_CONNECTED: Effort(300, 1200, 3),
    Part.DYNAMIC: Effort(60, 240, 2),
    Part.PHYSICAL: Effort(300, 1200, 3),
}
"""Enough for nearly all comparisons, and to see whether another seed decides alike."""


@dataclass(frozen=True)
class Scale:
    """How much is run of each experiment.

    Attributes:
        trials: How many; None for as many as decide.
        steps: Most steps of a trial.
        seed: The first one.
        seeds: How many; None for as many as ``ENOUGH`` has.
    """

    trials: int | None = None
    steps: int = 40_000
    seed: int = 1
    seeds: int | None = None

    def effort(self, part: Part) -> Effort:
        """How much is run of a part."""
        trials, most, seeds = ENOUGH[part]
        if self.trials is not None:
            trials = most = self.trials
        return Effort(trials, most, seeds if self.seeds is None else self.seeds)

    @property
    def allows_verdicts(self) -> bool:
        """True if trials are as many and as long as the paper's."""
        return self.steps >= Scale.steps and (self.trials is None or self.trials >= 30)


PAPER = Scale(trials=30, seeds=1)
QUICK = Scale(trials=10, steps=10_000, seeds=1)


def experiment_of(cell: Cell, scale: Scale) -> Experiment:
    """The experiment of a cell, before trials are added. Raises ParameterError for a scale out of range."""
    common = _experiments_of(cell.part)[0]
    varied = {
        "flawed": round(cell.percent * common.robots / 100),
        "fill_ratio": cell.fill_ratio,
        "true_accuracy": cell.true_accuracy,
        "flawed_accuracy": cell.flawed_accuracy,
        "filter": cell.filter,
        "filter_period": cell.period,
        "trials": scale.effort(cell.part).trials,
        "steps": min(common.steps, scale.steps),
        "seed": scale.seed,
    }
    return Experiment(**{**common.parameters(), **varied})


# --- Results ---------------------------------------------------------------------------------------------

MEASURES = (*SCORES, "b_hat")
"""A value for each trial: the scores; b_hat in the end, on average over the robots that began with the right
one."""


def corruption(trials: Trials) -> Sample:
    """That b_hat."""
    final: Sample = trials.b_hat[:, -1, trials.experiment.flawed :].mean(axis=1)
    return final


class Study:
    """Results of parts of the study with one seed, by cell."""

    def __init__(self, trials: Mapping[Cell, Trials]) -> None:
        """``trials`` of cells in their normal form."""
        self._trials = dict(trials)
        self._scores = {cell: each.scores() for cell, each in trials.items()}
        self._summarized: dict[tuple[Cell, str, Summary, int], Summarized] = {}

    @property
    def parts(self) -> set[Part]:
        """The parts of which there are results."""
        return {cell.part for cell in self._trials}

    def count(self, cells: Iterable[Cell]) -> int:
        """How many trials all of these cells have. Raises KeyError if one has not been run."""
        return min(len(self.trials(cell).numbers) for cell in cells)

    def trials(self, cell: Cell) -> Trials:
        """The results of a cell. Raises KeyError if it has not been run."""
        return self._trials[cell.normal]

    def sample(self, cell: Cell, measure: str) -> Sample:
        """A value for each trial of a cell. Raises KeyError if it has not been run."""
        found = cell.normal
        return corruption(self._trials[found]) if measure == "b_hat" else self._scores[found][measure]

    def summarized(self, cell: Cell, measure: str, summary: Summary, trials: int) -> Summarized:
        """The summary of a cell's first ``trials``, and of their resamples; kept for the next comparison."""
        key = (cell.normal, measure, summary, trials)
        if key not in self._summarized:
            self._summarized[key] = summarized(self.sample(cell, measure)[:trials], summary)
        return self._summarized[key]

    def share_of_better(self, pair: Sequence[Cell], measure: str) -> float | None:
        """Share of trials in which the first cell has more; None if neither cell's fall into two groups."""
        count = self.count(pair)
        ours, others = (self.sample(cell, measure)[:count] for cell in pair)
        if not (falls_apart(ours) or falls_apart(others)):
            return None
        return float((ours > others).mean())

    def of(self, part: Part) -> list[Trials]:
        """All results of a part."""
        return [trials for cell, trials in self._trials.items() if cell.part is part]
