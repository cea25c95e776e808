"""Trials that tests of several files run."""

from __future__ import annotations

from typing import cast

import pytest

from mcp_asdf.robot import FixedPointRobot
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.results import Trials
from mcp_asdf_tools.experiments.trials import Job, MessageSwarm


def images_by_message(experiment: Experiment, trial: int) -> list[bytes]:
    """Return the robots' states at the end of a trial that is run message by message."""
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
