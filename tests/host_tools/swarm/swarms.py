"""Short runs of swarms on any bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can
from can.interfaces import virtual

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.recording.events import EventsHeader, EventsWriter
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.carrier import Wiring
from mcp_asdf_tools.swarm.run import SwarmHook, SwarmRun, run_swarm
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from messages import IdentifierAndData, identifier_and_data


def one_bus(robot: int = 0) -> can.BusABC:
    """Join a virtual bus, the same for all robots."""
    return virtual.VirtualBus("one", receive_own_messages=True, preserve_timestamps=True)


def own_bus(robot: int) -> can.BusABC:
    """Join the virtual bus of a robot."""
    return virtual.VirtualBus(f"of {robot}", preserve_timestamps=True)


ON_ONE_BUS, ON_OWN_BUSES = Wiring(one_bus), Wiring(own_bus, is_shared=False)

MIXED_FAULTS = (
    *("loss=0.1", "corrupt=0.1,bits=2", "delay=0.2,ticks=3", "duplicate=0.2,ticks=1", "babble=0.1,frames=3"),
    *("crash=0.01,ticks=6", "crash=0.01,ticks=4,rejoin=restored", "busoff=0.01,ticks=3"),
    *("freeze=0.05", "liar=0.05,x=1,alpha=1e5", "collide=0.05,id=2", "sybil=0.05,ids=1+9,alpha=0"),
)
"""A fault of every kind that a swarm may have, at rates at which each occurs in a short run."""


def small_swarm(*faults: str, **changes: Any) -> SwarmSettings:
    """Return settings of five robots and 60 ticks, three filter periods, with these faults.

    The first two robots are flawed: they assume a wrong accuracy of their sensor.
    """
    plain: dict[str, Any] = {"robots": 5, "flawed": 0.4, "filter": "asdf-plus", "steps": 60}
    plain |= {"filter_period": 20, "seed": 11}
    return SwarmSettings(**(plain | changes), faults=faults)


def run_and_record(
    settings: SwarmSettings,
    wiring: Wiring = ON_ONE_BUS,
    hooks: Sequence[SwarmHook] = (),
    events: list[str] | None = None,
) -> tuple[SwarmRun, list[can.Message]]:
    """Run a swarm that nothing may end early, and return the run and the frames that were sent.

    ``hooks`` are called after each tick, and ``events`` gets the lines of the file of events.
    """
    frames: list[can.Message] = []
    header = EventsHeader(settings.robot_setups(), settings.seed, settings.frames)
    lines = [] if events is None else events
    lines.append(header.to_line())
    writer = EventsWriter(header, lines.append)
    with Swarm(settings, wiring, frames.append, writer) as swarm:
        run = run_swarm(swarm, hooks)
    writer.finish()
    assert run.failure is None
    return run, frames


def identifiers_and_data(frames: Sequence[can.Message]) -> list[IdentifierAndData]:
    """Return the identifier and the data of each frame, but not its time and its channel."""
    return [identifier_and_data(frame) for frame in frames]


def saved_robots(nodes: Sequence[BusRobot]) -> list[bytes]:
    """Return the saved state of each robot, which is all that its firmware holds."""
    return [node.robot.save() for node in nodes if isinstance(node.robot, FixedPointRobot)]
