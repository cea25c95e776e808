"""Robots with which the studies compare the project's own do what they are for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from mcp_asdf import Config, Filter
from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import B_HAT_MARGIN, Observation
from mcp_asdf_tools.robots.firmwares import RobotMaker
from mcp_asdf_tools.studies import peers

# --- BayesCPF --------------------------------------------------------------------------------------------

WITHOUT_FILTER = Config(filter=Filter.OFF, filter_period=4)
EVERY_ROUND = Config(filter=Filter.ALWAYS, filter_period=1)


def bayescpf_robot_after_100_readings(
    robot_class: type[peers.BayesCpfRobot] = peers.BayesCpfRobot,
) -> peers.BayesCpfRobot:
    """Make a robot that has read 60 of 100 tiles as black since the last update, with x = 0.7, then 0.4.

    It assumes an accuracy of 0.8, with a variance of 0.04, and filters in every round.
    """
    robot = robot_class(EVERY_ROUND, robot_id=0, b_hat=0.8)
    robot._n_since_update, robot._t_since_update = 60, 100
    robot._x_since_update = [0.7, 0.4]
    return robot


class Normal(NamedTuple):
    """A normal distribution of the accuracy."""

    mean: float
    variance: float


def posterior(prior: Normal) -> Normal:
    """Return what is known of b after the 100 readings, 60 of them black, by Bayes' rule for normal numbers.

    The older x weighs twice as much as the newer one.
    """
    x = (2 * 0.7 + 0.4) / 3
    slope = 100 * (2 * x - 1)  # by how much the expected number of black readings rises with b
    black_rate = x * prior.mean + (1 - x) * (1 - prior.mean)
    measured_deviation = 60 - 100 * black_rate
    # This is 100 * black_rate * (1 - black_rate), the variance of the number of black readings.
    noise = 100 * ((2 * prior.mean - 1) ** 2 * (x - x**2 - 0.25) + 0.25)
    variance = 1 / (1 / prior.variance + slope**2 / noise)
    return Normal(prior.mean + variance * slope * measured_deviation / noise, variance)


def test_bayescpf_updates_its_accuracy_by_bayes_rule() -> None:
    """Before its first update it assumes the accuracy of its start, 0.8, with a standard deviation of 0.2.

    Then it has read 60 of 100 tiles as black, which ``posterior`` takes into account.
    """
    robot = bayescpf_robot_after_100_readings()

    new_accuracy = robot.reestimate_b_hat()

    expected = posterior(prior=Normal(mean=0.8, variance=0.2**2))
    assert new_accuracy == pytest.approx(expected.mean)
    assert robot._variance == pytest.approx(expected.variance)


def test_bayescpf_uses_up_its_counts_in_the_update_at_the_end_of_each_round() -> None:
    """The counts of readings since the last update, and the estimates x of its rounds, are empty then.

    Here the robot updates its accuracy in every round.
    """
    robot = bayescpf_robot_after_100_readings()
    robot.observe(Observation.BLACK)

    robot.settle()  # ends the round

    assert robot._n_since_update == 0  # black readings
    assert robot._t_since_update == 0  # all readings
    assert robot._x_since_update == []


def test_bayescpf_does_not_update_its_accuracy_if_fewer_than_5_readings_are_expected_to_be_wrong() -> None:
    """With an accuracy of 0.8, 0.2 x 24 readings = 4.8 readings should be wrong. The result is None."""
    robot = peers.BayesCpfRobot(EVERY_ROUND, robot_id=0, b_hat=0.8)
    robot._n_since_update, robot._t_since_update = 12, 24  # black readings, and all readings
    robot._x_since_update = [0.7, 0.4]

    assert robot.reestimate_b_hat() is None


@pytest.mark.parametrize(("filter_choice", "updates"), [(Filter.OFF, 0), (Filter.ALWAYS, 1)])
def test_bayescpf_updates_its_accuracy_in_each_hundredth_step_unless_the_filter_is_off(
    filter_choice: Filter, updates: int
) -> None:
    """In 100 steps the robot counts one update, in the last step. With the filter off it counts none."""
    config = Config(filter=filter_choice, filter_period=100)
    robot = peers.BayesCpfRobot(config, robot_id=0, b_hat=0.8)

    for _ in range(99):
        robot.step(Observation.BLACK)
    assert robot.counters.updates == 0

    robot.step(Observation.BLACK)
    assert robot.counters.updates == updates


@pytest.mark.parametrize("mean", [0.4, 0.49, 0.5, 1.0, 1.02, 1.3])
def test_bayescpf_cuts_its_estimate_as_a_truncated_normal_distribution(mean: float) -> None:
    """The estimate is the mean of a normal distribution, cut to the possible accuracies 0.5 to 1."""
    robot = peers.BayesCpfRobot(EVERY_ROUND, robot_id=0, b_hat=0.8)
    # These are what an update has left.
    robot._mean = mean
    robot._variance = 0.1**2

    possible_accuracies = np.linspace(0.5, 1, 10_001)
    density = np.exp(-((possible_accuracies - mean) ** 2) / (2 * 0.1**2))
    mean_within_range = np.average(possible_accuracies, weights=density)
    assert robot._truncated_mean() == pytest.approx(mean_within_range, abs=1e-4)


@pytest.mark.parametrize(
    ("robot_class", "prior"),
    [
        # With each of the 100 readings before the update the accuracy falls by 1e-5 ...
        (peers.DriftingBayesCpfRobot, Normal(mean=0.8 - 100 * 1e-5, variance=0.04)),
        # ... or changes at random, with a standard deviation of 0.001.
        (peers.WanderingBayesCpfRobot, Normal(mean=0.8, variance=0.04 + 100 * 0.001**2)),
    ],
)
def test_bayescpf_for_sensors_that_change_expects_what_they_do_before_it_updates(
    robot_class: type[peers.BayesCpfRobot], prior: Normal
) -> None:
    """The prior is what is expected of the accuracy after 100 readings, in which it falls or wanders.

    It takes the place of the accuracy at the start, 0.8 with a variance of 0.04.
    """
    robot = bayescpf_robot_after_100_readings(robot_class)
    assert robot.reestimate_b_hat() == pytest.approx(posterior(prior).mean)


# --- Robots that know how sensors age --------------------------------------------------------------------


def test_a_robot_that_knows_its_accuracy_assumes_1e_5_less_after_each_observation() -> None:
    """All sensors of the study lose accuracy that fast. b_hat is the accuracy that the robot assumes."""
    robot = peers.KnownAccuracyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    b_hats = []
    for _ in range(3):
        robot.observe(Observation.BLACK)
        b_hats.append(robot.b_hat)

    assert b_hats == pytest.approx([0.9, 0.9 - 1e-5, 0.9 - 2e-5])


def test_a_robot_that_knows_its_sensor_to_be_perfect_assumes_a_margin_less() -> None:
    """The firmware accepts no accuracy of 1, but at most 1 less a margin."""
    robot = peers.KnownAccuracyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    robot._true_accuracy = 1.0  # which robots of this class know

    robot.observe(Observation.BLACK)

    assert robot.b_hat == 1 - B_HAT_MARGIN


def test_a_robot_can_know_the_mean_accuracy_of_the_observations_that_it_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its accuracy falls by 0.1 after each observation, so the three have the accuracies 0.9, 0.8 and 0.7."""
    monkeypatch.setattr(peers, "DRIFT_RATE", -0.1)  # of the accuracy, with each observation
    robot = peers.KnownMeanAccuracyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)

    for _ in range(3):
        robot.observe(Observation.BLACK)

    assert robot.b_hat == pytest.approx((0.9 + 0.8 + 0.7) / 3)


def test_a_robot_that_halves_its_counts_at_the_end_of_its_memory_halves_its_sum_of_accuracies_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The robot assumes the sum of the accuracies of its observations by their number.

    With a memory of 64 it halves both after 64 observations. So 64 observations with an accuracy of 0.9
    count as 32, and then comes one with an accuracy of 0.6.
    """
    monkeypatch.setattr(peers, "DRIFT_RATE", 0.0)  # the accuracy stays as it is
    config = Config(filter=Filter.OFF, filter_period=4, memory=64)
    robot = peers.KnownMeanAccuracyRobot(config, robot_id=0, b_hat=0.9)
    for _ in range(64):
        robot.observe(Observation.BLACK)

    robot._true_accuracy = 0.6  # which robots of this class know
    robot.observe(Observation.BLACK)

    sum_of_accuracies = 32 * 0.9 + 0.6
    observations = 32 + 1
    assert robot.b_hat == pytest.approx(sum_of_accuracies / observations)


# --- Resilient consensus ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("received", "tolerated_liars", "kept"),
    [
        ([0.1, 0.2, 0.6, 0.8], 1, [0.2, 0.6]),
        ([0.6, 0.7, 0.8, 0.9], 1, [0.6, 0.7, 0.8]),  # none is below the own one
        ([0.1, 0.5, 0.5, 0.9], 2, [0.5, 0.5]),  # what equals the own one stays
        ([0.1, 0.9], 0, [0.1, 0.9]),
        ([0.2, 0.3, 0.8], 5, []),  # too few neighbours
    ],
)
def test_w_msr_leaves_out_as_many_estimates_above_and_below_the_robot_s_own_one_as_liars_are_tolerated(
    received: list[float], tolerated_liars: int, kept: list[float]
) -> None:
    """W-MSR takes the mean of the own estimate, 0.5, and of those that it keeps."""
    mean_of_kept = np.mean([0.5, *kept])
    mean_by_w_msr = peers.wmsr_mean(
        own_estimate=0.5, received_estimates=received, tolerated_liars=tolerated_liars
    )
    assert mean_by_w_msr == pytest.approx(mean_of_kept)


def receive_in_one_round(robot: ReferenceRobot, x_hats: Sequence[float]) -> None:
    """Let a robot receive an estimate from each of its neighbours, equally confident, and end the round."""
    for sender, x_hat in enumerate(x_hats, start=1):
        robot.receive(sender, x_hat, alpha=8.0)
    robot.settle()


@pytest.mark.parametrize(
    ("received", "mean"),
    [([0.1, 0.1, 0.1, 0.1, 0.1], 1.0), ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], (1.0 + 0.6) / 2)],
)
def test_a_robot_with_w_msr_leaves_out_the_five_lowest_estimates_that_it_receives(
    received: list[float], mean: float
) -> None:
    """Five neighbours may be liars. The robot's own estimate is 1.0, as its only tile was black.

    It receives five estimates, and keeps its own alone, or six, and takes the mean with the highest of them.
    """
    robot = peers.WmsrRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    robot.observe(Observation.BLACK)

    receive_in_one_round(robot, received)

    assert robot.x == pytest.approx(mean)


@pytest.mark.parametrize(
    ("estimates", "mean"),
    [
        ([0.5, 0.0, 1.0, 0.6], (0.5 + 0.6) / 2),
        ([0.5, 0.0, 0.9], (0.5 + 0.0 + 0.9) / 3),  # a quarter of three is none
        ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0], (0.3 + 0.4 + 0.5 + 0.6) / 4),
    ],
)
def test_a_trimmed_mean_leaves_out_a_quarter_at_either_end(estimates: list[float], mean: float) -> None:
    """Of four estimates the lowest and the highest are left out. A quarter of three is rounded down to 0."""
    assert peers.trimmed_mean(estimates, trimmed_share=0.25) == pytest.approx(mean)


def test_a_robot_with_a_trimmed_mean_counts_its_own_estimate_among_the_others() -> None:
    """Its only tile was black, so its own estimate is 1.0. Of four estimates 0.2 and 1.0 are dropped."""
    robot = peers.TrimmedMeanRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    robot.observe(Observation.BLACK)

    receive_in_one_round(robot, [0.2, 0.4, 0.6])

    assert robot.x == pytest.approx((0.4 + 0.6) / 2)


# --- A vote on the prevailing colour ---------------------------------------------------------------------


def make_voter(robot_id: int) -> peers.MajorityRobot:
    """Make a robot that votes on the prevailing colour, and explores at first."""
    return peers.MajorityRobot(WITHOUT_FILTER, robot_id, b_hat=0.9)


def voter_that_broadcasts_white(rounds_left: int) -> peers.MajorityRobot:
    """Make a robot with the opinion white. It broadcasts this opinion for so many more rounds."""
    robot = make_voter(robot_id=0)
    robot._is_disseminating = True
    robot._rounds_left = rounds_left
    return robot


def test_voters_with_even_ids_begin_with_the_opinion_white_and_those_with_odd_ids_with_black() -> None:
    """An opinion is x, which is 0.0 for white and 1.0 for black."""
    white, black = 0.0, 1.0
    opinions_by_id = [make_voter(robot_id).x for robot_id in (0, 1, 2, 3)]
    assert opinions_by_id == [white, black, white, black]


def test_a_voter_has_confidence_in_its_opinion_only_while_it_broadcasts_it() -> None:
    """Receivers do not count messages with a confidence alpha of 0. At first a voter explores the floor."""
    exploring_robot = make_voter(robot_id=0)
    broadcasting_robot = voter_that_broadcasts_white(rounds_left=5)

    assert exploring_robot.alpha == 0.0
    assert broadcasting_robot.alpha == 1.0


@pytest.mark.parametrize(("received", "opinion"), [([1.0, 1.0], 1.0), ([1.0], 0.0), ([1.0, 0.0], 0.0)])
def test_a_voter_adopts_the_opinion_of_the_majority_and_keeps_its_own_in_a_tie(
    received: list[float], opinion: float
) -> None:
    """Opinions are 1.0 for black and 0.0 for white. The robot's own one is white, and counts too.

    It adopts an opinion at the end of its last round of broadcasting, which is this one.
    """
    robot = voter_that_broadcasts_white(rounds_left=1)

    receive_in_one_round(robot, received)

    assert robot.x == opinion


def test_a_voter_listens_only_in_the_last_30_rounds_in_which_it_broadcasts() -> None:
    """It keeps no opinion of a sender while 31 rounds are left, and keeps one while 30 are left."""
    robot = voter_that_broadcasts_white(rounds_left=31)

    robot.receive(sender=1, x_hat=1.0, alpha=1.0)
    assert robot._opinion_by_sender == {}

    robot.settle()  # ends a round, so 30 are left
    robot.receive(sender=1, x_hat=1.0, alpha=1.0)
    assert robot._opinion_by_sender == {1: Observation.BLACK}


def test_a_voter_ignores_messages_without_confidence() -> None:
    """Two neighbours broadcast black (1.0) with a confidence of 0; the robot stays with white (0.0)."""
    robot = voter_that_broadcasts_white(rounds_left=1)
    robot.receive(sender=1, x_hat=1.0, alpha=0.0)
    robot.receive(sender=2, x_hat=1.0, alpha=0.0)

    robot.settle()  # ends the last round, in which the robot decides

    assert robot.x == 0.0


def mean_rounds_of_broadcasting_black(black_readings: int) -> float:
    """Return for how long a robot broadcasts "black" on average after 100 readings, some of them black."""
    robot = make_voter(robot_id=1)  # with the opinion black
    durations = []
    for _ in range(2000):
        robot._start_exploration()
        for reading in range(100):
            robot.observe(Observation.BLACK if reading < black_readings else Observation.WHITE)
        robot._start_dissemination()
        durations.append(robot._rounds_left)
    return sum(durations) / len(durations)


@pytest.mark.slow
@pytest.mark.parametrize("black_readings", [100, 30])
def test_a_voter_broadcasts_longer_for_a_colour_that_it_reads_more_often(black_readings: int) -> None:
    """It broadcasts for n rounds on average, if n of the last 100 readings had its opinion's colour."""
    assert mean_rounds_of_broadcasting_black(black_readings) == pytest.approx(black_readings, rel=0.1)


def test_a_voter_broadcasts_an_opinion_whose_colour_it_never_read_for_one_round() -> None:
    """Its only reading is white, and its opinion is black."""
    robot_with_opinion_black = make_voter(robot_id=1)
    robot_with_opinion_black.observe(Observation.WHITE)

    robot_with_opinion_black._start_dissemination()  # as it does when it has explored for long enough

    assert robot_with_opinion_black._rounds_left == 1


# --- Liars -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make_robot", "honest_class"),
    [
        (peers.five_liars, NativeRobot),
        (peers.wmsr_robots_and_five_liars, peers.WmsrRobot),
        (peers.trimmed_mean_robots_and_five_liars, peers.TrimmedMeanRobot),
        (peers.majority_robots_and_five_liars, peers.MajorityRobot),
    ],
)
def test_the_last_five_robots_of_a_swarm_of_20_are_the_liars(
    make_robot: RobotMaker, honest_class: type
) -> None:
    """Functions such as ``five_liars`` make a robot of the swarm by its id, an honest one or a liar."""
    accuracy = 0.9
    swarm = [make_robot(WITHOUT_FILTER, robot_id, accuracy) for robot_id in range(20)]

    classes = [type(robot) for robot in swarm]
    assert classes == [honest_class] * 15 + [peers.Liar] * 5


def test_a_liar_that_reads_black_broadcasts_no_black_with_the_largest_confidence() -> None:
    """Its x_hat, the share of black floor, is 0, and its confidence alpha has the largest value."""
    liar = peers.Liar(WITHOUT_FILTER, robot_id=0, b_hat=0.9)

    liar.observe(Observation.BLACK)

    assert liar.x_hat_raw == 0
    assert liar.alpha_raw == ALPHA_MAX
