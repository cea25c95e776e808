"""Rounds crafted for a robot, against exact arithmetic of our own."""

from __future__ import annotations

from collections import Counter
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
    fractions_around,
    scatter_of,
)
from mcp_asdf_tools.tables.thresholds import generate, parse_omega
from support import slow

OMEGAS = ("0.05", "0.000000001", "0.5", "0.9")
"""Type II error probabilities of the test, from a usual to an extreme tolerance."""
TABLE = generate(parse_omega("0.05"), 127)
for_every_omega = pytest.mark.parametrize("omega", ["0.05", *slow(OMEGAS[1:])])
SIZES = (2, 3, 5, 10, 30, 126)


def eq_12_rejects(x_hats: Sequence[int], own_x_hat: int, k: Fraction) -> bool:
    """Return what the test decides: (mean - own)^2 > k times the variance over m, here times m^3."""
    m, total = len(x_hats), sum(x_hats)
    return m * (total - m * own_x_hat) ** 2 > k * sum((m * x - total) ** 2 for x in x_hats)


def table_of(omega: str) -> Table:
    """Return the table for 127 neighbours, which is generated once."""
    return generate(parse_omega(omega), 127)


def threshold_of(omega: str, m: int) -> Fraction:
    """Return k_m, which a table has in units of 2**-26."""
    return Fraction(table_of(omega).entry(m), 1 << 26)


def x_hats_of(estimates: Sequence[NeighbourEstimate]) -> list[int]:
    return [estimate.x_hat for estimate in estimates]


# --- Rounds at the threshold of the test ---


@for_every_omega
@given(own_x_hat=st.integers(0, ONE), m=st.sampled_from(SIZES), seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_the_test_passes_the_inner_round_and_rejects_the_outer_one(
    omega: str, own_x_hat: int, m: int, seed: int
) -> None:
    robot = RobotState(t=500, n=300, x_hat=own_x_hat, table=table_of(omega))
    rounds = draw_rounds_at_threshold(robot, m, Update.ABOVE, Random(seed))
    k = threshold_of(omega, m)
    assert len(rounds.inside) == len(rounds.outside) == m
    assert not eq_12_rejects(x_hats_of(rounds.inside), own_x_hat, k)
    assert eq_12_rejects(x_hats_of(rounds.outside), own_x_hat, k)


@for_every_omega
@given(own_x_hat=st.integers(0, ONE), m=st.sampled_from(SIZES), seed=st.integers(0, 2**32))
@settings(max_examples=5, deadline=None)
def test_rounds_at_the_threshold_show_a_threshold_that_is_wrong_by_a_millionth(
    omega: str, own_x_hat: int, m: int, seed: int
) -> None:
    robot = RobotState(t=500, n=300, x_hat=own_x_hat, table=table_of(omega))
    rounds = draw_rounds_at_threshold(robot, m, Update.ABOVE, Random(seed))
    k = threshold_of(omega, m)
    assert eq_12_rejects(x_hats_of(rounds.inside), own_x_hat, k * Fraction(999_999, 1_000_000))
    assert not eq_12_rejects(x_hats_of(rounds.outside), own_x_hat, k * Fraction(1_000_001, 1_000_000))


# design: R24
@for_every_omega
def test_most_rounds_at_the_threshold_are_decided_by_its_last_bits(omega: str) -> None:
    rng, decided_by_last_bits = Random(5), Counter[str]()
    for _ in range(200):
        m, own_x_hat = rng.randint(2, 127), rng.randint(0, ONE)
        x_hats = draw_x_hats_at_threshold(own_x_hat, table_of(omega).entry(m), m, rng, gap_share=1)
        if x_hats is not None:
            inside, outside = x_hats
            last_bits = Fraction(1, 1 << 24)
            k = threshold_of(omega, m)
            decided_by_last_bits["inside"] += eq_12_rejects(inside, own_x_hat, k * (1 - last_bits))
            decided_by_last_bits["outside"] += not eq_12_rejects(outside, own_x_hat, k * (1 + last_bits))
    assert min(decided_by_last_bits.values()) > 100


@given(own_x_hat=st.integers(0, ONE), m=st.integers(2, 127), seed=st.integers(0, 2**32))
def test_rounds_at_the_threshold_stay_between_0_and_1(own_x_hat: int, m: int, seed: int) -> None:
    x_hats = draw_x_hats_at_threshold(own_x_hat, TABLE.entry(m), m, Random(seed), gap_share=1)
    assume(x_hats is not None)
    assert x_hats is not None
    assert all(0 <= x_hat <= ONE for side in x_hats for x_hat in side)


def test_there_are_no_rounds_at_the_threshold_for_a_gap_of_less_than_a_unit() -> None:
    assert draw_x_hats_at_threshold(HALF, TABLE.entry(5), 5, Random(1), gap_share=2**-30) is None


@given(value=st.fractions(0, 3), max_denominator=st.integers(1, 200))
def test_fractions_around_a_value_are_the_nearest_on_either_side(
    value: Fraction, max_denominator: int
) -> None:
    below, above = fractions_around(value, max_denominator)
    candidates = range(1, max_denominator + 1)
    assert below == max(Fraction(value * k // 1, k) for k in candidates)
    assert above == min(Fraction(value * k // 1 + 1, k) for k in candidates)


def test_a_round_at_the_threshold_with_any_update_serves_if_the_preferred_one_is_impossible() -> None:
    robot = RobotState(t=500, n=300, x_hat=ONE // 3, table=TABLE)
    rounds = draw_rounds_at_threshold(robot, 3, Update.HALF, Random(1))
    assert robot.update_after(rounds.outside) not in (None, Update.HALF)


# --- Other rounds that the test decides ---


@for_every_omega
@given(own_x_hat=st.integers(0, ONE))
@settings(max_examples=25, deadline=None)
def test_a_round_of_large_scatter_is_rejected_only_without_the_bits_from_56_on(
    omega: str, own_x_hat: int
) -> None:
    robot = RobotState(t=500, n=300, x_hat=own_x_hat, table=table_of(omega))
    x_hats = x_hats_of(draw_round_of_large_scatter(robot, Random(1)))
    difference_squared = (sum(x_hats) - 126 * own_x_hat) ** 2
    scatter, k = scatter_of(x_hats), threshold_of(omega, 126)
    assert difference_squared <= k * scatter
    assert difference_squared > k * (scatter % (1 << 56))


@given(own_x_hat=st.integers(0, ONE))
@settings(deadline=None)
def test_a_round_of_distant_sum_is_rejected_by_the_bits_from_54_on_alone(own_x_hat: int) -> None:
    robot = RobotState(t=500, n=300, x_hat=own_x_hat, table=TABLE)
    x_hats = x_hats_of(draw_round_of_distant_sum(robot, Random(1)))
    assert eq_12_rejects(x_hats, own_x_hat, threshold_of("0.05", 126))
    assert (sum(x_hats) - 126 * own_x_hat) ** 2 % (1 << 54) == 0


# --- Updates ---


@pytest.mark.parametrize(
    ("b_hat", "update"),
    [
        ((1 << 31) - (1 << 27), Update.BELOW),
        ((1 << 31) - (1 << 27) + 1, Update.FAINT),
        ((1 << 31) - (1 << 19), Update.FAINT),
        ((1 << 31) - (1 << 19) + 1, Update.HALF),
        (1 << 31, Update.HALF),
        ((1 << 31) + (1 << 19) - 1, Update.HALF),
        ((1 << 31) + (1 << 19), Update.FAINT),
        ((1 << 31) + (1 << 27) - 1, Update.FAINT),
        ((1 << 31) + (1 << 27), Update.ABOVE),
        (None, Update.KEPT),
    ],
)
def test_an_update_is_classified_by_its_distance_from_one_half(b_hat: int | None, update: Update) -> None:
    assert classify_update(b_hat) is update


NEAR_A_QUARTER = [NeighbourEstimate(ONE // 4 + offset, ALPHA_ONE) for offset in (1, -1, 1)]


def test_a_round_that_the_test_does_not_reject_makes_no_update() -> None:
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=TABLE)
    assert robot.update_after(NEAR_A_QUARTER) is None


def test_a_single_estimate_makes_no_update_of_a_robot_with_a_test() -> None:
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=TABLE)
    assert robot.update_after(NEAR_A_QUARTER[:1]) is None


@pytest.mark.parametrize("count", [1, 3])
def test_any_estimates_make_an_update_of_a_robot_without_a_test(count: int) -> None:
    robot = RobotState(t=100, n=60, x_hat=ONE // 4, table=None)
    assert robot.update_after(NEAR_A_QUARTER[:count]) is Update.BELOW


@given(
    black_share=st.floats(0.55, 0.63),
    x_hat=st.integers(0, ONE).filter(lambda x: abs(x - HALF) > ONE // 8),
    update=st.sampled_from([Update.ABOVE, Update.BELOW, Update.MAXIMUM, Update.MINIMUM]),
    seed=st.integers(0, 2**32),
)
@settings(deadline=None)
def test_a_round_for_an_update_leads_to_it_by_eq_8(
    black_share: float, x_hat: int, update: Update, seed: int
) -> None:
    t = 997
    n = round(black_share * t)
    estimates = draw_round_for_update(RobotState(t, n, x_hat, TABLE), update, Random(seed))
    assert estimates is not None
    x_bar = exact_x_bar(estimates)
    b_hat = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    assert {
        Update.ABOVE: Fraction(1, 2) < b_hat < 1,
        Update.BELOW: 0 < b_hat < Fraction(1, 2),
        Update.MAXIMUM: b_hat >= 1,
        Update.MINIMUM: b_hat <= 0,
    }[update]


def test_a_round_that_keeps_b_hat_has_a_mean_of_one_half() -> None:
    estimates = draw_round_for_update(RobotState(997, 600, ONE // 4, TABLE), Update.KEPT, Random(1))
    assert estimates is not None
    assert exact_x_bar(estimates) == Fraction(1, 2)


def exact_x_bar(estimates: Sequence[NeighbourEstimate]) -> Fraction:
    """Return the mean of x_hat, weighted by alpha."""
    weights = [alpha_units(estimate.alpha) for estimate in estimates]
    weighted_sum = sum(map(int.__mul__, weights, x_hats_of(estimates)))
    return Fraction(weighted_sum, sum(weights) * ONE)
