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
    slots_with_supporters,
)
from robots import ROBUST


def robot_that_observed(*, black: int, white: int, b_hat: float) -> MirrorRobot:
    """Return a robot in its first round that has observed so many black and white tiles."""
    robot = MirrorRobot(ROBUST, robot_id=127, b_hat=b_hat)
    for _ in range(black):
        robot.observe(Observation.BLACK)
    for _ in range(white):
        robot.observe(Observation.WHITE)
    return robot


def copy_after_round_with(robot: MirrorRobot, estimates: Sequence[int]) -> MirrorRobot:
    """Return a copy of the robot that has received these estimates and ended the round.

    It has tested itself by them if they are five or more.

    The estimates come from robots 0, 1 and so on, in units of 2**-16.
    """
    settled_robot = deepcopy(robot)
    for sender, estimate in enumerate(estimates):
        assert settled_robot.receive_raw(sender, q23_from_q16(estimate), ALPHA_MAX) == Status.OK
    settled_robot.settle()
    return settled_robot


def draw_kept_and_rejected_slots(
    robot: MirrorRobot, count: int, width: int, seed: int
) -> tuple[SlotsAtTest, SlotsAtTest]:
    """Draw estimates by which the robot's test just does not reject, and others by which it just does."""
    pair = draw_slots_at_threshold(robot.s, count, width, Random(seed))
    assert pair is not None
    return pair


# --- Pairs at the threshold of the test ---

for_pairs = pytest.mark.parametrize(
    ("count", "width", "seed"), [(5, 4, 1), (5, 8192, 2), (6, 4, 3), (32, 4, 4), (32, 8192, 5)]
)
"""Number of estimates, how far they are from their middle in units of 2**-16, and the seed of the draw."""


@for_pairs
def test_the_estimates_of_a_pair_differ_by_one_unit_in_one_slot(count: int, width: int, seed: int) -> None:
    """The first estimates of a pair just let a robot keep its b_hat. The second just make it change b_hat.

    A slot holds the estimate of one neighbour, in units of 2**-16. Either of the pair has ``count`` of them,
    which are at most ``width`` units from their middle.
    """
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    kept, rejected = draw_kept_and_rejected_slots(robot, count, width, seed)
    distances = [abs(a - b) for a, b in zip(kept.estimates, rejected.estimates, strict=True)]
    distances_of_equal_slots = [0] * (count - 1)
    assert sorted(distances) == [*distances_of_equal_slots, 1]


@for_pairs
def test_a_robot_keeps_its_b_hat_by_the_first_estimates_of_a_pair(count: int, width: int, seed: int) -> None:
    """b_hat is the accuracy that it assumes of its sensor; the second ones differ from these by a unit.

    There are ``count`` estimates, at most ``width`` units from their middle.
    """
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    kept, _rejected = draw_kept_and_rejected_slots(robot, count, width, seed)

    assert copy_after_round_with(robot, kept.estimates).counters.updates == 0
    assert not kept.is_rejected


@for_pairs
def test_a_robot_re_estimates_b_hat_by_the_second_estimates_of_a_pair(
    count: int, width: int, seed: int
) -> None:
    """b_hat is the accuracy that it assumes of its sensor; the first ones differ from these by a unit.

    There are ``count`` estimates, at most ``width`` units from their middle.
    """
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    _kept, rejected = draw_kept_and_rejected_slots(robot, count, width, seed)

    assert copy_after_round_with(robot, rejected.estimates).counters.updates == 1
    assert rejected.is_rejected
    assert not rejected.is_supported, "more than two fifths agree with the robot, which would keep its b_hat"


@pytest.mark.parametrize(
    ("seed", "is_kept_decided", "is_rejected_decided"),
    [
        pytest.param(21, True, False, id="it rejects if the centre is lower"),
        pytest.param(55, True, False, id="it rejects if the centre is higher"),
        pytest.param(103, False, True, id="it does not reject if the centre is higher"),
        pytest.param(113, False, True, id="it does not reject if the centre is lower"),
    ],
)
def test_few_tests_at_the_threshold_are_decided_by_the_last_bit_of_the_centre(
    seed: int, is_kept_decided: bool, is_rejected_decided: bool
) -> None:
    """The centre of the estimates is in units of 2**-24, and is moved by one. Such estimates are rare."""
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    kept, rejected = draw_kept_and_rejected_slots(robot, count=32, width=8192, seed=seed)
    assert kept.is_decided_by_last_bit == is_kept_decided
    assert rejected.is_decided_by_last_bit == is_rejected_decided


def test_there_is_no_pair_if_no_estimates_contradict_the_robot() -> None:
    """With b_hat = 1/2 a robot predicts half black on any floor, so its test never rejects."""
    robot = robot_that_observed(black=250, white=250, b_hat=0.5)
    assert draw_slots_at_threshold(robot.s, count=5, width=4, rng=Random(1)) is None


def test_there_is_no_pair_if_all_estimates_contradict_the_robot() -> None:
    """With b_hat = 0.6 no fill ratio explains 500 black tiles of 500, so its test always rejects."""
    robot = robot_that_observed(black=500, white=0, b_hat=0.6)
    assert draw_slots_at_threshold(robot.s, count=5, width=4, rng=Random(1)) is None


def test_a_draw_does_not_change_the_robot() -> None:
    """Estimates are drawn for the robot's test, and the cross-check goes on with the same robot."""
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    state_before = robot.state()
    draw_kept_and_rejected_slots(robot, count=5, width=4, seed=1)
    assert robot.state() == state_before


# --- Supporters and opponents of a robot ---


@pytest.mark.parametrize(
    ("supporters", "opponents", "expected_updates"),
    [pytest.param(2, 3, 1, id="two fifths"), pytest.param(3, 4, 0, id="three of seven are more")],
)
def test_a_robot_re_estimates_b_hat_unless_more_than_two_fifths_of_its_neighbours_agree_with_it(
    supporters: int, opponents: int, expected_updates: int
) -> None:
    """Two supporters beside three opponents are too few, so there is an update; three beside four are enough.

    If 2/3 of the tiles are black, a sensor of accuracy 0.8 sees 2/3 * 0.8 + 1/3 * 0.2 = 0.6 of them black. So
    a supporter's estimate, 2/3, agrees with the robot's 300 black tiles of 500, and an opponent's, 0, does
    not. The robot's test rejects b_hat, the accuracy that it assumes, but supporters let it keep b_hat.
    """
    robot = robot_that_observed(black=300, white=200, b_hat=0.8)
    slots = slots_with_supporters(robot.s, count=supporters + opponents, supporter_count=supporters)
    assert slots is not None
    two_thirds = round(2 / 3 * 2**16)  # in units of 2**-16
    assert slots.estimates == (two_thirds,) * supporters + (0,) * opponents
    assert slots.is_rejected, "the test itself, which does not count supporters"

    assert copy_after_round_with(robot, slots.estimates).counters.updates == expected_updates


def test_no_neighbours_can_contradict_a_robot_with_a_b_hat_of_one_half() -> None:
    """Such a robot predicts half black on any floor. No estimates make its test reject: None."""
    robot = robot_that_observed(black=250, white=250, b_hat=0.5)
    assert slots_with_supporters(robot.s, count=5, supporter_count=2) is None


# --- What a test needs beside the estimates ---


@pytest.mark.parametrize(
    ("b_hat", "share_of_black", "expected_fill_ratio"),
    [
        (0.75, 0.5, 1 / 2),
        (0.75, 0.625, 3 / 4),  # 3/4 * 0.75 + 1/4 * 0.25 = 0.625
        (0.25, 0.625, 1 / 4),  # the sensor exchanges the colours more often than not
        (0.75, 0.1, 0),  # less than b_hat predicts of a floor without black tiles
        (0.75, 0.9, 1 - 2**-16),  # more than b_hat predicts of a black floor: the largest estimate
        (0.5, 0.9, 1 / 2),  # no estimate predicts anything but 1/2
    ],
)
def test_the_estimate_that_explains_a_share_of_black_follows_from_b_hat(
    b_hat: float, share_of_black: float, expected_fill_ratio: float
) -> None:
    """If x of a floor is black, a sensor of accuracy b sees x b + (1 - x) (1 - b) of the floor black.

    The estimate is the fill ratio x, in units of 2**-16, that is nearest to explaining the share of black.
    """
    robust = RobustFilter(initial_b_hat=round(b_hat * 2**32))
    estimate = estimate_that_predicts(robust, share_of_black)
    assert estimate == expected_fill_ratio * 2**16


def test_the_dispersion_that_a_robot_will_have_when_its_filter_runs_next_is_known_before() -> None:
    """Dispersion is how much more observations vary from batch to batch than independent ones.

    A run of the robust filter updates it before the test, and ``filter_at_test`` returns the filter's memory
    as it will be then. Here it rises above 1: 100 black tiles after a mixed batch are rare by chance.
    """
    robot = robot_that_observed(black=50, white=50, b_hat=0.8)
    robot.settle()  # ends the batch, and so the next 100 tiles are another one
    for _ in range(100):
        robot.observe(Observation.BLACK)
    predicted_dispersion = filter_at_test(robot.s).dispersion
    robot.settle()  # runs the filter

    one = 2**8  # in units of 2**-8
    assert predicted_dispersion == robot.s.robust.dispersion
    assert predicted_dispersion > one


def test_asking_for_the_filter_at_the_test_does_not_end_the_robot_s_batch() -> None:
    """A batch is the observations between two tests. The robot's first one, which began at 0, goes on.

    ``batch_t`` is the number of observations at its beginning.
    """
    robot = robot_that_observed(black=50, white=50, b_hat=0.8)
    filter_at_test(robot.s)
    assert robot.s.robust.batch_t == 0
