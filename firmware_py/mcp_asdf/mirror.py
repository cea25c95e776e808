"""The firmware in Python integers: after every call the same bits as ``c_ref/src/mcp_asdf.c``.

Read it beside the C, function by function; where the C has another name, the docstring says so. Where the C
needs several words for a number, or estimates a digit of a quotient and corrects it, here is the plain
expression in Python's unbounded integers: where both agree, the C's shortcuts are right. Numbers are rounded
down unless a comment says otherwise. ``docs/design.md`` specifies every bit; "eq." means an equation of the
paper.

Formats are those of ``mcp_asdf.fixed_point``. A "word" is an integer of 32 bits, and MAX_WORD the largest.
Names that begin with Q32 are numbers in units of 2**-32. ``mcp_asdf.robot`` defines the words of this
package; the ones needed most are b_hat, the accuracy that a robot assumes of its sensor; x_hat, its estimate
of the share of black tiles after n black among t observations; alpha, the confidence of that; and a round,
which is what a robot receives from one ``settle`` to the next. ``mcp_asdf.robust_filter`` has the robust
filter, which is not the paper's, and ``mcp_asdf.arithmetic`` the products and quotients.
"""

from __future__ import annotations

import operator
import struct
from dataclasses import astuple, dataclass, field, fields

from mcp_asdf.arithmetic import (
    Q32_HALF,
    Q32_ONE,
    divide_24,
    leading_zeros,
    multiply_high,
    q32_quotient,
)
from mcp_asdf.fixed_point import (
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    ONE,
    FixedPointView,
    add_estimate,
    alpha_units,
    alpha_word_from_units,
    are_valid_sums,
    b_hat_to_raw,
    is_valid_mean,
)
from mcp_asdf.image_format import (
    IMPOSSIBLE_STATE,
    find_image_error,
    first_image_word,
    unpack_image,
)
from mcp_asdf.robot import (
    MAX_ID,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Status,
    Sums,
    check_id_and_b_hat,
    check_settings,
    check_table,
)
from mcp_asdf.robust_filter import (
    SLOTS,
    TESTED_ESTIMATES_MIN,
    RobustFilter,
    are_valid_slots,
    are_valid_votes,
    begin_batch,
    centre_and_spread_of,
    end_batch,
    is_supported,
    is_valid_batch,
    is_valid_initial_b_hat,
    keep_estimate,
    q23_from_q30,
    q32_from_q24,
    robust_test_rejects,
    sorted_estimates,
    take_vote,
)
from mcp_asdf.table import FRACTION_BITS, MAX_WORD, Table, checksum

INFORMATIVE_G = 1 << 20
"""2**-12 in units of 2**-32: smallest |2 p - 1| of an accuracy or an estimate p that carries information."""

C_WITHOUT_INFORMATION = MAX_WORD
"""Value of c, the probability of an error, if b_hat carries no information. Otherwise c is at most 1/2."""

COUNTER_MASK = 0xFFFF
"""Counters of events have 16 bits."""

WORD_BITS = 32


@dataclass(frozen=True)
class Accuracy:
    """The assumed accuracy b_hat, and values that depend on it alone: see ``mcp_asdf_accuracy_t``.

    They are computed when b_hat changes, so that an observation takes less time. Two symbols are short for
    terms of eq. 3 and 4: c = min(b_hat, 1 - b_hat) is the probability of an error of a sensor that is right
    more often than not, and g = 1 - 2 c = |2 b_hat - 1|, the square root of the paper's d, says how much an
    observation tells.

    Attributes:
        b_hat: Accuracy that the robot assumes of its sensor, in units of 2**-32.
        c: Probability of an error, in units of 2**-32; C_WITHOUT_INFORMATION if b_hat carries none.
        common: Weight of an observation of the more frequent colour in alpha: (g / (1 - c))**2, times
            2**(30 + 2 g_shift) and rounded down.
        rare: Weight of an observation of the rarer colour: (g / c)**2, times 2**(30 + 2 g_shift - rare_shift)
            and rounded down.
        g_shift: Number of bits by which g can be shifted up until the highest of its 32 bits is set.
        rare_shift: Twice that number for c, because ``rare`` has c squared.
    """

    b_hat: int
    c: int
    common: int
    rare: int
    g_shift: int
    rare_shift: int


def square_of_ratio(g: int, p: int) -> int:
    """Return (g / p)**2 in units of 2**-30, for g and p in [2**31, 2**32).

    The ratio is rounded down to a multiple of 2**-24 before it is squared.
    """
    # divide_24 takes numbers of 31 bits. Both are halved, which changes their ratio by the lowest bits only.
    ratio_q24 = divide_24(g >> 1, p >> 1)
    ratio_q31 = ratio_q24 << 7  # the same ratio in units of 2**-31
    # The whole square has the unit 2**-62, 2**-31 squared. Its upper word has a unit 2**32 times as large.
    return multiply_high(ratio_q31, ratio_q31)


def accuracy_of(b_hat: int) -> Accuracy:
    """Return an assumed accuracy, in units of 2**-32, with c and the weights that observations have for it.

    c = min(b_hat, 1 - b_hat) is the probability of an error, or C_WITHOUT_INFORMATION if g = 1 - 2 c is below
    2**-12. In alpha, the confidence, an observation of the more frequent colour has the weight
    (g / (1 - c))**2, and an observation of the rarer colour the weight (g / c)**2. Both weights are computed
    from numbers that are shifted up until the highest of their 32 bits is set, and the result says by how
    many bits. In C this is ``set_b_hat``.
    """
    c = min(b_hat, Q32_ONE - b_hat)  # a sensor that is mostly wrong tells as much as its opposite
    g = Q32_ONE - 2 * c  # in units of 2**-32, as c
    is_informative = g >= INFORMATIVE_G
    # Shifted numbers give quotients of 24 bits also where g or c is small.
    g_shift = leading_zeros(g)
    c_shift = leading_zeros(c)
    shifted_g = g << g_shift
    shifted_c = c << c_shift
    one_minus_c = Q32_ONE - c  # at least 1/2: its highest bit is set without a shift
    return Accuracy(
        b_hat=b_hat,
        c=c if is_informative else C_WITHOUT_INFORMATION,
        common=square_of_ratio(shifted_g, one_minus_c),  # (g / (1 - c))**2, but for the shift
        rare=square_of_ratio(shifted_g, shifted_c),  # (g / c)**2, but for both shifts
        g_shift=g_shift,
        rare_shift=2 * c_shift,  # c is squared, and so is the factor 2**c_shift
    )


# ---- The local estimate: eq. 3 and 4 ----


def times_power_of_two(number: int, exponent: int) -> int:
    """Return number * 2**exponent, rounded down. The exponent may be negative."""
    return number << exponent if exponent >= 0 else number >> -exponent


def upper_bits(number: int, bits: int) -> tuple[int, int]:
    """Return the upper ``bits`` bits of a number above 0, and their exponent: the number of bits below them.

    The number is upper * 2**exponent, rounded down. A shorter number gets zeros as its lowest bits, and the
    exponent is negative.
    """
    exponent = number.bit_length() - bits
    return times_power_of_two(number, -exponent), exponent


def confidence_at_end(accuracy: Accuracy, t: int, rare_count: int) -> int:
    """Return alpha, the confidence, in units of 2**-24, where x_hat is 0 or 1 (eq. 4, first two cases).

    The paper's numerators, multiplied out, leave a sum without a difference:

        alpha = rare_count (g / c)**2 + (t - rare_count) (g / (1 - c))**2

    where ``rare_count`` of t > 0 observations are of the rarer colour, c is the probability of an error and
    g = 1 - 2 c. ``accuracy`` has the squares as integers: ``common`` is (g / (1 - c))**2, times
    2**(30 + 2 g_shift), and ``rare`` is (g / c)**2, times 2**(30 + 2 g_shift - rare_shift).
    """
    common_term = (t - rare_count) * accuracy.common
    # The exponent takes back the factor of ``common``, and adds the 24 bits of alpha behind the point.
    exponent = 24 - (30 + 2 * accuracy.g_shift)
    if rare_count == 0:
        return times_power_of_two(common_term, exponent)
    # The common term has rare_shift bits more behind the point than the rare one, and loses them.
    rare_term = rare_count * accuracy.rare
    shorter_common_term = common_term >> accuracy.rare_shift
    return times_power_of_two(rare_term + shorter_common_term, exponent + accuracy.rare_shift)


def confidence_inside(accuracy: Accuracy, total: int, rarer: int, g_total: int, count_shift: int) -> int:
    """Return alpha, the confidence, in units of 2**-24, where 0 < x_hat < 1 (eq. 4, last case).

    With d = g**2, that case is, with n of t observations of either colour,

        alpha = d t**3 / (n (t - n)) = (g t)**2 t / (n (t - n))

    The caller has shifted all numbers up, so that products keep their upper bits: ``total`` is t and
    ``rarer`` is n, both times 2**count_shift. ``g_total`` is g t, times 2**(count_shift + g_shift), with the
    ``g_shift`` of ``accuracy``.
    """
    # multiply_high leaves out the lower 32 bits of a product.
    square = multiply_high(g_total, g_total)  # (g t)**2, times 2**(2 count_shift + 2 g_shift - 32)
    numerator = multiply_high(square, total)  # (g t)**2 t, times 2**(3 count_shift + 2 g_shift - 64)
    denominator = rarer * (total - rarer)  # n (t - n), times 2**(2 count_shift)
    # numerator / denominator is alpha, times 2**-exponent:
    exponent = 64 - count_shift - 2 * accuracy.g_shift
    # divide_24 takes numbers of 31 bits: the upper ones of both. The bits below count in the exponent.
    upper_numerator, bits_below_numerator = upper_bits(numerator, 31)
    upper_denominator, bits_below_denominator = upper_bits(denominator, 31)
    quotient = divide_24(upper_numerator, upper_denominator)  # in units of 2**-24, as alpha
    return times_power_of_two(quotient, exponent + bits_below_numerator - bits_below_denominator)


def estimate(t: int, n: int, accuracy: Accuracy) -> tuple[int, int]:
    """Return x_hat (eq. 3) and its confidence as an alpha word (eq. 4) after n black of t > 0 observations.

    ``accuracy`` has b_hat, the accuracy that the robot assumes of its sensor. x_hat, the estimated share of
    black tiles, is in units of 2**-23. It is

        x_hat = (n / t + b_hat - 1) / (2 b_hat - 1)     clamped to 0 .. 1

    but 1/2, with no confidence, if |2 b_hat - 1| < 2**-12: then b_hat carries no information. An alpha word
    has a mantissa in bits 8 to 31 and a shift in bits 0 to 4; the word 0 is no confidence. Both are computed
    by ``estimate_of_rarer_colour`` as if the rarer colour were black and the sensor mostly right.
    """
    if accuracy.c == C_WITHOUT_INFORMATION:
        return HALF, 0
    rare_count = min(n, t - n)
    x_hat_of_rarer, alpha = estimate_of_rarer_colour(t, rare_count, accuracy)
    # x_hat is the share of black. Two things make it the share of the other colour, and both together do not:
    # white is the rarer colour, or the sensor takes most black tiles for white ones and the reverse.
    is_white_rarer = n >= t - n
    is_mostly_wrong = accuracy.b_hat < Q32_HALF
    is_mirrored = is_white_rarer != is_mostly_wrong
    x_hat = ONE - x_hat_of_rarer if is_mirrored else x_hat_of_rarer
    return x_hat, alpha_word_from_units(alpha)


def estimate_of_rarer_colour(t: int, rare_count: int, accuracy: Accuracy) -> tuple[int, int]:
    """Return the estimated share of the colour that was observed less often, and its confidence (eq. 3, 4).

    The share is in units of 2**-23, and the confidence in units of 2**-24. ``rare_count`` of ``t`` > 0
    observations are of this colour, a share p of at most 1/2. The sensor is taken for one that is right more
    often than not. It errs with the probability c that ``accuracy`` has, below 1/2; with g = 1 - 2 c the
    estimate is

        (p - c) / g     or 0 if p <= c

    The confidence is that of `confidence_at_end` if the estimate is 0, and of `confidence_inside` otherwise.
    """
    # Both counts are shifted up until t fills 32 bits, so that products keep their upper bits.
    count_shift = leading_zeros(t)
    total = t << count_shift
    rarer = rare_count << count_shift  # p total
    # On a floor without the rarer colour, errors of the sensor would show it this often.
    errors = multiply_high(accuracy.c, total)  # c total
    if rarer <= errors:
        # Errors explain all observations of the rarer colour.
        return 0, confidence_at_end(accuracy, t, rare_count)
    # Both sides of the fraction are multiplied by ``total``, and shifted up, since g may be small.
    shifted_excess = (rarer - errors) << accuracy.g_shift  # (p - c) total
    g_total = (total - 2 * errors) << accuracy.g_shift  # g total, as g is 1 - 2 c: 31 or 32 bits
    # divide_24 takes a divisor of at most 31 bits. With half of the divisor, the quotient is twice as large.
    twice_the_estimate = divide_24(shifted_excess, g_total >> 1)  # in units of 2**-24
    x_hat = twice_the_estimate >> 2  # by 1 to undo the doubling, and by 1 for units of 2**-23
    return x_hat, confidence_inside(accuracy, total, rarer, g_total, count_shift)


# ---- The round: eq. 5 to 7, and 12 ----


def informed_estimate(closed: Closed, x_hat: int, alpha: int) -> int:
    """Return x (eq. 7): the mean of the received x_hat and an own one, weighted by their confidence.

    ``closed`` has the sums over the messages j that the robot received in its last closed round. x is

        x = (alpha x_hat + sum alpha_j x_hat_j) / (alpha + sum alpha_j)

    ``x_hat`` and the result are in units of 2**-23. ``alpha``, its confidence, is an alpha word: a mantissa
    in bits 8 to 31 and a shift in bits 0 to 4. The result is ``x_hat`` if all confidences are 0. For an own
    alpha of 0 it is x_bar (eq. 5).
    """
    own_alpha = alpha_units(alpha)
    sum_alpha = closed.alpha + own_alpha  # units of 2**-24
    sum_alpha_x = closed.alpha_x + own_alpha * x_hat  # units of 2**-47, of 2**-24 times 2**-23
    if sum_alpha == 0:
        return x_hat
    return sum_alpha_x // sum_alpha


def asdf_test_rejects(table: Table, open_round: Sums, x_hat: int) -> bool:
    """Return whether a robot's x_hat differs too much from the m >= 2 estimates received in a round (eq. 12).

    With X and S, the mean and the standard deviation of the received x_hat, and the t-score t, it does if

        |X - x_hat| > (t / sqrt(m) + 1) S

    ``open_round`` has the sums over the m estimates, and ``table`` has the thresholds that take the place of
    the t-scores. ``x_hat`` is in units of 2**-23.
    """
    # Squared and multiplied by m**2, so that it takes neither a root nor a division, the inequality is
    #     (sum_x - m x_hat)**2 > k_m (m sum_x_squared - sum_x**2)
    # with the threshold k_m = (t / sqrt(m) + 1)**2 m / (m - 1).
    m = open_round.count
    sum_x = open_round.x  # units of 2**-23, as x_hat
    sum_x_squared = open_round.x_squared  # units of 2**-46, as both sides of the comparison
    difference = sum_x - m * x_hat  # m (X - x_hat)
    scaled_variance = m * sum_x_squared - sum_x * sum_x  # m (m - 1) S**2
    # ``table.entry(m)`` is k_m with 26 fraction bits, which the shift removes.
    limit = (table.entry(m) * scaled_variance) >> FRACTION_BITS
    return difference * difference > limit


# ---- The filter: eq. 8 ----


def round_mean(closed: Closed) -> int:
    """Return x_bar, the mean of the x_hat that a robot received in a round, in units of 2**-32, for eq. 8.

    It is weighted by their confidences: sum alpha_j x_hat_j / sum alpha_j (eq. 5). The sum of alpha, the
    divisor, must not be 0. It is in units of 2**-24, and times ONE, which is 2**23, in units of 2**-47, as
    the sum of alpha x_hat.
    """
    return q32_quotient(closed.alpha_x, closed.alpha * ONE)


def reestimate(t: int, n: int, x_bar: int) -> int | None:
    """Return the accuracy b_hat with which the robot would have estimated x_bar, its neighbours' mean: eq. 8.

    ``n`` of ``t`` > 0 observations were black. ``x_bar`` and the result are in units of 2**-32. The result is

        b_hat = (n / t + x_bar - 1) / (2 x_bar - 1)     clamped to B_HAT_MIN .. B_HAT_MAX

    It is None, so that b_hat stays, if |2 x_bar - 1| is below 2**-12: then x_bar carries no information. For
    an x_bar below 1/2 that limit is two units of 2**-32 higher, by rounding.
    """
    if x_bar < Q32_HALF:
        # Black and white are exchanged, which leaves the accuracy as it is but makes the divisor positive.
        x_bar = MAX_WORD - x_bar  # 1 - x_bar, less one unit, so that a word of the C can hold it
        n = t - n
    two_x_bar_minus_one = 2 * x_bar - Q32_ONE
    if two_x_bar_minus_one < INFORMATIVE_G:
        return None
    # Numerator and denominator of the fraction are multiplied by t, and in units of 2**-32.
    numerator = n * Q32_ONE - t * (Q32_ONE - x_bar)
    denominator = t * two_x_bar_minus_one
    b_hat = q32_quotient(numerator, denominator)  # may be below 0 or above 1
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


# ---- The state ----


def is_valid_estimate(s: State) -> bool:
    """Return whether a robot whose state is ``s`` can have this x_hat, and this alpha, its confidence.

    They were computed at the last observation, from the counts t and n and from b_hat, the assumed accuracy.
    If b_hat has not changed since (``s.updated`` is 0), both must be exactly what `estimate` returns, or 1/2
    and 0 before the first observation. If it has (``s.updated`` is 1), the b_hat from which they were
    computed is lost. Then there must be an observation, x_hat must be at most 1, and alpha must be a word in
    the form in which robots compute it: with the smallest shift. No other ``s.updated`` is possible.
    """
    if s.updated == 0:
        # Before the first observation x_hat is 1/2, and has no confidence.
        expected = estimate(s.t, s.n, s.accuracy) if s.t > 0 else (HALF, 0)
        return (s.x_hat, s.alpha) == expected
    # Several words stand for the same confidence. A robot computes the word with the smallest shift.
    word_of_robot = alpha_word_from_units(alpha_units(s.alpha))
    # A damaged image may have another flag than 0 and 1.
    return s.updated == 1 and s.t > 0 and s.x_hat <= ONE and s.alpha == word_of_robot


def is_valid_accuracy(accuracy: Accuracy) -> bool:
    """Return whether b_hat is in its range, and whether the values that are kept with it follow from it."""
    is_in_range = B_HAT_MIN <= accuracy.b_hat <= B_HAT_MAX
    return is_in_range and accuracy == accuracy_of(accuracy.b_hat)


def are_valid_robust_members(s: State) -> bool:
    """Return whether what the robust filter remembers of ``s``, a robot's state, is possible.

    That is its slots and votes, its present batch of observations and its initial b_hat.
    """
    return (
        are_valid_slots(s.robust, s.estimates)
        and are_valid_votes(s.robust)
        and is_valid_batch(s.robust, s.t, s.n)
        and is_valid_initial_b_hat(s.robust, s.accuracy.b_hat)
    )


def are_valid_rounds(s: State) -> bool:
    """Return whether a robot without the robust filter can have the sums of rounds that ``s`` has.

    These are the sums of the last closed round and of the open one. What only the robust filter changes must
    be as in a new robot.
    """
    return (
        is_valid_mean(s.closed.alpha, s.closed.alpha_x_low, s.closed.alpha_x_high)
        and are_valid_sums(s.open)
        and s.robust == RobustFilter()
    )


def are_valid_senders(s: State) -> bool:
    """Return whether the senders of the open round in ``s`` are possible: enough of them, and not the robot.

    Each estimate in the sums of the open round has a sender. Senders of estimates without confidence, which
    are in no sum, come on top. The robot's own id must be valid.
    """
    sender_count = sum(word.bit_count() for word in s.heard)
    own_word_index, own_bit = bit_of_sender(s.id)
    has_heard_itself = s.heard[own_word_index] & own_bit != 0
    return s.open.count <= sender_count and not has_heard_itself


def next_count(count: int) -> int:
    """Return a counter of events after one more event. It has 16 bits, so that 0 follows 2**16 - 1."""
    return (count + 1) & COUNTER_MASK


def bit_of_sender(sender: int) -> tuple[int, int]:
    """Return where the set of a round's senders, ``State.heard``, has its bit for this id.

    The result is the index of a word of 32 ids, and a mask with that bit alone. For example, sender 37 is bit
    5 of word 1.
    """
    word_index, bit_index = divmod(sender, WORD_BITS)
    return word_index, 1 << bit_index


def check_config(config: Config) -> None:
    """Raise FirmwareError for settings (ERR_CONFIG) or a table (ERR_TABLE) that the firmware would refuse.

    The table is checked for the adaptive filter only, as the others do not read it.
    """
    check_settings(config)
    if config.filter == Filter.ADAPTIVE:
        check_table(config.table)


@dataclass
class Closed:
    """Sums over the estimates of the last closed round; see ``mcp_asdf_closed_t``.

    Attributes:
        alpha: Sum of the confidences alpha, in units of 2**-24.
        alpha_x_low: Sum of (alpha mod 2**32) x_hat, with x_hat in units of 2**-23.
        alpha_x_high: Sum of (alpha div 2**32) x_hat.
    """

    alpha: int = 0
    alpha_x_low: int = 0
    alpha_x_high: int = 0

    @property
    def alpha_x(self) -> int:
        """Sum of alpha x_hat in units of 2**-47, from its two halves."""
        return (self.alpha_x_high << 32) + self.alpha_x_low


@dataclass
class State:
    """All that a robot remembers: the members of ``mcp_asdf_t``, by the same names.

    Attributes:
        id: The robot's own id.
        accuracy: The assumed accuracy b_hat, with values that depend on it.
        filter_left: Rounds until the filter runs next, from 1: at 1 it runs at the end of this round.
        t: Number of observations.
        n: Number of black observations.
        x_hat: Local estimate in units of 2**-23.
        alpha: Its confidence as an alpha word.
        heard: Senders of the open round as a mask of 128 bits in four words: sender 37 is bit 5 of word 1.
        robust: What the robust filter remembers, beside the estimates; as in a new robot with other filters.
        estimates: The latest estimate of each sender, in the slot of its id modulo 32, in units of 2**-16;
            all are 0 without the robust filter.
        open: Sums over the estimates of the open round; all are 0 with the robust filter.
        closed: Sums over the estimates of the last closed round; all are 0 with the robust filter.
        accepted: Counters of events, as the next four, modulo 2**16; see ``Counters``.
        updated: 1 if x_hat and alpha still follow from the b_hat before the last update, else 0.
    """

    id: int
    accuracy: Accuracy
    filter_left: int
    t: int = 0
    n: int = 0
    x_hat: int = HALF
    alpha: int = 0
    heard: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    robust: RobustFilter = field(default_factory=RobustFilter)
    estimates: list[int] = field(default_factory=lambda: [0] * SLOTS)
    open: Sums = field(default_factory=Sums)
    closed: Closed = field(default_factory=Closed)
    accepted: int = 0
    repeated: int = 0
    rejected: int = 0
    tests: int = 0
    updates: int = 0
    updated: int = 0


class MirrorRobot(FixedPointView):
    """MCP-ASDF in Python integers, the mirror image of the C. Implements ``FixedPointRobot``.

    Args:
        config: Settings, which robots may share.
        robot_id: Id of this robot, 0 .. 127.
        b_hat: Initial accuracy that the robot assumes of its sensor, rounded to a multiple of 2**-32.

    Attributes:
        config: Settings.
        s: The robot's state, with the members of ``mcp_asdf_t``; methods call it ``s``, too.

    Raises:
        FirmwareError: Where ``mcp_asdf_init`` returns an error.
    """

    def __init__(self, config: Config, robot_id: int, b_hat: float) -> None:
        """Make a robot without observations, which assumes that its sensor has the accuracy ``b_hat``.

        Raises FirmwareError for an argument that the firmware would refuse.
        """
        check_config(config)
        check_id_and_b_hat(robot_id, b_hat)
        self.config = config
        raw_b_hat = b_hat_to_raw(b_hat)
        # operator.index makes numbers of NumPy, which would overflow, Python's own.
        self.s = State(
            id=operator.index(robot_id),
            accuracy=accuracy_of(raw_b_hat),
            filter_left=operator.index(config.filter_period),
        )
        # The robust filter's test is always about the initial b_hat.
        if config.filter == Filter.ROBUST:
            self.s.robust.initial_b_hat = raw_b_hat

    @property
    def is_robust(self) -> bool:
        """True if this robot has the robust filter."""
        return self.config.filter == Filter.ROBUST

    def observe(self, z: Observation) -> Status:
        """Count an observation, and compute x_hat and alpha from all observations so far.

        At ``config.memory`` observations both counts, t and n, are halved, and the robust filter begins a new
        batch of observations. Returns OK; or ERR_OBSERVATION, and changes nothing, if ``z`` is neither WHITE
        nor BLACK.
        """
        s = self.s
        colour = operator.index(z)  # as Python's own int: 0 is white, and 1 black
        if colour not in (0, 1):
            return Status.ERR_OBSERVATION
        s.t += 1
        s.n += colour
        if s.t >= self.config.memory:
            # Halving keeps the share of black tiles, and lets new observations weigh more than old ones.
            s.t //= 2
            s.n = round(s.n / 2)  # the half of an odd n is a tie, which round() takes to the even number
            if self.is_robust:
                # The counts at the beginning of the present batch can no longer be compared with these.
                begin_batch(s.robust, s.t, s.n)
        s.x_hat, s.alpha = estimate(s.t, s.n, s.accuracy)
        # ``updated`` is 1 from an update of b_hat until x_hat and alpha are computed with the new one: here.
        s.updated = 0
        return Status.OK

    def _receive(self, sender: int, x_hat: int, alpha: int) -> Status:
        """Add a neighbour's estimate to the open round or, with the robust filter, keep it as its latest one.

        ``x_hat`` is in units of 2**-23, and ``alpha`` a word of 32 bits: a mantissa (bits 8 to 31) and a
        shift (bits 0 to 4). Returns OK, REPEATED, ERR_SENDER or ERR_X_HAT, as ``receive_raw`` explains, and
        counts the estimate as accepted, repeated or rejected. One with alpha = 0 is accepted, but neither
        added to a sum nor kept.
        """
        s = self.s
        status = self._check_message(sender, x_hat)
        if status != Status.OK:
            s.rejected = next_count(s.rejected)
            return status
        word_index, sender_bit = bit_of_sender(sender)
        # Clocks of robots are not aligned, so a sender may broadcast twice in a round of this robot.
        has_sent_before = s.heard[word_index] & sender_bit != 0
        if has_sent_before:
            s.repeated = next_count(s.repeated)
            return Status.REPEATED
        s.heard[word_index] |= sender_bit
        s.accepted = next_count(s.accepted)
        has_confidence = alpha_units(alpha) > 0
        if not self.is_robust:
            # add_estimate leaves out an estimate without confidence by itself.
            add_estimate(s.open, x_hat, alpha)
        elif has_confidence:
            keep_estimate(s.robust, s.estimates, sender, x_hat)
        return Status.OK

    def _check_message(self, sender: int, x_hat: int) -> Status:
        """Return ERR_SENDER or ERR_X_HAT for a message that the robot must reject, or OK for any other.

        ERR_SENDER: ``sender`` is not in 0 .. 127, or is the robot's own id. ERR_X_HAT: ``x_hat``, in units of
        2**-23, is not in [0, 1]. If both apply, the result is ERR_SENDER.
        """
        if not 0 <= sender <= MAX_ID or sender == self.s.id:
            return Status.ERR_SENDER
        return Status.OK if 0 <= x_hat <= ONE else Status.ERR_X_HAT

    def settle(self) -> Status:
        """End the open round, and run the filter if ``filter_period`` rounds have passed.

        The ended round becomes the closed one, and a round without messages opens. From the sums of the
        closed round follow x_bar, the mean of the neighbours' estimates, beta, the sum of their
        confidences, and x, the robot's answer. With the robust filter no sums are kept: one of the estimates
        that the robot keeps, or its own, becomes a vote, which moves x. Returns UPDATED if the filter has
        re-estimated b_hat, the assumed accuracy, and OK otherwise.
        """
        s = self.s
        is_updated = False
        if self.is_robust:
            take_vote(s.robust, s.estimates, s.x_hat, s.alpha)
        else:
            # These sums, of alpha and (in two halves) of alpha x_hat, are all that x_bar, beta and x need.
            s.closed = Closed(s.open.alpha, s.open.alpha_x_low, s.open.alpha_x_high)
        s.filter_left -= 1
        if s.filter_left == 0:
            s.filter_left = operator.index(self.config.filter_period)  # as Python's own int
            # Before ``s.open`` is cleared: the paper's test needs its sums of x_hat and x_hat**2, which
            # ``s.closed`` does not have.
            is_updated = self._update_b_hat()
        s.open = Sums()
        s.heard = [0, 0, 0, 0]  # a bit for each id: no message has come in the new round
        return Status.UPDATED if is_updated else Status.OK

    def step(self, z: Observation) -> Status:
        """Observe ``z``, then settle.

        Returns UPDATED if the filter has run and re-estimated b_hat, and OK otherwise; or ERR_OBSERVATION,
        without settling, for an invalid ``z``.
        """
        status = self.observe(z)
        if status == Status.OK:
            return self.settle()
        return status

    def _update_b_hat(self) -> bool:
        """Run the filter, and return whether it has re-estimated b_hat, the assumed accuracy of the sensor.

        If so, b_hat has its new value, the counter ``updates`` has gone up, and ``updated`` is 1; x_hat and
        alpha stay as they are until the next observation. Before the first observation nothing is done.
        """
        s = self.s
        if s.t == 0:
            return False  # there is no estimate to be tested
        new_b_hat = self._run_robust_filter() if self.is_robust else self._run_asdf_filter()
        if new_b_hat is None:
            return False
        s.accuracy = accuracy_of(new_b_hat)  # b_hat, with the values that are computed from it in advance
        s.updates = next_count(s.updates)
        s.updated = 1
        return True

    def _run_asdf_filter(self) -> int | None:
        """Run the paper's filter at the end of a round: return the new b_hat, or None if b_hat stays.

        The new b_hat, in units of 2**-32, is the accuracy with which the robot would have estimated x_bar,
        the mean estimate of its neighbours (eq. 8). The cases are, by the filter of the configuration:

        - OFF: None.
        - ALWAYS: a new b_hat if the round has a message with confidence, and None if not.
        - ADAPTIVE: None if the round has fewer than two of these messages. Otherwise the hypothesis test runs
          and is counted: a new b_hat if it rejects x_hat, and None if not.

        In place of a new b_hat the result is None, too, if x_bar is so near 1/2 that it carries no
        information (see `reestimate`).
        """
        s = self.s
        config = self.config
        # ``settle`` has copied the sums for x_bar to ``s.closed``. Those for the test are in ``s.open`` only.
        ending_round = s.open
        if config.filter == Filter.OFF:
            return None
        # The variance in eq. 12 takes two estimates, a re-estimate without a test takes one.
        messages_needed = 2 if config.filter == Filter.ADAPTIVE else 1
        if ending_round.count < messages_needed:
            return None
        if config.filter == Filter.ADAPTIVE:
            assert config.table is not None  # `check_config` has seen to it
            s.tests = next_count(s.tests)
            if not asdf_test_rejects(config.table, ending_round, s.x_hat):
                return None
        x_bar = round_mean(s.closed)
        return reestimate(s.t, s.n, x_bar)

    def _run_robust_filter(self) -> int | None:
        """Test the initial b_hat against the estimates that the robot keeps, one of each neighbour.

        Returns the new b_hat in units of 2**-32, or None if b_hat stays. First the observations since the
        last run enter the dispersion, which says how much more the robot's observations vary than independent
        ones. Then the first of these cases that applies decides:

        - The robot keeps fewer than five estimates: None, without a test. Of five, two can be outvoted.
        - The test, which is counted, rejects the initial b_hat, and at most two fifths of the estimates
          support this robot: the accuracy with which the robot would have estimated their centre (eq. 8), or
          None if the centre carries no information (see `reestimate`).
        - Otherwise: the initial b_hat, or None if that is the present b_hat.
        """
        s = self.s
        robust = s.robust
        end_batch(robust, s.t, s.n)  # updates the dispersion
        estimates = sorted_estimates(robust, s.estimates)
        if len(estimates) < TESTED_ESTIMATES_MIN:
            return None
        centre, spread = centre_and_spread_of(estimates)
        s.tests = next_count(s.tests)
        is_rejected = robust_test_rejects(robust, s.t, s.n, centre, spread)
        if is_rejected and not is_supported(robust, s.t, s.n, estimates, centre):
            # The centre takes the place of x_bar.
            return reestimate(s.t, s.n, q32_from_q24(centre))
        # An earlier test may have replaced the initial b_hat, and then it comes back.
        is_initial = s.accuracy.b_hat == robust.initial_b_hat
        return None if is_initial else robust.initial_b_hat

    @property
    def id(self) -> int:
        """Id of this robot."""
        return self.s.id

    @property
    def t(self) -> int:
        """Number of observations."""
        return self.s.t

    @property
    def n(self) -> int:
        """Number of black observations."""
        return self.s.n

    @property
    def b_hat_raw(self) -> int:
        """Accuracy that this robot assumes of its sensor, in units of 2**-32."""
        return self.s.accuracy.b_hat

    @property
    def x_hat_raw(self) -> int:
        """Local estimate in units of 2**-23."""
        return self.s.x_hat

    @property
    def alpha_raw(self) -> int:
        """Local confidence as an alpha word: a mantissa (bits 8 to 31) and a shift (bits 0 to 4)."""
        return self.s.alpha

    @property
    def beta_raw(self) -> int:
        """Social confidence, the sum of alpha of the last closed round, in units of 2**-24."""
        return self.s.closed.alpha

    @property
    def x_bar_raw(self) -> int:
        """Social estimate in units of 2**-23: the weighted mean x_hat of the last closed round's messages.

        It is HALF if none of them has confidence. With the robust filter it is the centre of the votes, or
        HALF before the first one.
        """
        if self.is_robust:
            return self._centre_of_votes(HALF)
        # An own estimate without confidence has no weight beside others, and is the result if there are none.
        return informed_estimate(self.s.closed, x_hat=HALF, alpha=0)

    @property
    def x_raw(self) -> int:
        """Informed estimate, which combines the local and the social one, in units of 2**-23.

        With the robust filter it is the centre of the votes, or the local estimate before the first one.
        """
        if self.is_robust:
            return self._centre_of_votes(self.s.x_hat)
        return informed_estimate(self.s.closed, self.s.x_hat, self.s.alpha)

    def _centre_of_votes(self, x_hat: int) -> int:
        """Return the centre of the robust filter's votes, or ``x_hat`` before the first one.

        Both are in units of 2**-23. In C this is ``robust_estimate``.
        """
        robust = self.s.robust
        return q23_from_q30(robust.centre) if robust.votes > 0 else x_hat

    @property
    def counters(self) -> Counters:
        """Numbers of events since the robot was made."""
        s = self.s
        return Counters(s.accepted, s.repeated, s.rejected, s.tests, s.updates)

    def state(self) -> dict[str, int]:
        """Return all numbers of the robot's state by name, to compare two firmwares.

        Members of a nested object are named as in ``open_alpha``, and elements of a list as in ``heard_0``.
        """
        values: dict[str, int] = {}
        for member in fields(State):
            value = getattr(self.s, member.name)
            if isinstance(value, (Sums, Accuracy, Closed, RobustFilter)):
                for inner_member in fields(value):
                    values[f"{member.name}_{inner_member.name}"] = getattr(value, inner_member.name)
            elif isinstance(value, list):
                for element_index, number in enumerate(value):
                    values[f"{member.name}_{element_index}"] = number
            else:
                values[member.name] = value
        return values

    def holds_invariants(self) -> bool:
        """Return whether calls alone could have led to this state, as far as can be checked in constant time.

        False means that the state, or the image from which it was restored, was damaged. True means:

        - The id is one that a robot can have, and the filter's next run is at most a filter period away.
        - The counts of observations are below the memory, and not more are black than there are.
        - b_hat is in its range, and x_hat and alpha can follow from it and the counts.
        - What the filter remembers, and the senders of the open round, are possible.
        """
        s = self.s
        config = self.config
        if s.id > MAX_ID:
            return False  # before the set of senders is checked, which has no bit for this id
        are_counts_valid = s.n <= s.t < config.memory  # at the memory both would have been halved
        is_filter_valid = are_valid_robust_members(s) if self.is_robust else are_valid_rounds(s)
        return (
            are_counts_valid
            and is_valid_accuracy(s.accuracy)
            and is_valid_estimate(s)
            and is_filter_valid
            and are_valid_senders(s)
            and 1 <= s.filter_left <= config.filter_period
        )

    def save(self) -> bytes:
        """Return the state as ``mcp_asdf_save`` writes it: little-endian numbers, the last a checksum.

        The first word marks the version. Then come the robot's own estimate and filter, the sums of the
        rounds or what the robust filter remembers, the senders of the open round, and counters, the flag
        ``updated`` and the id.
        """
        image = _encode_state(self.config, self.s)
        return image + checksum(unpack_image(image)).to_bytes(4, "little")

    @classmethod
    def restore(cls, config: Config, image: bytes) -> MirrorRobot:
        """Make a robot from an image of ``save``.

        Raises FirmwareError for an invalid ``config`` (ERR_CONFIG or ERR_TABLE), and for an image that is
        damaged, of another version or impossible with ``config`` (ERR_IMAGE). Raises TypeError for an
        ``image`` that is not bytes-like.
        """
        readable_image = memoryview(image)  # raises TypeError for a number, from which bytes would make zeros
        image_bytes = bytes(readable_image)
        check_config(config)
        error = find_image_error(image_bytes, config.filter)
        if error is not None:
            raise FirmwareError(Status.ERR_IMAGE, error)
        # Without __init__, which would make a new robot, and needs an id and a b_hat that are valid.
        robot = cls.__new__(cls)
        robot.config = config
        robot.s = _decode_state(config, image_bytes)
        if not robot.holds_invariants():
            raise FirmwareError(Status.ERR_IMAGE, IMPOSSIBLE_STATE)
        return robot


# ---- Images ----

# Formats of all numbers in an image but the checksum: I has 32 bits, Q 64, H 16, and B 8. In the middle is
# what the filter remembers, and after that the senders of the open round.
_FORMAT_WITH_ROUNDS = struct.Struct("<7I 7Q2I 4I5H2B")
"""Format without the robust filter. Sums of the closed and of the open round are in the middle.

A closed round has no sum of x_hat**2: only the test needs it, which runs before the sums of the open round
are cleared.
"""
_FORMAT_WITH_ROBUST_FILTER = struct.Struct("<7I 6I2HI32H 4I5H2B")
"""Format with the robust filter. Its members, and the estimates in the slots, are in the middle."""


def _encode_state(config: Config, s: State) -> bytes:
    """Return the image of a state without its checksum."""
    beginning = (first_image_word(config.filter), s.accuracy.b_hat, s.t, s.n, s.x_hat, s.alpha, s.filter_left)
    ending = (*s.heard, s.accepted, s.repeated, s.rejected, s.tests, s.updates, s.updated, s.id)
    if config.filter == Filter.ROBUST:
        return _FORMAT_WITH_ROBUST_FILTER.pack(*beginning, *astuple(s.robust), *s.estimates, *ending)
    return _FORMAT_WITH_ROUNDS.pack(*beginning, *astuple(s.closed), *astuple(s.open), *ending)


def _decode_state(config: Config, image: bytes) -> State:
    """Return the state that an image of `MirrorRobot.save` holds.

    ``config.filter`` says whether it has the sums of the rounds or what the robust filter remembers. Raises
    FirmwareError (ERR_IMAGE) for a b_hat out of range, from which other values could not be computed. Beyond
    that it is not checked whether a robot can have this state.
    """
    is_robust = config.filter == Filter.ROBUST
    image_format = _FORMAT_WITH_ROBUST_FILTER if is_robust else _FORMAT_WITH_ROUNDS
    numbers = image_format.unpack_from(image)  # without the checksum, which is behind them
    # These have the order of _encode_state.
    _version_word, b_hat, t, n, x_hat, alpha, filter_left = numbers[:7]
    memory_of_filter = numbers[7:-11]
    *senders_and_events, robot_id = numbers[-11:]
    if not B_HAT_MIN <= b_hat <= B_HAT_MAX:
        raise FirmwareError(Status.ERR_IMAGE, f"b_hat = {b_hat} is out of range")
    s = State(robot_id, accuracy_of(b_hat), filter_left, t, n, x_hat, alpha)
    *s.heard, s.accepted, s.repeated, s.rejected, s.tests, s.updates, s.updated = senders_and_events
    if is_robust:
        # The estimates in the slots come last.
        s.robust = RobustFilter(*memory_of_filter[:-SLOTS])
        s.estimates = list(memory_of_filter[-SLOTS:])
    else:
        # The three sums of the closed round come before those of the open one.
        s.closed = Closed(*memory_of_filter[:3])
        s.open = Sums(*memory_of_filter[3:])
    return s
