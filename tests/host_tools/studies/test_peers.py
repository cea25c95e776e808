"""Robots and sensors with which the robust filter is compared do what they are for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import truncnorm  # type: ignore[import-untyped]

import mcp_asdf_tools as m
from mcp_asdf import Config, Filter, Status
from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.native import NativeRobot
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import B_HAT_MARGIN, Observation
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.firmwares import RobotMaker
from mcp_asdf_tools.studies import peers
from mcp_asdf_tools.studies.ageing_sensors import DRIFT_RATE
from mcp_asdf_tools.studies.study_program import PARAMETERS_BY_FLAW

# --- Swarms ----------------------------------------------------------------------------------------------


def final_error_of_swarm(expected_x: float = 0.55, **changes: Any) -> float:
    """Return the mean distance of x from the expected one at the end of a short trial of 20 moving robots.

    The last five robots are left out. ``changes`` are parameters of the experiment. Without any 0.55 of the
    floor is black, and six robots are flawed and underconfident.
    """
    world: dict[str, Any] = {
        **PARAMETERS_BY_FLAW["underconfident"],
        "topology": "dynamic",
        "latency": 1,
        "steps": 4000,
    }
    (experiment,) = m.grid(**{**world, "trials": 1, "seed": 77, **changes})
    x = run_trials(experiment, first=0, trials=1, sampling_interval=50).records["x"]
    late_x_of_honest_robots = x[0, -20:, :15]  # by trial, sample and robot
    return float(abs(late_x_of_honest_robots - expected_x).mean())


@pytest.mark.slow
def test_a_memory_of_received_messages_halves_the_error_of_a_flawed_swarm_without_a_filter() -> None:
    """The error is the mean distance of the robots' x from the share of black, at the end of a trial."""
    error_with_memory = final_error_of_swarm(firmware=peers.RememberingRobot, filter="none", flawed=6)
    error_without_memory = final_error_of_swarm(firmware="native", filter="none", flawed=6)
    assert error_with_memory < error_without_memory / 2


@pytest.mark.slow
def test_a_swarm_without_a_filter_is_misled_by_one_liar_and_more_so_by_five() -> None:
    """The error is the mean distance of honest robots' x from the share of black, at the end of a trial."""
    error_of_honest_swarm = final_error_of_swarm(firmware="native", filter="none", flawed=0)
    error_with_one_liar = final_error_of_swarm(firmware=peers.one_liar, filter="none", flawed=0)
    error_with_five_liars = final_error_of_swarm(firmware=peers.five_liars, filter="none", flawed=0)
    assert error_of_honest_swarm < error_with_one_liar < error_with_five_liars


@pytest.mark.slow
def test_two_liars_mislead_the_robust_filter_less_than_half_as_much_as_five_mislead_no_filter() -> None:
    """The error is the mean distance of honest robots' x from the share of black, at the end of a trial."""
    error_of_robust_filter = final_error_of_swarm(firmware=peers.two_liars, filter="robust", flawed=0)
    error_without_filter = final_error_of_swarm(firmware=peers.five_liars, filter="none", flawed=0)
    assert error_of_robust_filter < error_without_filter / 2


@pytest.mark.slow
def test_a_swarm_on_a_floor_that_changes_ends_with_the_new_share_of_black() -> None:
    """0.55 of the floor is black in the first half of the trial, and 0.95 in the second half.

    The robots can follow, as they forget old readings: they halve their counts after 1024 of them.
    """
    swarm = {"sensor": peers.ChangingFloor, "filter": "none", "flawed": 0, "memory": 1024}

    distance_from_new_share = final_error_of_swarm(expected_x=0.95, **swarm)
    distance_from_old_share = final_error_of_swarm(expected_x=0.55, **swarm)

    assert distance_from_new_share < 0.1 < distance_from_old_share


@pytest.mark.slow
def test_a_swarm_that_votes_on_the_prevailing_colour_ends_with_the_answer_black() -> None:
    """Three quarters of the floor are black. An answer is x, which is 1.0 for black."""
    swarm = {"firmware": peers.MajorityRobot, "filter": "none", "fill_ratio": 0.75, "density": 4.0}
    distance_from_black = final_error_of_swarm(expected_x=1.0, **swarm)
    assert distance_from_black < 0.1


@pytest.mark.slow
def test_w_msr_withstands_five_liars_that_mislead_a_swarm_without_a_filter() -> None:
    """W-MSR is told the number of liars, five. It leaves out as many of the most extreme estimates."""
    swarm: dict[str, Any] = {"topology": "fully-connected", "latency": 0, "flawed": 0, "filter": "none"}

    error_of_w_msr = final_error_of_swarm(firmware=peers.wmsr_robots_and_five_liars, **swarm, steps=2000)
    error_without_rule = final_error_of_swarm(firmware=peers.five_liars, **swarm, steps=2000)

    assert error_of_w_msr < 0.02
    assert error_without_rule > 0.5


def final_error_of_ageing_swarm(firmware: Any, memory: int = 2**31) -> float:
    """Return the error of ten robots whose sensors age ten times as fast as the study's, and who know it.

    So a trial can be short: in 4000 steps accuracies fall by 0.4. Without ``memory`` robots never halve their
    counts.
    """
    drift_rate = 10 * DRIFT_RATE
    world: dict[str, Any] = {"steps": 4000, "fill_ratio": 0.75, "seed": 7, "trials": 1}
    ageing: dict[str, Any] = {"drift": "linear", "drift_rate": drift_rate, "memory": memory}
    (experiment,) = m.grid(**world, **ageing, robots=10, flawed=0, filter="none", firmware=firmware)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(peers, "DRIFT_RATE", drift_rate)
        x = run_trials(experiment, first=0, trials=1, sampling_interval=100).records["x"]
    return float(abs(x[0, -5:] - 0.75).mean())


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["reference", peers.KnownAccuracyRobot])
def test_a_robot_that_knows_the_accuracy_of_its_sensor_at_one_moment_only_has_a_large_error(
    firmware: Any,
) -> None:
    """The firmware "reference" knows only the first accuracy of its ageing sensor.

    ``KnownAccuracyRobot`` knows the present one. Most of the counted observations are from when the sensor
    was worse, or better.
    """
    assert final_error_of_ageing_swarm(firmware) > 0.06


@pytest.mark.slow
@pytest.mark.parametrize("memory", [2**31, 1024])
def test_a_robot_that_knows_the_mean_accuracy_of_what_it_counted_has_a_small_error(memory: int) -> None:
    """The sensor ages. When the observations fill the memory, the robot halves its counts."""
    assert final_error_of_ageing_swarm(peers.KnownMeanAccuracyRobot, memory=memory) < 0.03


# --- Memory ----------------------------------------------------------------------------------------------

WITHOUT_FILTER = Config(filter=Filter.OFF, filter_period=4)
EVERY_ROUND = Config(filter=Filter.ALWAYS, filter_period=1)


def remembering_robot_that_read_black(observations: int) -> peers.RememberingRobot:
    """Make a robot with a memory, and let it read so many tiles, which are all black."""
    robot = peers.RememberingRobot(WITHOUT_FILTER, robot_id=127, b_hat=0.9)
    for _ in range(observations):
        robot.observe(Observation.BLACK)
    return robot


def test_a_robot_with_a_memory_has_its_own_estimate_before_the_first_message() -> None:
    """Its only tile was black, so x, the estimate of the swarm, is 1.0, as is x_hat, its own estimate."""
    robot = remembering_robot_that_read_black(observations=1)

    assert robot.x_hat == 1.0
    assert robot.x == 1.0
    assert robot.x_bar == 0.5  # the mean of the received estimates: none yet


def test_a_memory_weighs_messages_by_their_confidence_and_older_ones_seven_eighths_as_much() -> None:
    """The robot divides the confidence alpha of a message by the number of its own observations, two."""
    robot = remembering_robot_that_read_black(observations=2)

    robot.receive(sender=1, x_hat=0.2, alpha=8.0)
    robot.receive(sender=2, x_hat=0.8, alpha=4.0)

    older_weight = 7 / 8 * 8.0 / 2  # alpha is 8.0
    newer_weight = 4.0 / 2
    weighted_mean = (older_weight * 0.2 + newer_weight * 0.8) / (older_weight + newer_weight)
    assert robot.x_bar == pytest.approx(weighted_mean)
    assert robot.x == robot.x_bar


@pytest.mark.parametrize(("messages_before", "share_of_last"), [(62, 1 / 8), (63, 1 / 16)])
def test_the_64th_message_counts_only_half_as_much_in_a_memory_as_those_before(
    messages_before: int, share_of_last: float
) -> None:
    """The 63rd message counts as 1/8 of the mean, as do those before, and the 64th as 1/16.

    All messages but the last say 0.0. So the mean is the share of the last one, which says 1.0.
    """
    robot = remembering_robot_that_read_black(observations=1)
    for sender in range(messages_before):
        robot.receive(sender, x_hat=0.0, alpha=1.0)

    last_sender = messages_before
    robot.receive(last_sender, x_hat=1.0, alpha=1.0)

    assert robot.x == pytest.approx(share_of_last, rel=1e-3)


def test_messages_without_confidence_do_not_count_in_a_memory() -> None:
    """After 63 ignored messages two others are the first ones, so the older weighs 7/8 of the newer."""
    robot = remembering_robot_that_read_black(observations=1)
    for sender in range(63):
        robot.receive(sender, x_hat=0.9, alpha=0.0)

    robot.receive(sender=63, x_hat=0.0, alpha=1.0)
    robot.receive(sender=64, x_hat=1.0, alpha=1.0)

    older_weight = 7 / 8
    newer_weight = 1
    weighted_mean = (older_weight * 0.0 + newer_weight * 1.0) / (older_weight + newer_weight)
    assert robot.x == pytest.approx(weighted_mean)


def test_a_robot_with_a_memory_ignores_a_second_message_of_a_sender_in_a_round() -> None:
    """The robot returns REPEATED, and its x stays at the estimate of the first message."""
    robot = remembering_robot_that_read_black(observations=1)
    robot.receive(sender=1, x_hat=0.2, alpha=8.0)

    status_of_second_message = robot.receive(sender=1, x_hat=0.9, alpha=8.0)

    assert status_of_second_message is Status.REPEATED
    assert robot.x == pytest.approx(0.2)


# --- BayesCPF --------------------------------------------------------------------------------------------


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

    # SciPy expects the ends of the range in standard deviations from the mean.
    lower_end = (0.5 - mean) / 0.1
    upper_end = (1 - mean) / 0.1
    mean_within_range = truncnorm.mean(lower_end, upper_end, loc=mean, scale=0.1)
    assert robot._truncated_mean() == pytest.approx(mean_within_range)


def test_bayescpf_does_not_cut_an_estimate_far_outside_the_possible_range() -> None:
    """A mean of 3 with a deviation of 0.01: next to nothing of the distribution is between 0.5 and 1."""
    robot = peers.BayesCpfRobot(EVERY_ROUND, robot_id=0, b_hat=0.8)
    # These are what an update has left.
    robot._mean = 3.0
    robot._variance = 0.01**2
    assert robot._truncated_mean() == 3.0


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


# --- Hard worlds -----------------------------------------------------------------------------------------


def test_a_lossy_radio_loses_about_three_messages_in_ten() -> None:
    """A robot with it accepts about 700 of 1000 messages, and no call returns an error."""
    robot = peers.LossyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    for _ in range(1000):
        status = robot.receive_raw(sender=1, x_hat=2**22, alpha=2**31)  # half black, and confident
        assert status >= Status.OK  # errors are negative
        robot.settle()  # ends the round, as a robot accepts one message of a sender in a round

    # 40 are almost three standard deviations: the square root of 1000 x 0.7 x 0.3 is 14.5.
    assert 700 - 40 < robot.counters.accepted < 700 + 40


@pytest.mark.parametrize(
    ("make_robot", "liars", "honest_class"),
    [
        (peers.one_liar, 1, NativeRobot),
        (peers.two_liars, 2, NativeRobot),
        (peers.five_liars, 5, NativeRobot),
        (peers.wmsr_robots_and_five_liars, 5, peers.WmsrRobot),
        (peers.trimmed_mean_robots_and_five_liars, 5, peers.TrimmedMeanRobot),
        (peers.majority_robots_and_five_liars, 5, peers.MajorityRobot),
    ],
)
def test_the_last_robots_of_a_swarm_of_20_are_the_liars(
    make_robot: RobotMaker, liars: int, honest_class: type
) -> None:
    """Functions such as ``one_liar`` make a robot of the swarm by its id, an honest one or a liar.

    The number of liars is also listed for the errors of a swarm, which leave out its liars.
    """
    accuracy = 0.9
    swarm = [make_robot(WITHOUT_FILTER, robot_id, accuracy) for robot_id in range(20)]

    classes = [type(robot) for robot in swarm]
    assert classes == [honest_class] * (20 - liars) + [peers.Liar] * liars
    assert peers.LIAR_COUNT_BY_FIRMWARE[make_robot.__name__] == liars


def test_a_liar_that_reads_black_broadcasts_no_black_with_the_largest_confidence() -> None:
    """Its x_hat, the share of black floor, is 0, and its confidence alpha has the largest value."""
    liar = peers.Liar(WITHOUT_FILTER, robot_id=0, b_hat=0.9)

    liar.observe(Observation.BLACK)

    assert liar.x_hat_raw == 0
    assert liar.alpha_raw == ALPHA_MAX


def make_changing_floor(steps: int, fill_ratio: float, accuracy: float) -> peers.ChangingFloor:
    """Make the sensors of two robots on a floor that changes in the middle of a trial of so many steps.

    ``fill_ratio`` is the share of black floor at first. A reading is right with the probability ``accuracy``.
    """
    experiment = Experiment(
        robots=2, flawed=0, steps=steps, filter_period=50, fill_ratio=fill_ratio, true_accuracy=accuracy
    )
    return peers.ChangingFloor(experiment, trial=0)


def share_of_black_readings(black_floor: float, accuracy_on_black: Any, accuracy_on_white: Any) -> Any:
    """Return the share of readings that are black: right ones of black tiles, wrong ones of white tiles."""
    return black_floor * accuracy_on_black + (1 - black_floor) * (1 - accuracy_on_white)


def test_a_floor_that_changes_looks_as_if_95_percent_were_black_in_the_second_half_of_a_trial() -> None:
    """Its tiles stay as they are: 55 % are black. But sensors begin to read white tiles as black ones."""
    changing_floor = make_changing_floor(steps=100, fill_ratio=0.55, accuracy=0.9)

    accuracy_on_black, accuracy_on_white = changing_floor.advance(steps=100)  # by step and robot

    black_share = share_of_black_readings(0.55, accuracy_on_black, accuracy_on_white)
    first_half = black_share[:50]
    second_half = black_share[50:]
    assert first_half == pytest.approx(share_of_black_readings(0.55, 0.9, 0.9))
    assert second_half == pytest.approx(share_of_black_readings(0.95, 0.9, 0.9))


def test_a_floor_that_changes_does_so_in_step_50_of_100_however_many_steps_are_taken_at_once() -> None:
    """Accuracies on white tiles, which change with the floor, are compared step by step.

    Step 50 is in the middle of the second part, which has the steps 30 to 99.
    """
    changing_floor = make_changing_floor(steps=100, fill_ratio=0.55, accuracy=0.9)
    _on_black, on_white_of_first_30_steps = changing_floor.advance(steps=30)
    _on_black, on_white_of_last_70_steps = changing_floor.advance(steps=70)

    same_floor = make_changing_floor(steps=100, fill_ratio=0.55, accuracy=0.9)
    _on_black, on_white_of_all_steps = same_floor.advance(steps=100)

    on_white_in_two_parts = [*on_white_of_first_30_steps, *on_white_of_last_70_steps]
    assert on_white_in_two_parts == on_white_of_all_steps.tolist()
