"""No sum or product of a round, or of the robust filter, wraps: the largest that each can be, derived.

Words of the firmware are integers here, which have no limit. The ranges are the mirror's, which are those of
the C. A product of numbers that are not negative is largest where each of them is, and a sum of two products
of a and b, and of what a and b lack, where a and b are at an end of their range.
"""

from __future__ import annotations

from itertools import product

from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, LARGEST_ALPHA_UNITS, ONE
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ROUND_SIZE
from mcp_asdf.robust_filter import (
    DISPERSION_MAX,
    DISPERSION_SHIFT,
    REJECTED_SIGMAS_SQUARED,
    SLOT_ESTIMATE_MAX,
    SLOTS,
    SPREAD_MAX,
)

WORD = 2**32
SHARE_MAX = WORD - 1
"""The largest share of observations, in units of 2^-32."""
VARIANCE_MAX = 2**30
"""The largest variance of one observation, p (1 - p), in units of 2^-32: that of a p of 1/2."""
T_MAX = DEFAULT_MEMORY
"""The largest number of observations: no robot has a longer memory than by default."""
SPREAD_OF_SLOTS_MAX = SPREAD_MAX >> 6
"""The largest spread, a quarter, in the unit 2^-24 of estimates in slots; SPREAD_MAX has 2^-30."""


# design: R20
def test_the_sums_of_a_round_with_the_most_and_largest_messages_fit_in_their_ranges() -> None:
    """Alpha is summed with its upper and its lower word apart (I7)."""
    upper_alpha, lower_alpha = LARGEST_ALPHA_UNITS // WORD, WORD - 1

    assert MAX_ROUND_SIZE * LARGEST_ALPHA_UNITS < 2**62
    assert MAX_ROUND_SIZE * lower_alpha * ONE < 2**62
    assert MAX_ROUND_SIZE * upper_alpha * ONE < 2**53
    assert MAX_ROUND_SIZE * ONE * ONE < 2**53
    assert MAX_ROUND_SIZE * ONE < 2**30
    # The robot's own message fits, too: x is formed with it.
    assert (MAX_ROUND_SIZE + 1) * LARGEST_ALPHA_UNITS < 2**62
    assert (MAX_ROUND_SIZE + 1) * lower_alpha * ONE < 2**62


def test_a_probability_of_black_is_above_0_and_below_1() -> None:
    """The firmware adds two products, each rounded down, of b_hat and x, and of what both lack to 1."""
    b_hat_range, x_range = (B_HAT_MIN, B_HAT_MAX), (0, WORD - 1)

    for b_hat, x in product(b_hat_range, x_range):
        exact_sum = b_hat * x + (WORD - 1 - b_hat) * (WORD - 1 - x)
        assert exact_sum // WORD - 1 > 0  # rounded down twice
        assert exact_sum // WORD < WORD - 1


def test_the_products_of_the_robust_test_fit_in_their_words() -> None:
    """The test is t * ((n / t - p)^2 - 12 (g * spread)^2) > 12 * dispersion * variance, with g = |2 b - 1|.

    Each product is largest where its factors are.
    """
    # 12 (g * spread)^2, in units of 2^-64: g and the spread have the unit 2^-32.
    g_max = WORD - 1
    spread_max = SPREAD_OF_SLOTS_MAX << 8  # from the unit 2^-24
    g_spread_max = g_max * spread_max // WORD
    assert g_spread_max < 2**30
    assert REJECTED_SIGMAS_SQUARED * g_spread_max**2 < 2**64

    # The left side, in units of 2^-32: t times the bracket, which is at most a square below 1.
    bracket_max = 2**64 - 1
    assert T_MAX * bracket_max // WORD < 2**64

    # The right side. The variance of one observation is largest for a probability of 1/2.
    half = WORD // 2
    assert half * (WORD - half) // WORD == VARIANCE_MAX
    assert REJECTED_SIGMAS_SQUARED * DISPERSION_MAX < WORD
    assert REJECTED_SIGMAS_SQUARED * DISPERSION_MAX * VARIANCE_MAX < 2**64


# design: R37
def test_the_products_that_end_a_batch_fit_in_their_words() -> None:
    """The batch may have all observations. Units are those of the firmware's comments."""
    batch_variance, largest_ratio = T_MAX * VARIANCE_MAX, REJECTED_SIGMAS_SQUARED * DISPERSION_MAX
    assert batch_variance <= 2**61
    assert largest_ratio < 2**20
    assert (largest_ratio * (batch_variance // WORD) << 14) + (largest_ratio * (WORD - 1) >> 18) < 2**63
    # The observed and the expected number of black ones are at most all of the batch.
    assert T_MAX * WORD <= 2**63
    assert T_MAX * SHARE_MAX < 2**63
    old_weight = 2**DISPERSION_SHIFT - 1
    assert old_weight * DISPERSION_MAX + largest_ratio < WORD


# design: R37
def test_the_sums_that_move_the_centre_fit_in_their_words() -> None:
    """A step of Huber's method sums up to 32 limited estimates, in units of 2^-24."""
    largest_centre = SLOT_ESTIMATE_MAX << 8  # from units of 2^-16
    assert SLOTS * (largest_centre + SPREAD_OF_SLOTS_MAX) < 2**30
    assert SLOTS * largest_centre < 2**29
    largest_divisor, largest_step = SLOTS << 24, 2**24
    assert largest_divisor <= 2**29
    assert largest_centre + largest_step < WORD
