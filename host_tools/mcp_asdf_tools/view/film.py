"""A run as a film: what stays the same, and the state of every robot at some of its steps."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

QUANTITIES = ("x", "x_hat", "b_hat", "b")
"""Of a robot in a sample: its estimates, and b, the true accuracy of its sensor."""

MAX_SAMPLES = 10_000
"""Of a film: as many steps as a swarm has by default, and more than a screen has columns."""


@dataclass(frozen=True)
class Stage:
    """Constant parts of a film.

    Attributes:
        title: The run in a few words.
        robots: Their ids.
        flawed: Places among them of the robots that are flawed at the start.
        fill_ratio: f; None if unknown.
        steps: Length of the whole run; None if it has no end.
        steps_per_second: Of simulated time.
        comms_period: Steps between broadcasts.
        sides: Width and height of the arena in metres; None if robots do not move.
        radio_range: In metres; None if robots do not move.
        floor: True where black, the first row in the north; None if there is no floor.
    """

    title: str
    robots: Sequence[int]
    flawed: Sequence[int] = ()
    fill_ratio: float | None = None
    steps: int | None = None
    steps_per_second: int = 10
    comms_period: int = 1
    sides: tuple[float, float] | None = None
    radio_range: float | None = None
    floor: NDArray[np.bool_] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Samples:
    """The robots' states after some steps.

    Attributes:
        ticks: Steps done, rising, shape (samples,).
        values: Those of QUANTITIES, NaN where unknown, shape (samples, quantities, N).
        hears: Whether robot i hears j, shape (samples, N, N).
        positions: Centres in metres from the middle of the arena, shape (samples, N, 2); None if robots do
            not move.
    """

    ticks: NDArray[np.int64]
    values: NDArray[np.float64]
    hears: NDArray[np.bool_]
    positions: NDArray[np.float64] | None

    def quantity(self, name: str) -> NDArray[np.float64]:
        """One of QUANTITIES, shape (samples, N)."""
        values: NDArray[np.float64] = self.values[:, QUANTITIES.index(name)]
        return values


@dataclass(frozen=True)
class Film:
    """A stage and what happened on it."""

    stage: Stage
    samples: Samples


class Sample(NamedTuple):
    """One row of ``Samples``."""

    tick: int
    values: NDArray[np.float64]
    hears: NDArray[np.bool_]
    positions: NDArray[np.float64] | None


class LiveFilm:
    """A film that grows while others watch it, from any thread.

    Attributes:
        stage: What stays the same.
        generation: Counts changes of what was taken already (it was thinned out, a robot joined), after which
            earlier indices mean nothing.
        has_ended: Whether nothing more comes.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.generation = 0
        self.has_ended = False
        self._rows: list[Sample] = []
        self._spacing = 1
        self._lock = threading.Lock()

    @classmethod
    def of(cls, film: Film) -> LiveFilm:
        """A film that has ended before anybody watches it."""
        live = cls(film.stage)
        live._rows = rows_of(film.samples)
        live.has_ended = True
        return live

    def add(self, sample: Sample) -> None:
        """Take the next sample. One that falls between those kept is dropped, so that memory has an end."""
        if sample.tick % self._spacing:
            return
        with self._lock:
            self._rows.append(sample)
            if len(self._rows) > MAX_SAMPLES:
                self._spacing *= 2
                self._rows = [row for row in self._rows if row.tick % self._spacing == 0]
                self.generation += 1

    def join(self, robot: int) -> None:
        """One more robot, of which nothing is known in the samples before. O(samples)."""
        with self._lock:
            self.stage = replace(self.stage, robots=[*self.stage.robots, robot])
            self._rows = [_with_one_more(row) for row in self._rows]
            self.generation += 1

    def end(self) -> None:
        """Nothing more comes."""
        self.has_ended = True

    def since(self, generation: int, index: int) -> tuple[int, Stage, Samples | None]:
        """The generation and its stage, and its samples from ``index`` on, or all if ``generation`` is over.

        No samples are None. O(samples returned).
        """
        with self._lock:
            rows = self._rows[index if generation == self.generation else 0 :]
            return self.generation, self.stage, _stacked(rows) if rows else None


def rows_of(samples: Samples) -> list[Sample]:
    """The samples one by one."""
    places = [None] * len(samples.ticks) if samples.positions is None else samples.positions
    rows = zip(samples.ticks.tolist(), samples.values, samples.hears, places, strict=True)
    return [Sample(*row) for row in rows]


def _with_one_more(row: Sample) -> Sample:
    values = np.pad(row.values, ((0, 0), (0, 1)), constant_values=np.nan)
    return row._replace(values=values, hears=np.pad(row.hears, (0, 1)))


def _stacked(rows: Sequence[Sample]) -> Samples:
    positions: Any = [row.positions for row in rows]
    return Samples(
        np.array([row.tick for row in rows], np.int64),
        np.stack([row.values for row in rows]),
        np.stack([row.hears for row in rows]),
        None if positions[0] is None else np.stack(positions),
    )
