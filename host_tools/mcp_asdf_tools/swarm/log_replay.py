"""Values of a swarm's robots over time, computed again from the events beside its log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcp_asdf.robot import Robot
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, events_path
from mcp_asdf_tools.recording.replay import rerun
from mcp_asdf_tools.robots.robot_setup import format_ids
from mcp_asdf_tools.swarm.settings import SwarmSettings


def read_swarm_settings(log: Path, header: EventsHeader) -> SwarmSettings:
    """Return the settings of the swarm that wrote a log; a parameter that the header lacks has its default.

    Raises UsageError for the log of a node or a controller, for settings that are impossible, and unless the
    robots of the log have the ids 0, 1, 2 and so on, as many as the settings say.
    """
    is_of_swarm = "flawed" in header.parameters  # all versions of swarm write it, and no other command does
    if not is_of_swarm:
        raise UsageError(
            f"{log} is not the log of a swarm; give one of mcp-asdf swarm, or check it with mcp-asdf replay"
        )
    try:
        settings = SwarmSettings.from_recording(header.parameters)
    except UsageError as error:
        raise UsageError(f"the first line of {events_path(log)} is damaged: {error}") from error
    ids = [setup.id for setup in header.robots]
    if ids != list(range(settings.robots)):
        raise UsageError(
            f"the first line of {events_path(log)} is damaged: it is of {settings.robots} robots, but "
            f"lists {len(ids)}, {format_ids(frozenset(ids)) or 'none'}; the ids must be 0, 1, 2 and so on"
        )
    return settings


def collect_values(robots: Iterable[Robot], quantities: Sequence[str]) -> NDArray[np.float64]:
    """Return the present values of robots, shape (quantities, N); quantities are attributes of ``Robot``."""
    rows_by_robot = [_values_of(robot, quantities) for robot in robots]
    return np.array(rows_by_robot).T


def replay_values(
    events: EventsReader, max_ticks: int, quantities: Sequence[str], spacing: int = 1
) -> Iterator[NDArray[np.float64]]:
    """Replay a swarm's events; yield all robots' values, shape (quantities, N), every ``spacing`` ticks.

    The values before the first tick come first. A robot that was dead in a tick, and so did not end it, has
    NaN there. Raises UsageError if the events cannot be read, contradict each other, or go on after
    ``max_ticks``.
    """
    setups = events.header.robots
    yield collect_values((setup.make_robot() for setup in setups), quantities)
    unknown_values = [np.nan] * len(quantities)
    for tick, values_by_robot in enumerate(_replay_ticks(events, max_ticks, quantities), start=1):
        if tick % spacing == 0:
            rows_by_robot = [values_by_robot.get(setup.id, unknown_values) for setup in setups]
            # Transposed, so that a row has the values of a quantity.
            yield np.array(rows_by_robot).T


def _replay_ticks(
    events: EventsReader, max_ticks: int, quantities: Sequence[str]
) -> Iterator[dict[int, list[float]]]:
    """Replay a swarm's events; for each tick yield, by id, the values of the robots that ended (settled) it.

    The values of a robot are in the order of ``quantities``. Raises UsageError if the events cannot be read,
    contradict each other, or go on after ``max_ticks``.
    """
    tick = 1
    values_by_robot: dict[int, list[float]] = {}
    for robot_id, robot in rerun(events):
        # Events have no ticks. But a living robot settles once in each, so the first one that settles again
        # begins the next tick.
        if robot_id in values_by_robot:
            yield values_by_robot
            values_by_robot = {}
            tick += 1
            if tick > max_ticks:
                raise events.error_in_line(f"the run goes on after the {max_ticks} steps of the first line")
        values_by_robot[robot_id] = _values_of(robot, quantities)
    if values_by_robot:
        yield values_by_robot


def _values_of(robot: Robot, quantities: Sequence[str]) -> list[float]:
    """Return the present values of a robot, in the order of ``quantities``, which are attributes of it."""
    return [float(getattr(robot, name)) for name in quantities]
