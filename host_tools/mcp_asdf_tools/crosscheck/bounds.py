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

UNDECIDED = Fraction(1, 2**13)
"""The firmware's robust test is right if its sides differ by more than this share of the larger one."""

Bounds = tuple[Fraction, Fraction]
"""Smallest and largest value that the firmware may have."""


def exact_alpha(n: int, t: int, b: Fraction) -> Fraction:
    """Return alpha (eq. 4) for t > 0 and b in (0, 1), limited to the firmware's largest alpha."""
    return min(local_confidence(n, t, b), LARGEST_ALPHA)


def x_hat_bounds(n: int, t: int, b: Fraction) -> Bounds:
    """Return the bounds of x_hat for t > 0 observations, n of them black, which are multiples of 2**-23.

    The rarer colour has k = min(n, t - n) observations, and so the share p = k / t. With c = min(b, 1 - b),
    g = 1 - 2 c and r = 1 / g its x_hat is x = (p - c) / g (eq. 3), or 0 if p <= c.

    The firmware decides exactly whether p > c. It computes with the whole numbers T = 2**s t in [2**31,
    2**32) and K = 2**s k, and rounds c T down, which loses e < 1. So it has (K - c T + e) / (g T + 2 e),
    rounded down, in place of (K - c T) / (g T). That is (1 - 2 x) e / (g T + 2 e) < (1 - 2 x) r 2**-31 too
    near to 1/2, and never beyond it. Where x is 0, so is the firmware's.

    Both bounds are 1/2 if ``b`` carries no information.
    """
    if not is_informative(b):
        return HALF, HALF
    exact = local_estimate(n, t, b)
    exact_of_rarer = min(exact, 1 - exact)
    r = 1 / abs(2 * b - 1)
    # By this much the firmware's may be nearer to 1/2, which is too large: it is never too small.
    largest_error = (1 - 2 * exact_of_rarer) * r * Q31 if exact_of_rarer > 0 else Fraction(0)
    lower = round_down(exact_of_rarer, Q23)
    upper = round_down(exact_of_rarer + largest_error, Q23)
    if exact == exact_of_rarer:
        return lower, upper
    # x_hat is the share of the other colour, so both bounds are mirrored.
    return 1 - upper, 1 - lower


def alpha_error(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Return by how much alpha may be too small and too large, relatively, before it becomes an alpha word.

    The symbols are those of `x_hat_bounds`.

    At an end of the scale (p <= c) k (g / c)**2 + (t - k) (g / (1 - c))**2 is computed with both ratios
    rounded down to 24 bits or more, and squares to 2**-28 of themselves; the second term loses 2**-28 of the
    first. That is (1 - 2**-23)**2 (1 - 2**-28)**2 > 1 - 2**-22 - 2**-27. 1 - c may lose half a unit of
    2**-31, which makes the square 2**-30 too large.

    Inside, (g T)**2 T / (K (T - K)) 2**-s is computed, with g T + 2 e for g T (see `x_hat_bounds`): its
    square is up to (1 + r 2**-30)**2 too large. Squaring loses 2**-28, multiplying 2**-27, and 31 bits of the
    dividend are left: less than 2**-26 in all. The 31 bits left of K (T - K) are up to 2**-30 too small.
    """
    p = Fraction(min(n, t - n), t)
    c = min(b, 1 - b)
    if p <= c:
        return Q22 + Q27, Q30  # at an end of the scale
    r = 1 / (1 - 2 * c)
    # What squaring, multiplying and cutting the dividend leave of alpha at least
    smallest_share = (1 - Q28) * (1 - Q27) * (1 - Q31)
    # The square may be too large, and the divisor too small.
    largest_share = (1 + r * Q30) ** 2 / (1 - Q30)
    return 1 - smallest_share, largest_share - 1


def alpha_bounds(n: int, t: int, b: Fraction) -> Bounds:
    """Return the bounds of alpha for t > 0.

    An alpha word, with its mantissa of 24 bits, loses up to 2**-23 of alpha and one unit.
    """
    exact = exact_alpha(n, t, b)
    too_small, too_large = alpha_error(n, t, b)
    return exact * (1 - too_small) * (1 - Q23) - Q24, exact * (1 + too_large)


def x_bar_bounds(x_bar: Fraction) -> Bounds:
    """Return the bounds of the x_bar from which the firmware computes b_hat, for the exact ``x_bar``.

    It is a quotient of the upper 32 bits of the sums, of which the divisor is rounded up to an even number E
    in (2**31, 2**32]. The dividend loses less than 1, the divisor gains at most 2, the quotient less than
    2**-32: it is less than (2 x_bar + 1) / E + 2**-32 too small. Below 1/2, 1 - x_bar takes its place, and
    loses 2**-32.
    """
    largest_error = x_bar * Q30 + Q31 + Q32
    offset = Q32 if x_bar < HALF else Fraction(0)
    return x_bar - largest_error + offset, x_bar + offset


def is_update_expected(x_bar: Fraction) -> bool | None:
    """Return whether the firmware's x_bar is informative, so that it computes a b_hat, for the exact one.

    Returns None if rounding decides, as the firmware's x_bar may be on either side of
    |2 x_bar - 1| = 2**-12.
    """
    lower, upper = x_bar_bounds(x_bar)
    is_lower_informative, is_upper_informative = is_informative(lower), is_informative(upper)
    return is_lower_informative if is_lower_informative == is_upper_informative else None


def b_hat_error(x_bar: Fraction) -> Fraction:
    """Return by how much b_hat may be wrong, for any n and t, after an update from the exact ``x_bar``.

    If x_bar is off by e, eq. 8 gives a b that is off by (2 b - 1) e / (2 x_bar - 1). A b outside [0, 1] is
    clamped. It is then as far off as for the smaller e that gives 0 or 1.
    """
    lower, upper = x_bar_bounds(x_bar)
    x_bar_error = max(x_bar - lower, upper - x_bar)
    return x_bar_error / abs(2 * x_bar - 1) + Q30 + Q31 + Q32


def round_down(value: Fraction, unit: Fraction) -> Fraction:
    """Return the largest multiple of ``unit`` that is not above ``value``."""
    return value // unit * unit
