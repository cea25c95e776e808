"""Robots and sensors with which the robust filter is compared do what they are for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid  # type: ignore[import-untyped]
from scipy.stats import truncnorm  # type: ignore[import-untyped]

import mcp_asdf_tools as m
from host_tools.studies.conftest import UNDERCONFIDENT
from mcp_asdf import Config, Filter, Status
from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.robot import B_HAT_MARGIN, Observation
from mcp_asdf_tools.experiments.experiment import Experiment
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.robots.firmwares import RobotMaker
from mcp_asdf_tools.studies import ageing, peers, robust_filter
from mcp_asdf_tools.studies.ageing_sensors import WanderingSensors
from mcp_asdf_tools.world.sensors import DriftingSensors


def error_of(true_fill_ratio: float = 0.55, **changes: Any) -> float:
    """Return the error at the end of a short trial of 20 moving robots, without the last five."""
    world: dict[str, Any] = {**UNDERCONFIDENT, "topology": "dynamic", "latency": 1, "steps": 4000}
    (experiment,) = m.grid(**{**world, "trials": 1, "seed": 77, **changes})
    x = run_trials(experiment, 0, 1, 50).records["x"][0, -20:, :15]
    return float(abs(x - true_fill_ratio).mean())


@pytest.fixture(scope="module")
def error_without_filter() -> float:
    return error_of(filter="none")


@pytest.fixture(scope="module")
def error_with_robust_filter() -> float:
    return error_of(filter="robust")


@pytest.mark.slow
def test_all_counts_are_a_bound_of_the_robust_filter(
    error_with_robust_filter: float, error_without_filter: float
) -> None:
    bound = error_of(firmware=peers.AllCountsRobot, filter="none")
    assert bound < error_with_robust_filter < error_without_filter / 3


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
def test_a_changing_floor_ends_with_the_other_fill_ratio() -> None:
    world = {"sensor": peers.ChangingFloor, "filter": "none", "flawed": 0, "memory": 1024}
    assert error_of(0.95, **world) < 0.1 < error_of(0.55, **world)


def ageing_error_of(**changes: Any) -> float:
    """Return the error at the end of a short trial in which all sensors lose 0.4 alike."""
    world: dict[str, Any] = {"steps": 4000, "drift": "linear", "drift_rate": -1e-4, "fill_ratio": 0.75}
    robots: dict[str, Any] = {"robots": 10, "flawed": 0, "sensor": peers.KnownSensors, "filter": "none"}
    (experiment,) = m.grid(**{**world, **robots, "seed": 7, "trials": 1, **changes})
    return float(abs(run_trials(experiment, 0, 1, 100).records["x"][0, -5:] - 0.75).mean())


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["reference", peers.OracleRobot])
def test_a_robot_that_knows_its_sensor_now_is_wrong(firmware: Any) -> None:
    assert ageing_error_of(firmware=firmware) > 0.06


@pytest.mark.slow
@pytest.mark.parametrize("memory", [2**31, 1024])
def test_a_robot_that_knows_the_accuracy_of_what_it_counts_is_right(memory: int) -> None:
    assert ageing_error_of(firmware=peers.MeanAccuracyRobot, memory=memory) < 0.03


@pytest.mark.slow
def test_bayescpf_makes_use_of_the_known_drift() -> None:
    knowing, unknowing = (
        ageing_error_of(firmware=firmware, filter="asdf-plus")
        for firmware in (peers.AgeingBayesCpfRobot, peers.BayesCpfRobot)
    )
    assert knowing != unknowing


def test_every_peer_has_a_column_of_its_own() -> None:
    experiments = [*robust_filter.peer_experiments(), *ageing.peer_experiments()]
    firmwares = {experiment.firmware for experiment in experiments} - {"native"}
    labels = {peers.column_label(experiment) for experiment in experiments if experiment.firmware != "native"}
    assert len(firmwares) == 6
    assert labels == {
        "no filter with memory",
        "ASDF- with memory",
        "BayesCPF",
        "all counts",
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


def test_a_remembering_robot_averages_by_alpha_per_observation() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 0, 0.9)
    robot.observe(Observation.BLACK)
    robot.observe(Observation.WHITE)
    robot.receive(1, 0.2, 8.0)  # weight 4, and so is the running mean of weights 4/8
    robot.receive(2, 0.8, 4.0)  # weight 2
    weight = 0.5 + (2 - 0.5) / 8
    weighted_sum = 0.1 + (2 * 0.8 - 0.1) / 8
    assert robot.x == robot.x_bar == pytest.approx(weighted_sum / weight)


def test_messages_without_confidence_are_not_remembered() -> None:
    robot = peers.RememberingRobot(WITHOUT_FILTER, 0, 0.9)
    robot.receive(1, 0.2, 0.0)
    assert robot.x == robot.x_hat == 0.5


def test_a_repeated_message_is_not_remembered() -> None:
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
    weight = 1 - (7 / 8) ** 63
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
    assert bayescpf_robot().reestimate_b_hat() == pytest.approx(posterior_b_hat(0.8, 0.04))


def test_bayescpf_is_less_uncertain_after_an_update() -> None:
    robot = bayescpf_robot()
    robot.reestimate_b_hat()
    slope, noise = 100 * 0.2, 100 * (0.36 * (0.6 - 0.36 - 0.25) + 0.25)
    assert robot._variance == pytest.approx(1 / (1 / 0.04 + slope**2 / noise))


def test_bayescpf_measures_only_what_came_since_the_last_update() -> None:
    robot = bayescpf_robot()
    robot.reestimate_b_hat()
    robot.observe(Observation.BLACK)
    robot.settle()
    assert (robot._n_since_update, robot._t_since_update, robot._x_since_update) == (0, 0, [])


def test_bayescpf_does_not_measure_few_observations() -> None:
    robot = bayescpf_robot()
    robot._t_since_update = 24  # 24 x 0.2 is below 5
    assert robot.reestimate_b_hat() is None


@pytest.mark.parametrize(("filter_choice", "updates"), [(Filter.OFF, 0), (Filter.ALWAYS, 1)])
def test_bayescpf_updates_at_every_filter_step_unless_the_filter_is_off(
    filter_choice: Filter, updates: int
) -> None:
    robot = peers.BayesCpfRobot(Config(filter=filter_choice, filter_period=100), 0, 0.8)
    for _ in range(100):
        robot.step(Observation.BLACK)
    assert robot.counters.updates == updates


@pytest.mark.parametrize("mean", [0.4, 0.49, 1.02, 1.3])
def test_bayescpf_cuts_its_estimate_as_a_truncated_normal_distribution(mean: float) -> None:
    robot = bayescpf_robot()
    robot._mean, robot._variance = mean, 0.01
    expected = truncnorm.mean((0.5 - mean) / 0.1, (1 - mean) / 0.1, mean, 0.1)
    assert robot._truncated_mean() == pytest.approx(expected)


def test_an_estimate_far_outside_stays_where_it_is() -> None:
    robot = bayescpf_robot()
    robot._mean, robot._variance = 3.0, 1e-4
    assert robot._truncated_mean() == 3.0


KNOWN_DRIFT = Experiment(robots=2, flawed=0, steps=200, filter_period=100, drift="linear", drift_rate=-1e-3)
WANDERING = replace(KNOWN_DRIFT, drift="none", drift_rate=0)


def test_bayescpf_for_ageing_sensors_moves_its_estimate_by_the_drift() -> None:
    peers.KnownSensors(KNOWN_DRIFT, 0)
    robot = bayescpf_robot(peers.AgeingBayesCpfRobot)
    assert robot.reestimate_b_hat() == pytest.approx(posterior_b_hat(0.7, 0.04))


def test_bayescpf_for_ageing_sensors_is_less_certain_where_they_wander() -> None:
    peers.KnownWanderingSensors(WANDERING, 0)
    robot = bayescpf_robot(peers.AgeingBayesCpfRobot)
    assert robot.reestimate_b_hat() == pytest.approx(posterior_b_hat(0.8, 0.04 + 100 * 0.001**2))


def test_known_sensors_have_the_accuracy_of_each_robot_and_step() -> None:
    sensors = peers.KnownWanderingSensors(WANDERING, 3)
    wandering = WanderingSensors(WANDERING, 3)
    for _ in range(2):
        sensors.advance(50)
    black, _ = wandering.advance(100)
    assert peers.KnownSensors.newest is sensors
    assert [sensors.true_accuracy(70, robot) for robot in (0, 1)] == black[70].tolist()


def test_known_sensors_are_the_built_in_ones() -> None:
    sensors, built_in = peers.KnownSensors(KNOWN_DRIFT, 3), DriftingSensors(KNOWN_DRIFT, 3)
    black, _ = built_in.advance(100)
    sensors.advance(100)
    assert sensors.true_accuracy(70, 1) == black[70, 0]


def test_one_accuracy_stands_for_all_robots() -> None:
    sensors = peers.KnownSensors(WANDERING, 0)
    sensors.advance(1)
    assert sensors.true_accuracy(0, 1) == sensors.true_accuracy(0, 0) == KNOWN_DRIFT.true_accuracy


def known_accuracies(*accuracies: float) -> None:
    """Let the robots of the newest trial have these accuracies in the first steps."""
    sensors = peers.KnownSensors(KNOWN_DRIFT, 0)
    sensors._accuracies_by_step = [[accuracy] for accuracy in accuracies]


def test_an_oracle_assumes_its_accuracy_of_the_moment() -> None:
    known_accuracies(0.9, 0.7, 1.0)
    robot = peers.OracleRobot(WITHOUT_FILTER, 0, 0.9)
    b_hats = []
    for _ in range(3):
        robot.observe(Observation.BLACK)
        b_hats.append(robot.b_hat)
    assert b_hats == [0.9, 0.7, 1 - B_HAT_MARGIN]


def test_a_robot_may_assume_the_mean_accuracy_of_what_it_counts() -> None:
    known_accuracies(0.9, 0.7, 0.8)
    robot = peers.MeanAccuracyRobot(WITHOUT_FILTER, 0, 0.9)
    for _ in range(3):
        robot.observe(Observation.BLACK)
    assert robot.b_hat == pytest.approx(0.8)


def test_the_sum_of_accuracies_is_halved_with_the_counts() -> None:
    known_accuracies(*[0.9] * 64, 0.6)
    robot = peers.MeanAccuracyRobot(replace(WITHOUT_FILTER, memory=64), 0, 0.9)
    for _ in range(65):
        robot.observe(Observation.BLACK)
    assert robot.b_hat == pytest.approx((32 * 0.9 + 0.6) / 33)


def all_counts_swarm(*counts: tuple[int, int]) -> list[peers.AllCountsRobot]:
    """Make a swarm whose robots have read so many black tiles of so many, and let a filter period pass."""
    swarm = [peers.AllCountsRobot(WITHOUT_FILTER, robot_id, 0.9) for robot_id in range(len(counts))]
    for robot, (black, total) in zip(swarm, counts, strict=True):
        for index in range(total):
            robot.observe(Observation.BLACK if index < black else Observation.WHITE)
    for _ in range(WITHOUT_FILTER.filter_period):
        for robot in swarm:
            robot.settle()
    return swarm


def test_all_counts_agree_with_numerical_integration() -> None:
    (robot,) = all_counts_swarm((7, 10))
    f, b = 0.8, np.linspace(0.5, 1, 20_001)
    p = f * b + (1 - f) * (1 - b)
    # NumPy's own trapezoid came with version 2 only.
    if_wrong = trapezoid(p**7 * (1 - p) ** 3, x=b) / 0.5
    p_right = f * 0.9 + (1 - f) * 0.1
    expected = 0.9 * p_right**7 * (1 - p_right) ** 3 + 0.1 * if_wrong
    likelihood = float(np.exp(np.interp(f, robot._fill_ratios, robot._log_likelihood())))
    assert likelihood == pytest.approx(expected, rel=1e-3)


def test_all_robots_take_the_posterior_mean_of_all_counts() -> None:
    swarm = all_counts_swarm((74, 100), (74, 100), (74, 100))  # of f = 0.8 and b = 0.9
    assert swarm[0].x == swarm[1].x == swarm[2].x == pytest.approx(0.8, abs=0.02)


def test_all_counts_wait_for_the_end_of_a_filter_period() -> None:
    robot = peers.AllCountsRobot(WITHOUT_FILTER, 0, 0.9)
    robot.step(Observation.BLACK)
    assert robot.x == 0.5


def test_a_new_swarm_shares_nothing_with_the_last_one() -> None:
    first, second = all_counts_swarm((9, 10)), all_counts_swarm((1, 10))
    assert (first[0]._swarm, second[0]._swarm) == (first, second)


def test_a_lossy_radio_loses_three_messages_in_ten() -> None:
    robot = peers.LossyRobot(WITHOUT_FILTER, 0, 0.9)
    for _ in range(1000):
        assert robot.receive_raw(1, 2**22, 2**31) >= Status.OK
        robot.settle()
    assert 660 < robot.counters.accepted < 740


@pytest.mark.parametrize(
    ("make_robot", "liars"), [(peers.one_liar, 1), (peers.two_liars, 2), (peers.five_liars, 5)]
)
def test_the_last_robots_of_a_swarm_lie(make_robot: RobotMaker, liars: int) -> None:
    swarm = [make_robot(WITHOUT_FILTER, robot_id, 0.9) for robot_id in range(20)]
    assert [isinstance(robot, peers.Liar) for robot in swarm] == [False] * (20 - liars) + [True] * liars


def test_a_liar_broadcasts_no_black_with_the_largest_confidence() -> None:
    liar = peers.Liar(WITHOUT_FILTER, 0, 0.9)
    liar.observe(Observation.BLACK)
    assert (liar.x_hat_raw, liar.alpha_raw) == (0, ALPHA_MAX)


def test_a_changing_floor_looks_as_if_0_95_were_black_from_the_middle_on() -> None:
    settings = Experiment(robots=2, flawed=0, steps=100, filter_period=50, fill_ratio=0.55, true_accuracy=0.9)
    floor = peers.ChangingFloor(settings, 0)
    black, white = (np.concatenate(parts) for parts in zip(floor.advance(30), floor.advance(70), strict=True))
    assert set(black.ravel()) == {0.9}
    black_readings = 0.55 * 0.9 + 0.45 * (1 - white.ravel())
    assert black_readings[:50] == pytest.approx(0.55 * 0.9 + 0.45 * 0.1)
    assert black_readings[50:] == pytest.approx(0.95 * 0.9 + 0.05 * 0.1)
