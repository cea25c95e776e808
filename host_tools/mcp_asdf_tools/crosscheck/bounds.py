"""Bounds of the firmware's rounding errors, as exact fractions.

The exact values come from ``mcp_asdf.reference``, computed in fractions. The bounds are derived from the
roundings that docs/design.md states, and nothing is taken from the firmware. ``robust_bounds`` has those of
the robust filter.

Both colours are treated alike, so the derivations are about the rarer one: with k = min(n, t - n),
c = min(b, 1 - b), g = 1 - 2 c, r = 1 / g and p = k / t, x_hat is max(0, (p - c) / g) or its mirror image.
"""

from __future__ import annotations

from fractions import Fraction

from mcp_asdf.reference import (
    is_informative,
    local_confidence,
    local_estimate,
)

HALF = Fraction(1, 2)
Q22, Q23, Q24, Q27, Q28, Q30, Q31, Q32 = (Fraction(1, 2**bits) for bits in (22, 23, 24, 27, 28, 30, 31, 32))

LARGEST_ALPHA = Fraction(2**31 - 2**7)

ROBUST_TEST_MARGIN = Fraction(1, 2**13)
"""The firmware's robust test is right if its sides differ by more than this share of the larger one.

The sides are (n/t - p)**2 and 12 (dispersion v/t + g**2 spread**2), with the names of `robust_test_outcome`.
Where they are alike, rounding changes them by less: both are at least 12 2**-33, since t < 2**31,
v >= (1 - g**2) / 4, dispersion >= 1 and spread >= 2**-12. So n/t - p is at least 160,000 units of 2**-32.
p is less than 4 units too small, and n/t less than 5: the square of the difference is off by 2**-13.9 of
itself. The product of g and the spread, rounded down, takes 2**-15.5 from the other side. There v lacks at
most 6 units: if it is below 2**-10, g is near 1, n/t - p is at least sqrt(12) 2**-12, and v has at least
350,000 units."""

Bounds = tuple[Fraction, Fraction]
"""Smallest and largest value that the firmware may have."""


def exact_alpha(n: int, t: int, b: Fraction) -> Fraction:
    """Return alpha (eq. 4) for t > 0 and b in (0, 1), limited to the firmware's largest alpha."""
    return min(local_confidence(n, t, b), LARGEST_ALPHA)


def x_hat_bounds(n: int, t: int, b: Fraction) -> Bounds:
    """Return the bounds of x_hat for t > 0 observations, n of them black, which are multiples of 2**-23.

    Before it is rounded the firmware's x_hat is right, or nearer to 1/2 than the exact one, but not beyond
    1/2. The difference is at most 2**-31 |2 x_hat - 1| / |2 b - 1|. An x_hat of 0 or 1 is exact. If ``b``
    carries no information both bounds are 1/2.
    """
    if not is_informative(b):
        return HALF, HALF
    exact = local_estimate(n, t, b)
    # The firmware computes the share of the rarer colour, which is x_hat or 1 - x_hat.
    rarer_share = min(exact, 1 - exact)
    largest_error = Fraction(0)
    if rarer_share > 0:
        # With k = min(n, t - n), c = min(b, 1 - b) and g = 1 - 2 c the share is x = (k / t - c) / g (eq. 3).
        # The firmware computes it with whole numbers, T = 2**s t in [2**31, 2**32) and K = 2**s k, and rounds
        # c T down, which loses e < 1. So it has (K - c T + e) / (g T + 2 e) in place of (K - c T) / (g T).
        # That is too large by (1 - 2 x) e / (g T + 2 e), which is below (1 - 2 x) / g 2**-31.
        g = abs(2 * b - 1)
        largest_error = (1 - 2 * rarer_share) / g * Q31
    lower = round_down(rarer_share, Q23)
    upper = round_down(rarer_share + largest_error, Q23)
    if rarer_share == exact:
        return lower, upper
    # x_hat is the share of the other colour, so both bounds are mirrored.
    return 1 - upper, 1 - lower


def alpha_error(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Return by which shares of itself alpha may be too small and too large, before it is an alpha word.

    Where x_hat is 0 or 1 the shares are about 2**-22 and 2**-30. Otherwise they are about 2**-26 and
    (1 + 2 / |2 b - 1|) 2**-30.
    """
    k = min(n, t - n)  # observations of the rarer colour
    c = min(b, 1 - b)
    is_estimate_at_end = Fraction(k, t) <= c  # x_hat is 0 or 1
    return _alpha_error_at_end() if is_estimate_at_end else _alpha_error_inside(c)


def _alpha_error_at_end() -> tuple[Fraction, Fraction]:
    """Return what `alpha_error` returns where x_hat is 0 or 1: about 2**-22, and 2**-30."""
    # With g = 1 - 2 c the firmware computes alpha as k (g / c)**2 + (t - k) (g / (1 - c))**2. Both ratios
    # lose up to 2**-23 of themselves, both squares 2**-28, and the second term 2**-28 of the first. So at
    # least (1 - 2**-23)**2 (1 - 2**-28)**2 is left, which is a little more than 1 less this sum.
    too_small = 2 * Q23 + 2 * Q28
    # 1 - c may lose half a unit of 2**-31, which makes the square in the second term larger.
    too_large = Q30
    return too_small, too_large


def _alpha_error_inside(c: Fraction) -> tuple[Fraction, Fraction]:
    """Return what `alpha_error` returns where 0 < x_hat < 1: about 2**-26, and (1 + 2 / (1 - 2 c)) 2**-30.

    ``c`` is the probability of an error of a sensor that is right more often than not, below 1/2.
    """
    # The firmware computes alpha as (g T)**2 T / (K (T - K)) 2**-s, with the T, K and s of `x_hat_bounds`.
    # Squaring, multiplying, and cutting the dividend to 31 bits make alpha smaller.
    smallest_share_left = (1 - Q28) * (1 - Q27) * (1 - Q31)
    # The rounding of c T makes g T larger, by up to 2**-30 / g of itself. And the divisor K (T - K) is cut to
    # 31 bits, which makes it smaller.
    g = 1 - 2 * c
    largest_square = (1 + Q30 / g) ** 2
    smallest_divisor = 1 - Q30
    too_small = 1 - smallest_share_left
    too_large = largest_square / smallest_divisor - 1
    return too_small, too_large


def alpha_bounds(n: int, t: int, b: Fraction) -> Bounds:
    """Return the bounds of alpha for t > 0 observations, n of them black, in the form of an alpha word.

    An alpha word, with its mantissa of 24 bits, loses up to 2**-23 of alpha and one unit of 2**-24.
    """
    exact = exact_alpha(n, t, b)
    too_small, too_large = alpha_error(n, t, b)
    smallest = exact * (1 - too_small)
    largest = exact * (1 + too_large)
    smallest_as_word = smallest * (1 - Q23) - Q24
    return smallest_as_word, largest


def x_bar_bounds(x_bar: Fraction) -> Bounds:
    """Return the bounds of the x_bar from which the firmware computes b_hat, for the exact ``x_bar``.

    It may be too small by up to x_bar 2**-30 + 2**-31 + 2**-32, and is not too large. Below 1/2 both bounds
    are 2**-32 higher.
    """
    # It is a quotient of the upper 32 bits of two sums. The divisor is rounded up to an even number E in
    # (2**31, 2**32]. The dividend loses less than 1, the divisor gains at most 2, and the quotient loses less
    # than 2**-32: it is less than (2 x_bar + 1) / E + 2**-32 too small.
    largest_error = x_bar * Q30 + Q31 + Q32
    lower, upper = x_bar - largest_error, x_bar
    if x_bar < HALF:
        # The firmware goes on with 1 - x_bar, which loses 2**-32 when it is formed.
        return lower + Q32, upper + Q32
    return lower, upper


def is_update_expected(x_bar: Fraction) -> bool | None:
    """Return whether the firmware must re-estimate b_hat from a mean whose exact value is ``x_bar``.

    It must if its own x_bar is informative. Returns None if rounding decides that, as the firmware's x_bar
    may be on either side of |2 x_bar - 1| = 2**-12.
    """
    lower, upper = x_bar_bounds(x_bar)
    if is_informative(lower) != is_informative(upper):
        return None
    return is_informative(lower)


def b_hat_error(x_bar: Fraction) -> Fraction:
    """Return by how much b_hat may be wrong, for any n and t, after an update from the exact ``x_bar``.

    That is the error of the firmware's x_bar, divided by |2 x_bar - 1|, and what its own roundings add.
    """
    lower, upper = x_bar_bounds(x_bar)
    x_bar_error = max(x_bar - lower, upper - x_bar)
    # If x_bar is off by e, eq. 8 gives a b that is off by (2 b - 1) e / (2 x_bar - 1), and |2 b - 1| is at
    # most 1. A b outside [0, 1] is clamped, and then as far off as for the smaller e that gives 0 or 1.
    propagated_error = x_bar_error / abs(2 * x_bar - 1)
    rounding_error = Q30 + Q31 + Q32
    return propagated_error + rounding_error


def round_down(value: Fraction, unit: Fraction) -> Fraction:
    """Return the largest multiple of ``unit`` that is not above ``value``."""
    return value // unit * unit
