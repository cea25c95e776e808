"""A run as a film: what stays the same, and the state of all robots after some of its steps."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

QUANTITIES = ("x", "x_hat", "b_hat", "b")
"""A robot's numbers in a state: its estimates, and b, the true accuracy of its sensor."""

MAX_STATES = 10_000
"""Longest film: as many steps as a swarm has by default, and more than a screen has columns."""


@dataclass(frozen=True)
class Stage:
    """Constant parts of a film.

    Attributes:
        title: The run in a few words.
        robots: Their ids.
        flawed: Places among them of the robots that are flawed at the start.
        fill_ratio: f; None if unknown.
        steps: Length of the whole run; None if it has no end.
        steps_per_second: Steps in a second of simulated time.
        sides: Width and height of the arena in metres; None if robots do not move.
        radio_range: In metres; None if robots do not move.
        floor: True where black, the first row in the north; None if there is no floor.
        filter: Name of the robots' filter; None if unknown.
        twin: Mean error of the same robots without a filter, as means over equal parts of the run; empty if
            unknown.
        faults: Text, first step and first step after (None if it has no end) of each fault.
    """

    title: str
    robots: list[int]
    flawed: Sequence[int] = ()
    fill_ratio: float | None = None
    steps: int | None = None
    steps_per_second: int = 10
    sides: tuple[float, float] | None = None
    radio_range: float | None = None
    floor: NDArray[np.bool_] | None = None
    filter: str | None = None
    twin: Sequence[float] = ()
    faults: Sequence[tuple[str, int, int | None]] = ()


class State(NamedTuple):
    """All robots after a step.

    Attributes:
        tick: Steps done.
        values: QUANTITIES of each robot, NaN where unknown, shape (quantities, N).
        hears: Whether robot i hears j, bool of shape (N, N); of more than MAX_ON_BUS robots who hears whom
            instead, ids of shape (pairs, 2).
        positions: Centres in metres from the middle of the arena, shape (N, 2); None if robots do not move.
    """

    tick: int
    values: NDArray[np.float64]
    hears: NDArray[Any]
    positions: NDArray[np.float64] | None


class Film:
    """A stage and what happens on it; it may grow while others watch it, from any thread.

    Attributes:
        stage: What stays the same.
        generation: Counts changes of what was taken already (it was thinned out, a robot joined), after which
            earlier indices mean nothing.
        has_ended: Whether nothing more comes.
        report: What stands beside the latest state, as plain values, replaced and never changed; None if
            nothing does.
    """

    def __init__(self, stage: Stage, states: Iterable[State] | None = None) -> None:
        """A film of a run that is over, or, without ``states``, one that begins."""
        self.stage = stage
        self.generation = 0
        self.has_ended = states is not None
        self.report: dict[str, Any] | None = None
        self._states = list(states or ())
        self._spacing = 1
        self._lock = threading.Lock()

    def add(self, state: State) -> None:
        """Take the next state. One that falls between those kept is dropped, so that memory has an end."""
        if state.tick % self._spacing:
            return
        with self._lock:
            self._states.append(state)
            if len(self._states) > MAX_STATES:
                self._spacing *= 2
                self._states = [each for each in self._states if each.tick % self._spacing == 0]
                self.generation += 1

    def join(self, robot: int) -> None:
        """One more robot, of which nothing is known in the states before. O(states)."""
        with self._lock:
            self.stage = replace(self.stage, robots=[*self.stage.robots, robot])
            self._states = [_with_one_more(each) for each in self._states]
            self.generation += 1

    def since(self, generation: int = -1, index: int = 0) -> tuple[int, Stage, list[State]]:
        """The generation and its stage, and its states from ``index`` on; all if ``generation`` is over."""
        with self._lock:
            states = self._states[index if generation == self.generation else 0 :]
            return self.generation, self.stage, states


def _with_one_more(state: State) -> State:
    values = np.pad(state.values, ((0, 0), (0, 1)), constant_values=np.nan)
    return state._replace(values=values, hears=np.pad(state.hears, (0, 1)))
