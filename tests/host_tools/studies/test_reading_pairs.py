"""Sensors that read every tile twice, and the robot that finds its accuracy from their disagreements."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import pearsonr  # type: ignore[import-untyped]

from mcp_asdf import ReferenceRobot, Status
from mcp_asdf.robot import B_HAT_MARGIN, Observation
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.studies.reading_pairs import (
    HalfRepeated,
    IndependentReadings,
    TenthRepeated,
    TwoReadingsRobot,
    accuracy_of_disagreements,
    disagreement_test_rejects,
)
from robots import ROBUST

# --- Sensors ---------------------------------------------------------------------------------------------

Readings = NDArray[np.bool_]
"""Whether a reading is black, by tile and robot."""


def first_and_second_readings(sensors: type[IndependentReadings]) -> tuple[Readings, Readings]:
    """Return both readings of 20,000 tiles by two robots: 0.7 are black, and a reading is right with 0.9.

    A share of these 40,000 pairs has a standard deviation of at most 0.0025.
    """
    settings = Experiment(robots=2, flawed=0, fill_ratio=0.7, true_accuracy=0.9)
    on_black, _on_white = sensors(settings, trial=0).advance(steps=2 * 20_000)
    is_black = on_black == 1  # as a black reading is an accuracy of 1 on black
    # A robot reads a tile in an even step, and again in the odd step after it.
    return is_black[0::2], is_black[1::2]


def test_both_readings_of_a_tile_are_black_as_often_as_the_floor_and_the_accuracy_say() -> None:
    """0.7 of the floor is black, and the accuracy is 0.9. A wrong reading of a white tile is black, too."""
    is_black_at_first, is_black_again = first_and_second_readings(IndependentReadings)

    black_rate = 0.7 * 0.9 + 0.3 * 0.1
    assert is_black_at_first.mean() == pytest.approx(black_rate, abs=0.015)
    assert is_black_again.mean() == pytest.approx(black_rate, abs=0.015)


@pytest.mark.parametrize(
    ("sensors", "repeated_share"), [(IndependentReadings, 0.0), (TenthRepeated, 0.1), (HalfRepeated, 0.5)]
)
def test_two_readings_of_a_tile_disagree_if_one_is_wrong_and_the_second_does_not_repeat_the_first(
    sensors: type[IndependentReadings], repeated_share: float
) -> None:
    """A reading is right with a probability of 0.9. Some sensors repeat a share of their first readings."""
    first_readings, second_readings = first_and_second_readings(sensors)

    right_then_wrong = 0.9 * 0.1
    wrong_then_right = 0.1 * 0.9
    disagreeing_share = (1 - repeated_share) * (right_then_wrong + wrong_then_right)
    assert (first_readings != second_readings).mean() == pytest.approx(disagreeing_share, abs=0.01)


def test_readings_of_successive_tiles_are_independent() -> None:
    """A robot's first reading of a tile and its first reading of the tile before have a correlation near 0.

    In half of the cases the second reading of a tile repeats the first. The next tile is read afresh.
    """
    first_readings, _second_readings = first_and_second_readings(HalfRepeated)
    readings_of_robot_0 = first_readings[:, 0]  # of all tiles
    readings_of_tiles = readings_of_robot_0[:-1]
    readings_of_next_tiles = readings_of_robot_0[1:]

    correlation = pearsonr(readings_of_tiles, readings_of_next_tiles).statistic

    # The correlation of 20,000 independent pairs has a standard deviation of 0.007.
    assert correlation == pytest.approx(0, abs=0.03)


def test_a_sensor_with_two_readings_gives_the_same_reading_on_black_and_on_white_tiles() -> None:
    """The sensor returns accuracies by step and robot: on black 1 is a black reading, on white 0 is one.

    So if the reading does not depend on the tile, both accuracies add up to 1.
    """
    sensors = IndependentReadings(Experiment(robots=3, flawed=0), trial=0)

    accuracy_on_black, accuracy_on_white = sensors.advance(steps=50)

    assert set(accuracy_on_black.ravel()) == {0.0, 1.0}
    assert accuracy_on_white.tolist() == (1 - accuracy_on_black).tolist()


def test_readings_do_not_depend_on_how_many_steps_are_taken_at_once() -> None:
    """Thirteen steps are taken in five parts. Readings on black tiles are compared, step by step."""
    three_robots = Experiment(robots=3, flawed=0)
    sensors = HalfRepeated(three_robots, trial=4)
    readings_in_parts = []
    for steps in (1, 2, 5, 1, 4):
        on_black, _on_white = sensors.advance(steps)
        readings_in_parts += on_black.tolist()

    readings_at_once, _on_white = HalfRepeated(three_robots, trial=4).advance(steps=13)
    assert readings_in_parts == readings_at_once.tolist()


def test_two_trials_have_different_readings() -> None:
    three_robots = Experiment(robots=3, flawed=0)
    readings_of_trial_0, _on_white = IndependentReadings(three_robots, trial=0).advance(steps=50)
    readings_of_trial_1, _on_white = IndependentReadings(three_robots, trial=1).advance(steps=50)
    assert readings_of_trial_0.tolist() != readings_of_trial_1.tolist()


# --- Test and accuracy -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("disagreements", "is_rejected"), [(62, True), (63, False), (127, False), (128, True)]
)
def test_an_assumed_accuracy_is_rejected_if_disagreements_are_beyond_sqrt_12_standard_deviations(
    disagreements: int, is_rejected: bool
) -> None:
    """With an accuracy of 0.95, 2 x 0.95 x 0.05 of all pairs of readings should disagree: 95 of 1000.

    The variance of that number is 1000 x 0.095 x 0.905 = 85.975, so the test allows sqrt(12 x 85.975) = 32.1
    more or fewer.
    """
    assert disagreement_test_rejects(disagreements, pairs=1000, b_hat=0.95) is is_rejected


def test_no_accuracy_is_rejected_without_pairs_of_readings() -> None:
    assert disagreement_test_rejects(disagreements=0, pairs=0, b_hat=0.95) is False


@pytest.mark.parametrize(
    ("disagreements", "accuracy"), [(18, 0.9), (32, 0.8), (50, 0.5), (60, 0.5), (0, 1 - B_HAT_MARGIN)]
)
def test_the_accuracy_is_the_one_at_which_as_many_of_100_pairs_of_readings_disagree(
    disagreements: int, accuracy: float
) -> None:
    """With an accuracy of 0.9, 2 x 0.9 x 0.1 of all pairs disagree: 18 of 100.

    Half of the pairs or more disagree at 0.5. Without disagreements the accuracy is 1 less a margin, as the
    firmware accepts no accuracy of 1.
    """
    assert accuracy_of_disagreements(disagreements, pairs=100) == pytest.approx(accuracy)


# --- Robot -----------------------------------------------------------------------------------------------


def read_tiles_twice(robot: TwoReadingsRobot, agreeing: int, disagreeing: int) -> Status:
    """Let a robot read so many tiles twice; return its status at the end of the round, when it filters.

    Readings that agree are both black, and of two that disagree the first is white.
    """
    for _ in range(agreeing):
        robot.observe(Observation.BLACK)
        robot.observe(Observation.BLACK)
    for _ in range(disagreeing):
        robot.observe(Observation.WHITE)
        robot.observe(Observation.BLACK)
    return robot.settle()


def two_readings_robot(b_hat: float) -> TwoReadingsRobot:
    return TwoReadingsRobot(ROBUST, robot_id=0, b_hat=b_hat)


def test_only_the_first_reading_of_a_tile_counts_as_an_observation() -> None:
    """Three tiles are read as black twice. Two are read as white first, and then as black."""
    robot = two_readings_robot(b_hat=0.9)
    read_tiles_twice(robot, agreeing=3, disagreeing=2)

    assert robot.t == 5  # observations
    assert robot.n == 3  # black ones


@pytest.mark.parametrize(
    ("b_hat", "disagreeing", "expected_status"), [(0.55, 180, Status.UPDATED), (0.9, 177, Status.OK)]
)
def test_an_accuracy_is_replaced_by_the_one_that_fits_the_disagreements_only_if_they_contradict_it(
    b_hat: float, disagreeing: int, expected_status: Status
) -> None:
    """With an accuracy of 0.9, 2 x 0.9 x 0.1 of the pairs disagree: 180 of 1000.

    They contradict an accuracy of 0.55, so 0.9 replaces it. 177 do not contradict 0.9, which stays as it is.
    """
    robot = two_readings_robot(b_hat)

    status = read_tiles_twice(robot, agreeing=1000 - disagreeing, disagreeing=disagreeing)

    assert status is expected_status
    assert robot.b_hat == pytest.approx(0.9)


def test_a_robot_returns_to_its_first_accuracy_when_disagreements_no_longer_contradict_it() -> None:
    """60 of 160 pairs of readings that disagree are too many for 0.9, and 60 of 410 are not."""
    robot = two_readings_robot(b_hat=0.9)
    read_tiles_twice(robot, agreeing=100, disagreeing=60)
    assert robot.b_hat == pytest.approx(0.75)  # 2 x 0.75 x 0.25 of 160 pairs are 60

    read_tiles_twice(robot, agreeing=250, disagreeing=0)

    assert robot.b_hat == 0.9


def test_a_robot_with_two_readings_combines_estimates_as_the_robust_filter_does() -> None:
    """It ends with the same x as a robot that has the robust filter and has read the tile once.

    A neighbour's message has changed x, so that it is no longer x_hat, the robot's estimate by its readings.
    """
    robot = two_readings_robot(b_hat=0.9)
    robot.observe(Observation.BLACK)
    robot.observe(Observation.BLACK)  # of the same tile
    robust_robot = ReferenceRobot(ROBUST, robot_id=0, b_hat=0.9)
    robust_robot.observe(Observation.BLACK)

    for either_robot in (robot, robust_robot):
        either_robot.receive(sender=1, x_hat=0.25, alpha=8.0)
        either_robot.settle()

    assert robot.x == robust_robot.x
    assert robot.x != robot.x_hat


@pytest.mark.parametrize("readings_before", [0, 1])
def test_a_reading_that_is_no_colour_is_refused_and_not_counted(readings_before: int) -> None:
    """The bad reading comes as first or second reading of a tile. So there is no pair of readings yet."""
    robot = two_readings_robot(b_hat=0.9)
    for _ in range(readings_before):
        robot.observe(Observation.BLACK)
    no_colour: Any = 2

    assert robot.observe(no_colour) is Status.ERR_OBSERVATION

    assert robot.t == readings_before  # observations
    assert robot._pairs == 0  # tiles that were read twice
