"""The study on disk: run with several seeds, and with more trials where comparisons are open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from mcp_asdf_tools.common.files import make_folder
from mcp_asdf_tools.experiments.results import experiments_in
from mcp_asdf_tools.experiments.store import Store
from mcp_asdf_tools.reproduction.decisions import Decided, decide
from mcp_asdf_tools.reproduction.study import Cell, Part, Scale, Study, cell_of, cells_of, experiment_of


class Run(NamedTuple):
    """Results with one seed, and what they make of the claims."""

    seed: int
    study: Study
    decided: Decided


class StudyFolder:
    """The results of parts of the study in a folder, whole or not: a store for each seed and part."""

    def __init__(self, folder: Path, parts: Sequence[Part], scale: Scale) -> None:
        """Read what is there. Raises UsageError if it is of another study, or the folder cannot be made.

        Raises ParameterError for a scale out of range.
        """
        grids = [
            (replace(scale, seed=scale.seed + index), part)
            for part in parts
            for index in range(scale.effort(part).seeds)
        ]
        wanted = [[experiment_of(cell, own) for cell in cells_of(part)] for own, part in grids]
        make_folder(folder)
        self._by_scale: dict[Scale, dict[Part, Store]] = {}
        for (own, part), experiments in zip(grids, wanted, strict=True):
            suffix = "" if own.seed == scale.seed else f"_seed{own.seed}"
            store = Store(folder / f"{part.value}{suffix}.parquet", experiments, most=scale.effort(part).most)
            self._by_scale.setdefault(own, {})[part] = store

    @property
    def stores(self) -> list[Store]:
        """All results, seed after seed."""
        return [store for own in self._by_scale.values() for store in own.values()]

    def runs(self, run_missing: Callable[[Store], object]) -> Iterator[Run]:
        """Run what is missing, seed after seed; each until its comparisons are decided or trials are most."""
        for scale, stores in self._by_scale.items():
            while True:
                for store in stores.values():
                    run_missing(store)
                tables = {part: experiments_in(store.table()) for part, store in stores.items()}
                found = [(part, trials) for part, own in tables.items() for trials in own]
                study = Study({cell_of(part, trials.experiment): trials for part, trials in found})
                decided = decide(study, scale)
                unsettled = {cell for each in decided for cell in each.unsettled}
                if not _grow(stores, study, scale, unsettled):
                    break
            for store in stores.values():
                store.finish()
            yield Run(scale.seed, study, decided)


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
