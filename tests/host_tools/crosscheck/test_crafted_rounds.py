"""Estimates that the cross-check crafts for a robot's test, against exact arithmetic that is written here.

A round is the estimates that a robot receives between two broadcasts. At its end the robot's filter tests by
them whether b_hat, the accuracy that the robot assumes of its sensor, can be right.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import HALF, ONE, alpha_units
from mcp_asdf.table import Table
from mcp_asdf_tools.crosscheck.crafted_rounds import (
    ALPHA_ONE,
    NeighbourEstimate,
    RobotState,
    Update,
    classify_update,
    draw_round_for_update,
    draw_round_of_distant_sum,
    draw_round_of_large_scatter,
    draw_rounds_at_threshold,
    draw_x_hats_at_threshold,
    scatter_of,
)
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import slow

TABLE = generate(parse_omega("0.05"), 127)
"""The table of the firmware's default test, for 127 neighbours."""
for_every_omega = pytest.mark.parametrize("omega", ["0.05", *slow(["0.000000001", "0.5", "0.9"])])
"""Type II error probabilities of the test, from a usual to an extreme tolerance."""
x_hats_of_robots = st.integers(0, ONE)
sizes_of_rounds = st.sampled_from([2, 3, 5, 10, 30, 126])
seeds = st.integers(0, 2**32)


def is_rejected(x_hats: Sequence[int], own_x_hat: int, k: Fraction) -> bool:
    """Return whether the filter's test rejects by eq. 12, computed exactly.

    It does if the neighbours' mean is so far from a robot's own x_hat that the squared distance is above k
    times the neighbours' variance (that of all of them, with m and not m - 1 in its denominator).
    """
    m = len(x_hats)
    mean = Fraction(sum(x_hats), m)
    variance = Fraction(sum(x_hat**2 for x_hat in x_hats), m) - mean**2
    return (mean - own_x_hat) ** 2 > k * variance


def table_of(omega: str) -> Table:
    """Return the table for 127 neighbours, which is generated once."""
    return generate(parse_omega(omega), 127)


def threshold_of(omega: str, m: int) -> Fraction:
    """Return k_m, the test's threshold for m messages, which a table has in units of 2**-26."""
    return Fraction(table_of(omega).entry(m), 2**26)


def robot_with_test(own_x_hat: int, omega: str) -> RobotState:
    """Return a robot with an x_hat of its own and a table for the test; it has 500 observations."""
    return RobotState(t=500, n=300, x_hat=own_x_hat, table=table_of(omega))


def x_hats_of(estimates: Sequence[NeighbourEstimate]) -> list[int]:
    """Return the x_hat of each estimate."""
    return [estimate.x_hat for estimate in estimates]


# --- Rounds at the threshold of the test: one just inside, which passes, and one just outside ------------


@for_every_omega
@given(own_x_hat=x_hats_of_robots, m=sizes_of_rounds, seed=seeds)
@settings(max_examples=8, deadline=None)
def test_estimates_just_inside_the_filter_s_threshold_pass_and_those_just_outside_are_rejected(
    omega: str, own_x_hat: int, m: int, seed: int
) -> None:
    """The cross-check sends m estimates so near the threshold k that a robot with a wrong threshold shows.

    With a threshold that is wrong by a millionth the test decides differently. The threshold follows from
    ``omega``.
    """
    robot = robot_with_test(own_x_hat, omega)
    passing_estimates, rejected_estimates = draw_rounds_at_threshold(robot, m, rng=Random(seed))
    inside, outside = x_hats_of(passing_estimates), x_hats_of(rejected_estimates)
    k = threshold_of(omega, m)
    millionth = k / 1_000_000

    assert len(inside) == len(outside) == m
    assert not is_rejected(inside, own_x_hat, k)
    assert is_rejected(inside, own_x_hat, k - millionth)
    assert is_rejected(outside, own_x_hat, k)
    assert not is_rejected(outside, own_x_hat, k + millionth)


# design: R24
@for_every_omega
def test_most_drawn_estimates_are_decided_by_the_last_bits_of_the_threshold(omega: str) -> None:
    """More than 50 of 100 drawn pairs are decided differently if the threshold changes by a part in 2**24.

    The first of a pair just passes the test, the second is just rejected. So a robot whose threshold has a
    wrong last bit shows.
    """
    rng = Random(5)
    rejected_by_smaller_threshold = 0
    passed_by_larger_threshold = 0
    for _ in range(100):
        m = rng.randint(2, 127)  # number of estimates
        own_x_hat = rng.randint(0, ONE)
        entry_for_m = table_of(omega).entry(m)
        pair = draw_x_hats_at_threshold(own_x_hat, table_entry=entry_for_m, m=m, rng=rng, distance_share=1)
        if pair is not None:
            passing, rejected = pair
            threshold = threshold_of(omega, m)
            last_bits = threshold / 2**24
            if is_rejected(passing, own_x_hat, threshold - last_bits):
                rejected_by_smaller_threshold += 1
            if not is_rejected(rejected, own_x_hat, threshold + last_bits):
                passed_by_larger_threshold += 1

    assert rejected_by_smaller_threshold > 50
    assert passed_by_larger_threshold > 50


@given(own_x_hat=x_hats_of_robots, m=st.integers(2, 127), seed=seeds)
@settings(max_examples=40, deadline=None)
def test_drawn_estimates_are_fill_ratios_between_0_and_1(own_x_hat: int, m: int, seed: int) -> None:
    """Estimates are in units of 2**-23, so ONE stands for 1. With a share of 1 they may fill 0 to ONE.

    A robot gets m of them. Its test has a threshold for each m, which is an entry of its table. Two lists are
    drawn: of estimates just inside the threshold, and of estimates just outside.
    """
    rng = Random(seed)
    pair = draw_x_hats_at_threshold(own_x_hat, table_entry=TABLE.entry(m), m=m, rng=rng, distance_share=1)
    assume(pair is not None)  # hypothesis tries other numbers where the estimates have no room
    assert pair is not None  # tells mypy
    inside, outside = pair

    for x_hat in [*inside, *outside]:
        assert 0 <= x_hat <= ONE


def test_no_estimates_are_drawn_if_they_would_differ_by_less_than_a_unit() -> None:
    """The estimates may fill 1 / 2**30 of the 2**22 units of room on either side of the robot's own x_hat."""
    half = 2**22  # of 2**23 units
    pair = draw_x_hats_at_threshold(
        half, table_entry=TABLE.entry(5), m=5, rng=Random(1), distance_share=2**-30
    )
    assert pair is None


def test_rejected_estimates_at_the_threshold_change_b_hat() -> None:
    """b_hat is the accuracy that a robot assumes. The estimates that its test rejects must change it.

    Otherwise the verification would not notice a robot that does not reject them.
    """
    robot = RobotState(t=500, n=300, x_hat=ONE // 3, table=TABLE)
    # Two rounds of 3 estimates, on either side of the test's threshold: it just rejects the second.
    _passing_estimates, rejected_estimates = draw_rounds_at_threshold(robot, m=3, rng=Random(1))
    assert robot.update_after(rejected_estimates) not in (None, Update.KEPT)


# --- Other rounds that the test decides ---


@for_every_omega
@given(own_x_hat=x_hats_of_robots)
@settings(max_examples=15, deadline=None)
def test_widely_scattered_estimates_pass_the_test(omega: str, own_x_hat: int) -> None:
    """The test rejects if their mean is far off for their variance, which is large as all are 0 or 1.

    There are 126 of them.
    """
    robot = robot_with_test(own_x_hat, omega)
    estimates = draw_round_of_large_scatter(robot, rng=Random(1))
    x_hats = x_hats_of(estimates)
    assert not is_rejected(x_hats, own_x_hat, threshold_of(omega, m=126))


@for_every_omega
@given(own_x_hat=x_hats_of_robots)
@settings(max_examples=15, deadline=None)
def test_widely_scattered_estimates_would_be_rejected_by_firmware_with_a_sum_of_56_bits(
    omega: str, own_x_hat: int
) -> None:
    """So they show such a mistake. The test rejects if (sum - m x_hat)^2 is above k times the scatter.

    The scatter is m times the sum of the squared estimates, less the square of their sum. It needs more than
    56 bits. There are 126 estimates.
    """
    robot = robot_with_test(own_x_hat, omega)
    estimates = draw_round_of_large_scatter(robot, rng=Random(1))
    x_hats = x_hats_of(estimates)
    difference_squared = (sum(x_hats) - 126 * own_x_hat) ** 2
    scatter_in_56_bits = scatter_of(x_hats) % 2**56
    k = threshold_of(omega, m=126)
    assert difference_squared > k * scatter_in_56_bits


@given(own_x_hat=x_hats_of_robots)
@settings(max_examples=15, deadline=None)
def test_estimates_far_from_the_robot_s_own_are_rejected(own_x_hat: int) -> None:
    """The 126 estimates are near each other, and their mean is far from the robot's own x_hat."""
    robot = robot_with_test(own_x_hat, omega="0.05")
    estimates = draw_round_of_distant_sum(robot, rng=Random(1))
    x_hats = x_hats_of(estimates)
    assert is_rejected(x_hats, own_x_hat, threshold_of(omega="0.05", m=126))


@given(own_x_hat=x_hats_of_robots)
@settings(max_examples=15, deadline=None)
def test_estimates_far_from_the_robot_s_own_would_pass_in_firmware_with_54_bits(own_x_hat: int) -> None:
    """So they show such a mistake: the lowest 54 bits of the squared difference are 0, as if all agreed.

    The difference is that of the sum of 126 estimates from 126 times the robot's own.
    """
    robot = robot_with_test(own_x_hat, omega="0.05")
    estimates = draw_round_of_distant_sum(robot, rng=Random(1))
    x_hats = x_hats_of(estimates)
    difference = sum(x_hats) - 126 * own_x_hat
    lowest_54_bits = difference**2 % 2**54
    assert lowest_54_bits == 0


# --- Updates ---


@pytest.mark.parametrize(
    ("distance", "expected_update"),
    [
        (-(2**27), Update.BELOW),
        (-(2**27) + 1, Update.FAINT),
        (-(2**19), Update.FAINT),
        (-(2**19) + 1, Update.HALF),
        (0, Update.HALF),
        (2**19 - 1, Update.HALF),
        (2**19, Update.FAINT),
        (2**27 - 1, Update.FAINT),
        (2**27, Update.ABOVE),
    ],
)
def test_a_new_b_hat_is_classified_by_its_distance_from_one_half(
    distance: int, expected_update: Update
) -> None:
    """b_hat is the accuracy that a robot assumes of its sensor, in units of 2**-32; 2**31 are one half.

    Nearer to 1/2 than 2**-13 it is as good as 1/2, as |2 b_hat - 1| is below the firmware's limit of 2**-12.
    Nearer than 2**-5 it is faint, that is, nearly without information. Otherwise it is above or below 1/2.
    """
    one_half = 2**31
    assert classify_update(one_half + distance) is expected_update


def test_no_new_b_hat_is_classified_as_one_that_is_kept() -> None:
    """A robot that re-estimates b_hat, the accuracy that it assumes, may keep it. So there is no new one."""
    no_new_b_hat = None
    assert classify_update(no_new_b_hat) is Update.KEPT


THREE_ESTIMATES_NEAR_A_QUARTER = [
    NeighbourEstimate(x_hat=ONE // 4 + 1, alpha=ALPHA_ONE),
    NeighbourEstimate(x_hat=ONE // 4 - 1, alpha=ALPHA_ONE),
    NeighbourEstimate(x_hat=ONE // 4 + 1, alpha=ALPHA_ONE),
]


def test_estimates_near_the_robot_s_own_do_not_change_its_assumed_accuracy() -> None:
    """Three estimates of about 1/4 agree with the robot's own, 1/4, so the filter's test does not reject.

    60 of the robot's 100 observations are black. None says that it keeps b_hat, the accuracy that it assumes.
    """
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=TABLE)
    assert robot.update_after(THREE_ESTIMATES_NEAR_A_QUARTER) is None


def test_a_single_estimate_is_too_few_for_a_test() -> None:
    """The estimate 1 is far from the robot's own, 1/4. Yet the robot does not change b_hat: None."""
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=TABLE)
    estimate = NeighbourEstimate(x_hat=ONE, alpha=ALPHA_ONE)
    assert robot.update_after([estimate]) is None


@pytest.mark.parametrize("count", [1, 3])
def test_a_robot_without_a_test_changes_its_assumed_accuracy_by_any_estimates(count: int) -> None:
    """Without a table it has no test, and one estimate is enough. It gets one or three of about 1/4.

    If 1/4 of the tiles is black and 60 % look black, the sensor errs more often than not: b_hat is below 1/2.
    """
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=None)
    estimates = THREE_ESTIMATES_NEAR_A_QUARTER[:count]
    assert robot.update_after(estimates) is Update.BELOW


@given(
    black_share=st.floats(0.55, 0.63),
    x_hat=st.integers(0, ONE).filter(lambda x: abs(x - HALF) > ONE // 8),
    update=st.sampled_from([Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM]),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=40, deadline=None)
def test_estimates_drawn_for_a_new_b_hat_above_or_below_a_half_or_at_an_end_lead_to_it(
    black_share: float, x_hat: int, update: Update, seed: int
) -> None:
    """The new accuracy b_hat follows from the paper's equation 8, computed exactly. The ends are 0 and 1.

    It explains the share n / t of black observations if the fill ratio is x_bar, the mean of the estimates.
    A b_hat beyond an end is cut off there. ``update`` says where b_hat shall be.
    """
    t = 997
    n = round(black_share * t)
    robot = RobotState(t, n, x_hat, TABLE)
    estimates = draw_round_for_update(robot, update, Random(seed))
    assert estimates is not None
    x_bar = exact_x_bar(estimates)
    b_hat = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)

    if update is Update.ABOVE:
        assert Fraction(1, 2) < b_hat < 1
    elif update is Update.BELOW:
        assert 0 < b_hat < Fraction(1, 2)
    elif update is Update.MAXIMUM:
        assert b_hat >= 1
    else:
        assert b_hat <= 0


def test_estimates_drawn_to_keep_b_hat_have_a_mean_of_one_half() -> None:
    """Any sensor sees half of the tiles black on such a floor, so nothing follows for its accuracy."""
    robot = RobotState(t=997, n=600, x_hat=ONE // 4, table=TABLE)
    estimates = draw_round_for_update(robot, Update.KEPT, Random(1))
    assert estimates is not None
    assert exact_x_bar(estimates) == Fraction(1, 2)


def exact_x_bar(estimates: Sequence[NeighbourEstimate]) -> Fraction:
    """Return the mean of x_hat, weighted by alpha, as a number between 0 and 1."""
    weighted_sum = sum(alpha_units(estimate.alpha) * estimate.x_hat for estimate in estimates)
    sum_of_weights = sum(alpha_units(estimate.alpha) for estimate in estimates)
    return Fraction(weighted_sum, sum_of_weights * ONE)
