"""What the firmware's robust filter must compute, in fractions: the value where one is right, or else bounds.

The exact values come from ``mcp_asdf.robust_reference``. The roundings are those that docs/design.md states
in section 13, and nothing is taken from the firmware.

The firmware's quotient of two numbers, upper() in docs/design.md, is always smaller than the exact one if
that is above 0. With a divisor of at most 32 bits it is smaller by at most 2**-30 of it plus one unit of
2**-32.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil
from statistics import median

from mcp_asdf.robust_reference import (
    DISPERSION_MAX,
    DISPERSION_MIN,
    DISPERSION_SHIFT,
    HUBER_STEPS,
    REJECTED_SIGMAS_SQUARED,
    Observations,
    Votes,
    huber_step,
    probability_of_black,
    robust_test_sides,
    spread_around,
    votes_after,
)
from mcp_asdf_tools.crosscheck.bounds import HALF, Q22, Q24, Q30, Q32, ROBUST_TEST_MARGIN, Bounds, round_down

Q8, Q11, Q16 = (Fraction(1, 2**bits) for bits in (8, 11, 16))

SUPPORT_MARGIN = 10 * Q32
"""The firmware is right about a supporter if its distances from both shares differ by more than this.

A probability of black lacks less than 4 units of 2**-32, and n/t less than 5."""

LARGEST_ESTIMATE = 1 - Q16
"""Largest estimate in a slot, which has 16 bits."""


def slot_estimate(x_hat: Fraction) -> Fraction:
    """Return the estimate that a slot must hold for this x_hat: the nearest multiple of 2**-16 below 1.

    Halves are rounded up.
    """
    half_unit = Q16 / 2
    nearest = round_down(x_hat + half_unit, Q16)
    return min(nearest, LARGEST_ESTIMATE)


def round_towards_0(value: Fraction, unit: Fraction) -> Fraction:
    """Return the multiple of ``unit`` next to ``value`` on the side of 0."""
    units = int(value / unit)  # int rounds towards 0
    return units * unit


def rounded_votes_after(votes: Votes[Fraction], x_hat: Fraction) -> Votes[Fraction]:
    """Return the summary of the votes that the firmware must have after one more vote, ``x_hat``.

    A vote pulls the centre of all votes towards itself, and widens or narrows their spread; `votes_after`
    says exactly by how much. The firmware's centre and spread are multiples of 2**-30, and it rounds their
    changes towards 0 to such multiples.
    """
    exact = votes_after(votes, x_hat)
    # The firmware shifts distances, which are not negative, and applies the sign afterwards.
    centre_change = round_towards_0(exact.centre - votes.centre, Q30)
    spread_change = round_towards_0(exact.spread - votes.spread, Q30)
    return Votes(votes.centre + centre_change, votes.spread + spread_change, exact.count)


# ---- The dispersion ----


def dispersion_bounds(
    observations: Observations[Fraction], batch_black_count: int, batch_count: int
) -> Bounds:
    """Return the bounds of the dispersion after a batch of observations: multiples of 2**-8.

    The dispersion says how much more a robot's observations vary from batch to batch than independent ones.
    The batch has ``batch_count`` observations, ``batch_black_count`` of them black. ``observations`` are all
    observations of the robot, with the batch's, and have the dispersion before the batch. An empty batch, or
    one of a robot that has never observed black, does not change the dispersion. The bounds are wide where
    the variance of n/t is of the size of its rounding error, as next to 0.
    """
    old_dispersion, share = observations.dispersion, observations.share
    if batch_count == 0 or share == 0:
        return old_dispersion, old_dispersion
    ratio_limit = REJECTED_SIGMAS_SQUARED * old_dispersion  # a batch of a larger ratio counts with this one
    share_bounds = _smallest_quotient(share), share
    smallest_ratio, largest_ratio = _ratio_bounds(share_bounds, batch_black_count, batch_count, ratio_limit)
    smallest_dispersion = _rounded_dispersion(old_dispersion, smallest_ratio)
    largest_dispersion = _rounded_dispersion(old_dispersion, largest_ratio)
    return smallest_dispersion, largest_dispersion


def _smallest_quotient(exact: Fraction) -> Fraction:
    """Return the smallest number that the firmware may have in place of an exact quotient of 0 or more."""
    return max(exact * (1 - Q30) - Q32, Fraction(0))


def _ratio_bounds(
    share_bounds: Bounds, batch_black_count: int, batch_count: int, ratio_limit: Fraction
) -> Bounds:
    """Return the bounds of a batch's ratio: the square of its deviation, divided by its variance.

    The deviation is that of its number of black observations from the expected one, and the variance that of
    independent observations. Both depend on the share of black, which is within ``share_bounds``. A ratio
    above ``ratio_limit`` counts as the limit. If by rounding the firmware may find a variance of 0, the
    bounds are 0 and the limit.
    """
    smallest_variance, largest_variance = _variance_bounds(share_bounds, batch_count)
    smallest_deviation, largest_deviation = _deviation_bounds(share_bounds, batch_black_count, batch_count)
    # The firmware also limits the square of the deviation, to that with the largest ratio.
    smallest_square_limit = round_down(ratio_limit * smallest_variance, Q22)
    largest_square_limit = ratio_limit * largest_variance
    if smallest_square_limit <= 0:
        # The firmware finds a variance of 0, and keeps the dispersion. Or it finds one that is near to 0, so
        # that the ratio may have any size up to its limit.
        return Fraction(0), ratio_limit
    # It divides the square of the deviation by its limit, and multiplies the ratio's limit by this quotient.
    # A square above its limit counts as the limit, so that the quotient is at most 1.
    smallest_exact_quotient = min(smallest_deviation**2 / largest_square_limit, Fraction(1))
    largest_quotient = min(largest_deviation**2 / smallest_square_limit, Fraction(1))
    smallest_ratio = ratio_limit * _smallest_quotient(smallest_exact_quotient)
    largest_ratio = ratio_limit * largest_quotient
    return smallest_ratio, largest_ratio


def _variance_bounds(share_bounds: Bounds, batch_count: int) -> Bounds:
    """Return the bounds of the variance of the number of black ones among independent observations.

    There are ``batch_count`` observations. The firmware computes the variance from a share of black within
    ``share_bounds``, and rounds the variance of one observation down to 2**-32. The variance is largest for a
    share of 1/2.
    """
    smallest_share, largest_share = share_bounds
    # Variances of one observation
    variances_at_bounds = [share * (1 - share) for share in share_bounds]
    smallest = min(variances_at_bounds) - Q32
    largest = max(variances_at_bounds)
    if smallest_share < HALF < largest_share:
        largest = Fraction(1, 4)  # that of a share of 1/2
    return batch_count * smallest, batch_count * largest


def _deviation_bounds(share_bounds: Bounds, batch_black_count: int, batch_count: int) -> Bounds:
    """Return the bounds of how far the number of black observations in a batch is from the expected one.

    The firmware expects the batch's count times a share of black within ``share_bounds``, and rounds the
    distance down to 2**-11.
    """
    smallest_share, largest_share = share_bounds
    least_deviation = batch_black_count - batch_count * largest_share
    greatest_deviation = batch_black_count - batch_count * smallest_share
    distances = [abs(least_deviation), abs(greatest_deviation)]
    smallest_distance = min(distances)
    if least_deviation < 0 < greatest_deviation:
        smallest_distance = Fraction(0)  # A share between the bounds may give the very number.
    return round_down(smallest_distance, Q11), max(distances)


def _rounded_dispersion(old_dispersion: Fraction, ratio: Fraction) -> Fraction:
    """Return the dispersion that the firmware has after a batch of this ratio (`_ratio_bounds`).

    The dispersion is a moving average of ratios, in which the one before the batch has a weight of 7/8. The
    firmware rounds ratio and average down to multiples of 2**-8, and limits the average to DISPERSION_MIN ..
    DISPERSION_MAX.
    """
    weight_sum = 2**DISPERSION_SHIFT  # of which the new ratio has 1
    weighted_sum = (weight_sum - 1) * old_dispersion + round_down(ratio, Q8)
    average = round_down(weighted_sum / weight_sum, Q8)
    return min(max(average, Fraction(DISPERSION_MIN)), Fraction(DISPERSION_MAX))


# ---- The test ----


def rounded_centre_and_spread(estimates: Sequence[Fraction]) -> tuple[Fraction, Fraction]:
    """Return the centre and the spread of estimates that the firmware must have, as multiples of 2**-24.

    The centre is found by a few steps from the median, and limited to the range of estimates in slots. The
    estimates are multiples of 2**-16, so that their median and their spread need no rounding.
    """
    middle = median(estimates)
    spread = spread_around(estimates, middle)
    centre = middle
    for _ in range(HUBER_STEPS):
        step = huber_step(estimates, centre, spread)
        # The firmware's quotient is always a little too small. So a step is shortened to the next smaller
        # multiple of 2**-24, even if it is such a multiple already.
        units = max(ceil(abs(step) / Q24) - 1, 0)
        if step > 0:
            centre += units * Q24
        else:
            centre -= units * Q24
        centre = min(max(centre, Fraction(0)), LARGEST_ESTIMATE)
    return centre, spread


def robust_test_outcome(
    observations: Observations[Fraction], b: Fraction, centre: Fraction, spread: Fraction
) -> bool | None:
    """Return whether the robust filter's test rejects ``b``, or None if rounding in the firmware may decide.

    The test rejects if the squared difference of the share of black and its probability is above a limit.
    Rounding may decide if these two differ by no more than 2**-13 of the larger one.
    """
    difference_squared, limit = robust_test_sides(observations, b, centre, spread)
    # With g = 2 b - 1, the test rejects if (n/t - p)**2 is above 12 (dispersion v/t + g**2 spread**2). Here
    # p is the probability of black by b and the centre, and v the larger of p (1 - p) and n/t (1 - n/t).
    margin = ROBUST_TEST_MARGIN * max(difference_squared, limit)
    if abs(difference_squared - limit) <= margin:
        return None
    return difference_squared > limit


def support_outcome(
    observations: Observations[Fraction], b: Fraction, estimates: Sequence[Fraction], centre: Fraction
) -> bool | None:
    """Return whether more than two of five estimates support the robot, or None if rounding may decide.

    By ``b`` an estimate predicts a share of black observations. It supports the robot if that is nearer to
    the robot's share than to the share that the centre predicts.
    """
    prediction_of_centre = probability_of_black(b, centre)
    certain_supporters = possible_supporters = 0
    for estimate in estimates:
        prediction = probability_of_black(b, estimate)
        distance_from_centre = abs(prediction - prediction_of_centre)
        distance_from_robot = abs(prediction - observations.share)
        # In the firmware, rounding may change the sign of a lead that is within SUPPORT_MARGIN of 0.
        lead = distance_from_centre - distance_from_robot
        if lead > SUPPORT_MARGIN:
            certain_supporters += 1
        if lead > -SUPPORT_MARGIN:
            possible_supporters += 1
    is_certainly_supported = 5 * certain_supporters > 2 * len(estimates)
    is_possibly_supported = 5 * possible_supporters > 2 * len(estimates)
    if is_certainly_supported != is_possibly_supported:
        return None
    return is_certainly_supported
