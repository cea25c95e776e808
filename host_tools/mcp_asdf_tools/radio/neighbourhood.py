"""The neighbours of one real controller: a swarm in which the controller is the external robot.

``Neighbourhood`` needs no bus. It takes the frames that the controller has sent, and returns those that the
controller is to receive, from neighbours in range and after the faults.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
from mcp_asdf_tools.swarm.fault_injection.faults import Faults
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings
from mcp_asdf_tools.swarm.swarm import Members, Swarm


def choose_ids(controller: int, count: int, first: int = 0) -> tuple[int, ...]:
    """Return ids for ``count`` neighbours: the lowest from ``first`` on, without the controller's.

    Raises UsageError if ``count`` is not 1 or more, ``first`` is not 0 to 125, or the ids up to 125 do not
    suffice.
    """
    if not 0 <= first < MAX_ROBOTS_AND_TOOLS:
        raise UsageError(f"first-id is {first}; it must be 0 to {MAX_ROBOTS_AND_TOOLS - 1}")
    free_ids = tuple(robot for robot in range(first, MAX_ROBOTS_AND_TOOLS) if robot != controller)
    if not 1 <= count <= len(free_ids):
        raise UsageError(
            f"robots is {count + 1}; from id {first} on there is room for 2 to {len(free_ids) + 1}, with the "
            f"controller, {controller}, and without the ids that Cyphal keeps for tools"
        )
    return free_ids[:count]


@dataclass(frozen=True)
class RadioSettings:
    """Surroundings of a controller, whose id differs from those of its neighbours.

    Attributes:
        controller: Initial state of the controller.
        neighbours: Initial states of the robots to emulate.
        swarm: Their world, which counts all robots; its settings of robots, frames and faults are ignored.
        subjects: Formats of the frames.
        faults: Faults between the robots, in the order in which they act.
    """

    controller: RobotSetup
    neighbours: tuple[RobotSetup, ...]
    swarm: SwarmSettings
    subjects: Subjects
    faults: tuple[Fault, ...] = ()


class Neighbourhood:
    """Emulated robots around a controller.

    The controller takes its part of a tick between ``begin_tick`` and ``finish_tick``.

    Attributes:
        settings: The surroundings of the controller.
        nodes: The neighbours by id, crashed ones included.
        faults: The faults between the robots.
    """

    def __init__(self, settings: RadioSettings) -> None:
        """Make the neighbours, in a swarm to which the controller belongs as a robot from outside.

        The faults between them are those of ``settings`` alone: the swarm's own parameter is left out.
        """
        self.settings = settings
        robots = [settings.controller, *settings.neighbours]
        self._swarm = Swarm(
            replace(settings.swarm, frames=settings.subjects.estimates, faults=(), clock="lockstep"),
            Wiring(),
            members=Members(robots, settings.faults, external_robot=settings.controller.id),
        )
        self.nodes: dict[int, BusRobot] = {node.id: node for node in self._swarm.nodes}
        self.faults: Faults = self._swarm.faults

    @property
    def tick(self) -> int:
        """Number of the tick that has begun or, between ticks, of the next one; the first is 0."""
        return self._swarm.ticks

    def begin_tick(self) -> Observation | None:
        """Let all neighbours observe and send, and return the observation of the controller, or None."""
        observation_by_robot = self._swarm.begin_tick()
        return observation_by_robot[self.settings.controller.id]

    def finish_tick(self, controller_frames: Sequence[can.Message]) -> list[can.Message]:
        """Let all neighbours receive and settle, with the frames that the controller has sent.

        Returns the frames that the controller receives, in order. O(neighbours**2).
        """
        return self._swarm.finish_tick(controller_frames)
