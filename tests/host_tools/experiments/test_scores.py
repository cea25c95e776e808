"""K, e and the scores against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import metrics
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.metrics import convergence_step, score
from mcp_asdf_tools.experiments.scores import Limits


def convergence_step_by_definition(series: NDArray[np.float64], delta: float) -> int:
    """Return the least K with abs(x[K] - x[k]) < delta for every k >= K, tried one after the other."""
    for k in range(len(series)):
        if (abs(series[k] - series[k:]) < delta).all():
            return k
    raise AssertionError("the last value does not differ from itself")


@given(
    values=st.lists(st.integers(97, 104), min_size=1, max_size=60),
    values_at_once=st.sampled_from([1, 3, 7, 4096]),
)
def test_the_step_of_convergence_is_the_first_from_which_on_no_value_differs_by_a_threshold(
    values: list[int], values_at_once: int
) -> None:
    """Values are whole, so that differences meet the threshold, 3, exactly. They are integers or floats.

    A long series is searched in chunks; their size is set to ``values_at_once``, so that short ones are, too.
    """
    integers = np.array(values, np.uint32)
    floats = np.array(values, np.float64)
    expected_step = convergence_step_by_definition(floats, delta=3.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrics, "_CHUNK_LENGTH", values_at_once)
        assert convergence_step(integers, delta=3.0) == expected_step
        assert convergence_step(floats, delta=3.0) == expected_step


@pytest.mark.parametrize("series", [[0.5, math.nan, 0.5], [0.5, 0.5, math.nan]])
def test_a_series_with_a_nan_converges_only_in_its_last_step(series: list[float]) -> None:
    """A NaN is near no number, not even a NaN. The last step is step 2, as the first one is step 0."""
    assert convergence_step(np.array(series), delta=0.25) == 2


@pytest.mark.parametrize(
    ("steps_of_robots", "mean", "lower_quartile", "upper_quartile"),
    [
        ([0, 100, 200, 300], 150, 50, 250),  # quartiles in the middle between two steps
        ([0, 100, 200, 300, 500], 220, 100, 300),  # the second and the fourth step
    ],
)
def test_the_score_of_convergence_comes_from_the_mean_and_the_quartiles_of_the_robots_steps(
    steps_of_robots: list[int], mean: float, lower_quartile: float, upper_quartile: float
) -> None:
    """It is 100 (1 - mean / limit) exp(-(upper - lower quartile) / limit). The limit is 1000 steps.

    ``score`` takes lists of trials, and returns a list of scores; here there is one trial.
    """
    errors_of_robots = [0.0] * len(steps_of_robots)
    scores_of_trials = score([steps_of_robots], [errors_of_robots], k_max=1000, e_max=0.5)

    expected_score = 100 * (1 - mean / 1000) * math.exp(-(upper_quartile - lower_quartile) / 1000)
    assert scores_of_trials["h_K"] == pytest.approx([expected_score])


def test_the_score_of_errors_has_a_limit_of_its_own() -> None:
    """The limit is 0.5 here. The mean of the errors is 0.15, and the quartiles are 0.1 and 0.2.

    The score is 100 (1 - mean / limit) exp(-(upper - lower quartile) / limit), like that of convergence.
    """
    steps_of_robots = [0, 0, 0, 0]
    errors_of_robots = [0.1, 0.1, 0.1, 0.3]
    scores_of_trials = score([steps_of_robots], [errors_of_robots], k_max=1000, e_max=0.5)

    expected_score = 100 * (1 - 0.15 / 0.5) * math.exp(-(0.2 - 0.1) / 0.5)
    assert scores_of_trials["h_e"] == pytest.approx([expected_score])


def test_the_score_h_is_the_mean_of_those_for_convergence_and_for_errors() -> None:
    """There is one trial with four robots."""
    steps_of_robots = [0, 100, 200, 300]
    errors_of_robots = [0.1, 0.1, 0.1, 0.3]
    scores_of_trials = score([steps_of_robots], [errors_of_robots], k_max=1000, e_max=0.5)

    [h_k] = scores_of_trials["h_K"]
    [h_e] = scores_of_trials["h_e"]
    assert scores_of_trials["H"] == pytest.approx([(h_k + h_e) / 2])


def test_a_trial_whose_errors_are_nan_has_a_score_of_0_for_errors() -> None:
    scores_of_trials = score(convergence_steps=[[1, 1]], errors=[[math.nan, math.nan]], k_max=10, e_max=0.5)
    assert scores_of_trials["h_e"] == [0]


def test_limits_of_scores_are_the_paper_s_unless_the_user_gives_others() -> None:
    """In figures 4 to 7 of the paper K_max is T, the number of steps, and e_max 0.45 for every fill ratio.

    A user may give one of the two limits, or both. Pairs are K_max and e_max.
    """
    experiment = Experiment(steps=40_000, fill_ratio=0.95)
    assert Limits().of(experiment) == (40_000, 0.45)
    assert Limits(k_max=7).of(experiment) == (7, 0.45)
    assert Limits(e_max=0.3).of(experiment) == (40_000, 0.3)
    assert Limits(k_max=7, e_max=0.3).of(experiment) == (7, 0.3)


@pytest.mark.parametrize("value", [0, -1, math.inf, math.nan])
def test_limits_of_scores_that_are_not_above_0_and_finite_are_refused(value: float) -> None:
    with pytest.raises(UsageError, match=f"K_max is {value}; it must be above 0"):
        Limits(k_max=value)
    with pytest.raises(UsageError, match=f"e_max is {value}; it must be above 0"):
        Limits(e_max=value)
