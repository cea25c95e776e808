"""The ground truth of a run: observations, positions, and which robots receive from which, step by step.

The world knows nothing of radios, frames or firmware. It says which robots are neighbours; whether and when
a message arrives is up to what carries it. One world therefore drives a swarm on a CAN bus, trials in Python
and trials in C alike: equal settings and trial give the same bits in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.graph import Graph
from mcp_asdf_tools.world.philox import OBSERVATION_STREAM, Stream
from mcp_asdf_tools.world.sensors import (
    Accuracies,
    black_probabilities_anywhere,
    black_probabilities_by_colour,
    make_sensor_model,
)
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import CheckedTopology, FixedTopology, Topology, graph_topology

_STEPS_AT_ONCE = 64
"""Steps that ``SteppedWorld`` computes together, which is faster than one by one."""
_OBSERVATION_OF_COLOUR = (Observation.WHITE, Observation.BLACK)
"""Observations by whether the sensor reports black: False is index 0, True index 1."""

_BITS_BELOW_PROBABILITY_UNIT = np.uint32(1)
"""Lowest bits of a random word of 32 bits that are dropped, as probabilities have units of 2**-31."""

_TopologyMaker = Callable[[WorldSettings, int], Topology]
"""An extension's entry point, called with the settings and the number of the trial."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Observations, neighbours and positions of all robots in some consecutive steps.

    Attributes:
        black: Whether a sensor reports black, shape (steps, N).
        observes: Whether robots observe in a step, shape (steps,).
        neighbours: Whether robot i receives from robot j, shape (steps, N, N).
        positions: Centres in metres from the middle of the arena, shape (steps, N, 2); None if robots do not
            move.
        accuracy: True accuracy of each sensor, shape (steps, N); the mean of both colours if they differ.
    """

    black: NDArray[np.bool_]
    observes: NDArray[np.bool_]
    neighbours: NDArray[np.bool_]
    positions: NDArray[np.float64] | None
    accuracy: NDArray[np.float64]


class World:
    """The world of one trial, many steps at a time."""

    def __init__(self, settings: WorldSettings, trial: int = 0) -> None:
        """Start before the first step.

        Raises UsageError if the robots find no room in the arena, or an extension cannot be loaded.
        """
        self.settings = settings
        self._next_step = 0
        self._observation_draws = Stream(OBSERVATION_STREAM, settings.seed, trial, settings.robots)
        self._sensors = make_sensor_model(settings, trial)
        self._topology = Arena(settings, trial) if settings.is_dynamic else _make_topology(settings, trial)

    def advance(self, steps: int) -> Scene:
        """Let ``steps`` steps pass, and return what happens in each of them as a ``Scene``. O(steps N^2).

        The Scene holds what sensors report, which steps have an observation, who receives from whom, where
        the robots are (None if they do not move), and how accurate their sensors are.
        """
        first_step = self._next_step
        self._next_step += steps
        accuracies = self._sensors.advance(steps)
        if isinstance(self._topology, Arena):
            motion = self._topology.record(steps)
            on_black, on_white = black_probabilities_by_colour(accuracies)
            black_probability = np.where(motion.black, on_black, on_white)
            neighbours = motion.adjacency
            positions = motion.position
        else:
            # The floor is not modelled: any tile is black with probability f.
            black_probability = black_probabilities_anywhere(accuracies, self.settings.fill_ratio)
            neighbours = self._topology.advance(steps)
            positions = None
        random_words = self._observation_draws.draw_words(steps, first_step)
        return Scene(
            black=(random_words >> _BITS_BELOW_PROBABILITY_UNIT) < black_probability,
            observes=self._has_observation(first_step, steps),
            neighbours=neighbours,
            positions=positions,
            accuracy=self._mean_of_colours(accuracies, steps),
        )

    def _has_observation(self, first_step: int, steps: int) -> NDArray[np.bool_]:
        """Return an array with one value per step, which says whether robots observe in this step.

        There are ``steps`` steps, the first of which is ``first_step``. Robots observe at the end of every
        period: with period 3 in the third step, the sixth, and so on.
        """
        step_numbers_from_1 = np.arange(first_step, first_step + steps) + 1
        observes: NDArray[np.bool_] = step_numbers_from_1 % self.settings.observation_period == 0
        return observes

    def _mean_of_colours(self, accuracies: Accuracies, steps: int) -> NDArray[np.float64]:
        """Return the mean of the accuracies on black and on white tiles, shape (steps, N).

        Accuracies that do not change, or are the same for all robots, have an axis of length 1. They are
        repeated along it, as a view to be read only.
        """
        on_black, on_white = accuracies
        return np.broadcast_to((on_black + on_white) / 2, (steps, self.settings.robots))

    def skip(self, steps: int) -> None:
        """Let 1 or more steps pass without computing their Scene.

        Later steps are the same as after ``advance``. O(steps N), or O(steps N^2) with topology extensions.
        Draws need no skipping, as each is a function of its step alone. Sensors and topology have a state.
        """
        self._next_step += steps
        self._sensors.advance(steps)
        if isinstance(self._topology, Arena):
            self._topology.step(steps)
        else:
            self._topology.advance(steps)


class SteppedWorld:
    """The world of one trial, one step at a time; its properties are those of the last step."""

    def __init__(self, settings: WorldSettings, trial: int = 0) -> None:
        """Start before the first step.

        Raises UsageError if the robots find no room in the arena, or an extension cannot be loaded.
        """
        self.settings = settings
        self._world = World(settings, trial)
        self._steps_left = settings.steps
        self._scene: Scene | None = None
        self._index_in_scene = -1  # of the present step, along the first axis of the scene's arrays

    def step(self) -> Sequence[Observation | None]:
        """Take one step, and return each robot's observation by id. O(N^2).

        Robots observe in every step whose number is a multiple of ``observation_period``. In all others the
        observation of every robot is None.
        """
        self._index_in_scene += 1
        if self._scene is None or self._index_in_scene == len(self._scene.black):
            # Not beyond the end of the run, where an extension may have no answers. A caller who goes on
            # there gets one step at a time.
            steps_at_once = max(1, min(_STEPS_AT_ONCE, self._steps_left))
            self._scene = self._world.advance(steps_at_once)
            self._steps_left -= steps_at_once
            self._index_in_scene = 0
        if not self._scene.observes[self._index_in_scene]:
            return [None] * self.settings.robots
        black_by_robot = self._scene.black[self._index_in_scene].tolist()
        return [_OBSERVATION_OF_COLOUR[is_black] for is_black in black_by_robot]

    @property
    def current_neighbours(self) -> NDArray[np.bool_]:
        """True where robot i receives from robot j, shape (N, N). AssertionError before the first step."""
        assert self._scene is not None, "no step has been taken"
        return cast(NDArray[np.bool_], self._scene.neighbours[self._index_in_scene])

    @property
    def positions(self) -> NDArray[np.float64] | None:
        """Centres in metres from the middle of the arena, shape (N, 2).

        None if robots do not move, and before the first step.
        """
        if self._scene is None or self._scene.positions is None:
            return None
        return cast(NDArray[np.float64], self._scene.positions[self._index_in_scene])

    @property
    def accuracy(self) -> NDArray[np.float64]:
        """True accuracy of each sensor, shape (N,). AssertionError before the first step."""
        assert self._scene is not None, "no step has been taken"
        return cast(NDArray[np.float64], self._scene.accuracy[self._index_in_scene])


def _make_topology(settings: WorldSettings, trial: int) -> Topology:
    """Return which robots receive from which, where robots do not move.

    That is all from all others, the edges of ``settings.graph``, or what the extension named by
    ``settings.topology`` answers. Only an extension uses the number of the ``trial``. Raises UsageError if
    the extension cannot be loaded.
    """
    if settings.topology == "fully-connected":
        return FixedTopology(neighbours=~np.eye(settings.robots, dtype=np.bool_))
    # Settings have a Graph exactly if their topology is "graph".
    if isinstance(settings.graph, Graph):
        return graph_topology(settings.graph, settings.robots)
    name = str(settings.topology)
    make_topology = cast(_TopologyMaker, extensions.load(extensions.TOPOLOGIES, name))
    return CheckedTopology(make_topology(settings, trial), name, settings.robots)
