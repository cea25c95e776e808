"""The neighbours of one real controller: an emulated swarm in which one robot is not emulated.

``Neighbourhood`` needs no bus: it takes the controller's frames and returns those that the controller hears,
from neighbours in range and after the faults.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import MAX_ID, Observation
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.node import Subjects
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.swarm.delivery import Delivery, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault
from mcp_asdf_tools.swarm.faults import Faults
from mcp_asdf_tools.swarm.settings import MAX_ROBOTS_AND_TOOLS, SwarmSettings
from mcp_asdf_tools.world.world import SteppedWorld


def choose_ids(controller: int, count: int, first: int = 0) -> tuple[int, ...]:
    """Ids for ``count`` neighbours: from ``first`` on, without the controller's.

    Raises UsageError if ``count`` is not 1 or more, or the ids up to 125 are too few.
    """
    ids = tuple(robot for robot in range(first, MAX_ROBOTS_AND_TOOLS) if robot != controller)
    if not 0 <= first < MAX_ROBOTS_AND_TOOLS:
        raise UsageError(f"first-id is {first}; it must be 0 to {MAX_ROBOTS_AND_TOOLS - 1}")
    if not 1 <= count <= len(ids):
        raise UsageError(
            f"robots is {count + 1}; from id {first} on there is room for 2 to {len(ids) + 1}, with the "
            f"controller, {controller}, and without the ids that Cyphal keeps for tools"
        )
    return ids[:count]


@dataclass(frozen=True)
class RadioSettings:
    """Surroundings of the controller, whose ids differ.

    Attributes:
        controller: Initial state of the robot on the bus.
        neighbours: Initial states of those to emulate.
        swarm: Their world, which counts all robots. Settings of robots and frames are ignored.
        subjects: Formats of the messages.
        faults: Faults between them, in the order in which they act.
    """

    controller: RobotRecord
    neighbours: tuple[RobotRecord, ...]
    swarm: SwarmSettings
    subjects: Subjects
    faults: tuple[Fault, ...] = ()


class Neighbourhood:
    """Emulated robots around a controller. A tick is ``begin``, the controller's part, ``finish``.

    Attributes:
        settings: Its parameters.
        nodes: The neighbours by id, crashed ones included.
        faults: The faults between robots.
        tick: Number of the tick that is open or, between ticks, of the next.
    """

    def __init__(self, settings: RadioSettings) -> None:
        self.settings = settings
        self.nodes = {each.id: BusRobot(each, settings.subjects.estimates) for each in settings.neighbours}
        self.faults = Faults(settings.faults, settings.swarm.seed, settings.subjects.estimates)
        self.tick = 0
        self._steps_per_second = settings.swarm.steps_per_second
        self._ids = sorted([settings.controller.id, *self.nodes])
        self._world = SteppedWorld(settings.swarm)
        self._delivery = Delivery(self._hears, self.faults.paths, settings.swarm.latency)
        self._sent: list[SentFrame] = []

    def _hears(self) -> NDArray[np.bool_]:
        """True if robot i hears j, by id; the world's are 0, 1, 2 ..."""
        hears = np.zeros((MAX_ID + 1, MAX_ID + 1), np.bool_)
        hears[np.ix_(self._ids, self._ids)] = self._world.current_neighbours
        return hears

    def begin(self) -> Observation | None:
        """Let all neighbours observe; returns the observation of the controller. O(neighbours)."""
        seen = dict(zip(self._ids, self._world.step(), strict=True))
        alive = [node for node in self.nodes.values() if self.faults.survives(node, self.tick)]
        frames = [(node.id, frame) for node in alive for frame in self._frames_of(node, seen[node.id])]
        early, late = (self._babble(is_early) for is_early in (True, False))
        self._sent = [
            each
            for robot, frame in [*early, *frames, *late]
            for each in self.faults.leave(frame, robot, self.tick)
        ]
        return seen[self.settings.controller.id]

    def _babble(self, is_early: bool) -> list[tuple[int, can.Message]]:
        now = self.tick / self._steps_per_second
        return [
            (robot, frame)
            for robot in self.nodes
            for frame in self.faults.babble(robot, self.tick, now, is_early)
        ]

    def finish(self, sent: Sequence[can.Message]) -> list[can.Message]:
        """Take the frames that the controller has ``sent``, and let all neighbours hear and settle.

        Returns the frames that the controller hears, in order. O(neighbours**2).
        """
        controller = self.settings.controller.id
        frames = [*self._sent, *(SentFrame(frame, controller, self.tick, n) for n, frame in enumerate(sent))]
        arrivals = self._delivery.arrivals(self.tick, frames)
        for robot, node in self.nodes.items():
            node.listen(arrivals.of(robot))
            node.end()  # one that is dead has no tick open
        self.tick += 1
        return arrivals.of(controller)

    def _frames_of(self, node: BusRobot, z: Observation | None) -> list[can.Message]:
        now = node.ticks / self._steps_per_second
        heartbeats = [node.heartbeat(now)] if node.is_heartbeat_due(self._steps_per_second) else []
        return heartbeats + node.broadcast(z, now)
