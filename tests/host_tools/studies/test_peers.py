"""Robots and sensors with which the robust filter is compared do what they are for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
from mcp_asdf_tools.studies import ageing, peers, reading_pairs, robust_filter
from mcp_asdf_tools.studies.ageing_sensors import DRIFT_RATE
from mcp_asdf_tools.studies.study_program import FLAWS


def error_of(true_fill_ratio: float = 0.55, **changes: Any) -> float:
    """Return the error at the end of a short trial of 20 moving robots, without the last five."""
    world: dict[str, Any] = {**FLAWS["underconfident"], "topology": "dynamic", "latency": 1, "steps": 4000}
    (experiment,) = m.grid(**{**world, "trials": 1, "seed": 77, **changes})
    x = run_trials(experiment, first=0, trials=1, sampling_interval=50).records["x"]
    return float(abs(x[0, -20:, :15] - true_fill_ratio).mean())


@pytest.fixture(scope="module")
def error_without_filter() -> float:
    return error_of(filter="none")


@pytest.fixture(scope="module")
def error_with_robust_filter() -> float:
    return error_of(filter="robust")


@pytest.mark.slow
def test_a_memory_halves_the_error_without_a_filter(error_without_filter: float) -> None:
    assert error_of(firmware=peers.RememberingRobot, filter="none") < error_without_filter / 2


@pytest.mark.slow
def test_bayescpf_is_another_filter_than_asdf_plus() -> None:
    assert error_of(firmware=peers.BayesCpfRobot, filter="asdf-plus") != error_of(filter="asdf-plus")


@pytest.mark.slow
def test_lost_messages_change_the_estimates(error_with_robust_filter: float) -> None:
    assert error_of(firmware=peers.LossyRobot, filter="robust") != error_with_robust_filter


@pytest.mark.slow
def test_each_liar_makes_a_swarm_without_a_filter_worse() -> None:
    honest, one, five = (
        error_of(firmware=firmware, filter="none", flawed=0)
        for firmware in ("native", peers.one_liar, peers.five_liars)
    )

    assert honest < one < five


@pytest.mark.slow
def test_the_robust_filter_withstands_two_liars() -> None:
    five_without_filter = error_of(firmware=peers.five_liars, filter="none", flawed=0)
    assert error_of(firmware=peers.two_liars, filter="robust", flawed=0) < five_without_filter / 2


@pytest.mark.slow
def test_a_swarm_on_a_floor_that_changes_ends_with_the_new_share_of_black() -> None:
    """From the middle of the trial on it is 0.95 and no longer 0.55."""
    world = {"sensor": peers.ChangingFloor, "filter": "none", "flawed": 0, "memory": 1024}
    assert error_of(0.95, **world) < 0.1 < error_of(0.55, **world)


def ageing_error_of(**changes: Any) -> float:
    """Return the error at the end of a short trial in which all sensors lose accuracy as the study's do."""
    world: dict[str, Any] = {"steps": 4000, "drift": "linear", "fill_ratio": 0.75}
    robots: dict[str, Any] = {"robots": 10, "flawed": 0, "filter": "none", "drift_rate": DRIFT_RATE}
    (experiment,) = m.grid(**{**world, **robots, "seed": 7, "trials": 1, **changes})
    x = run_trials(experiment, first=0, trials=1, sampling_interval=100).records["x"]
    return float(abs(x[0, -5:] - 0.75).mean())


@pytest.fixture
def fast_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let sensors age ten times as fast, and robots know it, so that a trial can be short."""
    monkeypatch.setattr(peers, "DRIFT_RATE", 10 * DRIFT_RATE)
    monkeypatch.setattr(peers.DriftingBayesCpfRobot, "drift_rate", 10 * DRIFT_RATE)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["reference", peers.KnownAccuracyRobot])
def test_a_robot_that_knows_only_its_sensor_s_present_accuracy_is_wrong(
    firmware: Any, fast_drift: None
) -> None:
    """The sensor loses accuracy, and most of the counted observations are from when it was better."""
    assert ageing_error_of(firmware=firmware, drift_rate=10 * DRIFT_RATE) > 0.06


@pytest.mark.slow
@pytest.mark.parametrize("memory", [2**31, 1024])
def test_a_robot_that_knows_the_mean_accuracy_of_its_observations_is_right(
    memory: int, fast_drift: None
) -> None:
    firmware = peers.KnownMeanAccuracyRobot
    assert ageing_error_of(firmware=firmware, memory=memory, drift_rate=10 * DRIFT_RATE) < 0.03


@pytest.mark.parametrize(
    ("firmware", "filter_name", "label"),
    [
        ("native", "robust", "robust"),
        (peers.RememberingRobot, "none", "no filter with memory"),
        (peers.RememberingRobot, "asdf-minus", "ASDF- with memory"),
        (peers.BayesCpfRobot, "asdf-plus", "BayesCPF"),
        (peers.WanderingBayesCpfRobot, "asdf-plus", "BayesCPF"),
        (peers.KnownAccuracyRobot, "none", "knows b now"),
        (peers.KnownMeanAccuracyRobot, "none", "knows its mean"),
        (peers.LossyRobot, "asdf-plus", "ASDF+"),
        (peers.five_liars, "robust", "robust"),
        (peers.WmsrRobot, "none", "W-MSR"),
        (peers.wmsr_robots_and_five_liars, "none", "W-MSR"),
        (peers.TrimmedMeanRobot, "none", "trimmed mean"),
        (peers.trimmed_mean_robots_and_five_liars, "none", "trimmed mean"),
        (peers.MajorityRobot, "none", "DMMD"),
        (peers.majority_robots_and_five_liars, "none", "DMMD"),
        (reading_pairs.TwoReadingsRobot, "robust", "two readings"),
    ],
)
def test_a_column_is_named_after_its_peer_or_filter(firmware: Any, filter_name: str, label: str) -> None:
    assert peers.column_label(Experiment(firmware=firmware, filter=filter_name)) == label


def test_every_peer_has_a_column_of_its_own() -> None:
    rows = [*robust_filter.peer_rows().values(), *ageing.peer_rows().values()]
    experiments = [experiment for row in rows for experiment in row if experiment.firmware != "native"]

    assert {peers.column_label(experiment) for experiment in experiments} == {
        "no filter with memory",
        "ASDF- with memory",
        "BayesCPF",
        "knows b now",
        "knows its mean",
    }


# --- By hand ---------------------------------------------------------------------------------------------

WITHOUT_FILTER = Config(filter=Filter.OFF, filter_period=4)
EVERY_ROUND = Config(filter=Filter.ALWAYS, filter_period=1)


def test_a_remembering_robot_starts_with_its_own_estimate() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 0, 0.9)
    robot.observe(Observation.BLACK)
    assert (robot.x, robot.x_bar) == (robot.x_hat, 0.5)


def test_a_robot_with_a_memory_averages_messages_by_their_confidence_per_observation() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 0, 0.9)
    robot.observe(Observation.BLACK)
    robot.observe(Observation.WHITE)
    robot.receive(1, 0.2, 8.0)  # alpha 8 by two observations: weight 4
    robot.receive(2, 0.8, 4.0)  # weight 2
    gain = 1 / 8  # of each of the first messages in the running means, which begin at 0
    weight = gain * 4
    weighted_sum = gain * 4 * 0.2
    weight += gain * (2 - weight)
    weighted_sum += gain * (2 * 0.8 - weighted_sum)

    assert robot.x == robot.x_bar == pytest.approx(weighted_sum / weight)


def test_a_robot_with_a_memory_ignores_messages_without_confidence() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 127, 0.9)
    robot.observe(Observation.BLACK)
    for sender in range(63):
        robot.receive(sender, 0.9, 0.0)
    robot.receive(63, 0.2, 8.0)
    gain_of_first_message = 1 / 8

    assert robot.x_bar == pytest.approx(0.2)
    assert robot._weight == gain_of_first_message * 8.0


def test_a_robot_with_a_memory_ignores_a_repeated_message() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 0, 0.9)
    robot.receive(1, 0.2, 8.0)
    weight = robot._weight

    assert robot.receive(1, 0.9, 8.0) is Status.REPEATED
    assert robot._weight == weight


def test_the_gain_of_a_remembering_robot_falls_from_the_64th_message() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 127, 0.9)
    robot.observe(Observation.BLACK)
    for sender in range(63):
        robot.receive(sender, 1.0, 1.0)
    weight = 1 - (7 / 8) ** 63  # a running mean of 63 ones, each with a gain of 1/8
    assert robot._weight == pytest.approx(weight)
    robot.receive(63, 1.0, 1.0)

    assert robot._weight == pytest.approx(weight + (1 - weight) / 16)


def bayescpf_robot(robot_class: type[peers.BayesCpfRobot] = peers.BayesCpfRobot) -> peers.BayesCpfRobot:
    """Make a robot that has read 60 of 100 tiles as black since the last update, with x = 0.7, then 0.4."""
    robot = robot_class(EVERY_ROUND, 0, 0.8)
    robot._n_since_update, robot._t_since_update = 60, 100
    robot._x_since_update = [0.7, 0.4]
    return robot


def posterior_b_hat(prior_mean: float, prior_variance: float) -> float:
    """Return the mean of b after 60 black readings of 100 with x = 0.6, by Bayes' rule for normal numbers."""
    x = (2 * 0.7 + 0.4) / 3
    slope = 100 * (2 * x - 1)
    black_rate = x * prior_mean + (1 - x) * (1 - prior_mean)
    measured_deviation = 60 - 100 * black_rate
    noise = 100 * ((2 * prior_mean - 1) ** 2 * (x - x**2 - 0.25) + 0.25)
    precision = 1 / prior_variance + slope**2 / noise
    return prior_mean + slope * measured_deviation / noise / precision


def test_bayescpf_updates_b_by_bayes_rule() -> None:
    """Before its first update it assumes the accuracy of its start, 0.8, with a standard deviation of 0.2."""
    b_hat = bayescpf_robot().reestimate_b_hat()
    assert b_hat == pytest.approx(posterior_b_hat(prior_mean=0.8, prior_variance=0.2**2))


def test_bayescpf_is_less_uncertain_after_an_update() -> None:
    """The precision, 1 / variance, of b grows by what 100 readings with x = 0.6 say about it.

    With the formulas of ``posterior_b_hat``, where 2 b - 1 is 0.6 for the prior mean, 0.8.
    """
    robot = bayescpf_robot()

    robot.reestimate_b_hat()

    x = 0.6
    slope = 100 * (2 * x - 1)
    noise = 100 * (0.6**2 * (x - x**2 - 0.25) + 0.25)
    prior_variance = 0.04
    assert robot._variance == pytest.approx(1 / (1 / prior_variance + slope**2 / noise))


def test_bayescpf_measures_only_what_came_since_the_last_update() -> None:
    """The robot updates its accuracy at the end of each round, too, which uses up the counts."""
    robot = bayescpf_robot()
    robot.reestimate_b_hat()
    robot.observe(Observation.BLACK)

    robot.settle()

    assert robot._n_since_update == 0
    assert robot._t_since_update == 0
    assert robot._x_since_update == []


def test_bayescpf_does_not_measure_few_observations() -> None:
    """The number of readings that the sensor gets wrong has to be 5 at least: here it is 24 x (1 - 0.8)."""
    robot = bayescpf_robot()
    robot._t_since_update = 24
    assert robot.reestimate_b_hat() is None


@pytest.mark.parametrize(("filter_choice", "updates"), [(Filter.OFF, 0), (Filter.ALWAYS, 1)])
def test_bayescpf_updates_at_every_filter_step_unless_the_filter_is_off(
    filter_choice: Filter, updates: int
) -> None:
    """The robot filters in every hundredth step, and takes a hundred."""
    robot = peers.BayesCpfRobot(Config(filter=filter_choice, filter_period=100), 0, 0.8)
    for _ in range(100):
        robot.step(Observation.BLACK)
    assert robot.counters.updates == updates


@pytest.mark.parametrize("mean", [0.4, 0.49, 0.5, 1.0, 1.02, 1.3])
def test_bayescpf_cuts_its_estimate_as_a_truncated_normal_distribution(mean: float) -> None:
    """It is the mean of a normal distribution of which only the possible accuracies, 0.5 to 1, are left."""
    robot = bayescpf_robot()
    deviation = 0.1
    robot._mean, robot._variance = mean, deviation**2

    lowest, highest = (0.5 - mean) / deviation, (1 - mean) / deviation
    expected = truncnorm.mean(lowest, highest, loc=mean, scale=deviation)
    assert robot._truncated_mean() == pytest.approx(expected)


def test_bayescpf_does_not_cut_an_estimate_far_outside_the_possible_range() -> None:
    """A mean of 3 with a deviation of 0.01: next to nothing of the distribution is between 0.5 and 1."""
    robot = bayescpf_robot()
    robot._mean, robot._variance = 3.0, 1e-4
    assert robot._truncated_mean() == 3.0


def test_bayescpf_for_ageing_sensors_moves_its_estimate_by_the_drift() -> None:
    """Its accuracy falls by 1e-5 with each of the 100 readings before the update."""
    robot = bayescpf_robot(peers.DriftingBayesCpfRobot)
    assert robot.reestimate_b_hat() == pytest.approx(posterior_b_hat(0.8 - 100 * 1e-5, 0.04))


def test_bayescpf_for_wandering_sensors_is_less_certain_of_its_estimate() -> None:
    """With each of 100 readings the accuracy changes at random, with a standard deviation of 0.001."""
    robot = bayescpf_robot(peers.WanderingBayesCpfRobot)
    assert robot.reestimate_b_hat() == pytest.approx(posterior_b_hat(0.8, 0.04 + 100 * 0.001**2))


def test_a_robot_may_know_its_accuracy_of_the_moment() -> None:
    """By the drift that the study assumes, accuracies fall by 1e-5 with each observation."""
    robot = peers.KnownAccuracyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    b_hats = []
    for _ in range(3):
        robot.observe(Observation.BLACK)
        b_hats.append(robot.b_hat)

    assert b_hats == pytest.approx([0.9, 0.9 - 1e-5, 0.9 - 2e-5])


def test_a_robot_with_a_perfect_sensor_assumes_a_little_less() -> None:
    """The firmware accepts no accuracy of 1, but at most 1 less a margin."""
    robot = peers.KnownAccuracyRobot(WITHOUT_FILTER, 0, 1 - B_HAT_MARGIN)
    robot._true_accuracy = 1.0  # which robots of this class know
    robot.observe(Observation.BLACK)
    assert robot.b_hat == 1 - B_HAT_MARGIN


@pytest.fixture
def drift_of_a_tenth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the accuracy change by -0.1 with each observation."""
    monkeypatch.setattr(peers, "DRIFT_RATE", -0.1)


def test_a_robot_may_know_the_mean_accuracy_of_what_it_counts(drift_of_a_tenth: None) -> None:
    """Its accuracy is 0.9 in the first observation, 0.8 in the second and 0.7 in the third."""
    robot = peers.KnownMeanAccuracyRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    for _ in range(3):
        robot.observe(Observation.BLACK)
    assert robot.b_hat == pytest.approx((0.9 + 0.8 + 0.7) / 3)


@pytest.fixture
def accuracy_without_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the accuracy stay as it is from one observation to the next."""
    monkeypatch.setattr(peers, "DRIFT_RATE", 0.0)


def test_a_robot_that_halves_its_counts_at_the_end_of_its_memory_halves_its_sum_of_accuracies_too(
    accuracy_without_drift: None,
) -> None:
    """The robot assumes the mean accuracy over its observations: the sum of accuracies by their number.

    With a memory of 64 it halves both after 64 observations. So 64 observations with an accuracy of 0.9
    count as 32, and then comes one with an accuracy of 0.6.
    """
    robot = peers.KnownMeanAccuracyRobot(replace(WITHOUT_FILTER, memory=64), robot_id=0, b_hat=0.9)
    for _ in range(64):
        robot.observe(Observation.BLACK)

    robot._true_accuracy = 0.6  # which robots of this class know
    robot.observe(Observation.BLACK)

    assert robot.b_hat == pytest.approx((32 * 0.9 + 0.6) / 33)


# --- Resilient consensus and votes -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("received", "tolerated_liars", "kept"),
    [
        ([0.1, 0.2, 0.6, 0.8], 1, [0.2, 0.6]),
        ([0.6, 0.7, 0.8, 0.9], 1, [0.6, 0.7, 0.8]),  # none is below the own one
        ([0.1, 0.5, 0.5, 0.9], 2, [0.5, 0.5]),  # what equals the own one stays
        ([0.1, 0.9], 0, [0.1, 0.9]),
        ([0.2, 0.3, 0.8], 5, []),  # too few neighbours
        ([], 5, []),
    ],
)
def test_wmsr_removes_the_most_extreme_estimates_on_both_sides_of_the_own_one(
    received: list[float], tolerated_liars: int, kept: list[float]
) -> None:
    mean = sum([0.5, *kept]) / (1 + len(kept))
    assert peers.wmsr_mean(0.5, received, tolerated_liars) == pytest.approx(mean)


def receive_from_neighbours(robot: ReferenceRobot, x_hats: Sequence[float]) -> None:
    """Let a robot receive an estimate from each of its neighbours, all equally confident, in one round."""
    for sender, x_hat in enumerate(x_hats, start=1):
        robot.receive(sender, x_hat, alpha=8.0)
    robot.settle()


def make_wmsr_robot_that_has_seen_black() -> peers.WmsrRobot:
    """Make a robot whose own estimate of the share of black tiles is 1, after one tile."""
    robot = peers.WmsrRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    robot.observe(Observation.BLACK)
    return robot


def test_a_wmsr_robot_with_five_neighbours_is_left_with_its_own_estimate() -> None:
    """W-MSR removes the five lowest estimates below the robot's own one, as five neighbours may be liars.

    So of five estimates below its own one, 1.0, none is left, and the mean x is its own estimate.
    """
    robot = make_wmsr_robot_that_has_seen_black()

    receive_from_neighbours(robot, [0.1, 0.1, 0.1, 0.1, 0.1])

    assert robot.x_hat == 1.0
    assert robot.x == 1.0


def test_a_wmsr_robot_keeps_one_of_six_estimates_on_one_side() -> None:
    """It removes the five lowest, and takes the mean of the sixth, 0.6, and of its own estimate, 1.0."""
    robot = make_wmsr_robot_that_has_seen_black()

    receive_from_neighbours(robot, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])

    assert robot.x == pytest.approx((1.0 + 0.6) / 2)


@pytest.mark.parametrize(
    ("estimates", "mean"),
    [
        ([0.5, 0.0, 1.0, 0.6], 0.55),
        ([0.5, 0.0, 0.9], 1.4 / 3),  # a quarter of three is none
        ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0], 0.45),
    ],
)
def test_a_trimmed_mean_leaves_out_a_quarter_at_either_end(estimates: list[float], mean: float) -> None:
    assert peers.trimmed_mean(estimates, 0.25) == pytest.approx(mean)


def test_a_trimming_robot_counts_its_own_estimate_among_the_others() -> None:
    """Of 0.2, 0.4, 0.6 and its own, 1.0, it leaves out a quarter at either end: 0.2 and 1.0."""
    robot = peers.TrimmedMeanRobot(WITHOUT_FILTER, robot_id=0, b_hat=0.9)
    robot.observe(Observation.BLACK)

    receive_from_neighbours(robot, [0.2, 0.4, 0.6])

    assert robot.x_hat == 1.0
    assert robot.x == pytest.approx((0.4 + 0.6) / 2)


def make_broadcasting_voter(robot_id: int, rounds_left: int) -> peers.MajorityRobot:
    """Make a robot that broadcasts its opinion for some more rounds: black if the id is odd, else white."""
    robot = peers.MajorityRobot(WITHOUT_FILTER, robot_id, 0.9)
    robot._is_disseminating = True
    robot._rounds_left = rounds_left
    return robot


def test_half_of_the_voting_robots_begin_with_either_colour() -> None:
    opinions = [peers.MajorityRobot(WITHOUT_FILTER, robot_id, 0.9).x for robot_id in range(4)]
    assert opinions == [0.0, 1.0, 0.0, 1.0]


def test_a_voting_robot_is_silent_while_it_explores() -> None:
    robot = peers.MajorityRobot(WITHOUT_FILTER, 0, 0.9)
    robot.observe(Observation.BLACK)
    assert robot.alpha == 0.0
    assert make_broadcasting_voter(robot_id=0, rounds_left=5).alpha == 1.0


@pytest.mark.parametrize(("received", "opinion"), [([1.0, 1.0], 1.0), ([1.0], 0.0), ([1.0, 0.0], 0.0)])
def test_a_voting_robot_adopts_the_opinion_of_the_majority(received: list[float], opinion: float) -> None:
    """Opinions are 1.0 for black and 0.0 for white. The robot's own one is white, and counts too.

    So a single neighbour for black makes a tie, in which the robot keeps its opinion.
    """
    robot = make_broadcasting_voter(robot_id=0, rounds_left=1)

    receive_from_neighbours(robot, received)

    assert robot.x == opinion


def test_a_voting_robot_listens_only_in_the_last_30_rounds_in_which_it_broadcasts() -> None:
    robot = make_broadcasting_voter(robot_id=0, rounds_left=31)
    robot.receive(1, x_hat=1.0, alpha=1.0)
    assert robot._opinion_by_sender == {}

    robot.settle()  # ends a round, so 30 are left
    robot.receive(1, x_hat=1.0, alpha=1.0)

    assert robot._opinion_by_sender == {1: Observation.BLACK}


def test_a_voting_robot_ignores_messages_without_confidence() -> None:
    """Two neighbours broadcast black (1.0) with a confidence of 0; the robot stays with white (0.0)."""
    robot = make_broadcasting_voter(robot_id=0, rounds_left=1)
    robot.receive(1, x_hat=1.0, alpha=0.0)
    robot.receive(2, x_hat=1.0, alpha=0.0)
    robot.settle()

    assert robot.x == 0.0


def mean_dissemination(black_readings: int) -> float:
    """Return for how long a robot broadcasts "black" on average after 100 readings, some of them black."""
    robot = peers.MajorityRobot(WITHOUT_FILTER, 1, 0.9)
    durations = []
    for _ in range(2000):
        robot._start_exploration()
        for reading in range(100):
            robot.observe(Observation.BLACK if reading < black_readings else Observation.WHITE)
        robot._start_dissemination()
        durations.append(robot._rounds_left)
    return sum(durations) / len(durations)


@pytest.mark.slow
@pytest.mark.parametrize(("black_readings", "mean"), [(100, 100), (30, 30)])
def test_a_voting_robot_broadcasts_longer_for_a_colour_that_it_reads_more_often(
    black_readings: int, mean: float
) -> None:
    assert mean_dissemination(black_readings) == pytest.approx(mean, rel=0.1)


def test_a_colour_that_was_never_read_is_broadcast_for_one_round() -> None:
    robot = peers.MajorityRobot(WITHOUT_FILTER, 1, 0.9)
    robot.observe(Observation.WHITE)
    robot._start_dissemination()
    assert robot._rounds_left == 1


@pytest.mark.slow
def test_a_vote_finds_the_prevailing_colour() -> None:
    vote: dict[str, Any] = {"firmware": peers.MajorityRobot, "filter": "none"}
    assert error_of(1.0, **vote, fill_ratio=0.75, density=4.0) < 0.1


@pytest.mark.slow
def test_wmsr_withstands_as_many_liars_as_it_knows_of() -> None:
    liars: dict[str, Any] = {
        "topology": "fully-connected",
        "latency": 0,
        "robots": 20,
        "flawed": 0,
        "steps": 2000,
    }

    assert error_of(firmware=peers.wmsr_robots_and_five_liars, filter="none", **liars) < 0.02
    assert error_of(firmware=peers.five_liars, filter="none", **liars) > 0.5


# --- Hard worlds -----------------------------------------------------------------------------------------


def test_a_lossy_radio_loses_three_messages_in_ten() -> None:
    robot = peers.LossyRobot(WITHOUT_FILTER, 0, 0.9)
    for _ in range(1000):
        assert robot.receive_raw(1, 2**22, 2**31) >= Status.OK
        robot.settle()

    assert 660 < robot.counters.accepted < 740


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
def test_the_last_robots_of_a_swarm_lie(make_robot: RobotMaker, liars: int, honest_class: type) -> None:
    swarm = [make_robot(WITHOUT_FILTER, robot_id, 0.9) for robot_id in range(20)]
    assert [type(robot) for robot in swarm] == [honest_class] * (20 - liars) + [peers.Liar] * liars
    assert peers.LIARS[make_robot.__name__] == liars


def test_a_liar_broadcasts_no_black_with_the_largest_confidence() -> None:
    liar = peers.Liar(WITHOUT_FILTER, 0, 0.9)
    liar.observe(Observation.BLACK)
    assert (liar.x_hat_raw, liar.alpha_raw) == (0, ALPHA_MAX)


def test_a_changing_floor_looks_as_if_0_95_were_black_from_the_middle_on() -> None:
    """The tiles stay as they are: 0.55 are black. The sensors' accuracy on white tiles falls after 50 steps.

    So they read as many tiles black as sensors with an accuracy of 0.9 would on a floor of 0.95.
    """
    settings = Experiment(robots=2, flawed=0, steps=100, filter_period=50, fill_ratio=0.55, true_accuracy=0.9)
    floor = peers.ChangingFloor(settings, 0)
    black_of_30_steps, white_of_30_steps = floor.advance(30)
    black_of_70_steps, white_of_70_steps = floor.advance(70)
    accuracies_on_black = np.concatenate([black_of_30_steps, black_of_70_steps])
    accuracies_on_white = np.concatenate([white_of_30_steps, white_of_70_steps]).ravel()

    assert set(accuracies_on_black.ravel()) == {0.9}
    share_of_black_readings = 0.55 * 0.9 + 0.45 * (1 - accuracies_on_white)
    assert share_of_black_readings[:50] == pytest.approx(0.55 * 0.9 + 0.45 * 0.1)
    assert share_of_black_readings[50:] == pytest.approx(0.95 * 0.9 + 0.05 * 0.1)
