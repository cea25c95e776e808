"""The history of a swarm's log, which is replayed from the events beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mcp_asdf_tools.recording.events import EventsReader, events_path
from mcp_asdf_tools.swarm.log_replay import read_swarm_settings, replay_values
from mcp_asdf_tools.view.history import History, steps_between_states
from mcp_asdf_tools.view.run_description import describe_run
from mcp_asdf_tools.view.run_states import ESTIMATES, complete_states


def recompute_swarm_history(log: Path) -> History:
    """Compute the run of a swarm again from the events beside its log, and return the history of that run.

    The history is marked as that of a run that is over. Raises UsageError if the events cannot be read,
    contradict themselves, or are not of a swarm.
    """
    with EventsReader(events_path(log)) as events:
        settings = read_swarm_settings(log, events.header)
        spacing = steps_between_states(settings.steps, settings.robots)
        estimates = np.stack(list(replay_values(events, settings.steps, ESTIMATES, spacing)))
    # A swarm's run is trial 0 of its world. The estimates, shape (states, 3, N), are completed by accuracies,
    # neighbours and positions, which are not recorded.
    description = describe_run(settings, trial=0, faults=settings.faults, allow=settings.allow)
    return History(description, complete_states(settings, 0, estimates, spacing))
