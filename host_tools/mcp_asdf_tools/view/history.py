"""The history of a run, which the page draws: what stays the same, and states of all robots."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.world.graph import MAX_ON_BUS

QUANTITIES = ("x", "x_hat", "b_hat", "b")
"""Rows of ``State.values``: informed estimate, local estimate, the accuracy that a robot assumes of its
sensor, and the sensor's true accuracy."""

MAX_STATES = 10_000
"""Most states of a history: as many as a swarm has steps by default, more than a screen has columns."""
_MAX_LINKS = 4_000_000
"""Links between robots in all states, which bound the size of a page."""
_LINKS_PER_ROBOT_OF_MANY = 16
"""Links that a robot is taken to have among more than MAX_ON_BUS robots, where few hear each other."""


@dataclass(frozen=True)
class RunDescription:
    """What stays the same during a run, for the page to draw.

    Attributes:
        title: The run's parameters as a short text, such as "20 robots, 10 flawed, no filter, dynamic, seed
            1".
        robots: Ids of the robots, in the order of the columns of every state.
        flawed: Indices in ``robots`` of those that start with a wrong b_hat.
        fill_ratio: Share of black tiles of the floor, f; None if unknown.
        steps: Length of the complete run; None if it has no end.
        steps_per_second: Steps in a second of simulated time.
        sides: Width and height of the arena in metres; None if robots do not move.
        radio_range: Largest distance in metres at which robots receive each other; None if they do not move.
        floor: True where the floor is black, the first row in the north; None if there is no floor.
        filter: Name of the filter by which the robots re-estimate b_hat, which is also the name of its colour
            on the page; None if unknown.
        filter_term: The filter's name for readers, such as "ASDF+"; None if unknown.
        unfiltered_errors: Mean error of the same robots in the same run without a filter, averaged over
            consecutive parts of nearly equal length; empty if unknown.
        faults: The text, the first step and the step after the last (None if it has no end) of each fault.
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
    filter_term: str | None = None
    unfiltered_errors: Sequence[float] = ()
    faults: Sequence[tuple[str, int, int | None]] = ()


class State(NamedTuple):
    """All robots after one step.

    Attributes:
        tick: Number of steps done.
        values: ``QUANTITIES`` of each robot, NaN where unknown, shape (quantities, N).
        links: Receiver and sender of each link between two robots, as indices, shape (links, 2).
        positions: Centres in metres from the middle of the arena, shape (N, 2); None if robots do not move.
    """

    tick: int
    values: NDArray[np.float64]
    links: NDArray[np.uint16]
    positions: NDArray[np.float64] | None


@dataclass(frozen=True)
class HistoryUpdate:
    """What a reader of a history does not have yet.

    Attributes:
        generation: The history's generation when this was read.
        description: The run's description at the same moment.
        states: States after the reader's last one; all states if the reader's are of another generation.
    """

    generation: int
    description: RunDescription
    states: list[State]


class History:
    """The description and the states of a run; one thread may add to it while others read it.

    Attributes:
        description: What stays the same. It is replaced when a robot joins.
        generation: Number of times that the states so far were changed, because they were thinned out or a
            robot joined. Indices into the states of an earlier generation mean nothing.
        ticks_between_states: Ticks from one state that is kept to the next.
        has_ended: Whether the run is over, so that no more states come.
        report: Plain values that the page shows beside the latest state (see ``Roster.report``). It is
            replaced, never changed; None if there is none.
    """

    def __init__(self, description: RunDescription, states: Iterable[State] | None = None) -> None:
        """Create the history of a run that is over; without ``states``, that of a run that begins."""
        self.description = description
        self.generation = 0
        self.has_ended = states is not None
        self.report: dict[str, Any] | None = None
        self._states = list(states or ())
        self.ticks_between_states = 1
        self._lock = threading.Lock()

    def add(self, state: State) -> None:
        """Append a state, if its tick is a multiple of the present spacing; drop it otherwise.

        With more than MAX_STATES the spacing doubles, states between are removed, and a new generation
        begins, so that readers take all states anew.
        """
        if state.tick % self.ticks_between_states != 0:
            return
        with self._lock:
            self._states.append(state)
            if len(self._states) > MAX_STATES:
                # A run without an end must not fill the memory; the page still shows all of it, coarser.
                self.ticks_between_states *= 2
                self._states = [
                    kept_state
                    for kept_state in self._states
                    if kept_state.tick % self.ticks_between_states == 0
                ]
                self.generation += 1

    def add_robot(self, robot_id: int) -> None:
        """Add a robot as the last column of every state, without values or links in those so far. O(states).

        A new generation begins, so that readers take all states anew.
        """
        with self._lock:
            robot_ids = [*self.description.robots, robot_id]
            self.description = replace(self.description, robots=robot_ids)
            self._states = [_with_unknown_robot(state) for state in self._states]
            self.generation += 1

    def states_since(self, generation: int = -1, index: int = 0) -> HistoryUpdate:
        """Return what a reader lacks that has the states before ``index`` of this ``generation``.

        The update has the states from ``index`` on, or all if the generation is not the present one, with the
        present generation and description.
        """
        with self._lock:
            # Where the states so far have changed, the reader has to take all of them anew.
            first_index = index if generation == self.generation else 0
            return HistoryUpdate(self.generation, self.description, self._states[first_index:])


def _with_unknown_robot(state: State) -> State:
    """Return the state with one more robot: its values are NaN, and it has no links."""
    unknown_values = np.full((len(QUANTITIES), 1), np.nan)
    return state._replace(values=np.hstack([state.values, unknown_values]))


def find_links(neighbours: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the links of a state; ``neighbours`` says whether robot i receives from robot j."""
    return np.argwhere(neighbours).astype(np.uint16)


NO_LINKS = np.zeros((0, 2), np.uint16)
"""Links of a state where nobody knows who receives from whom."""


def steps_between_states(steps: int, robots: int) -> int:
    """Return how many steps a history leaves between two states that it keeps, so that its page stays small.

    ``steps`` is the length of the run. The result is the smallest number, at least 1, with which there are at
    most MAX_STATES states, and with which the page of these ``robots`` has a few megabytes at most.
    """
    links_per_robot = robots if robots <= MAX_ON_BUS else _LINKS_PER_ROBOT_OF_MANY
    affordable_states = _MAX_LINKS // (robots * links_per_robot)
    states = min(MAX_STATES, affordable_states)
    return math.ceil(steps / states)
