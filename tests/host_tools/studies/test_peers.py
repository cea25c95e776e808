"""Robots and sensors with which the robust filter is compared do what they are for."""

from __future__ import annotations

from typing import Any

import pytest

import mcp_asdf_tools as m
from host_tools.studies.conftest import UNDERCONFIDENT
from mcp_asdf_tools.experiments.trials import run_trials
from mcp_asdf_tools.studies import ageing, peers, robust_filter


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
