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
from mcp_asdf_tools.world.philox import OBSERVATION_STREAM, Stream
from mcp_asdf_tools.world.sensors import black_probabilities, make_sensor_model
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.topology import CheckedTopology, FixedTopology, Graph, Topology

_STEPS_AT_ONCE = 64
"""Steps that ``SteppedWorld`` computes together, which is faster than one by one."""
_OBSERVATION_OF_COLOUR = (Observation.WHITE, Observation.BLACK)


@dataclass(frozen=True, eq=False)
class Scene:
    """What happens in some consecutive steps.

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
        """Start before the first step. Raises UsageError if the arena or an extension cannot be loaded."""
        self.settings = settings
        self._next_step = 0
        self._observation_draws = Stream(OBSERVATION_STREAM, settings.seed, trial, settings.robots)
        self._sensors = make_sensor_model(settings, trial)
        self._topology = Arena(settings, trial) if settings.is_dynamic else _make_topology(settings, trial)

    def advance(self, steps: int) -> Scene:
        """Let ``steps`` steps pass; return the observations, neighbours and more in each. O(steps N^2)."""
        settings, first_step = self.settings, self._next_step
        self._next_step += steps
        # The last bit is left out, as probabilities have units of 2**-31.
        draws = self._observation_draws.draw_words(steps, first_step) >> np.uint32(1)
        accuracies = self._sensors.advance(steps)
        mean_accuracy = np.broadcast_to((accuracies[0] + accuracies[1]) / 2, draws.shape)
        steps_passed = np.arange(first_step, first_step + steps) + 1
        observes = steps_passed % settings.observation_period == 0
        if isinstance(self._topology, Arena):
            motion = self._topology.record(steps)
            on_black, on_white = black_probabilities(accuracies, None)
            black_probability = np.where(motion.black, on_black, on_white)
            neighbours, positions = motion.adjacency, motion.position
        else:
            black_probability, _ = black_probabilities(accuracies, settings.fill_ratio)
            neighbours, positions = self._topology.advance(steps), None
        return Scene(draws < black_probability, observes, neighbours, positions, mean_accuracy)

    def skip(self, steps: int) -> None:
        """Let 1 or more steps pass of which nobody wants to know anything.

        O(steps N), or O(steps N^2) with the topology of an extension.
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
        """Start before the first step. Raises UsageError as ``World``."""
        self.settings = settings
        self._world = World(settings, trial)
        self._scene: Scene | None = None
        self._row = -1  # the present step's in the scene

    def step(self) -> Sequence[Observation | None]:
        """Take one step, and return each robot's observation, None where it makes none. O(N^2)."""
        if self._scene is None or self._row + 1 == len(self._scene.black):
            self._scene, self._row = self._world.advance(_STEPS_AT_ONCE), -1
        self._row += 1
        # In some steps robots make no observation, by observation_period.
        if not self._scene.observes[self._row]:
            return [None] * self.settings.robots
        return [_OBSERVATION_OF_COLOUR[is_black] for is_black in self._scene.black[self._row].tolist()]

    @property
    def current_neighbours(self) -> NDArray[np.bool_]:
        """Whether robot i receives from robot j, shape (N, N). Not known before the first step."""
        assert self._scene is not None, "no step has been taken"
        neighbours: NDArray[np.bool_] = self._scene.neighbours[self._row]
        return neighbours

    @property
    def positions(self) -> NDArray[np.float64] | None:
        """Centres in metres, shape (N, 2); None if robots do not move, and before the first step."""
        if self._scene is None or self._scene.positions is None:
            return None
        positions: NDArray[np.float64] = self._scene.positions[self._row]
        return positions

    @property
    def accuracy(self) -> NDArray[np.float64]:
        """True accuracy of each sensor, shape (N,). Not known before the first step."""
        assert self._scene is not None, "no step has been taken"
        accuracy: NDArray[np.float64] = self._scene.accuracy[self._row]
        return accuracy


def _make_topology(settings: WorldSettings, trial: int) -> Topology:
    """Return which robots receive from which, where robots do not move."""
    if settings.topology == "fully-connected":
        return FixedTopology(~np.eye(settings.robots, dtype=np.bool_))
    if isinstance(settings.graph, Graph):
        return settings.graph.topology(settings.robots)
    name = str(settings.topology)
    make_extension = cast(
        Callable[[WorldSettings, int], Topology], extensions.load(extensions.TOPOLOGIES, name)
    )
    return CheckedTopology(make_extension(settings, trial), name, settings.robots)
