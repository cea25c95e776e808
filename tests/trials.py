"""Checks on trials that several test files make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from host_tools.experiments import Experiment
from host_tools.simulation import run_trials


def check_that_the_engine_is_the_mirror(experiment: Experiment) -> None:
    """Two trials by the C engine have every result and record of those run message by message in Python."""
    own = run_trials(experiment, 1, 2, thinning=7)
    other = run_trials(replace(experiment, firmware="mirror"), 1, 2, thinning=7)
    for name in ("settled", "errors", "b_hat", "tests", "updates", "records"):
        assert np.array_equal(getattr(own, name), getattr(other, name)), name
