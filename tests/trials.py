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
    """Two trials by the C engine have every result and record of those run message by message in Python, and
    leave the robots in the same states."""
    mirrored = replace(experiment, firmware="mirror")
    own, other = (run_trials(each, 1, 2, sampling_interval=7) for each in (experiment, mirrored))
    for name in ("convergence_steps", "errors", "b_hat", "tests", "updates", "sampling_interval"):
        assert np.array_equal(getattr(own, name), getattr(other, name)), name
    for name, values in own.records.items():
        assert np.array_equal(values, other.records[name]), name
    assert native.run(experiment, 1, 1).images() == images_by_message(mirrored, 1)


def images_by_message(experiment: Experiment, trial: int) -> list[bytes]:
    """The robots' states at the end of a trial that is run message by message."""
    swarm = MessageSwarm(experiment, trial)
    assert max(swarm.steps()) == experiment.steps
    return [cast(FixedPointRobot, robot).save() for robot in swarm.robots]


def noted_jobs(monkeypatch: pytest.MonkeyPatch, most: int = 10**9) -> list[Job]:
    """The jobs that this process runs from now on, as they start; one more than ``most`` ends in Ctrl-C."""
    started: list[Job] = []
    run = Job.run

    def noted(job: Job) -> Trials:
        if len(started) == most:
            raise KeyboardInterrupt
        started.append(job)
        return run(job)

    monkeypatch.setattr(Job, "run", noted)
    return started
