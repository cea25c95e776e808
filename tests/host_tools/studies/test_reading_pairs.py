"""Sensors that read every tile twice, and the robot that finds its accuracy from their disagreements."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

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


def readings_of(sensor: type[IndependentReadings], tiles: int = 20_000) -> NDArray[np.bool_]:
    """Return whether readings of two robots are black, with f = 0.7 and b = 0.9, shape (tiles, 2, robots)."""
    settings = Experiment(robots=2, flawed=0, fill_ratio=0.7, true_accuracy=0.9)
    on_black, _ = sensor(settings, 0).advance(2 * tiles)
    is_black: NDArray[np.bool_] = on_black.reshape(tiles, 2, 2) == 1
    return is_black


def test_both_readings_are_black_as_often_as_the_accuracy_says() -> None:
    black_rates = readings_of(IndependentReadings).mean(axis=0)
    assert black_rates == pytest.approx(0.7 * 0.9 + 0.3 * 0.1, abs=0.015)


@pytest.mark.parametrize(
    ("sensor", "rate"),
    [(IndependentReadings, 0.18), (TenthRepeated, 0.9 * 0.18), (HalfRepeated, 0.5 * 0.18)],
)
def test_readings_of_a_tile_disagree_as_often_as_errors_and_repetitions_say(
    sensor: type[IndependentReadings], rate: float
) -> None:
    first, second = readings_of(sensor).swapaxes(0, 1)
    assert (first != second).mean() == pytest.approx(rate, abs=0.01)


def test_readings_of_successive_tiles_are_independent() -> None:
    first_readings = readings_of(HalfRepeated)[:, 0, 0].astype(float)
    correlation = np.corrcoef(first_readings[:-1], first_readings[1:])[0, 1]
    assert correlation == pytest.approx(0, abs=0.03)


def test_a_reading_does_not_depend_on_the_colour_of_the_floor() -> None:
    settings = Experiment(robots=3, flawed=0)
    on_black, on_white = IndependentReadings(settings, 0).advance(50)
    assert set(on_black.ravel()) == {0.0, 1.0}
    assert (on_white == 1 - on_black).all()


def test_readings_do_not_depend_on_how_many_steps_are_taken_at_once() -> None:
    settings = Experiment(robots=3, flawed=0)
    sensor = HalfRepeated(settings, 4)
    in_parts = np.concatenate([sensor.advance(steps)[0] for steps in (1, 2, 5, 1, 4)])
    assert (in_parts == HalfRepeated(settings, 4).advance(13)[0]).all()


def test_trials_have_different_readings() -> None:
    settings = Experiment(robots=3, flawed=0)
    readings = [IndependentReadings(settings, trial).advance(50)[0] for trial in (0, 1)]
    assert (readings[0] != readings[1]).any()


# --- Test and accuracy -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("disagreements", "is_rejected"), [(62, True), (63, False), (95, False), (127, False), (128, True)]
)
def test_counts_beyond_sqrt_12_standard_deviations_are_rejected(
    disagreements: int, is_rejected: bool
) -> None:
    """With an accuracy of 0.95, 95 of 1000 pairs of readings should disagree: 2 x 0.95 x 0.05 of them.

    The variance of that number is 1000 x 0.095 x 0.905 = 85.975, so the test allows sqrt(12 x 85.975) = 32.1
    more or fewer.
    """
    assert disagreement_test_rejects(disagreements, pairs=1000, b_hat=0.95) is is_rejected


def test_without_pairs_nothing_is_rejected() -> None:
    assert disagreement_test_rejects(0, pairs=0, b_hat=0.95) is False


@pytest.mark.parametrize(
    ("disagreements", "accuracy"), [(18, 0.9), (32, 0.8), (50, 0.5), (60, 0.5), (0, 1 - B_HAT_MARGIN)]
)
def test_the_accuracy_is_the_one_at_which_as_many_pairs_disagree(disagreements: int, accuracy: float) -> None:
    assert accuracy_of_disagreements(disagreements, pairs=100) == pytest.approx(accuracy)


# --- Robot -----------------------------------------------------------------------------------------------


def robot_after(agreeing_pairs: int, disagreeing_pairs: int, b_hat: float) -> TwoReadingsRobot:
    """Make a robot, and let it read so many tiles twice, with a run of the filter at the end."""
    robot = TwoReadingsRobot(ROBUST, 0, b_hat)
    for _ in range(agreeing_pairs):
        robot.observe(Observation.BLACK)
        robot.observe(Observation.BLACK)
    for _ in range(disagreeing_pairs):
        robot.observe(Observation.WHITE)
        robot.observe(Observation.BLACK)
    robot.settle()
    return robot


def test_only_the_first_reading_of_a_tile_is_an_observation() -> None:
    robot = robot_after(agreeing_pairs=3, disagreeing_pairs=2, b_hat=0.9)
    assert (robot.t, robot.n) == (5, 3)


def test_a_wrong_b_hat_is_replaced_by_the_accuracy_of_the_disagreements() -> None:
    robot = robot_after(agreeing_pairs=820, disagreeing_pairs=180, b_hat=0.55)
    assert robot.b_hat == pytest.approx(0.9)


def test_a_right_b_hat_stays_exactly_as_it_was() -> None:
    robot = robot_after(agreeing_pairs=823, disagreeing_pairs=177, b_hat=0.9)
    assert robot.b_hat == 0.9


def test_b_hat_returns_when_the_disagreements_no_longer_contradict_it() -> None:
    robot = robot_after(agreeing_pairs=100, disagreeing_pairs=60, b_hat=0.9)
    assert robot.b_hat == pytest.approx(0.75)
    for _ in range(250):
        robot.observe(Observation.BLACK)
        robot.observe(Observation.BLACK)
    robot.settle()

    assert robot.b_hat == 0.9


@pytest.mark.parametrize(("b_hat", "status"), [(0.9, Status.OK), (0.55, Status.UPDATED)])
def test_settle_reports_an_update_where_b_hat_is_rejected(b_hat: float, status: Status) -> None:
    robot = TwoReadingsRobot(ROBUST, 0, b_hat)
    robot._pairs, robot._disagreements = 1000, 180
    assert robot.settle() is status


def test_a_robot_with_two_readings_combines_estimates_as_the_robust_filter_does() -> None:
    robot = TwoReadingsRobot(ROBUST, 0, 0.9)
    ordinary_robot = ReferenceRobot(ROBUST, 0, 0.9)
    robot.observe(Observation.BLACK)
    robot.observe(Observation.BLACK)
    ordinary_robot.observe(Observation.BLACK)
    for swarm_member in (robot, ordinary_robot):
        swarm_member.receive(1, 0.25, 8.0)
        swarm_member.settle()

    assert robot.x == ordinary_robot.x != robot.x_hat


@pytest.mark.parametrize("readings_before", [0, 1])
def test_a_reading_that_is_no_colour_is_refused(readings_before: int) -> None:
    robot = TwoReadingsRobot(ROBUST, 0, 0.9)
    for _ in range(readings_before):
        robot.observe(Observation.BLACK)
    no_colour: Any = 2

    assert robot.observe(no_colour) is Status.ERR_OBSERVATION
    assert (robot.t, robot._pairs) == (readings_before, 0)
