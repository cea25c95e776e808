"""Estimates at the threshold of the robust filter's test, as a real robot receives and tests them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from random import Random

import pytest

from mcp_asdf.fixed_point import ALPHA_MAX
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.robot import Observation, Status
from mcp_asdf.robust_filter import RobustFilter, q23_from_q16
from mcp_asdf_tools.crosscheck.crafted_slots import (
    SlotsAtTest,
    draw_slots_at_threshold,
    estimate_that_predicts,
    filter_at_test,
    slots_of_two_parties,
)
from robots import ROBUST


def robot_before_test(t: int, n: int, b_hat: float = 0.8) -> MirrorRobot:
    """Return a robot in its first round that has made ``t`` observations, ``n`` of them black."""
    robot = MirrorRobot(ROBUST, robot_id=127, b_hat=b_hat)
    for index in range(t):
        robot.observe(Observation(index < n))
    return robot


def settle_with(robot: MirrorRobot, estimates: Sequence[int]) -> MirrorRobot:
    """Return a copy of the robot that has received these estimates of robots 0, 1 and so on, and settled."""
    settled_robot = deepcopy(robot)
    for sender, estimate in enumerate(estimates):
        assert settled_robot.receive_raw(sender, q23_from_q16(estimate), ALPHA_MAX) == Status.OK
    settled_robot.settle()
    return settled_robot


def draw_pair(robot: MirrorRobot, count: int, width: int, seed: int) -> tuple[SlotsAtTest, SlotsAtTest]:
    """Draw estimates at the threshold, of which there must be some."""
    pair = draw_slots_at_threshold(robot, count, width, Random(seed))
    assert pair is not None
    return pair


# --- Pairs at the threshold of the test ---

for_pairs = pytest.mark.parametrize(
    ("count", "width", "seed"), [(5, 4, 1), (5, 8192, 2), (6, 4, 3), (32, 4, 4), (32, 8192, 5)]
)
"""Number of estimates, how far they are from their middle in units of 2**-16, and the seed of the draw."""


@for_pairs
def test_the_estimates_of_a_pair_differ_by_one_unit_in_one_slot(count: int, width: int, seed: int) -> None:
    kept, rejected = draw_pair(robot_before_test(t=500, n=300), count, width, seed)
    distances = [abs(a - b) for a, b in zip(kept.estimates, rejected.estimates, strict=True)]
    assert sorted(distances) == [0] * (count - 1) + [1]


@for_pairs
def test_a_robot_keeps_its_b_hat_by_the_first_estimates_of_a_pair(count: int, width: int, seed: int) -> None:
    robot = robot_before_test(t=500, n=300)
    kept, _ = draw_pair(robot, count, width, seed)
    settled_robot = settle_with(robot, kept.estimates)
    assert settled_robot.counters.updates == 0
    assert not kept.is_rejected()


@for_pairs
def test_a_robot_re_estimates_b_hat_by_the_second_estimates_of_a_pair(
    count: int, width: int, seed: int
) -> None:
    robot = robot_before_test(t=500, n=300)
    _, rejected = draw_pair(robot, count, width, seed)
    settled_robot = settle_with(robot, rejected.estimates)
    assert settled_robot.counters.updates == 1
    assert rejected.is_rejected()
    assert not rejected.is_supported


def test_there_is_no_pair_if_the_test_rejects_by_no_estimates() -> None:
    """With b_hat = 1/2 a robot predicts that half of its observations are black, whatever the floor is."""
    robot = robot_before_test(t=500, n=250, b_hat=0.5)
    assert draw_slots_at_threshold(robot, 5, 4, Random(1)) is None


def test_there_is_no_pair_if_the_test_rejects_by_the_estimates_that_explain_the_observations_best() -> None:
    """With b_hat = 0.6 no fill ratio explains that all of 500 observations are black."""
    robot = robot_before_test(t=500, n=500, b_hat=0.6)
    assert draw_slots_at_threshold(robot, 5, 4, Random(1)) is None


def test_a_draw_does_not_change_the_robot() -> None:
    robot = robot_before_test(t=500, n=300)
    state = robot.state()
    draw_pair(robot, 5, 4, seed=1)
    assert robot.state() == state


# --- Two parties ---


def test_two_of_five_supporters_do_not_prevent_a_re_estimate() -> None:
    robot = robot_before_test(t=500, n=300)
    slots = slots_of_two_parties(robot, count=5, supporter_count=2)
    assert slots is not None
    # The share of black, 0.6, is predicted by a fill ratio of 2/3: 43691 / 2**16.
    assert slots.estimates == (43691, 43691, 0, 0, 0)
    assert settle_with(robot, slots.estimates).counters.updates == 1


def test_three_of_seven_supporters_prevent_a_re_estimate() -> None:
    robot = robot_before_test(t=500, n=300)
    slots = slots_of_two_parties(robot, count=7, supporter_count=3)
    assert slots is not None
    assert slots.estimates == (43691, 43691, 43691, 0, 0, 0, 0)
    assert slots.is_rejected()
    assert settle_with(robot, slots.estimates).counters.updates == 0


def test_there_are_no_two_parties_if_the_test_rejects_by_no_estimates() -> None:
    assert slots_of_two_parties(robot_before_test(t=500, n=250, b_hat=0.5), 5, 2) is None


# --- What a test needs beside the estimates ---


@pytest.mark.parametrize(
    ("b_hat", "share", "estimate"),
    [
        (0.75, 0.5, 32768),  # a fill ratio of 1/2
        (0.75, 0.625, 49152),  # 3/4
        (0.25, 0.625, 16384),  # 1/4, as the sensor exchanges the colours more often than not
        (0.75, 0.1, 0),  # less than b_hat predicts of a floor without black tiles
        (0.75, 0.9, 65535),
        (0.5, 0.9, 32768),  # no estimate predicts anything but 1/2
    ],
)
def test_an_estimate_predicts_a_share_of_black(b_hat: float, share: float, estimate: int) -> None:
    robust = RobustFilter(initial_b_hat=round(b_hat * 2**32))
    assert estimate_that_predicts(robust, share) == estimate


def test_the_filter_at_the_test_has_the_dispersion_of_the_robot_after_it() -> None:
    robot = settle_with(robot_before_test(t=100, n=50), [])
    for _ in range(100):
        robot.observe(Observation.BLACK)  # by as many more than expected as is rare of independent ones
    robust = filter_at_test(robot.s)
    robot.settle()
    assert robust.dispersion == robot.s.robust.dispersion > 256


def test_the_filter_at_the_test_is_a_copy() -> None:
    robot = robot_before_test(t=100, n=50)
    filter_at_test(robot.s)
    assert robot.s.robust.batch_t == 0


def test_a_test_decides_by_the_centre_and_the_spread_of_the_estimates() -> None:
    slots = SlotsAtTest((16384,) * 3 + (32768,) * 2, RobustFilter(), t=500, n=300)
    arguments: list[tuple[int, ...]] = []

    def other_test(robust: RobustFilter, *other_arguments: int) -> bool:
        arguments.append(other_arguments)
        return True

    assert slots.is_rejected(other_test)
    # The median is 1/4, and the spread the least one, 2**-12. The two estimates of 1/2 move the centre by two
    # thirds of a spread in the first step; then three at -2/3 balance two that count with a spread each.
    centre = (1 << 22) + 4096 * 2 // 3
    assert arguments == [(500, 300, centre, 4096)]
