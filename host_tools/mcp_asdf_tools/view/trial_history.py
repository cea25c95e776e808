"""The history of a trial of an experiment, which is run again, as results hold no states."""

from __future__ import annotations

import numpy as np

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.view.history import History, steps_between_states
from mcp_asdf_tools.view.run_description import describe_run
from mcp_asdf_tools.view.run_states import add_world

_MAX_TRIAL_ROBOT_STEPS = 200_000_000
"""Robots times steps of a trial that is run again: its estimates take 800 MB."""


def recompute_trial_history(trials: Trials, trial: int) -> History:
    """Run one trial of an experiment again, and return its history, which has ended.

    ``trial`` is the trial's number, one of ``trials.numbers``. Raises UsageError if there is no such trial,
    if it is too long, or if its errors differ from those in ``trials``.
    """
    experiment = trials.experiment
    if trial not in trials.numbers:
        numbers = f"{trials.numbers[0]} to {trials.numbers[-1]}"
        raise UsageError(f"there is no trial {trial}; choose one of {numbers}")
    if experiment.robots * experiment.steps > _MAX_TRIAL_ROBOT_STEPS:
        raise UsageError(
            f"a trial of {experiment.robots} robots and {experiment.steps} steps is too long to be run "
            f"again, which view has to do; take one of at most {_MAX_TRIAL_ROBOT_STEPS // experiment.robots} "
            "steps"
        )
    spacing = steps_between_states(experiment.steps, experiment.robots)
    rerun_trials = run_trials(experiment, first=trial, trials=1, sampling_interval=spacing)
    # The results hold no states. Equal errors are the evidence that this run has the states of the first.
    recorded_errors = trials.errors[trials.numbers.index(trial)]
    if not np.array_equal(rerun_trials.errors[0], recorded_errors):
        raise UsageError(
            f"trial {trial} does not come out again as in the results, which another version or extension "
            "made: run mcp-asdf simulate again"
        )
    series = [rerun_trials.records[name][0] for name in ("x", "x_hat", "b_hat")]
    estimates = np.stack(series, axis=1)
    return History(describe_run(experiment, trial), add_world(experiment, trial, estimates, spacing))
