"""K, e and the scores against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.experiments import scores
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.scores import Limits, convergence_step, score


def convergence_step_by_definition(series: NDArray[np.float64], delta: float) -> int:
    """The least K with abs(x[K] - x[k]) < delta for every k >= K, tried one after the other."""
    return next(k for k in range(len(series)) if all(abs(series[k] - later) < delta for later in series[k:]))


@given(st.lists(st.integers(97, 104), min_size=1, max_size=60), st.sampled_from([1, 3, 7, 4096]))
def test_the_step_of_convergence_is_the_one_of_its_definition(values: list[int], chunk: int) -> None:
    """The definition tries each step. Values are whole, so that differences meet the threshold, 3.

    They may be integers or floats, and are searched in chunks of any size.
    """
    expected = convergence_step_by_definition(np.array(values, float), 3.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scores, "_CHUNK", chunk)
        for kind in (np.uint32, np.float64):
            assert convergence_step(np.array(values, kind), 3.0) == expected  # type: ignore[arg-type]


@pytest.mark.parametrize("series", [[0.5, math.nan, 0.5], [0.5, 0.5, math.nan]])
def test_a_series_with_a_nan_converges_at_its_end(series: list[float]) -> None:
    assert convergence_step(np.array(series), 0.25) == 2


def test_scores_by_hand() -> None:
    """A score is 100 (1 - mean / limit), less by the factor exp(-(upper - lower quartile) / limit).

    Means are 150 of 1000 and 0.15 of 0.5; quartiles lie between two values: 50 and 250, and 0.1 and 0.2.
    """
    convergence_steps = np.array([[0, 100, 200, 300]])
    errors = np.array([[0.1, 0.1, 0.1, 0.3]])
    result = score(convergence_steps, errors, 1000, 0.5)

    assert result["h_K"][0] == pytest.approx(85 * math.exp(-0.2))
    assert result["h_e"][0] == pytest.approx(70 * math.exp(-0.2))
    assert result["H"][0] == pytest.approx((result["h_K"][0] + result["h_e"][0]) / 2)


def test_quartiles_are_values_where_they_can_be() -> None:
    """Of five robots the second, third and fourth are the quartiles. A score has a maximum of 100.

    It falls with the median, and exponentially with the distance of the quartiles, both as parts of a limit.
    The limits are 1000 steps for convergence and 0.5 for errors.
    """
    convergence_steps, errors = [0, 100, 200, 300, 400], [0.0, 0.1, 0.2, 0.3, 0.4]
    result = score([convergence_steps], [errors], 1000, 0.5)

    median_step, quartile_distance_of_steps = 200 / 1000, (300 - 100) / 1000
    median_error, quartile_distance_of_errors = 0.2 / 0.5, (0.3 - 0.1) / 0.5
    assert result["h_K"][0] == pytest.approx(100 * (1 - median_step) * math.exp(-quartile_distance_of_steps))
    assert result["h_e"][0] == pytest.approx(
        100 * (1 - median_error) * math.exp(-quartile_distance_of_errors)
    )


def test_an_error_that_is_nan_counts_as_the_worst() -> None:
    assert score([[1, 1]], [[math.nan, math.nan]], 10, 0.5)["h_e"][0] == 0


def test_limits_are_the_papers_unless_given() -> None:
    """Figures 4 to 7 of the paper: K_max = 40000 = T, e_max = 0.45 for every fill ratio."""
    experiment = Experiment(steps=40_000, fill_ratio=0.95)
    assert Limits().of(experiment) == (40_000, 0.45)
    assert Limits(7).of(experiment) == (7, 0.45)
    assert Limits(e_max=0.3).of(experiment) == (40_000, 0.3)


@pytest.mark.parametrize("wrong", [0, -1, math.inf, math.nan])
def test_limits_that_are_none_are_refused(wrong: float) -> None:
    with pytest.raises(UsageError, match=f"K_max is {wrong}; it must be above 0"):
        Limits(wrong, 0.3)
    with pytest.raises(UsageError, match=f"e_max is {wrong}; it must be above 0"):
        Limits(None, wrong)
