"""The ground truth of a run: observations, positions, and who hears whom, step by step.

The world knows nothing of radios, frames or firmware. It gives who could hear whom; whether and when a
message arrives is up to the carrier. One world therefore drives a swarm on a CAN bus, trials in Python and
trials in C alike: equal settings and trial give the same bits in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common import extensions
from mcp_asdf_tools.world import topology
from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.philox import OBSERVATIONS, Stream
from mcp_asdf_tools.world.sensors import black_probabilities, sensor_model
from mcp_asdf_tools.world.settings import WorldSettings

_STEPS_AT_ONCE = 64
"""Steps computed ahead where they are taken one by one."""
_COLOURS = (Observation.WHITE, Observation.BLACK)


@dataclass(frozen=True, eq=False)
class Scene:
    """Some steps in a row.

    Attributes:
        black: Whether a sensor reports black, shape (steps, N).
        observes: Whether robots observe in a step, shape (steps,).
        hears: Whether robot i hears robot j, shape (steps, N, N).
        positions: Centres in metres from the middle of the arena, shape (steps, N, 2); None if robots do not
            move.
        accuracy: True accuracy of each sensor, shape (steps, N); the mean of both colours if they differ.
    """

    black: NDArray[np.bool_]
    observes: NDArray[np.bool_]
    hears: NDArray[np.bool_]
    positions: NDArray[np.float64] | None
    accuracy: NDArray[np.float64]


class World:
    """The world of one trial: many steps at once with ``advance``, or one by one with ``step``, not both."""

    def __init__(self, settings: WorldSettings, trial: int = 0) -> None:
        """Start before the first step. Raises UsageError if the arena or an extension cannot be loaded."""
        self.settings = settings
        self._draws = Stream(OBSERVATIONS, settings.seed, trial, settings.robots)
        self._next = 0
        self._sensors = sensor_model(settings, trial)
        self._place = Arena(settings, trial) if settings.is_dynamic else _topology_of(settings, trial)
        self._ahead: Scene | None = None
        self._at = -1

    def advance(self, steps: int) -> Scene:
        """The next ``steps`` steps. O(steps N^2)."""
        settings, first = self.settings, self._next
        self._next += steps
        draws = self._draws.words(steps, first) >> np.uint32(1)
        accuracies = self._sensors.advance(steps)
        accuracy = np.broadcast_to((accuracies[0] + accuracies[1]) / 2, draws.shape)
        observes = (np.arange(first, first + steps) + 1) % settings.observation_period == 0
        if not isinstance(self._place, Arena):
            limit, _ = black_probabilities(accuracies, settings.fill_ratio)
            return Scene(draws < limit, observes, self._place.advance(steps), None, accuracy)
        on_black, on_white = black_probabilities(accuracies, None)
        motion = self._place.record(steps)
        limits = np.where(motion.black, on_black, on_white)
        return Scene(draws < limits, observes, motion.adjacency, motion.position, accuracy)

    def skip(self, steps: int) -> None:
        """Let 1 or more steps pass unseen. O(steps N), or N^2 with the topology of an extension."""
        self._next += steps
        self._sensors.advance(steps)
        if isinstance(self._place, Arena):
            self._place.step(steps)
        else:
            self._place.advance(steps)

    def step(self) -> Sequence[Observation | None]:
        """Take one step; returns the observation of each robot, None where it makes none. O(N^2)."""
        if self._ahead is None or self._at + 1 == len(self._ahead.black):
            self._ahead, self._at = self.advance(_STEPS_AT_ONCE), -1
        self._at += 1
        if not self._ahead.observes[self._at]:
            return [None] * self.settings.robots
        return [_COLOURS[black] for black in self._ahead.black[self._at].tolist()]

    def neighbours(self, robot: int) -> Sequence[int]:
        """Ids that ``robot`` hears in the present step, rising. Fails before the first."""
        near: list[int] = np.flatnonzero(self.hears[robot]).tolist()
        return near

    @property
    def hears(self) -> NDArray[np.bool_]:
        """True at [i, j] if robot i hears j in the present step, shape (N, N). Fails before the first."""
        assert self._ahead is not None
        heard: NDArray[np.bool_] = self._ahead.hears[self._at]
        return heard

    @property
    def positions(self) -> NDArray[np.float64] | None:
        """Centres in the present step, shape (N, 2), in metres; None if robots do not move."""
        if self._ahead is None or self._ahead.positions is None:
            return None
        centres: NDArray[np.float64] = self._ahead.positions[self._at]
        return centres

    @property
    def accuracy(self) -> NDArray[np.float64]:
        """True accuracy of each sensor in the present step, shape (N,). Fails before the first."""
        assert self._ahead is not None
        accuracy: NDArray[np.float64] = self._ahead.accuracy[self._at]
        return accuracy


def _topology_of(settings: WorldSettings, trial: int) -> topology.Topology:
    if settings.topology == "fully-connected":
        return topology.Static(~np.eye(settings.robots, dtype=np.bool_))
    if isinstance(settings.graph, topology.Graph):
        return settings.graph.topology(settings.robots)
    name = str(settings.topology)
    make = cast(
        Callable[[WorldSettings, int], topology.Topology], extensions.load(extensions.TOPOLOGIES, name)
    )
    return topology.Checked(make(settings, trial), name, settings.robots)
