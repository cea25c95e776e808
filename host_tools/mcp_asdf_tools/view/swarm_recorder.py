"""The history of a running swarm, recorded step by step."""

from __future__ import annotations

import time

import numpy as np

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.swarm.log_replay import collect_values
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.history import History, State, find_links, steps_between_states
from mcp_asdf_tools.view.run_description import describe_run
from mcp_asdf_tools.view.run_states import ESTIMATES


class SwarmRecorder:
    """Hook of ``run_swarm`` that adds the swarm's states to a history, and slows the run to a given pace.

    Attributes:
        history: The description of the swarm, and its states so far. Its owner sets ``has_ended``.
    """

    def __init__(self, settings: SwarmSettings, pace: float = 0.0) -> None:
        """Prepare for a run of at most ``pace`` steps a second; 0 sets no limit.

        Raises UsageError if ``pace`` is below 0 or no number, or if the arena cannot be made.
        """
        if not pace >= 0:  # written as "not >=", since NaN is refused, too
            raise UsageError(f"--pace is {pace:g}; give steps a second, or 0 for as many as it can")
        self.history = History(describe_run(settings, faults=settings.faults, allow=settings.allow))
        self._spacing = steps_between_states(settings.steps, settings.robots)
        self._seconds_per_step = 0.0 if pace == 0 else 1 / pace
        self._next_step_time = 0.0

    def __call__(self, swarm: Swarm) -> None:
        """Sleep until the next step may begin, and add the present state if it is due. O(robots^2).

        States are due every ``steps_between_states`` ticks.
        """
        now = time.monotonic()
        # After a slow step the schedule starts anew from now: the steps that follow do not hurry to make up
        # for it.
        self._next_step_time = max(self._next_step_time + self._seconds_per_step, now)
        time.sleep(self._next_step_time - now)
        if swarm.ticks % self._spacing == 0:
            self.history.add(_read_swarm_state(swarm))


def _read_swarm_state(swarm: Swarm) -> State:
    """Return the present state of a running swarm; robots that are not alive have NaN for their estimates."""
    world = swarm.world
    # A row for each quantity, and a column for each robot
    estimates = collect_values((node.robot for node in swarm.nodes), ESTIMATES)
    is_robot_dead = [not node.is_alive for node in swarm.nodes]
    estimates[:, is_robot_dead] = np.nan
    # The last row is the true accuracy of each robot's sensor.
    values = np.vstack([estimates, world.accuracy])
    return State(swarm.ticks, values, find_links(world.current_neighbours), world.positions)
