"""The history of a swarm's log, which is replayed from the events beside it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.events import EventsHeader, EventsReader, events_path
from mcp_asdf_tools.recording.replay import rerun
from mcp_asdf_tools.robots.robot_setup import format_ids
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.view.history import History, steps_between_states
from mcp_asdf_tools.view.run_description import describe_run
from mcp_asdf_tools.view.run_states import add_world, collect_estimates


def recompute_swarm_history(log: Path) -> History:
    """Compute the run of a swarm again from the events beside its log, and return the history of that run.

    The history is marked as that of a run that is over. Raises UsageError if the events cannot be read,
    contradict themselves, or are not of a swarm.
    """
    with EventsReader(events_path(log)) as events:
        settings = _read_swarm_settings(log, events.header)
        spacing = steps_between_states(settings.steps, settings.robots)
        estimates = np.stack(list(_replay_estimates(events, settings.steps, spacing)))
    # A swarm's run is trial 0 of its world. `add_world` adds accuracies, neighbours and positions, which are
    # not recorded, to the estimates of shape (states, 3, N).
    description = describe_run(settings, trial=0, faults=settings.faults, allow=settings.allow)
    return History(description, add_world(settings, 0, estimates, spacing))


def _read_swarm_settings(log: Path, header: EventsHeader) -> SwarmSettings:
    """Return the settings of the swarm that wrote a log; a parameter that the header lacks has its default.

    Raises UsageError for the log of a node or a controller, and for settings that contradict its robots.
    """
    # Every version of swarm has written this parameter, and no other command does.
    if "flawed" not in header.parameters:
        raise UsageError(f"{log} is not of a swarm, so there is nothing to see; mcp-asdf replay checks it")
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


def _replay_estimates(events: EventsReader, max_ticks: int, spacing: int) -> Iterator[NDArray[np.float64]]:
    """Replay a swarm's events; yield x, x_hat and b_hat of all robots, shape (3, N), every ``spacing`` ticks.

    The first is their start. A robot that did not settle in a tick, since it was dead, has NaN there. Raises
    UsageError if the events go on after ``max_ticks``, and as ``rerun``.
    """
    setups = events.header.robots
    yield collect_estimates(setup.make_robot() for setup in setups)
    unknown_estimates = (np.nan, np.nan, np.nan)
    for tick, estimates_by_robot in enumerate(_replay_ticks(events, max_ticks), start=1):
        if tick % spacing == 0:
            rows = [estimates_by_robot.get(setup.id, unknown_estimates) for setup in setups]
            yield np.array(rows).T


def _replay_ticks(events: EventsReader, max_ticks: int) -> Iterator[dict[int, tuple[float, float, float]]]:
    """Replay a swarm's events; yield x, x_hat and b_hat of the robots that settled in each tick, by id.

    Raises UsageError if the events go on after ``max_ticks``, and as ``rerun``.
    """
    tick = 1
    estimates_by_robot: dict[int, tuple[float, float, float]] = {}
    for robot_id, robot in rerun(events):
        # Events have no ticks. But a living robot settles once in each, so the first one that settles again
        # begins the next tick.
        if robot_id in estimates_by_robot:
            yield estimates_by_robot
            estimates_by_robot = {}
            tick += 1
            if tick > max_ticks:
                raise events.error(f"the run goes on after the {max_ticks} steps of the first line")
        estimates_by_robot[robot_id] = (robot.x, robot.x_hat, robot.b_hat)
    if estimates_by_robot:
        yield estimates_by_robot
