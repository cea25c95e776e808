"""The neighbours of one real controller: a swarm without a bus, in which it is the external robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.fault_injection.fault import Fault
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


def create_neighbours(settings: RadioSettings) -> Swarm:
    """Return the neighbours, in a swarm to which the controller belongs as a robot from outside.

    In each tick ``begin_tick`` returns the observations of all robots, the controller's among them, and
    ``finish_tick`` takes the frames that the controller has sent, and returns those that it is to receive.
    The faults are those of ``settings`` alone: the swarm's own parameter is left out.
    """
    return Swarm(
        replace(settings.swarm, frames=settings.subjects.estimates, faults=(), clock="lockstep"),
        Wiring(),
        members=Members(
            [settings.controller, *settings.neighbours],
            settings.faults,
            external_robot=settings.controller.id,
        ),
    )
