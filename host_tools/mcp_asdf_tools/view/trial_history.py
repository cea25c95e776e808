"""The history of a trial of an experiment, which is run again, as results hold no complete states.

A trial that another program has run cannot be run again here. Of it, the page shows what is recorded.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.history import NO_LINKS, History, RunDescription, State, steps_between_states
from mcp_asdf_tools.view.run_description import describe_population, describe_run
from mcp_asdf_tools.view.run_states import ESTIMATES, complete_states

_MAX_TRIAL_ROBOT_STEPS = 200_000_000
"""Robots times steps of a trial that is run again: its estimates take 800 MB."""


def recompute_trial_history(trials: Trials, trial: int) -> History:
    """Run one trial of an experiment again, and return its history, which has ended.

    ``trial`` is the trial's number, one of ``trials.numbers``. Raises UsageError if there is no such trial,
    if it is too long, or if its errors differ from those in ``trials``.
    """
    experiment = trials.experiment
    recorded_errors = trials.errors[trials.index_of(trial)]
    if experiment.robots * experiment.steps > _MAX_TRIAL_ROBOT_STEPS:
        raise UsageError(
            f"a trial of {experiment.robots} robots and {experiment.steps} steps is too long to be run "
            f"again, which view has to do; take one of at most {_MAX_TRIAL_ROBOT_STEPS // experiment.robots} "
            "steps"
        )
    spacing = steps_between_states(experiment.steps, experiment.robots)
    rerun_trials = run_trials(experiment, first=trial, trials=1, sampling_interval=spacing)
    # The results hold no states. Equal errors are the evidence that this run has the states of the first.
    (rerun_errors,) = rerun_trials.errors  # of the only trial
    if not np.array_equal(rerun_errors, recorded_errors):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    estimates = _recorded_estimates(rerun_trials, trial)
    return History(describe_run(experiment, trial), complete_states(experiment, trial, estimates, spacing))


def recorded_trial_history(trials: Trials, trial: int) -> History:
    """Return the history of a trial that another program has run, as far as it is recorded.

    It has the robots' values, but neither places nor neighbours. ``trial`` is the trial's number, one of
    ``trials.numbers``. Raises UsageError if there is no such trial, or if nothing is recorded.
    """
    experiment = trials.experiment
    if not trials.records:
        raise UsageError(
            f"nothing is recorded of the trials of {trials.source}; run mcp-asdf convert again, without "
            "--record 0"
        )
    estimates = _recorded_estimates(trials, trial)
    true_accuracies = np.full(experiment.robots, experiment.true_accuracy)
    # A page should have at most one state every ``spacing`` steps, so only every ``stride``-th recorded one
    # is taken.
    spacing = steps_between_states(experiment.steps, experiment.robots)
    stride = math.ceil(spacing / trials.sampling_interval)
    states = [
        State(
            tick=sample * trials.sampling_interval,
            values=np.vstack([estimates[sample], true_accuracies]),
            links=NO_LINKS,
            positions=None,
        )
        for sample in range(0, len(estimates), stride)
    ]
    return History(_describe_recorded_trial(trials, trial), states)


def _describe_recorded_trial(trials: Trials, trial: int) -> RunDescription:
    """Return the description of a trial that another program has run: it has neither a floor nor an arena."""
    experiment = trials.experiment
    filter_term = experiment.swarm_filter.typeset_term
    swarm_term = f"{experiment.robots} robots, {experiment.flawed} flawed, {filter_term}"
    return describe_population(experiment, f"{swarm_term}, trial {trial} of {trials.source}")


def _recorded_estimates(trials: Trials, trial: int) -> NDArray[np.float64]:
    """Return the recorded ESTIMATES of the robots in a trial, by its number; shape (recorded steps, 3, N).

    Raises UsageError if there is no such trial.
    """
    index = trials.index_of(trial)
    # Arrays of shape (recorded steps, N), which are stacked along a new axis between the two
    values_by_name = [trials.records[name][index] for name in ESTIMATES]
    return np.stack(values_by_name, axis=1)
