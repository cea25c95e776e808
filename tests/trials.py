"""Checks on trials that several test files make."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.experiments.engine import native
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import Job, MessageSwarm, run_trials


def check_that_the_engine_is_the_mirror(experiment: Experiment) -> None:
    """Check that the C engine and Python, message by message, agree on trial 1 of an experiment.

    All results, all records and the final states of the robots must be equal to the bit.
    """
    mirrored = replace(experiment, firmware="mirror")
    engine_trials = run_trials(experiment, first=1, trials=1, sampling_interval=7)
    mirror_trials = run_trials(mirrored, first=1, trials=1, sampling_interval=7)
    for name in ("convergence_steps", "errors", "b_hat", "tests", "updates", "sampling_interval"):
        assert np.array_equal(getattr(engine_trials, name), getattr(mirror_trials, name)), name
    for name, values in engine_trials.records.items():
        assert np.array_equal(values, mirror_trials.records[name]), name
    assert native.run(experiment, 1, 1).images() == images_by_message(mirrored, 1)


def images_by_message(experiment: Experiment, trial: int) -> list[bytes]:
    """The robots' states at the end of a trial that is run message by message."""
    swarm = MessageSwarm(experiment, trial)
    assert max(swarm.steps()) == experiment.steps
    return [cast(FixedPointRobot, robot).save() for robot in swarm.robots]


def record_jobs(monkeypatch: pytest.MonkeyPatch, max_jobs: int = 10**9) -> list[Job]:
    """Return a list to which each job that this process starts from now on is added.

    Once the list has ``max_jobs``, Ctrl-C interrupts the next job before it starts.
    """
    started_jobs: list[Job] = []
    run = Job.run

    def record_and_run(job: Job) -> Trials:
        if len(started_jobs) == max_jobs:
            raise KeyboardInterrupt
        started_jobs.append(job)
        return run(job)

    monkeypatch.setattr(Job, "run", record_and_run)
    return started_jobs
