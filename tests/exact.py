"""The paper's equations on exact rationals, and how far from them the firmware's numbers may be.

The formulas are the paper's as printed, the limits follow from the roundings of ``docs/design.md``; nothing
here is taken from the firmware. With m = min(n, t - n), c = min(b, 1 - b), g = 1 - 2 c and r = 1 / g, only
the rarer colour counts: p = m / t, and x_hat is max(0, (p - c) / g) or its mirror image.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction

Q23, Q24, Q30, Q31, Q32 = (Fraction(1, 2**bits) for bits in (23, 24, 30, 31, 32))
HALF = Fraction(1, 2)
B_HAT_LEAST, B_HAT_MOST = Fraction(1, 2**20), 1 - Fraction(1, 2**20)
ALPHA_MOST = Fraction(2**31 - 2**7)
INFORMATIVE = Fraction(1, 2**12)


def is_informative(p: Fraction) -> bool:
    """True if an observation under the accuracy ``p``, or a social estimate ``p``, carries information."""
    return abs(2 * p - 1) >= INFORMATIVE


def x_hat(n: int, t: int, b: Fraction) -> Fraction:
    """Eq. 3 with w = b, t > 0, b informative."""
    quotient = (Fraction(n, t) + b - 1) / (2 * b - 1)
    return min(max(quotient, Fraction(0)), Fraction(1))


def alpha(n: int, t: int, b: Fraction) -> Fraction:
    """Eq. 4 with w = b, t > 0, b informative and not 0 or 1."""
    d, estimate = (2 * b - 1) ** 2, x_hat(n, t, b)
    if estimate == 0:
        return d * (t * b**2 - (2 * b - 1) * (t - n)) / (b**2 * (b - 1) ** 2)
    if estimate == 1:
        return d * (t * b**2 - (2 * b - 1) * n) / (b**2 * (b - 1) ** 2)
    return d * t**3 / (n * (t - n))


def weighted_mean(messages: Iterable[tuple[Fraction, Fraction]]) -> Fraction:
    """Eq. 5 and the second form of eq. 7, from (x_hat, alpha); not all alpha are 0."""
    pairs = list(messages)
    return sum((a * x for x, a in pairs), Fraction(0)) / sum((a for _, a in pairs), Fraction(0))


def b_hat(n: int, t: int, x_bar: Fraction) -> Fraction:
    """Eq. 8, kept off 0 and 1 by 2**-20; t > 0, x_bar not 1/2."""
    return _clamped(_eq_8(n, t, x_bar))


def rejects(own: Fraction, others: Sequence[Fraction], k: Fraction) -> bool:
    """Eq. 12 squared, for m >= 2 estimates; k = (t / sqrt(m) + 1)**2 m / (m - 1)."""
    m = len(others)
    mean = sum(others, Fraction(0)) / m
    variance = sum(((x - mean) ** 2 for x in others), Fraction(0)) / (m - 1)
    return (mean - own) ** 2 > k * (m - 1) / m * variance


def floor_to(value: Fraction, unit: Fraction) -> Fraction:
    """The largest multiple of ``unit`` not above ``value``."""
    return value // unit * unit


def alpha_on_grid(value: Fraction) -> Fraction:
    """The largest confidence that the firmware has, not above ``value`` >= 0."""
    units = min(value, ALPHA_MOST) // Q24
    lost = max(units.bit_length() - 24, 0)
    return (units >> lost << lost) * Q24


def of_word(word: int) -> Fraction:
    """The value of an alpha word: a mantissa in its upper 24 bits, a shift in its lower five."""
    return (word >> 8 << word % 32) * Q24


def to_word(value: Fraction) -> int:
    """The word of a confidence on the grid, with the smallest shift."""
    units, shift = value / Q24, 0
    while units >= 2**24:
        units, shift = units / 2, shift + 1
    word = int(units) * 256 + shift
    assert of_word(word) == value
    return word


def _eq_8(n: int, t: int, x_bar: Fraction) -> Fraction:
    return (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)


def _clamped(b: Fraction) -> Fraction:
    return min(max(b, B_HAT_LEAST), B_HAT_MOST)


def x_hat_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most x_hat that the firmware may give for t > 0, both multiples of 2**-23.

    Whether p > c is decided exactly. T = 2**s t in [2**31, 2**32) and P = 2**s m are whole numbers; c T loses
    e < 1. So x = (P - c T + e) / (g T + 2 e), rounded down, where eq. 3 has (P - c T) / (g T): the quotient
    is (1 - 2 x) e / (g T + 2 e) < (1 - 2 x) r 2**-31 too near to 1/2, and never beyond it.
    """
    if not is_informative(b):
        return HALF, HALF
    exact = x_hat(n, t, b)
    near, r = min(exact, 1 - exact), 1 / abs(2 * b - 1)
    drift = (1 - 2 * near) * r * Q31 if near else Fraction(0)
    least, most = floor_to(near, Q23), floor_to(near + drift, Q23)
    return (least, most) if exact == near else (1 - most, 1 - least)


def alpha_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most alpha that the firmware may give for t > 0: what :func:`alpha_error` allows, brought to
    the grid of confidences. A quotient rounded down to 24 or 25 bits, then 24, then to the grid is that."""
    if not is_informative(b):
        return Fraction(0), Fraction(0)
    exact, (below, above) = alpha(n, t, b), alpha_error(n, t, b)
    return alpha_on_grid(exact * (1 - below)), alpha_on_grid(exact * (1 + above))


def alpha_error(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Relative errors (below, above) of alpha before it is brought to its grid.

    At an end of the scale (p <= c) m (g / c)**2 + (t - m) (g / (1 - c))**2 is formed with both ratios rounded
    down to 24 bits or more, and squares to 2**-28 of themselves; the second term loses 2**-28 of the first.
    That is (1 - 2**-23)**2 (1 - 2**-28)**2 > 1 - 2**-22 - 2**-27. 1 - c may lose half a unit of 2**-31, which
    makes the square 2**-30 too large.

    Inside, (g T)**2 T / (P (T - P)) 2**-s is formed, with g T + 2 e for g T (see :func:`x_hat_limits`): its
    square is up to (1 + r 2**-30)**2 too large. Squaring loses 2**-28, multiplying 2**-27, and 31 bits of the
    dividend are left: less than 2**-26 in all. The 31 bits left of P (T - P) are up to 2**-30 too small.
    """
    p, c = Fraction(min(n, t - n), t), min(b, 1 - b)
    if p <= c:
        return Fraction(1, 2**22) + Fraction(1, 2**27), Q30
    r = 1 / (1 - 2 * c)
    return 1 - (1 - 4 * Q30) * (1 - 8 * Q30) * (1 - Q31), (1 + r * Q30) ** 2 / (1 - Q30) - 1


def x_bar_range(x_bar: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most x_bar with which b_hat may be formed, for the exact one.

    It is a quotient of the upper 32 bits of the sums, of which the divisor is rounded up to an even number E
    in (2**31, 2**32]. The dividend loses less than 1, the divisor gains at most 2, the quotient less than
    2**-32: it is less than (2 x_bar + 1) / E + 2**-32 too small. Below 1/2, 1 - x_bar takes its place, and
    loses 2**-32.
    """
    error = x_bar * Q30 + Q31 + Q32
    shift = Q32 if x_bar < HALF else Fraction(0)
    return x_bar - error + shift, x_bar + shift


def updates(x_bar: Fraction) -> bool | None:
    """True if b_hat may be formed from the exact ``x_bar``; None where the firmware's may be on either side
    of |2 x_bar - 1| = 2**-12."""
    found = {is_informative(each) and (each < HALF) == (x_bar < HALF) for each in x_bar_range(x_bar)}
    return found.pop() if len(found) == 1 else None


def b_hat_limits(n: int, t: int, x_bar: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most b_hat that eq. 8 may give for the exact ``x_bar``, from which an update follows.

    Eq. 8 falls or rises with x_bar on either side of 1/2. Its quotient q, too, is one of the upper 32 bits of
    numerator and denominator, which are exact: less than q 2**-30 + 2**-31 too small, then rounded down.
    """
    ends = [_eq_8(n, t, each) for each in x_bar_range(x_bar)]
    least = floor_to(min(ends) * (1 - Q30) - Q31, Q32)
    return _clamped(least), _clamped(floor_to(max(ends), Q32))


def b_hat_error(x_bar: Fraction) -> Fraction:
    """A limit of the error of b_hat for any n and t, from the exact ``x_bar``, from which an update follows.

    If x_bar is off by e, eq. 8 is off by (2 b - 1) e / (2 x_bar - 1), b being what it then gives; where that
    is outside [0, 1] it is clamped, and as far off as for the smaller e that gives 0 or 1.
    """
    least, most = x_bar_range(x_bar)
    return max(x_bar - least, most - x_bar) / abs(2 * x_bar - 1) + Q30 + Q31 + Q32


def x_error(g: Fraction) -> Fraction:
    """A limit of the error of x, against eq. 3, 4 and 7 without any rounding, in a round of robots with
    |2 b - 1| >= g whose confidences are below the largest.

    x_hat is off by 2**-23 or r 2**-31, x is rounded down to 2**-23. Relative errors of the weights between
    -l and h move a mean of numbers in [0, 1] by at most (h + l) / (4 (1 - l)). They are those of
    :func:`alpha_error`, and 2**-23 for the mantissa, or 2**-24 absolutely where that is more; the least
    confidence is that of one observation, ((1 - 2 c) / (1 - c))**2.
    """
    r, least = 1 / g, (2 * g / (1 + g)) ** 2
    low = Fraction(1, 2**22) + Fraction(1, 2**27) + max(Q23, Q24 / least)
    high = (1 + r * Q30) ** 2 / (1 - Q30) - 1
    return Q23 + max(Q23, r * Q31) + (high + low) / (4 * (1 - low))
