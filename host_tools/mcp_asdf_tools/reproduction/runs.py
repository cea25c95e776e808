"""The study on disk: run with several seeds, and with more trials where comparisons are open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.experiments import Experiment, Store, Trials, experiments_in
from mcp_asdf_tools.reproduction.comparisons import FULLY_CONNECTED, NONE, PLUS
from mcp_asdf_tools.reproduction.decisions import Decided, decide
from mcp_asdf_tools.reproduction.study import Cell, Part, Scale, Study, cells_of, experiment_of, study_of

_NANOSECONDS = {Part.FULLY_CONNECTED: 7, Part.DYNAMIC: 44, Part.PHYSICAL: 62}
"""Of a robot's step with the native firmware on one Zen 4 core."""

SERIES_CELL = Cell(FULLY_CONNECTED, 0.95, 0.55, 0.95, 50)
"""The paper's figure 6, a trial each without a filter and with ASDF+."""
SERIES_INTERVAL = 100
"""Steps between the values of a recorded trial."""


@dataclass(frozen=True)
class Run:
    """Results with one seed.

    Attributes:
        seed: Of everything random.
        study: The results.
        decided: What they make of the claims.
    """

    seed: int
    study: Study
    decided: Decided


RunMissing = Callable[[Store, int], None]
"""Runs what a store misses, recorded every so many steps unless that is 0."""


def seconds_of(store: Store) -> float:
    """Processor time that the missing trials of a store take, about, with the native firmware."""
    return sum(len(store.missing(each)) * _seconds_of_trial(each) for each in store.experiments)


def _seconds_of_trial(experiment: Experiment) -> float:
    """Processor time of a trial, about, with the native firmware."""
    part = Part.FULLY_CONNECTED
    if experiment.is_dynamic:
        part = Part.PHYSICAL if experiment.observation_period > 1 else Part.DYNAMIC
    return 1e-9 * _NANOSECONDS[part] * experiment.robots * experiment.steps


class StudyFolder:
    """The results of parts of the study in a folder, whole or not."""

    def __init__(self, folder: Path, parts: Sequence[Part], scale: Scale) -> None:
        """Read what is there. Raises UsageError if it is of another study, or the folder cannot be made.

        Raises ParameterError for a scale out of range.
        """
        self._parts = parts
        self._scale = scale
        grids = {seed: self._grids(seed) for seed in self.seeds}
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"cannot make the folder {folder}: {error.strerror}; choose another") from error
        self._stores = {
            seed: {
                part: Store(self._path(folder, part, seed), grid, most=scale.effort(part).most)
                for part, grid in own.items()
            }
            for seed, own in grids.items()
        }
        self._series = Store(folder / "series.parquet", self._recorded(), SERIES_INTERVAL)

    @property
    def seeds(self) -> list[int]:
        """From the first on, as many as the part that has most."""
        most = max(self._scale.effort(part).seeds for part in self._parts)
        return [self._scale.seed + index for index in range(most)]

    @property
    def stores(self) -> list[Store]:
        """All results."""
        return [self._series, *(store for own in self._stores.values() for store in own.values())]

    def _scale_of(self, seed: int) -> Scale:
        return replace(self._scale, seed=seed)

    def _grids(self, seed: int) -> dict[Part, list[Experiment]]:
        index = seed - self._scale.seed
        return {
            part: [experiment_of(cell, self._scale_of(seed)) for cell in cells_of(part)]
            for part in self._parts
            if index < self._scale.effort(part).seeds
        }

    def _path(self, folder: Path, part: Part, seed: int) -> Path:
        suffix = "" if seed == self._scale.seed else f"_seed{seed}"
        return folder / f"{part.value}{suffix}.parquet"

    def _recorded(self) -> list[Experiment]:
        if FULLY_CONNECTED not in self._parts:
            return []
        cells = [SERIES_CELL.but(filter=some) for some in (NONE, PLUS)]
        return [replace(experiment_of(cell, self._scale), trials=1) for cell in cells]

    def series(self, run_missing: RunMissing) -> list[Trials]:
        """The recorded trials, run if they are missing; none without fully connected swarms."""
        if not self._series.experiments:
            return []
        run_missing(self._series, SERIES_INTERVAL)
        return experiments_in(self._series.finish())

    def runs(self, run_missing: RunMissing) -> Iterator[Run]:
        """Run what is missing, seed after seed; each until its comparisons are decided or trials are most."""
        for seed, stores in self._stores.items():
            scale = self._scale_of(seed)
            while True:
                for store in stores.values():
                    run_missing(store, 0)
                study = study_of(
                    ((part, experiments_in(store.table())) for part, store in stores.items()), scale
                )
                decided = decide(study, scale)
                unsettled = {cell for each in decided for cell in each.unsettled}
                if not _grow(stores, study, scale, unsettled):
                    break
            for store in stores.values():
                store.finish()
            yield Run(seed, study, decided)


def _grow(stores: Mapping[Part, Store], study: Study, scale: Scale, cells: set[Cell]) -> bool:
    """Double the trials of cells, up to the most; returns whether there are any to be run."""
    grown = False
    for part, store in stores.items():
        most = scale.effort(part).most
        experiments = []
        for cell in cells_of(part):
            given = study.trials(cell).experiment
            trials = min(2 * given.trials, most) if cell in cells else given.trials
            grown |= trials > given.trials
            experiments.append(replace(given, trials=trials))
        store.want(experiments)
    return grown
