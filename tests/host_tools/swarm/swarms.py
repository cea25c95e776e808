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


def small(*faults: str, **changes: Any) -> SwarmSettings:
    """Settings of a short run with several filter periods, in which these faults strike."""
    plain: dict[str, Any] = {"robots": 5, "flawed": 0.4, "filter": "asdf-plus", "steps": 60}
    plain |= {"filter_period": 20, "seed": 11}
    return SwarmSettings(**(plain | changes), faults=faults)


def record(
    settings: SwarmSettings,
    wiring: Wiring = ON_ONE_BUS,
    hooks: Sequence[SwarmHook] = (),
    events: list[str] | None = None,
) -> tuple[SwarmRun, list[can.Message]]:
    """A run that nothing ended early, and the frames it sent; ``events`` gets the lines of its events."""
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


def content(frames: Sequence[can.Message]) -> list[IdentifierAndData]:
    """Identity of frames, without time and place."""
    return [identifier_and_data(frame) for frame in frames]


def states(nodes: Sequence[BusRobot]) -> list[bytes]:
    """All that the firmwares of robots hold."""
    return [node.robot.save() for node in nodes if isinstance(node.robot, FixedPointRobot)]
