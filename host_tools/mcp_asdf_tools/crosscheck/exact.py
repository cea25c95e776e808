"""The paper's equations in exact rationals, and how far from them the firmware's arithmetic may be; and the
robust filter's, which are not the paper's.

Nothing here is taken from the firmware: the limits follow from the roundings that docs/design.md states. With
m = min(n, t - n), c = min(b, 1 - b), g = 1 - 2 c and r = 1 / g, only the rarer colour counts: p = m / t, and
x_hat is max(0, (p - c) / g) or its mirror image.
"""

from __future__ import annotations

from fractions import Fraction

HALF = Fraction(1, 2)
Q23, Q24, Q30, Q31, Q32 = (Fraction(1, 2**bits) for bits in (23, 24, 30, 31, 32))
EPSILON = Fraction(1, 2**20)
"""b_hat stays in [EPSILON, 1 - EPSILON]."""
UNINFORMATIVE = Fraction(1, 2**12)
LARGEST_ALPHA = Fraction(2**31 - 2**7)
SPREADS = Fraction(1, 2**12), Fraction(1, 4)
UNDECIDED = Fraction(1, 2**13)
"""The robust filter's test is right where its two sides differ by more than this part of the larger."""


def is_informative(p: Fraction) -> bool:
    """True if an observation under the accuracy ``p``, or a social estimate ``p``, carries information."""
    return abs(2 * p - 1) >= UNINFORMATIVE


def exact_estimate(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """x_hat (eq. 3) and alpha (eq. 4, at most the firmware's largest) for t > 0 and b in (0, 1)."""
    if not is_informative(b):
        return HALF, Fraction(0)
    d = 2 * b - 1
    x_hat = min(max((Fraction(n, t) + b - 1) / d, Fraction(0)), Fraction(1))
    if x_hat == 0:
        alpha = d * d * (n / (1 - b) ** 2 + (t - n) / b**2)
    elif x_hat == 1:
        alpha = d * d * (n / b**2 + (t - n) / (1 - b) ** 2)
    else:
        alpha = d * d * Fraction(t**3, n * (t - n))
    return x_hat, min(alpha, LARGEST_ALPHA)


def exact_b_hat(n: int, t: int, x_bar: Fraction) -> Fraction:
    """b_hat (eq. 8) for t > 0 and x_bar other than 1/2, kept in its range."""
    b_hat = (Fraction(n, t) + x_bar - 1) / (2 * x_bar - 1)
    return min(max(b_hat, EPSILON), 1 - EPSILON)


def x_hat_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most x_hat that the firmware may give for t > 0, both multiples of 2**-23.

    Whether p > c is decided exactly. T = 2**s t in [2**31, 2**32) and P = 2**s m are whole numbers; c T loses
    e < 1. So x = (P - c T + e) / (g T + 2 e), rounded down, where eq. 3 has (P - c T) / (g T): the quotient
    is (1 - 2 x) e / (g T + 2 e) < (1 - 2 x) r 2**-31 too near to 1/2, and never beyond it.
    """
    if not is_informative(b):
        return HALF, HALF
    exact, _ = exact_estimate(n, t, b)
    near, r = min(exact, 1 - exact), 1 / abs(2 * b - 1)
    drift = (1 - 2 * near) * r * Q31 if near else Fraction(0)
    least, most = near // Q23 * Q23, (near + drift) // Q23 * Q23
    return (least, most) if exact == near else (1 - most, 1 - least)


def alpha_error(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Relative errors (below, above) of alpha before it is brought to its grid.

    At an end of the scale (p <= c) m (g / c)**2 + (t - m) (g / (1 - c))**2 is formed with both ratios rounded
    down to 24 bits or more, and squares to 2**-28 of themselves; the second term loses 2**-28 of the first.
    That is (1 - 2**-23)**2 (1 - 2**-28)**2 > 1 - 2**-22 - 2**-27. 1 - c may lose half a unit of 2**-31, which
    makes the square 2**-30 too large.

    Inside, (g T)**2 T / (P (T - P)) 2**-s is formed, with g T + 2 e for g T (see ``x_hat_limits``): its
    square is up to (1 + r 2**-30)**2 too large. Squaring loses 2**-28, multiplying 2**-27, and 31 bits of the
    dividend are left: less than 2**-26 in all. The 31 bits left of P (T - P) are up to 2**-30 too small.
    """
    p, c = Fraction(min(n, t - n), t), min(b, 1 - b)
    if p <= c:
        return Fraction(1, 2**22) + Fraction(1, 2**27), Q30
    r = 1 / (1 - 2 * c)
    return 1 - (1 - 4 * Q30) * (1 - 8 * Q30) * (1 - Q31), (1 + r * Q30) ** 2 / (1 - Q30) - 1


def alpha_limits(n: int, t: int, b: Fraction) -> tuple[Fraction, Fraction]:
    """Least and most alpha that the firmware may give for t > 0: 24 bits and its grid lose some more."""
    (_, exact), (below, above) = exact_estimate(n, t, b), alpha_error(n, t, b)
    return exact * (1 - below) * (1 - Q23) - Q24, exact * (1 + above)


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


def b_hat_error(x_bar: Fraction) -> Fraction:
    """A limit of the error of b_hat for any n and t, from the exact ``x_bar``, from which an update follows.

    If x_bar is off by e, eq. 8 is off by (2 b - 1) e / (2 x_bar - 1), b being what it then gives; where that
    is outside [0, 1] it is clamped, and as far off as for the smaller e that gives 0 or 1.
    """
    least, most = x_bar_range(x_bar)
    return max(x_bar - least, most - x_bar) / abs(2 * x_bar - 1) + Q30 + Q31 + Q32


def vote_limits(
    votes: int, centre: Fraction, spread: Fraction, said: Fraction
) -> list[tuple[Fraction, Fraction]]:
    """Least and most centre and spread after the ``votes``-th vote. The step and the change, powers of two of
    whole numbers of 2**-30, are rounded down, so that neither moves too far."""
    gain = Fraction(1, 2 ** max(votes.bit_length() - 3, 3))
    step = gain * min(max(said - centre, -spread), spread)
    change = gain / 2 * (spread if abs(said - centre) > spread else -spread)
    centres = sorted((centre + step, centre + step - (Q30 if step > 0 else -Q30)))
    spreads = sorted((spread + change, spread + change - (Q30 if change > 0 else -Q30)))
    least, most = (min(max(each, SPREADS[0]), SPREADS[1]) for each in spreads)
    return [(max(centres[0], min(centre, said)), min(centres[1], max(centre, said))), (least, most)]


def deviates(n: int, t: int, b: Fraction, centre: Fraction, spread: Fraction) -> bool | None:
    """Whether the robust filter's test rejects ``b`` for t > 0; None where rounding may decide.

    With g = 2 b - 1 both sides are at least 12 2**-33 where they are alike, as t < 2**31, v >= (1 - g**2) / 4
    and spread >= 2**-12. So D is at least 160,000 units of 2**-32, of which p lacks less than 4, and n/t less
    than 5: D**2 is off by 2**-13.9 of itself. The product of g and the spread, rounded down, takes 2**-15.5
    from the other side, and v, which lacks 5 units, far less.
    """
    seen, p = Fraction(n, t), b * centre + (1 - b) * (1 - centre)
    variance = max(p * (1 - p), seen * (1 - seen))
    square, least = (seen - p) ** 2, 12 * (variance / t + (2 * b - 1) ** 2 * spread**2)
    return None if abs(square - least) <= UNDECIDED * max(square, least) else square > least
