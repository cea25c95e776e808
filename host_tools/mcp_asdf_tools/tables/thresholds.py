"""Generating t-tables: the thresholds of the hypothesis test (eq. 12) for one omega and one q.

With ``k_m = (t_{m-1,(1-omega)/2} / sqrt(m) + 1)**2 * m / (m - 1)`` the test needs no square root and no
division. Omega is a decimal with at most 9 places, so the word that a table stores (omega in units of
2**-32, a finer grid) identifies it exactly: a robot that has a table can name the omega that made it.
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

_DECIMAL_DIGITS = 50
"""Precision of the computation. It decides every entry that is not within 10^-30 of the middle between two
multiples of 2^-26; that one of the 10^13 entries of all possible tables is so close has a probability of
10^-17."""
_NEGLIGIBLE_STEP = mpf("1e-47")
"""A step of Newton's method that is not larger is rounding noise."""


def parse_omega(omega_text: str) -> Decimal:
    """Return the omega that a decimal text gives, in its shortest form.

    Raises UsageError for anything but a number above 0 and at most 0.9 with at most 9 decimal places.
    """
    try:
        omega = Decimal(omega_text)
    except InvalidOperation:
        raise UsageError(f"omega is {omega_text!r}, not a decimal number; give one such as 0.05") from None
    # Decimal reads Infinity and NaN, too. NaN cannot be compared, so both are refused first.
    is_legal = omega.is_finite() and 0 < omega <= MAX_OMEGA and omega == round(omega, OMEGA_PLACES)
    if not is_legal:
        raise UsageError(
            f"omega is {omega_text}; it must be above 0 and at most {MAX_OMEGA}, "
            f"with no more than {OMEGA_PLACES} decimal places, for example 0.05"
        )
    return omega.normalize()


def omega_word(omega: Decimal) -> int:
    """Return omega in units of 2**-32, rounded to nearest, as a table stores it.

    With 9 decimal places omega never lies in the middle between two units.
    """
    return round(omega * 2**32)


def omega_from_word(word: int) -> Decimal | None:
    """Return the only omega with at most 9 decimal places that has this word, or None if there is none.

    Units of 2^-32 are finer than 9 decimal places: at most one such omega rounds to this word.
    """
    omega = round(Decimal(word) / 2**32, OMEGA_PLACES).normalize()
    is_exact = omega_word(omega) == word
    return omega if is_exact and 0 < omega <= MAX_OMEGA else None


def check_q(q: int) -> int:
    """Return ``q``, the number of neighbours. Raises UsageError unless it is 2 to 127."""
    if not MIN_Q <= q <= MAX_Q:
        raise UsageError(f"the number of neighbours is {q}; it must be {MIN_Q} to {MAX_Q}")
    return q


@lru_cache(maxsize=16)
def generate(omega: Decimal, q: int) -> Table:
    """Return the t-table for ``omega`` and for ``q`` neighbours with exact thresholds.

    Every entry is the multiple of 2**-26 nearest to k_m, the threshold for m messages. Takes about 0.1 s.
    Raises UsageError unless omega is above 0 and at most 0.9, with at most 9 decimal places, and q is 2 to
    127.
    """
    omega = parse_omega(str(omega))
    q = check_q(q)
    with mp.workdps(_DECIMAL_DIGITS):
        exact_thresholds = true_thresholds(omega)[: q - 1]  # for m = 2 .. q
        # One more threshold serves all m above q. It is that of a normal distribution at m = q + 1.
        common_threshold = _threshold(_normal_quantile(omega), q + 1)
        # In units of 2**-26, rounded to the nearest.
        entries = [
            int(mp.nint(mp.ldexp(threshold, FRACTION_BITS)))
            for threshold in (*exact_thresholds, common_threshold)
        ]
        return Table(omega_word(omega), tuple(entries))


@lru_cache(maxsize=16)
def true_thresholds(omega: Decimal) -> tuple[mpf, ...]:
    """Return the thresholds k_m for m = 2 .. 127 messages, all that a robot can receive in a round.

    Their relative error is below 10**-40.
    """
    with mp.workdps(_DECIMAL_DIGITS):
        # From many degrees of freedom to few the quantile grows, so each is a start below the next one. The
        # first start is the normal quantile, which is below all of them.
        quantile = _normal_quantile(omega)
        thresholds = []
        for m in range(MAX_MESSAGES, 1, -1):
            degrees_of_freedom = m - 1
            quantile = _t_quantile(mpf(str(omega)), degrees_of_freedom, start=quantile)
            thresholds.append(_threshold(quantile, m))
        return tuple(reversed(thresholds))


def _normal_quantile(omega: Decimal) -> mpf:
    """Return the normal distribution's quantile, to which the quantile of eq. 12 falls as m grows.

    The quantile of eq. 12 is t_{m-1,(1-omega)/2}, the quantile of Student's distribution for m messages.
    """
    return mp.sqrt(2) * mp.erfinv(mpf(str(omega)))


def _threshold(quantile: mpf, m: int) -> mpf:
    """Return k_m, the threshold for m messages, from the quantile t in eq. 12, the hypothesis test."""
    return (quantile / mp.sqrt(m) + 1) ** 2 * m / (m - 1)


def _t_quantile(omega: mpf, degrees_of_freedom: int, start: mpf) -> mpf:
    """Return t with P(|T| < t) = omega, where T has Student's distribution.

    ``start`` must not lie above the result.
    """
    # Newton's method for the root of P(|T| < t) - omega, whose derivative is the density of |T|. P is concave
    # for t > 0, so steps from below never pass the root: the first that is not upward is rounding noise.
    quantile = start
    step = mp.inf
    while step > _NEGLIGIBLE_STEP:
        missing_probability = omega - _central_probability(quantile, degrees_of_freedom)
        step = missing_probability / _density(quantile, degrees_of_freedom)
        quantile += step
    return quantile


def _central_probability(t: mpf, degrees_of_freedom: int) -> mpf:
    """Return P(|T| < t), where T has Student's distribution.

    With d degrees of freedom it is the regularised incomplete beta function I_x(1/2, d/2) at
    x = t^2 / (d + t^2).
    """
    square = t * t
    upper_limit = square / (degrees_of_freedom + square)
    return mp.betainc(mpf(1) / 2, mpf(degrees_of_freedom) / 2, 0, upper_limit, regularized=True)


def _density(t: mpf, degrees_of_freedom: int) -> mpf:
    """Return the probability density of |T| at ``t``, where T has Student's distribution.

    It is twice the density of T, since t and -t count alike.
    """
    scale = 2 / (mp.sqrt(degrees_of_freedom) * mp.beta(mpf(1) / 2, mpf(degrees_of_freedom) / 2))
    return scale * (1 + t * t / degrees_of_freedom) ** (-mpf(degrees_of_freedom + 1) / 2)


class ThresholdError(NamedTuple):
    """Largest relative errors of a table's thresholds as eq. 12 compares them: of sqrt(k_m).

    Attributes:
        rounding: For m = 2 .. q.
        beyond_q: For m = q + 1 .. 127, which share one entry; 0 if q is 127.

    Both are rounded up to three digits.
    """

    rounding: float
    beyond_q: float


def worst_threshold_error(omega: Decimal, table: Table) -> ThresholdError:
    """Return the largest errors of the thresholds that ``table`` gives for m = 2 .. 127 messages.

    They are relative errors of sqrt(k_m), rounded up to three digits. One error is for m up to q, which have
    entries of their own; the other is for all m above q, which share an entry, and is 0 if q is 127.
    """
    with mp.workdps(_DECIMAL_DIGITS):
        errors = []
        for m, true_threshold in enumerate(true_thresholds(omega), start=2):
            table_threshold = mp.ldexp(table.entry(m), -FRACTION_BITS)
            # This is the relative error of sqrt(k_m), with which eq. 12 compares.
            errors.append(abs(mp.sqrt(table_threshold / true_threshold) - 1))
        # The errors begin with m = 2: the first q - 1 belong to m = 2 .. q.
        exact_entry_errors = errors[: table.q - 1]
        common_entry_errors = errors[table.q - 1 :]
        return ThresholdError(
            rounding=_round_up(max(exact_entry_errors)),
            beyond_q=_round_up(max(common_entry_errors, default=mpf(0))),
        )


def _round_up(value: mpf) -> float:
    """Return a value rounded up to three digits, so that a stated error is never exceeded."""
    return float(Context(prec=3, rounding=ROUND_CEILING).create_decimal(str(value)))
