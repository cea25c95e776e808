"""The paper's equations on exact rationals, and how far from them the firmware's numbers may be.

The formulas are the paper's as printed, the limits those of ``docs/design.md`` (sections 3, 4, 6 and 7);
nothing here is taken from the firmware. With m = min(n, t - n), c = min(b, 1 - b), g = 1 - 2 c and
r = 1 / g, only the rarer colour counts: p = m / t, and x_hat is max(0, (p - c) / g) or its mirror image.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction

Q23, Q24, Q32 = Fraction(1, 2**23), Fraction(1, 2**24), Fraction(1, 2**32)
HALF = Fraction(1, 2)
B_HAT_LEAST, B_HAT_MOST = Fraction(1, 2**20), 1 - Fraction(1, 2**20)
ALPHA_MOST = Fraction(2**31 - 2**7)
LONG = 2**31
"""From this many observations on, estimates use t and n without their last bits."""


def is_informative(b: Fraction) -> bool:
    """Whether an observation under the accuracy ``b`` says anything."""
    return abs(2 * b - 1) >= Fraction(1, 2**12)


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
    quotient = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    return min(max(quotient, B_HAT_LEAST), B_HAT_MOST)


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


def of_bits(bits: int) -> Fraction:
    """The value of finite binary32 bits."""
    return Fraction(struct.unpack("<f", struct.pack("<I", bits))[0])


def to_bits(value: Fraction) -> int:
    """binary32 bits of a value that is one."""
    bits = int(struct.unpack("<I", struct.pack("<f", float(value)))[0])
    assert of_bits(bits) == value
    return bits


def _rarer(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    return Fraction(min(n, t - n), t), min(b, 1 - b)


def x_hat_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most x_hat that the firmware may give for t > 0.

    On the nearer half of the scale, x - x_exact is in (-2**-23 - r e, r f + 2**-31]:

    - 2**-23: x is rounded down to its unit, once.
    - e = 2**-32: n / t is rounded down to 32 bits, and eq. 3 divides that by g.
    - 2**-31: 1 / g is rounded up by at most 2**-30 of itself, and x <= 1/2.
    - From t = 2**31 on, floor(m / 2) / floor(t / 2) stands for p: from 2**-31 below to 2**-32 above it, so
      e = 2**-31 + 2**-32 and f = 2**-32. Below, f = 0.
    """
    if not is_informative(b):
        return HALF, HALF
    exact, r = x_hat(n, t, b), 1 / abs(2 * b - 1)
    below = Q23 + r * (3 * Q32 if t >= LONG else Q32)
    above = (r * Q32 if t >= LONG else 0) + 2 * Q32
    below, above = (below, above) if exact <= HALF else (above, below)
    return max(exact - below, Fraction(0)), min(exact + above, Fraction(1))


def alpha_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most alpha that the firmware may give for t > 0; :func:`alpha_error` makes them."""
    if not is_informative(b):
        return Fraction(0), Fraction(0)
    exact, (below, above) = alpha(n, t, b), alpha_error(n, t, b)
    least = min(exact, ALPHA_MOST) * (1 - below) - Q24
    return max(least, Fraction(0)), min(exact * (1 + above), ALPHA_MOST)


def alpha_error(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Relative errors (below, above) of alpha, before it loses what is off its grid or above its cap.

    Always: at least 23 significant bits are kept, so 2**-22 below; and 2**-26 below for products of 32 bits
    (10.5 2**-30 at an end: edge 3, odds 4, the sum 2, its mantissa 1/2, their product 1; 3 2**-30 inside).

    At an end of the scale (floor of p <= c) 2**-21 below: edge and odds are squares of quotients of 24 bits
    or more, each at most 2**-23 too small; and 2**-30 above: edge is formed with (1 - c) rounded down. Where
    p > c all the same, this formula gives at most 2 / s more than the other.

    Inside, p (1 - p) in units of 2**-32, s exactly, is up to 2 too small: floor of p, then of the product.
    So alpha is up to 2 / (s - 2) too large: 2**-21 from p (1 - p) = 2**-10 on, and 2**-15.5 at the rarest
    colour whose alpha is below the cap, as p >= 1 / t and t / p < 2**31.

    From t = 2**31 on, the lost bits of t and m put p off by -2 .. 1 units of 2**-32 and t by one in 2**31.
    Inside, p (1 - p) is from 1 unit too large to 4 too small; near p = c the two formulas may change places,
    which adds at most 2 / s. At an end a lost bit of m takes odds / t, odds = ((1 - c) / c)**2. Where that is
    much, alpha is near its cap: what is left, (g / (1 - c))**2 t, is at most 2 c / (1 - c) below it. The
    smaller of the two is 2**-9.67 at the worst c, 2**-10.67.
    """
    p, c = _rarer(n, t, b)
    always, s = Fraction(1, 2**22) + Fraction(1, 2**26), max(p, c) * (1 - max(p, c)) / Q32
    roots, edge = (Fraction(1, 2**21), Fraction(1, 2**30)) if p < c + 3 * Q32 else (Fraction(0), Fraction(0))
    if t < LONG:
        return always + roots, (2 / (s - 2) if p > c else Fraction(0)) + edge
    lost_bit = min(((1 - c) / c) ** 2 / t, 2 * c / (1 - c)) if roots else Fraction(0)
    return always + roots + lost_bit + 3 / (s - 3), 6 / (s - 6) + edge


def b_hat_limits(n: int, t: int, x_bar: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most b_hat that eq. 8 may give: less than 2**-29 below the exact quotient, never above.

    Let u = 2**s drop all but the upper 31 bits: numerator A u + a, denominator (D - 1) u + d. The quotient q
    loses (a + q (u - d)) / (u D) < (a + u - d) / u 2**-30 to A / D. Twice the numerator less the denominator
    is a multiple of 2**23, and s <= 24, so 2 a - d is a multiple of u / 2, and a + u - d at most 7 u / 4.
    That makes 7 2**-32, and rounding down one more.
    """
    exact = b_hat(n, t, x_bar)
    return max(exact - 8 * Q32, B_HAT_LEAST), exact
