"""The paper's equations in exact rationals, and how far from them the firmware's arithmetic may be.

Nothing here knows how the firmware computes. The limits follow from the roundings that docs/design.md
lists, each taken at its worst at once, so they are above what is measured.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

from mpmath import mp  # type: ignore[import-untyped]

from firmware_py.fixed_point import ALPHA_MAX, bits_to_alpha
from host_tools.scenarios import TableChoice, build_table
from host_tools.tables import parse_omega, true_thresholds, worst_threshold_error

HALF = Fraction(1, 2)
EPSILON = Fraction(1, 2**20)
"""b_hat stays in [EPSILON, 1 - EPSILON]."""
UNINFORMATIVE = Fraction(1, 2**12)
"""Where |2 b_hat - 1| is below this an observation says nothing."""
LARGEST_ALPHA = Fraction(bits_to_alpha(ALPHA_MAX))
LATE = 2**31
"""From here on t does not fit 31 bits, and the firmware's ratio n / t has lost one."""

THRESHOLD_SCALE = 128
B_HAT_LIMIT = Fraction(1, 2**29)
"""b_hat may be below eq. 8 of the rounded x_bar by at most this, and never above it."""


def exact_estimate(n: int, t: int, b_hat: Fraction) -> tuple[Fraction, Fraction]:
    """x_hat (eq. 3) and alpha (eq. 4, at most the firmware's largest) for t > 0 and b_hat in (0, 1)."""
    d = 2 * b_hat - 1
    if abs(d) < UNINFORMATIVE:
        return HALF, Fraction(0)
    x_hat = min(max((Fraction(n, t) + b_hat - 1) / d, Fraction(0)), Fraction(1))
    if x_hat == 0:
        alpha = d * d * (n / (1 - b_hat) ** 2 + (t - n) / b_hat**2)
    elif x_hat == 1:
        alpha = d * d * (n / b_hat**2 + (t - n) / (1 - b_hat) ** 2)
    else:
        alpha = d * d * Fraction(t**3, n * (t - n))
    return x_hat, min(alpha, LARGEST_ALPHA)


def exact_b_hat(n: int, t: int, x_bar: Fraction) -> Fraction:
    """b_hat (eq. 8) for t > 0 and x_bar other than 1/2, kept in its range."""
    b_hat = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    return min(max(b_hat, EPSILON), 1 - EPSILON)


def x_hat_limit(b_hat: Fraction) -> Fraction:
    """The largest error of x_hat: one unit of 2**-23, and n / t off by less than 2**-29."""
    d = abs(2 * b_hat - 1)
    return Fraction(0) if d < UNINFORMATIVE else Fraction(1, 2**23) + Fraction(1, 2**29) / d


def alpha_limit(n: int, t: int, b_hat: Fraction, alpha: Fraction) -> Fraction:
    """The largest error of an ``alpha``: its last bit, the grid, and what n / t has lost; at an end of the
    scale also two squares of quotients of 24 bits.

    Inside the scale the rarer colour's share counts as a 32-bit fraction. From t = 2**31 on its number may be
    1 too small, or that of all observations, which matters for a rare colour at an end of the scale.
    """
    rarer, c = min(n, t - n), min(b_hat, 1 - b_hat)
    relative = Fraction(1, 2**22) + Fraction(1, 2**28)
    if rarer <= c * t * (1 + Fraction(1, 2**20)):
        relative += Fraction(1, 2**21)
    if rarer > c * t * (1 - Fraction(1, 2**20)):
        relative += Fraction(t, rarer) / 2**29
    elif t >= LATE:
        relative += (1 / c**2) / t
    return alpha * relative + Fraction(1, 2**24)


@lru_cache(maxsize=512)
def true_threshold(choice: TableChoice, m: int) -> int:
    """k_m for the omega of a table, in units of 2**-THRESHOLD_SCALE, from 40 digits."""
    k = true_thresholds(parse_omega(choice.omega)).of_m[m - 2]
    return int(mp.nint(mp.ldexp(k, THRESHOLD_SCALE)))


@lru_cache(maxsize=512)
def threshold_limit(choice: TableChoice, m: int) -> float:
    """The largest relative error of the entry for ``m`` messages: half a unit, up to m = q."""
    table = build_table(choice)
    if m > table.q:
        return (1 + _error_beyond_q(choice)) ** 2 - 1
    return (1 << (THRESHOLD_SCALE - table.fraction_bits)) / 2 / true_threshold(choice, m)


@lru_cache(maxsize=64)
def _error_beyond_q(choice: TableChoice) -> float:
    return worst_threshold_error(parse_omega(choice.omega), build_table(choice)).beyond_q
