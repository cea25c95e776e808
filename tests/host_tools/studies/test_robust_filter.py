"""The study of the robust filter, whose numbers another simulator computed, beside trials of the engine."""

from __future__ import annotations

import numpy as np
import pytest

import mcp_asdf_tools as m
from benchmarks.robust_judge.__main__ import read_rows
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies.study_program import MOVING_SWARM, PARAMETERS_BY_FLAW, late_errors
from support import ROOT


def error_in_study(flaw: str, filter_name: str) -> float:
    """Return the late error that docs/robust_study.csv has for 30 % flawed robots in moving swarms."""
    [row] = [
        row
        for row in read_rows(ROOT / "docs/robust_study.csv")
        if (row["case"], row["flaw"], row["filter"]) == ("moving, .3 flawed", flaw, filter_name)
    ]
    return float(row["error"])


@pytest.mark.slow
@pytest.mark.parametrize("flaw", ["underconfident", "overconfident"])
@pytest.mark.parametrize("filter_name", ["none", "asdf-minus", "robust"])
def test_ten_trials_of_another_seed_give_about_the_errors_of_the_study_of_the_robust_filter(
    flaw: str, filter_name: str
) -> None:
    """The study has medians over 40 trials of moving swarms with 30 % flawed robots."""
    swarm = {**MOVING_SWARM, **PARAMETERS_BY_FLAW[flaw], "robots": 20, "flawed": 6}
    (experiment,) = m.grid(**swarm, filter=filter_name, steps=40_000, trials=10, seed=5)
    trials = run_trials(experiment, first=0, trials=10, sampling_interval=1000)

    median_error = float(np.median(late_errors(trials)))

    # The median of so few trials may be half as large again, or half as large.
    assert median_error == pytest.approx(error_in_study(flaw, filter_name), rel=0.5)
