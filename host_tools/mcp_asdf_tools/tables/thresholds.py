"""Making t-tables: the thresholds of the hypothesis test (eq. 12) for one omega and one bound q.

With ``k_m = (t_{m-1,(1-omega)/2} / sqrt(m) + 1)**2 * m / (m - 1)`` the test needs no root and no
division. Omega is a decimal with at most 9 places, so that the word that the table stores
(omega in units of 2**-32, a finer grid) identifies it exactly, and a table found in an image can be
compared with the one that it claims to be.
"""

from __future__ import annotations

from decimal import ROUND_CEILING, Context, Decimal, InvalidOperation
from functools import lru_cache
from typing import NamedTuple

from mpmath import mp, mpf  # type: ignore[import-untyped]

from mcp_asdf.robot import MAX_ID
from mcp_asdf.table import FRACTION_BITS, MAX_Q, MIN_Q, Table
from mcp_asdf_tools.common.errors import UsageError

GENERATOR_VERSION = 2
"""Changes whenever the bytes of a generated file change."""

MAX_OMEGA = Decimal("0.9")
OMEGA_PLACES = 9
MAX_MESSAGES = MAX_ID
"""Maximum number of messages in a round, for any q."""

_DIGITS = 50
"""Digits computed. They decide every entry that is not within 10^-30 of the middle between two multiples:
that one of the 10^13 entries of all possible tables is so close has a probability of 10^-17."""
_NOISE = mpf("1e-47")
"""Steps so small are rounding noise."""


def parse_omega(text: str) -> Decimal:
    """Read omega from decimal text, in its shortest form. Raises UsageError outside (0, 0.9]."""
    try:
        omega = Decimal(text)
    except InvalidOperation:
        raise UsageError(f"omega is {text!r}, not a decimal number; give one such as 0.05") from None
    if not (omega.is_finite() and 0 < omega <= MAX_OMEGA and omega == round(omega, OMEGA_PLACES)):
        raise UsageError(
            f"omega is {text}; it must be above 0 and at most {MAX_OMEGA}, "
            f"with no more than {OMEGA_PLACES} decimal places, for example 0.05"
        )
    return omega.normalize()


def omega_word(omega: Decimal) -> int:
    """Omega in units of 2**-32, rounded to nearest (a tie cannot happen with 9 decimal places)."""
    return round(omega * 2**32)


def omega_from_word(word: int) -> Decimal | None:
    """Return the only omega with at most 9 decimal places that has this word; None if there is none."""
    omega = round(Decimal(word) / 2**32, OMEGA_PLACES).normalize()
    return omega if omega_word(omega) == word and 0 < omega <= MAX_OMEGA else None


def check_q(q: int) -> int:
    """Return ``q``. Raises UsageError outside 2 .. 127."""
    if not MIN_Q <= q <= MAX_Q:
        raise UsageError(f"the number of neighbours is {q}; it must be {MIN_Q} to {MAX_Q}")
    return q


@lru_cache(maxsize=16)
def generate(omega: Decimal, q: int) -> Table:
    """Return the table for ``omega`` (see ``parse_omega``) and ``q`` in 2 .. 127.

    Every entry is the multiple of 2**-26 nearest to k_m. Takes about 0.1 s. Raises UsageError if ``omega`` or
    ``q`` is out of range.
    """
    omega, q = parse_omega(str(omega)), check_q(q)
    with mp.workdps(_DIGITS):
        beyond_q = _threshold(_normal_score(omega), q + 1)
        thresholds = (*true_thresholds(omega)[: q - 1], beyond_q)
        entries = tuple(int(mp.nint(mp.ldexp(k, FRACTION_BITS))) for k in thresholds)
        return Table(omega_word(omega), entries)


@lru_cache(maxsize=16)
def true_thresholds(omega: Decimal) -> tuple[mpf, ...]:
    """Compute k_m for every m a round can hold, 2 .. 127; relative error below 10**-40."""
    with mp.workdps(_DIGITS):
        score = _normal_score(omega)
        downward = []
        for m in range(MAX_MESSAGES, 1, -1):
            score = _t_score(mpf(str(omega)), m - 1, score)
            downward.append(_threshold(score, m))
        return tuple(reversed(downward))


def _normal_score(omega: Decimal) -> mpf:
    """The quantile that t_{m-1,(1-omega)/2} falls to as m grows."""
    return mp.sqrt(2) * mp.erfinv(mpf(str(omega)))


def _threshold(score: mpf, m: int) -> mpf:
    return (score / mp.sqrt(m) + 1) ** 2 * m / (m - 1)


def _t_score(omega: mpf, freedom: int, start: mpf) -> mpf:
    """Return t with P(|T| < t) = omega, that is P(T > t) = (1 - omega)/2; ``start`` lies at or below it.

    P is concave for t > 0, so Newton's steps from below never pass the root: the first step that is
    not upward is rounding noise. The score for more degrees of freedom is such a start.
    """
    score, step = start, mp.inf
    while step > _NOISE:
        step = (omega - _central_probability(score, freedom)) / _density(score, freedom)
        score += step
    return score


def _central_probability(t: mpf, freedom: int) -> mpf:
    """P(|T| < t) of Student's distribution."""
    square = t * t
    return mp.betainc(mpf(1) / 2, mpf(freedom) / 2, 0, square / (freedom + square), regularized=True)


def _density(t: mpf, freedom: int) -> mpf:
    """Density of |T| at ``t``."""
    scale = 2 / (mp.sqrt(freedom) * mp.beta(mpf(1) / 2, mpf(freedom) / 2))
    return scale * (1 + t * t / freedom) ** (-mpf(freedom + 1) / 2)


class ThresholdError(NamedTuple):
    """Largest relative error of a table's thresholds, as eq. 12 compares them: of sqrt(k_m).

    Attributes:
        rounding: For m = 2 .. q.
        beyond_q: For m = q + 1 .. 127, which share one entry; 0 if q is 127.

    Both are rounded up to three digits.
    """

    rounding: float
    beyond_q: float


def worst_threshold_error(omega: Decimal, table: Table) -> ThresholdError:
    """Compare every threshold that ``table`` can give (m = 2 .. 127) with the true one."""
    with mp.workdps(_DIGITS):
        errors = [
            abs(mp.sqrt(mp.ldexp(table.entry(m), -FRACTION_BITS) / true) - 1)
            for m, true in enumerate(true_thresholds(omega), start=2)
        ]
        own = table.q - 1
        return ThresholdError(_round_up(max(errors[:own])), _round_up(max(errors[own:], default=mpf(0))))


def _round_up(value: mpf) -> float:
    return float(Context(prec=3, rounding=ROUND_CEILING).create_decimal(str(value)))
