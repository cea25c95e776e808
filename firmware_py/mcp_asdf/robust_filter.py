"""The mirror's robust filter: after every call the same bits as ``c_ref/src/mcp_asdf_robust.h``.

The robust filter is this project's own and not the paper's. ``docs/internals/robust.md`` explains it, and
``docs/design.md``, section 13, specifies every bit.

A robot with this filter keeps no sums of rounds, but the latest estimate of each sender, in one of 32 slots.
In each round one of these estimates is a vote, in turn, and after the last of them the robot's own estimate
is one. Votes move the robot's answer, their centre. Every ``filter_period`` rounds the robot tests whether
its own observations contradict the estimates that it keeps; that test does not use the votes.

Formats: an x_hat is in units of 2**-23; the estimates in slots are in units of 2**-16, and those that are
tested in units of 2**-24; the votes and their centre and spread are in units of 2**-30; probabilities, shares
and accuracies are in units of 2**-32.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mcp_asdf.arithmetic import Q32_ONE, multiply_high, q32_quotient
from mcp_asdf.fixed_point import B_HAT_MAX, B_HAT_MIN, alpha_units
from mcp_asdf.table import MAX_WORD

# Constants by the names that they have in C; docs/internals/robust.md has the reasons.
SLOTS = 32
"""Number of slots for estimates of senders."""
OWN_ESTIMATE = SLOTS
"""Stands for the robot's own estimate where otherwise a slot is named. It comes after the last slot."""
SLOT_ESTIMATE_MAX = (1 << 16) - 1
"""Largest estimate in a slot, which has 16 bits; it stands for 1.0, too."""
TESTED_ESTIMATES_MIN = 5
"""Smallest number of estimates against which a robot tests itself: of five, two wrong ones are outvoted."""
CENTRE_START = 1 << 29
"""Centre of the votes before the first one: 1/2."""
CENTRE_MAX = 1 << 30
"""Largest centre of the votes: 1."""
SPREAD_MIN = 1 << 18
"""Smallest spread: 2**-12."""
SPREAD_MAX = 1 << 28
"""Largest spread, and that before the first vote: 1/4."""
VOTES_MAX = 1 << 9
"""More votes are not counted, so that the gain does not fall below 2**-7."""
VOTES_OF_MAX_GAIN = 32
"""Up to 63 votes the gain is 1/8, as with 32 votes."""
HUBER_STEPS = 3
"""Steps from the median of the estimates to their Huber centre, which a further step hardly ever moves."""
REJECTED_SIGMAS_SQUARED = 12
"""The test rejects beyond sqrt(12) standard deviations."""
DISPERSION_MIN = 1 << 8
"""Smallest dispersion, 1, and that before the first batch: observations are independent."""
DISPERSION_MAX = (1 << 16) - 1
DISPERSION_SHIFT = 3
"""The ratio of a batch of observations counts 2**-3 in the dispersion, and all batches before it the rest."""


@dataclass
class RobustFilter:
    """What a robot with the robust filter remembers, beside the estimates: see ``mcp_asdf_robust_t``.

    Attributes:
        centre: Centre of the votes, in units of 2**-30.
        spread: Median distance of the votes from the centre, in units of 2**-30.
        initial_b_hat: The b_hat that the robot had at its start, in units of 2**-32.
        filled_slots: Slots that have an estimate, as a mask: bit i stands for slot i.
        batch_t: t, the number of observations, when the present batch of observations began.
        batch_n: n, the number of black ones among them, at that time.
        votes: Number of votes, up to VOTES_MAX.
        dispersion: Variance of n from batch to batch, as a multiple of the variance of independent
            observations, in units of 2**-8.
        turn: Slot whose estimate is the next vote. If it is empty, the next filled slot votes; OWN_ESTIMATE
            after the last slot.
    """

    centre: int = CENTRE_START
    spread: int = SPREAD_MAX
    initial_b_hat: int = 0
    filled_slots: int = 0
    batch_t: int = 0
    batch_n: int = 0
    votes: int = 0
    dispersion: int = DISPERSION_MIN
    turn: int = 0

    def is_filled(self, slot: int) -> bool:
        """Return whether a slot has an estimate."""
        return (self.filled_slots >> slot) & 1 == 1


# ---- Formats ----


def q30_from_q23(x_hat: int) -> int:
    """Convert an estimate from units of 2**-23 to units of 2**-30, those of the votes. Exact."""
    return x_hat << 7


def q23_from_q30(centre: int) -> int:
    """Convert the centre of the votes from units of 2**-30 to units of 2**-23, rounded down."""
    return centre >> 7


def q23_from_q16(estimate: int) -> int:
    """Convert a slot's estimate from units of 2**-16 to units of 2**-23. Exact."""
    return estimate << 7


def q24_from_q30(spread: int) -> int:
    """Convert a limit of the spread from units of 2**-30, those of the votes, to units of 2**-24. Exact."""
    return spread >> 6


def q24_from_q16(estimate: int) -> int:
    """Convert a slot's estimate from units of 2**-16 to units of 2**-24, those of the test. Exact."""
    return estimate << 8


def q24_from_q32(step: int) -> int:
    """Convert a step of the centre from units of 2**-32 to units of 2**-24, rounded down."""
    return step >> 8


def q32_from_q24(value: int) -> int:
    """Convert an estimate of the test, or their spread, from units of 2**-24 to units of 2**-32. Exact."""
    return value << 8


def q32_from_q40(variance: int) -> int:
    """Convert a dispersion times a variance from units of 2**-40 to units of 2**-32, rounded down."""
    return variance >> 8


def q32_from_q64(square: int) -> int:
    """Convert the square of a difference of shares from units of 2**-64 to units of 2**-32, rounded down."""
    return square >> 32


def q22_from_q40(square: int) -> int:
    """Convert the square of a deviation from units of 2**-40 to units of 2**-22, rounded down."""
    return square >> 18


def q11_from_q32(deviation: int) -> int:
    """Convert a deviation of a batch from units of 2**-32 to units of 2**-11, rounded down."""
    return deviation >> 21


# ---- Receive: the latest estimate of each sender ----


def slot_estimate(x_hat: int) -> int:
    """Convert an x_hat in units of 2**-23 to an estimate in a slot, in units of 2**-16 and to nearest.

    One unit of a slot is 2**7 units of x_hat, so half a unit is 64. Halves are rounded up. 1.0, for which a
    slot has one bit too few, becomes SLOT_ESTIMATE_MAX.
    """
    return min((x_hat + 64) >> 7, SLOT_ESTIMATE_MAX)


def keep_estimate(robust: RobustFilter, estimates: list[int], sender: int, x_hat: int) -> None:
    """Keep a neighbour's x_hat, in units of 2**-23, in the slot of its sender, in place of what was there.

    ``estimates``, the list of the robot's 32 slots, changes, and ``robust``, which says which of them are
    filled. Senders whose ids are equal modulo 32 share a slot.
    """
    slot = sender % SLOTS
    estimates[slot] = slot_estimate(x_hat)
    robust.filled_slots |= 1 << slot


# ---- Settle: one vote ----


def lowest_bit(mask: int) -> int:
    """Return the index of the lowest bit of a mask that is set. At least one must be."""
    lowest_bit_alone = mask & -mask  # -mask is opposite to the mask in all bits above the lowest one
    return lowest_bit_alone.bit_length() - 1


def next_slot(filled_slots: int, turn: int, has_confidence: bool) -> int:
    """Return the slot whose estimate is the next vote, or OWN_ESTIMATE if the robot's own estimate is.

    That is the first filled slot from ``turn`` on. If there is none, it is the robot's own estimate, which
    must have confidence for that; and if it has none, the first of all filled slots. ``filled_slots`` is a
    mask of 32 bits, one per slot. At least one bit must be set.
    """
    remaining_slots = (filled_slots >> turn) << turn  # clears the bits of the slots before ``turn``
    if remaining_slots:
        return lowest_bit(remaining_slots)
    return OWN_ESTIMATE if has_confidence else lowest_bit(filled_slots)


def take_vote(robust: RobustFilter, estimates: Sequence[int], x_hat: int, alpha: int) -> None:
    """Choose the next vote among the estimates that a robot keeps and its own, and count it.

    The robot keeps estimates of its neighbours in 32 slots, whose contents are ``estimates``, in units of
    2**-16. Filled slots vote one after the other, and after the last of them the robot's own estimate:
    ``x_hat`` in units of 2**-23, if the alpha word ``alpha`` stands for a confidence above 0. ``robust``, the
    filter's memory, changes: the vote moves the centre and the spread of all votes, as `count_vote` says, and
    the turn goes to the next slot. Nothing happens while all slots are empty.
    """
    if robust.filled_slots == 0:
        return
    has_confidence = alpha_units(alpha) > 0
    voter = next_slot(robust.filled_slots, robust.turn, has_confidence)
    if voter == OWN_ESTIMATE:
        count_vote(robust, x_hat)
        robust.turn = 0
    else:
        count_vote(robust, q23_from_q16(estimates[voter]))
        robust.turn = voter + 1


def gain_shift_after(votes: int) -> int:
    """Return the shift that multiplies by the gain of a vote: 3 up to 63 votes, 4 up to 127, and so on.

    ``votes`` includes this vote, and is at most VOTES_MAX, for which the shift is 7.
    """
    votes_that_count = max(votes, VOTES_OF_MAX_GAIN)
    # 32 to 63 have 6 bits and the shift 3. Each doubling takes one bit more.
    return votes_that_count.bit_length() - 3


def count_vote(robust: RobustFilter, x_hat: int) -> None:
    """Move the centre and the spread of the votes by one more vote, an x_hat in units of 2**-23.

    The centre moves towards the vote by gain * min(distance, spread), where distance is how far the vote is
    from the centre. The spread grows by gain / 2 of itself if the distance is above it, and shrinks by as
    much otherwise; it stays within SPREAD_MIN .. SPREAD_MAX. The gain is 1/8 up to 63 votes, 1/16 up to 127,
    and so on to 1/128 from 512 votes on. ``robust``, the filter's memory, changes.
    """
    robust.votes = min(robust.votes + 1, VOTES_MAX)
    gain_shift = gain_shift_after(robust.votes)  # the gain is 2**-gain_shift

    position = q30_from_q23(x_hat)
    distance = abs(position - robust.centre)
    # A vote farther away than the spread moves the centre no more than one at that distance: this limits
    # what a liar can do.
    step = min(distance, robust.spread) >> gain_shift
    robust.centre += step if position > robust.centre else -step

    # Votes outside widen the spread, votes inside narrow it: it converges to the median of the distances.
    spread_step = robust.spread >> (gain_shift + 1)
    is_outside = distance > robust.spread
    new_spread = robust.spread + (spread_step if is_outside else -spread_step)
    robust.spread = min(max(new_spread, SPREAD_MIN), SPREAD_MAX)


# ---- The dispersion of the robot's own observations ----


def begin_batch(robust: RobustFilter, t: int, n: int) -> None:
    """Begin a new batch of observations, after ``t`` observations of which ``n`` were black.

    A batch is what a robot observes from one run of its filter to the next. ``robust`` keeps both counts.
    """
    robust.batch_t = t
    robust.batch_n = n


def end_batch(robust: RobustFilter, t: int, n: int) -> None:
    """Update the dispersion by the batch of observations that ends now, and begin the next batch.

    ``t`` is the number of all observations so far, ``n`` the number of black ones. The dispersion says how
    many times more the number of black ones varies from batch to batch than that of independent observations
    would: more if a robot observes the same tile several times. It is a moving average of the ratio
    deviation**2 / variance (see `ratio_of_batch`), in which a batch has a weight of 1/8. Without observations
    in the batch, or while no observation at all was black, the dispersion stays as it is.
    """
    count = t - robust.batch_t
    black_count = n - robust.batch_n
    begin_batch(robust, t, n)

    share = q32_quotient(n, t)
    # On average this is 1 for independent observations: it is the phi of overdispersed binomial models.
    ratio = ratio_of_batch(robust, count, black_count, share)
    if ratio is None:
        return
    old_weight = (1 << DISPERSION_SHIFT) - 1  # 7, where the batch has 1
    weighted_sum = old_weight * robust.dispersion + ratio
    average = weighted_sum >> DISPERSION_SHIFT  # divided by the sum of both weights, 8
    robust.dispersion = min(max(average, DISPERSION_MIN), DISPERSION_MAX)


def ratio_of_batch(robust: RobustFilter, count: int, black_count: int, share: int) -> int | None:
    """Return deviation**2 / variance of a batch of observations, at most 12 times the dispersion.

    ``black_count`` of the batch's ``count`` observations are black, where count * share are expected, and the
    deviation is the difference. The variance is count * share * (1 - share). A larger ratio is an outlier,
    such as after a change of the floor. ``share`` is in units of 2**-32, and the result, as the dispersion,
    in units of 2**-8. It is None where the variance is 0, in a batch without observations or for a share of
    0, and where it is so small that it is rounded to 0.
    """
    largest_ratio = REJECTED_SIGMAS_SQUARED * robust.dispersion  # units of 2**-8
    variance = count * variance_of_observation(share)  # units of 2**-32
    # The largest ratio is that of this deviation**2. The product has the unit 2**-40. Squares have the unit
    # 2**-22 here, so that they fit 64 bits in the C.
    largest_square = q22_from_q40(largest_ratio * variance)
    if largest_square == 0:
        return None
    expected_count_q32 = count * share
    deviation_q32 = abs(black_count * Q32_ONE - expected_count_q32)
    deviation = q11_from_q32(deviation_q32)
    square = deviation * deviation  # units of 2**-22, as the deviation has 2**-11
    limited_square = min(square, largest_square)
    # A quotient of the C is at most 1, but square / variance may be above 1. As largest_square / variance is
    # largest_ratio, the ratio is largest_ratio times square / largest_square.
    part_of_largest = q32_quotient(limited_square, largest_square)
    return multiply_high(largest_ratio, part_of_largest)


# ---- The test ----


def sorted_estimates(robust: RobustFilter, estimates: Sequence[int]) -> list[int]:
    """Return the estimates of all filled slots in ascending order, in units of 2**-24.

    ``estimates`` are the robot's slots, in units of 2**-16.
    """
    return sorted(q24_from_q16(estimates[slot]) for slot in range(SLOTS) if robust.is_filled(slot))


def median_of(sorted_values: Sequence[int]) -> int:
    """Return the median of sorted values: of an even number, the mean of the middle two, rounded down."""
    count = len(sorted_values)
    # For an odd number of values both are the same one.
    lower_middle = sorted_values[(count - 1) // 2]
    upper_middle = sorted_values[count // 2]
    return (lower_middle + upper_middle) // 2


def spread_of(estimates: Sequence[int], median: int) -> int:
    """Return the median distance of estimates from their median, limited to SPREAD_MIN .. SPREAD_MAX.

    All are in units of 2**-24.
    """
    distances = sorted(abs(estimate - median) for estimate in estimates)
    smallest, largest = q24_from_q30(SPREAD_MIN), q24_from_q30(SPREAD_MAX)
    return min(max(median_of(distances), smallest), largest)


def huber_centre(estimates: Sequence[int], median: int, spread: int) -> int:
    """Return the Huber centre of estimates, after three steps of Newton's method from their median.

    It is the point where the distances of the estimates above and below balance, if none counts with more
    than ``spread``: a mean of the estimates near to it, which those far away move by a limited amount. All
    are in units of 2**-24. A fourth step would hardly ever move the result.
    """
    centre = median
    for _ in range(HUBER_STEPS):
        centre = centre_after_huber_step(estimates, centre, spread)
    return centre


def centre_and_spread_of(sorted_values: Sequence[int]) -> tuple[int, int]:
    """Return the Huber centre and the spread of sorted estimates. All are in units of 2**-24."""
    median = median_of(sorted_values)
    spread = spread_of(sorted_values, median)
    return huber_centre(sorted_values, median, spread), spread


def centre_after_huber_step(estimates: Sequence[int], centre: int, spread: int) -> int:
    """Return ``centre`` after one step of Newton's method towards the Huber centre of some estimates.

    That is the point at which the balance is 0: the sum of the estimates' differences from it, each limited
    to -spread .. spread. A step adds the balance divided by the number of estimates whose difference is not
    limited, or by 1 if there is none. All are in units of 2**-24. The result is at least 0, and at most the
    largest estimate that a slot can hold.
    """
    differences = [estimate - centre for estimate in estimates]
    limited_differences = [max(-spread, min(spread, difference)) for difference in differences]
    balance = sum(limited_differences)
    # The slope: where the centre moves up by 1, the balance falls by 1 for each estimate whose difference is
    # not limited.
    inside_count = sum(abs(difference) <= spread for difference in differences)
    slope = max(inside_count, 1)
    step = huber_step_size(abs(balance), slope)
    if balance < 0:
        return max(centre - step, 0)
    largest_estimate = q24_from_q16(SLOT_ESTIMATE_MAX)
    return min(centre + step, largest_estimate)


def huber_step_size(balance: int, slope: int) -> int:
    """Return balance / slope, which is how far a step moves the Huber centre, but at most 1.0.

    ``balance``, without its sign, and the result are in units of 2**-24. ``slope`` is a number of estimates.
    """
    slope_q24 = slope << 24  # in the units of the balance, so that these cancel out in the quotient
    # A quotient of the C is at most 1.0.
    limited_balance = min(balance, slope_q24)
    step_q32 = q32_quotient(limited_balance, slope_q24)
    return q24_from_q32(step_q32)


def probability_of_black(b_hat: int, fill_ratio: int) -> int:
    """Return the probability that a sensor of accuracy b_hat names a tile black (eq. 1).

    It is b_hat fill_ratio + (1 - b_hat) (1 - fill_ratio), where the fill ratio is the share of black tiles.
    All are in units of 2**-32. In place of 1, which has 33 bits, stands the largest number of 32 bits, as in
    the firmware in C.
    """
    black_observed_as_black = multiply_high(b_hat, fill_ratio)
    white_observed_as_black = multiply_high(MAX_WORD - b_hat, MAX_WORD - fill_ratio)
    return black_observed_as_black + white_observed_as_black


def variance_of_observation(p: int) -> int:
    """Return p (1 - p), the variance of an observation that is black with probability p, in units of 2**-32.

    ``p`` is in the same units, and may also be a share of observations.
    """
    return multiply_high(p, Q32_ONE - p)


def slope_of_probability(b_hat: int) -> int:
    """Return g = |2 b_hat - 1|, by which a probability of black changes where the fill ratio changes by 1.

    Both are in units of 2**-32. See `probability_of_black`.
    """
    return abs(2 * b_hat - Q32_ONE)


def robust_test_rejects(robust: RobustFilter, t: int, n: int, centre: int, spread: int) -> bool:
    """Return whether n black of t > 0 observations contradict the initial b_hat, by the robust filter's test.

    b_hat is the accuracy that the robot assumes of its sensor. ``centre`` and ``spread`` are those of the
    estimates that the robot keeps, in units of 2**-24; the centre is taken for the share of black tiles. With
    p, the probability of observing black by the initial b_hat and the centre, the test rejects for

        (n / t - p)**2 > 12 (dispersion * v / t + (g * spread)**2)

    Here dispersion * v / t is the variance of n / t, where v is the variance of one observation: the larger
    of p (1 - p) and n / t (1 - n / t), as either may be 0. And g * spread, with g = |2 b_hat - 1|, is the
    uncertainty of p, which changes by g where the centre changes by 1.
    """
    # Shares, probabilities, variances and g are in units of 2**-32.
    share = q32_quotient(n, t)
    p = probability_of_black(robust.initial_b_hat, q32_from_q24(centre))
    variance = max(variance_of_observation(share), variance_of_observation(p))  # v
    g = slope_of_probability(robust.initial_b_hat)
    g_spread = multiply_high(g, q32_from_q24(spread))
    # With g * spread on the left side, and multiplied by t, so that v needs no division, the inequality is
    #     t * ((n / t - p)**2 - 12 (g * spread)**2) > 12 * dispersion * v
    squared_difference = (share - p) ** 2  # units of 2**-64, as the next square
    excess = squared_difference - REJECTED_SIGMAS_SQUARED * g_spread**2
    left_side = q32_from_q64(t * excess)
    # The dispersion has the unit 2**-8, so that its product with v has the unit 2**-40.
    right_side = q32_from_q40(REJECTED_SIGMAS_SQUARED * robust.dispersion * variance)
    return left_side > right_side


def is_supported(robust: RobustFilter, t: int, n: int, estimates: Sequence[int], centre: int) -> bool:
    """Return whether more than 2/5 of the estimates support a robot whose n of t observations were black.

    An estimate supports the robot if the share of black that it predicts, with the initial b_hat, is nearer
    to the robot's own share, n / t, than to the share that the ``centre`` of all estimates predicts. More
    than 2/5 are a party and not outliers: which side is right cannot be known. Estimates and centre are in
    units of 2**-24.
    """
    share = q32_quotient(n, t)
    p_of_centre = probability_of_black(robust.initial_b_hat, q32_from_q24(centre))
    supporter_count = 0
    for estimate in estimates:
        p_of_estimate = probability_of_black(robust.initial_b_hat, q32_from_q24(estimate))
        distance_from_robot = abs(p_of_estimate - share)
        distance_from_centre = abs(p_of_estimate - p_of_centre)
        if distance_from_robot < distance_from_centre:
            supporter_count += 1
    # supporter_count / len(estimates) > 2 / 5, without a division
    return 5 * supporter_count > 2 * len(estimates)


# ---- Invariants ----


def are_valid_slots(robust: RobustFilter, estimates: Sequence[int]) -> bool:
    """Return whether every slot that is not filled has the estimate 0, as in a new robot."""
    return all(robust.is_filled(slot) or estimates[slot] == 0 for slot in range(SLOTS))


def are_valid_votes(robust: RobustFilter) -> bool:
    """Return whether a robot can have this number of votes with this centre, spread and turn.

    Without votes centre, spread and turn must be as in a new robot. With votes all of them must be within
    their limits, at least one slot must be filled, and the turn must be 0 or that after a filled slot.
    """
    if robust.votes == 0:
        return (robust.centre, robust.spread, robust.turn) == (CENTRE_START, SPREAD_MAX, 0)
    # A slot votes when the turn is its index. Then the turn is one more.
    is_after_filled_slot = 1 <= robust.turn <= SLOTS and robust.is_filled(robust.turn - 1)
    return (
        robust.votes <= VOTES_MAX
        and robust.filled_slots != 0
        and robust.centre <= CENTRE_MAX
        and SPREAD_MIN <= robust.spread <= SPREAD_MAX
        and (robust.turn == 0 or is_after_filled_slot)
    )


def is_valid_batch(robust: RobustFilter, t: int, n: int) -> bool:
    """Return whether the beginning of the present batch of observations, and the dispersion, are possible.

    ``t`` is the number of observations now, and ``n`` the number of black ones. When the batch began there
    were no more of either colour than there are now. Before the first batch has ended, which ``batch_t`` = 0
    says, the dispersion is that of a new robot.
    """
    is_first_batch = robust.batch_t == 0
    white_count = t - n
    white_count_at_begin = robust.batch_t - robust.batch_n
    return (
        robust.batch_n <= robust.batch_t
        and robust.batch_n <= n
        and white_count_at_begin <= white_count
        and robust.dispersion >= DISPERSION_MIN
        and (not is_first_batch or robust.dispersion == DISPERSION_MIN)
    )


def is_valid_initial_b_hat(robust: RobustFilter, b_hat: int) -> bool:
    """Return whether the initial b_hat is in its range, and ``b_hat``, the present one, equals it if it must.

    Both are in units of 2**-32. Only a test makes them differ. A test takes five estimates, and it ends a
    batch of observations, so that the next batch begins at a ``batch_t`` above 0.
    """
    is_in_range = B_HAT_MIN <= robust.initial_b_hat <= B_HAT_MAX
    has_enough_estimates = robust.filled_slots.bit_count() >= TESTED_ESTIMATES_MIN
    may_have_tested = has_enough_estimates and robust.batch_t > 0
    return is_in_range and (may_have_tested or b_hat == robust.initial_b_hat)
