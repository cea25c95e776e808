"""Parts of the robot in Python at the edges of what they accept, which random calls may never reach."""

from __future__ import annotations

from dataclasses import replace

from mcp_asdf.arithmetic import Q32_HALF
from mcp_asdf.fixed_point import B_HAT_MIN
from mcp_asdf.mirror import INFORMATIVE_G, accuracy_of, is_valid_accuracy, reestimate
from mcp_asdf.table import MAX_WORD

LEAST_INFORMATIVE_X_BAR = Q32_HALF + INFORMATIVE_G // 2
"""The mean of the neighbours, above 1/2 and in units of 2**-32, for which |2 x_bar - 1| is exactly 2**-12."""


def test_a_robot_re_estimates_its_accuracy_from_the_mean_nearest_to_a_half_that_says_something() -> None:
    """Where the neighbours' mean x_bar is nearer to a half, ``reestimate`` returns None in place of b_hat."""
    assert reestimate(t=10, n=5, x_bar=LEAST_INFORMATIVE_X_BAR) is not None
    assert reestimate(t=10, n=5, x_bar=LEAST_INFORMATIVE_X_BAR - 1) is None


def test_the_limit_for_means_below_a_half_is_two_units_further_from_it() -> None:
    """The mean is mirrored to MAX_WORD - x_bar there: 1 - x_bar less one unit, as no word is 1."""
    nearest_below_half = MAX_WORD - LEAST_INFORMATIVE_X_BAR

    assert reestimate(t=10, n=5, x_bar=nearest_below_half) is not None
    assert reestimate(t=10, n=5, x_bar=nearest_below_half + 1) is None


def test_an_accuracy_is_damaged_if_a_value_kept_with_it_does_not_follow_from_it() -> None:
    """With an accuracy a robot keeps numbers that follow from it, such as ``rare``, so that it divides less.

    A bit that flips in one of them would change what the robot computes.
    """
    three_quarters = 3 * Q32_HALF // 2
    accuracy = accuracy_of(three_quarters)
    assert is_valid_accuracy(accuracy)

    damaged_accuracy = replace(accuracy, rare=accuracy.rare + 1)
    assert not is_valid_accuracy(damaged_accuracy)


def test_an_accuracy_below_the_least_one_is_damaged() -> None:
    assert is_valid_accuracy(accuracy_of(B_HAT_MIN))
    assert not is_valid_accuracy(accuracy_of(B_HAT_MIN - 1))
