"""Parts of the robot in Python at the edges of what they accept, which random calls may never reach."""

from __future__ import annotations

from dataclasses import replace

from mcp_asdf.mirror import MirrorRobot, accuracy_of, is_valid_accuracy, reestimate
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Observation
from robots import NO_FILTER, restore_robot


def test_from_a_mean_of_the_neighbours_too_near_to_a_half_a_robot_re_estimates_no_accuracy() -> None:
    """``reestimate`` returns None if the mean, x_bar, is less than 2**19 units of 2**-32 above 1/2.

    Where half of the tiles are black, good and bad sensors see the same.
    """
    half, least_distance = 2**31, 2**19

    assert reestimate(t=10, n=5, x_bar=half + least_distance) is not None
    assert reestimate(t=10, n=5, x_bar=half + least_distance - 1) is None


def test_the_limit_for_means_below_a_half_is_one_unit_further_from_it() -> None:
    """A mean x_bar below 1/2 is mirrored to 1 - x_bar less a unit of 2**-32, so that a word can hold it.

    ``reestimate`` returns None, and no accuracy, for a mean that is nearer to 1/2 than the limit.
    """
    half, least_distance = 2**31, 2**19 + 1

    assert reestimate(t=10, n=5, x_bar=half - least_distance) is not None
    assert reestimate(t=10, n=5, x_bar=half - least_distance + 1) is None


def test_a_confidence_is_divided_by_as_many_bits_as_in_c() -> None:
    """By eq. 4 it is divided by n (t - n), which may have 62 bits. The C keeps the upper 31 of them.

    With 30 bits one pair of counts in 1500 would give another confidence, and this pair does.
    """
    confidences = []
    for firmware in (MirrorRobot, NativeRobot):
        robot = restore_robot(firmware, NO_FILTER, t=532_056, n=377_654)
        robot.observe(Observation.WHITE)
        confidences.append(robot.alpha_raw)

    confidence_in_python, confidence_in_c = confidences
    assert confidence_in_python == confidence_in_c


def test_an_accuracy_is_damaged_if_a_value_kept_with_it_does_not_follow_from_it() -> None:
    """With an accuracy a robot keeps numbers that follow from it, such as ``rare``, so that it divides less.

    A bit that flips in one of them would change what the robot computes.
    """
    three_quarters = 3 * 2**30  # in units of 2**-32
    accuracy = accuracy_of(three_quarters)
    assert is_valid_accuracy(accuracy)

    damaged_accuracy = replace(accuracy, rare=accuracy.rare + 1)
    assert not is_valid_accuracy(damaged_accuracy)


def test_an_accuracy_below_the_least_one_is_damaged() -> None:
    """The firmware keeps every accuracy at 2**-20 or above, so only a flipped bit can lead below that."""
    least_accuracy = 2**12  # 2**-20 in units of 2**-32
    assert is_valid_accuracy(accuracy_of(least_accuracy))
    assert not is_valid_accuracy(accuracy_of(least_accuracy - 1))
