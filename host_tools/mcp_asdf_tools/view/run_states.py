"""States of emulated runs: what robots estimate, and the world around them.

A recording holds no positions, neighbours or true accuracies. They follow from its parameters, and are
computed again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.view.history import State, find_links
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import Scene, World

ESTIMATES = ("x", "x_hat", "b_hat")
"""What a state has of each robot besides its true accuracy, as attributes of ``Robot``."""


def complete_states(
    settings: WorldSettings, trial: int, estimates: NDArray[np.float64], spacing: int
) -> Iterator[State]:
    """Yield a state for each of the robots' ``estimates``, with what is computed from its world again.

    ``estimates`` has x, x_hat and b_hat at ticks 0, ``spacing`` and so on, shape (states, 3, N). The rest is
    true accuracies, links and positions.
    """
    world = World(settings, trial)
    # The world has no state before the first step, so the state at tick 0 shows the world at tick 1.
    scene = world.advance(1)
    world_tick = 1
    for index, estimates_at_tick in enumerate(estimates):
        tick = index * spacing
        if tick > world_tick:
            scene = _scene_after(world, tick - world_tick)
            world_tick = tick
        # The scene is of one step, which is the first entry of each of its arrays.
        positions = None if scene.positions is None else scene.positions[0]
        values = np.vstack([estimates_at_tick, scene.accuracy[0]])
        yield State(tick, values, find_links(scene.neighbours[0]), positions)


def _scene_after(world: World, steps: int) -> Scene:
    """Let ``steps`` steps of a world pass, at least one, and return the Scene of the last one alone."""
    # To skip steps is faster than to compute their scenes.
    steps_to_skip = steps - 1
    if steps_to_skip > 0:
        world.skip(steps_to_skip)
    return world.advance(1)
