"""No sum or product of a round, or of the robust filter, wraps: the largest that each can be, derived.

Words of the firmware are integers here, which have no limit. A product of numbers that are not negative is
largest where each of them is, and a sum of two products of a and b, and of what a and b lack, where a and b
are at an end of their range.
"""

from __future__ import annotations

from itertools import product

WORD = 2**32
ONE = 2**23
"""An x_hat of 1."""
NEIGHBOURS = 127
ALPHA_MAX = (2**24 - 1) * 2**31
"""The largest alpha word in units of 2^-24."""
SHARE_MAX = B_HAT_MAX = WORD - 1
VARIANCE_MAX = 2**30
"""Of one observation: p (1 - p), which is largest for a p of 1/2."""
DISPERSION_MAX = 2**16 - 1
T_MAX = 2**31
SPREAD_MAX = 2**22
"""Of the estimates in slots, in units of 2^-24: a quarter."""


# design: R20
def test_the_sums_of_a_round_with_the_most_and_largest_messages_fit_in_their_ranges() -> None:
    """Alpha is summed with its upper and its lower word apart (I7)."""
    upper_alpha, lower_alpha = ALPHA_MAX // WORD, WORD - 1

    assert NEIGHBOURS * ALPHA_MAX < 2**62
    assert NEIGHBOURS * lower_alpha * ONE < 2**62
    assert NEIGHBOURS * upper_alpha * ONE < 2**53
    assert NEIGHBOURS * ONE * ONE < 2**53
    assert NEIGHBOURS * ONE < 2**30
    # The robot's own message fits, too: x is formed with it.
    assert (NEIGHBOURS + 1) * ALPHA_MAX < 2**62
    assert (NEIGHBOURS + 1) * lower_alpha * ONE < 2**62


def test_a_probability_of_black_is_above_0_and_below_1() -> None:
    """The firmware adds two products, each rounded down, of b_hat and x, and of what both lack to 1."""
    b_hat_range, x_range = (2**12, WORD - 2**12), (0, WORD - 1)

    for b_hat, x in product(b_hat_range, x_range):
        exact_sum = b_hat * x + (WORD - 1 - b_hat) * (WORD - 1 - x)
        assert exact_sum // WORD - 1 > 0  # rounded down twice
        assert exact_sum // WORD < WORD - 1


def test_the_products_of_the_robust_test_fit_in_their_words() -> None:
    """Each is largest where its factors are; t is formed with two words of the excess."""
    uncertainty_of_p = (WORD - 1) * (SPREAD_MAX << 8) // WORD
    assert uncertainty_of_p < 2**30
    assert 12 * uncertainty_of_p**2 < 2**64
    half = WORD // 2
    assert half * (WORD - half) // WORD == VARIANCE_MAX
    assert 12 * DISPERSION_MAX < WORD
    assert 12 * DISPERSION_MAX * VARIANCE_MAX < 2**64
    largest_excess = 2**64 - 1
    assert (WORD - 1) * largest_excess // WORD < 2**64


# design: R37
def test_the_products_that_end_a_batch_fit_in_their_words() -> None:
    """The batch may have all observations. Units are those of the firmware's comments."""
    batch_variance, largest_ratio = T_MAX * VARIANCE_MAX, 12 * DISPERSION_MAX
    assert batch_variance <= 2**61
    assert largest_ratio < 2**20
    assert (largest_ratio * (batch_variance // WORD) << 14) + (largest_ratio * (WORD - 1) >> 18) < 2**63
    # The observed and the expected number of black ones are at most all of the batch.
    assert T_MAX * WORD <= 2**63
    assert T_MAX * SHARE_MAX < 2**63
    assert 7 * DISPERSION_MAX + largest_ratio < WORD


# design: R37
def test_the_sums_that_move_the_centre_fit_in_their_words() -> None:
    """A step of Huber's method sums up to 32 limited estimates, in units of 2^-24."""
    largest_centre, slots = (2**16 - 1) * 2**8, 32
    assert slots * (largest_centre + SPREAD_MAX) < 2**30
    assert slots * largest_centre < 2**29
    largest_divisor, largest_step = slots << 24, 2**24
    assert largest_divisor <= 2**29
    assert largest_centre + largest_step < WORD
