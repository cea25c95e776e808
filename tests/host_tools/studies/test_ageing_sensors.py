"""Sensors of the study of ageing: their accuracies against the random draws that they are made of."""

from __future__ import annotations

from typing import Any

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


def accuracies_of_20_robots(
    sensors: type[AgeingSensors], steps: int, true_accuracy: float, lowest_accuracy: float = 0.5
) -> NDArray[Any]:
    """Return the accuracies of 20 robots in each of so many steps, on black and on white tiles alike.

    All robots begin with the true accuracy. The array has the shape (steps, robots).
    """
    settings = WorldSettings(robots=20, seed=1, true_accuracy=true_accuracy, lowest_accuracy=lowest_accuracy)
    on_black, on_white = sensors(settings, trial=3).advance(steps)
    assert on_white is on_black
    return on_black


def random_numbers_of_sensors(steps: int, first_step: int) -> NDArray[Any]:
    """Return the standard normal numbers that the sensors above draw in these steps, by step and robot."""
    stream = Stream(SENSOR_STREAM, seed=1, trial=3, robots=20)
    draws: NDArray[Any] = ndtri(stream.draw_uniforms(steps, first_step))
    return draws


def test_sensors_that_are_suddenly_worse_lose_0_2_of_their_accuracy_at_step_20_000() -> None:
    """The accuracies of all robots are 0.75 before this step, and 0.55 from it on."""
    accuracies = accuracies_of_20_robots(SuddenlyWorseSensors, steps=20_002, true_accuracy=0.75)

    before = accuracies[:20_000]
    after = accuracies[20_000:]
    assert set(before.ravel()) == {0.75}
    assert after == pytest.approx(0.75 - 0.2)


def test_unequally_ageing_sensors_lose_accuracy_at_a_normally_distributed_rate_for_each_robot() -> None:
    """The rates have a mean of -5e-6 in a step, and a standard deviation as large.

    The test has the random numbers from which the sensors make them, a standard normal one for each robot.
    """
    accuracies = accuracies_of_20_robots(UnequallyAgeingSensors, steps=201, true_accuracy=0.75)
    at_step_0, *_between, at_step_200 = accuracies

    [number_of_each_robot] = random_numbers_of_sensors(steps=1, first_step=0)
    rate_of_each_robot = -5e-6 + 5e-6 * number_of_each_robot
    assert at_step_0.tolist() == [0.75] * 20
    assert at_step_200 == pytest.approx(0.75 + 200 * rate_of_each_robot)


def test_a_wandering_accuracy_changes_by_a_normally_distributed_number_in_each_step() -> None:
    """The changes have a standard deviation of 0.001. All 20 accuracies begin with 0.75.

    The test has the random numbers from which the sensors make them: standard normal ones, from step 1 on.
    """
    accuracies = accuracies_of_20_robots(WanderingSensors, steps=100, true_accuracy=0.75)

    changes = accuracies[1:] - accuracies[:-1]  # from each step to the next
    random_numbers = random_numbers_of_sensors(steps=99, first_step=1)
    assert accuracies[0].tolist() == [0.75] * 20
    assert changes == pytest.approx(0.001 * random_numbers)


def test_wandering_accuracies_stay_above_the_lowest_one_that_is_allowed() -> None:
    """They begin with 0.75. In 400 steps some would fall below 0.74, and are kept at it."""
    accuracies = accuracies_of_20_robots(
        WanderingSensors, steps=400, true_accuracy=0.75, lowest_accuracy=0.74
    )
    assert accuracies.min() == 0.74


@pytest.mark.parametrize("sensors", [SuddenlyWorseSensors, UnequallyAgeingSensors, WanderingSensors])
def test_accuracies_do_not_depend_on_how_many_steps_are_taken_at_once(sensors: type[AgeingSensors]) -> None:
    """200 steps are taken in four parts; accuracies on black tiles are compared, step by step."""
    settings = WorldSettings(robots=20, seed=1, true_accuracy=0.75)
    sensors_of_robots = sensors(settings, trial=3)
    accuracies_in_parts = []
    for steps in (1, 7, 130, 62):
        on_black, _on_white = sensors_of_robots.advance(steps)
        accuracies_in_parts += on_black.tolist()

    accuracies_at_once, _on_white = sensors(settings, trial=3).advance(steps=200)
    assert accuracies_in_parts == accuracies_at_once.tolist()
