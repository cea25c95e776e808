"""The ground truth around the robots: what is under each of them, what its sensor says, who is near.

The world knows nothing of radios, frames or firmware. It says who could hear whom; whether and when a
message gets through is the business of what carries it. So one world drives a swarm on a CAN bus and a
simulation without one alike.

Randomness: robot i draws from a generator of its own, PCG64 seeded with child i of
``SeedSequence(seed)``, two uniform numbers in [0, 1) per tick: the tile is black if the first is below
the fill ratio, the sensor is right if the second is below its accuracy. What a robot sees therefore
depends on the seed and its id alone, not on the size of the swarm or how many ticks are drawn at once.
In an arena the floor says what is under a robot, and only the second number counts; the arena's seed is
the first word, of 64 bits, of ``SeedSequence(seed)`` itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.world.arena import Arena
from mcp_asdf_tools.world.topology import FullyConnected, Topology

__all__ = ["FullyConnected", "Topology", "World", "arena_seed"]


class World:
    """Black and white tiles, and robots on them with imperfect sensors.

    Robots stand on black with probability f, each tick anew, as in the paper's fully connected experiments;
    or they move through an arena, as in its dynamic ones.

    Attributes:
        fill_ratio: f, the share of black tiles, 0 .. 1.
        accuracies: True accuracy b of each robot's sensor for both colours, 0 .. 1, by robot id.
        topology: Who can hear whom.
    """

    def __init__(self, fill_ratio: float, accuracies: Sequence[float], topology: Topology, seed: int) -> None:
        """Make a world of ``len(accuracies)`` robots. If ``topology`` is an arena, they move in it.

        Raises ValueError if a probability is outside [0, 1] or ``seed`` is negative.
        """
        for name, values in (("fill ratio", [fill_ratio]), ("true accuracy", accuracies)):
            if not all(0 <= value <= 1 for value in values):
                raise ValueError(f"{name} is {values}; it must be within 0 to 1")
        self.fill_ratio = fill_ratio
        self.accuracies = tuple(accuracies)
        self.topology = topology
        children = np.random.SeedSequence(seed).spawn(len(accuracies))
        self._generators = [np.random.Generator(np.random.PCG64(child)) for child in children]

    @property
    def robots(self) -> int:
        """Number of robots."""
        return len(self.accuracies)

    def observe(self, ticks: int = 1) -> NDArray[np.uint8]:
        """Let ``ticks`` pass; returns what each robot's sensor says then, of shape (ticks, robots).

        1 is black and 0 white, as in ``Observation``. O(ticks * robots).
        """
        draws = np.stack([generator.random((ticks, 2)) for generator in self._generators], axis=1)
        if isinstance(self.topology, Arena):
            black = self.topology.record(ticks).black.astype(np.bool_)
        else:
            black = draws[:, :, 0] < self.fill_ratio
        right = draws[:, :, 1] < np.array(self.accuracies)
        says_black: NDArray[np.bool_] = black == right
        return says_black.astype(np.uint8)


def arena_seed(seed: int) -> int:
    """The seed of the arena in a world of this seed, 0 .. 2**64 - 1."""
    return int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])
