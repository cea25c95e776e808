"""The paper's equations in exact rationals, and how far from them the firmware's arithmetic may be.

Nothing here knows how the firmware computes. The limits are what ``tests/exact.py`` derives, each as one
number for both directions.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

from mpmath import mp  # type: ignore[import-untyped]

from mcp_asdf.table import FRACTION_BITS
from mcp_asdf_tools.crosscheck.scenario import TableChoice, build_table
from mcp_asdf_tools.tables.thresholds import parse_omega, true_thresholds, worst_threshold_error

HALF = Fraction(1, 2)
EPSILON = Fraction(1, 2**20)
"""b_hat stays in [EPSILON, 1 - EPSILON]."""
UNINFORMATIVE = Fraction(1, 2**12)
"""Where |2 p - 1| is below this, an accuracy or a social estimate p is uninformative."""
LARGEST_ALPHA = Fraction(2**31 - 2**7)
UNIT = Fraction(1, 2**23)
"""Of x_hat, x_bar and x."""

THRESHOLD_SCALE = 128


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


def updates(x_bar: Fraction) -> bool | None:
    """True if a re-estimate follows from the exact ``x_bar``; None within its error of the limit."""
    distance = abs(2 * x_bar - 1) - UNINFORMATIVE
    return None if abs(distance) < 2 * _x_bar_error(x_bar) else distance > 0


def x_hat_limit(b_hat: Fraction) -> Fraction:
    """The largest error of x_hat: one unit towards an end of the scale, or c t cut to t's 31 bits."""
    d = abs(2 * b_hat - 1)
    return Fraction(0) if d < UNINFORMATIVE else max(UNIT, Fraction(1, 2**31) / d)


def alpha_limit(n: int, t: int, b_hat: Fraction, alpha: Fraction) -> Fraction:
    """The largest error of an ``alpha``: its last bit, the grid, and either two squares of quotients of 24
    bits (at an end of the scale) or c t cut to t's 31 bits and squared (inside)."""
    if Fraction(min(n, t - n), t) <= min(b_hat, 1 - b_hat):
        relative = Fraction(1, 2**23) + Fraction(1, 2**22) + Fraction(1, 2**27)
    else:
        relative = max(Fraction(1, 2**23) + Fraction(1, 2**26), (1 / abs(2 * b_hat - 1) + 1) / 2**29)
    return alpha * relative + Fraction(1, 2**24)


def b_hat_limit(x_bar: Fraction) -> Fraction:
    """The largest error of a b_hat re-estimated from the exact ``x_bar``, not 1/2: below 2**-26 for
    |2 x_bar - 1| from 0.1 on."""
    return _x_bar_error(x_bar) / abs(2 * x_bar - 1) + Fraction(7, 2**32)


def _x_bar_error(x_bar: Fraction) -> Fraction:
    """Of x_bar inside the firmware: it is a quotient of 32 bits by 31."""
    return (x_bar + Fraction(3, 4)) / 2**30


@lru_cache(maxsize=512)
def true_threshold(choice: TableChoice, m: int) -> int:
    """k_m for the omega of a table, in units of 2**-THRESHOLD_SCALE, from 40 digits."""
    k = true_thresholds(parse_omega(choice.omega))[m - 2]
    return int(mp.nint(mp.ldexp(k, THRESHOLD_SCALE)))


@lru_cache(maxsize=512)
def threshold_limit(choice: TableChoice, m: int) -> float:
    """The largest relative error of the entry for ``m`` messages: half a unit, up to m = q."""
    if m > build_table(choice).q:
        return (1 + _error_beyond_q(choice)) ** 2 - 1
    return (1 << (THRESHOLD_SCALE - FRACTION_BITS)) / 2 / true_threshold(choice, m)


@lru_cache(maxsize=64)
def _error_beyond_q(choice: TableChoice) -> float:
    return worst_threshold_error(parse_omega(choice.omega), build_table(choice)).beyond_q
