"""Film of a running swarm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.swarm import Swarm, SwarmSettings
from mcp_asdf_tools.view.film import QUANTITIES, LiveFilm, Sample
from mcp_asdf_tools.view.sources import spacing_of
from mcp_asdf_tools.view.stage import stage_of


class SwarmCamera:
    """Hook that adds a swarm's state to a film, as often as its length asks for.

    Attributes:
        film: What was taken so far.
    """

    def __init__(self, settings: SwarmSettings) -> None:
        """Prepare for a run. Raises UsageError if its arena cannot be made."""
        self.film = LiveFilm(stage_of(settings))
        self._spacing = spacing_of(settings.steps, settings.robots)

    def __call__(self, swarm: Swarm) -> None:
        """Take the present state if it is due. O(robots^2)."""
        if swarm.ticks % self._spacing == 0:
            world = swarm.world
            self.film.add(Sample(swarm.ticks, _values(swarm), world.hears.copy(), world.positions))


def _values(swarm: Swarm) -> NDArray[np.float64]:
    states = [[getattr(node.robot, name) for node in swarm.nodes] for name in QUANTITIES[:3]]
    return np.array([*states, swarm.world.accuracy])
