"""Sensors of the study of ageing: their accuracies against the random draws that they are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri  # type: ignore[import-untyped]

from mcp_asdf_tools.studies.ageing_sensors import (
    AgeingSensors,
    SuddenlyWorseSensors,
    UnequallyAgeingSensors,
    WanderingSensors,
)
from mcp_asdf_tools.world.philox import SENSOR_STREAM, Stream
from mcp_asdf_tools.world.settings import WorldSettings

SETTINGS: dict[str, Any] = {"robots": 100, "true_accuracy": 0.75, "seed": 1}


def accuracies_of(kind: type[AgeingSensors], steps: int, trial: int = 0, **changes: Any) -> NDArray[Any]:
    on_black, on_white = kind(WorldSettings(**SETTINGS | changes), trial).advance(steps)
    assert on_white is on_black
    return on_black


def normal_draws(steps: int, first_step: int, trial: int) -> NDArray[Any]:
    stream = Stream(SENSOR_STREAM, SETTINGS["seed"], trial, SETTINGS["robots"])
    draws: NDArray[Any] = ndtri(stream.draw_uniforms(steps, first_step))
    return draws


def test_sensors_that_are_suddenly_worse_lose_a_fifth_at_step_20_000() -> None:
    accuracies = accuracies_of(SuddenlyWorseSensors, 20_002)
    assert accuracies[[0, 19_999, 20_000, 20_001], 0] == pytest.approx([0.75, 0.75, 0.55, 0.55])


def test_each_robot_ages_at_a_rate_of_its_own_around_a_common_one() -> None:
    accuracies = accuracies_of(UnequallyAgeingSensors, 201)
    rates = -5e-6 + 5e-6 * normal_draws(1, 0, trial=0)[0]
    assert accuracies[0].tolist() == [0.75] * 100
    assert accuracies[200] == pytest.approx(0.75 + 200 * rates)


def test_a_wandering_accuracy_is_the_sum_of_normal_changes() -> None:
    accuracies = accuracies_of(WanderingSensors, 400, trial=3)
    assert accuracies[0].tolist() == [0.75] * 100
    assert np.diff(accuracies, axis=0) == pytest.approx(0.001 * normal_draws(399, 1, trial=3))


def test_accuracies_stay_above_the_lowest_one() -> None:
    assert accuracies_of(WanderingSensors, 400, lowest_accuracy=0.74).min() == 0.74


@pytest.mark.parametrize("kind", [SuddenlyWorseSensors, UnequallyAgeingSensors, WanderingSensors])
def test_accuracies_are_the_same_however_many_steps_are_taken_at_once(kind: type[AgeingSensors]) -> None:
    sensors = kind(WorldSettings(**SETTINGS), 0)
    parts = [sensors.advance(steps)[0] for steps in (1, 7, 130, 62)]
    assert np.array_equal(np.concatenate(parts), accuracies_of(kind, 200))
