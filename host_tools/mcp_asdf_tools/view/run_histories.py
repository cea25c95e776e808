"""Histories of emulated runs: of a swarm as it runs, and of recordings.

A recording holds no positions, links or true accuracies. They follow from its parameters, and are computed
again. Results hold no complete states either, so a trial is run again, unless another program has run it: of
such a trial the page shows what is recorded.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.recording.events import EventsReader, events_path
from mcp_asdf_tools.swarm.log_replay import collect_values, read_swarm_settings, replay_values
from mcp_asdf_tools.swarm.settings import SwarmSettings
from mcp_asdf_tools.swarm.swarm import Swarm
from mcp_asdf_tools.view.history import (
    NO_LINKS,
    History,
    RunDescription,
    State,
    find_links,
    steps_between_states,
)
from mcp_asdf_tools.view.run_description import describe_population, describe_swarm, describe_trial
from mcp_asdf_tools.world.settings import WorldSettings
from mcp_asdf_tools.world.world import Scene, World

_ESTIMATES = ("x", "x_hat", "b_hat")
"""What a state has of each robot besides its true accuracy, as attributes of ``Robot``."""
_MAX_TRIAL_ROBOT_STEPS = 200_000_000
"""Robots times steps of a trial that is run again: its estimates take 800 MB."""

# --- A swarm as it runs ----------------------------------------------------------------------------------


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
        self.history = History(describe_swarm(settings))
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
    estimates = collect_values((node.robot for node in swarm.nodes), _ESTIMATES)
    is_robot_dead = [not node.is_alive for node in swarm.nodes]
    estimates[:, is_robot_dead] = np.nan
    # The last row is the true accuracy of each robot's sensor.
    values = np.vstack([estimates, world.accuracy])
    return State(swarm.ticks, values, find_links(world.current_neighbours), world.positions)


# --- Logs and trials that are computed again -------------------------------------------------------------


def recompute_swarm_history(log: Path) -> History:
    """Compute the run of a swarm again from the events beside its log, and return the history of that run.

    The history is marked as that of a run that is over. Raises UsageError if the events cannot be read,
    contradict themselves, or are not of a swarm.
    """
    with EventsReader(events_path(log)) as events:
        settings = read_swarm_settings(log, events.header)
        spacing = steps_between_states(settings.steps, settings.robots)
        estimates_by_state = list(replay_values(events, settings.steps, _ESTIMATES, spacing))
    # A swarm's run is trial 0 of its world.
    states = _complete_states(settings, 0, estimates_by_state, spacing)
    return History(describe_swarm(settings), states)


def recompute_trial_history(trials: Trials, trial: int) -> History:
    """Run one trial of an experiment again, and return its history, which has ended.

    ``trial`` is the trial's number, one of ``trials.numbers``. Raises UsageError if there is no such trial,
    if it is too long, or if its errors differ from those in ``trials``.
    """
    recorded_errors = trials.errors[trials.index_of(trial)]
    rerun_trials = _run_with_records(trials.experiment, trial)
    # The results hold no states. Equal errors are the evidence that this run has the states of the first.
    (rerun_errors,) = rerun_trials.errors  # of the only trial
    if not np.array_equal(rerun_errors, recorded_errors):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    return _complete_history(rerun_trials)


def run_trial_history(experiment: Experiment, trial: int) -> History:
    """Run one trial of an experiment, by its number, and return its history, which has ended.

    Raises UsageError if the trial is too long.
    """
    return _complete_history(_run_with_records(experiment, trial))


def _run_with_records(experiment: Experiment, trial: int) -> Trials:
    """Run one trial, by its number, and record the robots in those steps of which a history has states.

    Raises UsageError if the trial is too long.
    """
    if experiment.robots * experiment.steps > _MAX_TRIAL_ROBOT_STEPS:
        raise UsageError(
            f"a trial of {experiment.robots} robots and {experiment.steps} steps is too long to be run for "
            f"a view; take one of at most {_MAX_TRIAL_ROBOT_STEPS // experiment.robots} steps"
        )
    spacing = steps_between_states(experiment.steps, experiment.robots)
    return run_trials(experiment, first=trial, trials=1, sampling_interval=spacing)


def _complete_history(trials: Trials) -> History:
    """Return the history of the only trial in ``trials``, which ``_run_with_records`` has run."""
    [trial] = trials.numbers
    estimates = _recorded_estimates(trials, trial)
    states = _complete_states(trials.experiment, trial, estimates, trials.sampling_interval)
    return History(describe_trial(trials.experiment, trial), states)


def _complete_states(
    settings: WorldSettings, trial: int, estimates_by_state: Iterable[NDArray[np.float64]], spacing: int
) -> Iterator[State]:
    """Yield the states of a run, of which only the robots' estimates are known.

    ``estimates_by_state`` has x, x_hat and b_hat at ticks 0, ``spacing`` and so on, with the shape (3, N) at
    each tick. True accuracies, links and positions are computed by running the world of the trial again.
    """
    world = World(settings, trial)
    # The world has no scene before its first step, so the state at tick 0 shows that of tick 1.
    scene = world.advance(1)
    steps_done = 1
    for index, estimates in enumerate(estimates_by_state):
        tick = index * spacing
        if tick > steps_done:
            scene = _scene_after(world, tick - steps_done)
            steps_done = tick
        # The arrays of the scene have an entry for each of its steps, and it is of one step alone.
        true_accuracies = scene.accuracy[0]
        links = find_links(scene.neighbours[0])
        positions = None if scene.positions is None else scene.positions[0]
        yield State(tick, np.vstack([estimates, true_accuracies]), links, positions)


def _scene_after(world: World, steps: int) -> Scene:
    """Let ``steps`` steps of a world pass, at least one, and return the Scene of the last one alone."""
    # To skip steps is faster than to compute their scenes.
    steps_to_skip = steps - 1
    if steps_to_skip > 0:
        world.skip(steps_to_skip)
    return world.advance(1)


# --- Trials of another program ---------------------------------------------------------------------------


def recorded_trial_history(trials: Trials, trial: int) -> History:
    """Return the history of a trial that another program has run, as far as it is recorded.

    It has the robots' values, but neither places nor neighbours. ``trial`` is the trial's number, one of
    ``trials.numbers``. Raises UsageError if there is no such trial, or if nothing is recorded.
    """
    if not trials.records:
        raise UsageError(
            f"nothing is recorded of the trials of {trials.source}; run mcp-asdf convert again, without "
            "--record 0"
        )
    return History(_describe_recorded_trial(trials, trial), _recorded_states(trials, trial))


def _recorded_states(trials: Trials, trial: int) -> Iterator[State]:
    """Yield the recorded states of a trial. If they are too many for a page, yield some at equal distances.

    The true accuracy of all sensors is a parameter of the experiment. Raises UsageError if there is no such
    trial.
    """
    experiment = trials.experiment
    true_accuracies = np.full(experiment.robots, experiment.true_accuracy)
    least_spacing = steps_between_states(experiment.steps, experiment.robots)
    # Only samples that were recorded can be shown, so the spacing is a multiple of their interval.
    samples_between_states = math.ceil(least_spacing / trials.sampling_interval)
    ticks_between_states = samples_between_states * trials.sampling_interval
    estimates_by_state = _recorded_estimates(trials, trial)[::samples_between_states]
    for index, estimates in enumerate(estimates_by_state):
        values = np.vstack([estimates, true_accuracies])
        yield State(index * ticks_between_states, values, NO_LINKS, positions=None)


def _describe_recorded_trial(trials: Trials, trial: int) -> RunDescription:
    """Return the description of a trial that another program has run: it has neither a floor nor an arena."""
    experiment = trials.experiment
    filter_term = experiment.swarm_filter.typeset_term
    swarm_term = f"{experiment.robots} robots, {experiment.flawed} flawed, {filter_term}"
    return describe_population(experiment, f"{swarm_term}, trial {trial} of {trials.source}")


def _recorded_estimates(trials: Trials, trial: int) -> NDArray[np.float64]:
    """Return the recorded _ESTIMATES of the robots in a trial, by its number; shape (recorded steps, 3, N).

    Raises UsageError if there is no such trial.
    """
    index = trials.index_of(trial)
    # Arrays of shape (recorded steps, N), which are stacked along a new axis between the two
    values_by_name = [trials.records[name][index] for name in _ESTIMATES]
    return np.stack(values_by_name, axis=1)
