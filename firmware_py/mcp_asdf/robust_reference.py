"""The robust filter in plain equations, as ``ReferenceRobot`` uses it. docs/internals/robust.md explains it.

The filter is this project's own and not the paper's. Nothing is quantised here. The functions take floats or
fractions: from `fractions.Fraction` they give exact results, from which the cross-check knows what the
firmware must compute. ``mcp_asdf.robust_filter`` is the same filter in the firmware's integers.

A robot with this filter keeps the latest estimate of each sender in one of 32 slots. In each round one of
these estimates, or the robot's own, is a vote, which moves the robot's answer. Every ``filter_period`` rounds
the robot tests its own observations against the estimates in the slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from statistics import median
from typing import Generic, TypeVar

Number = TypeVar("Number", float, Fraction)
"""The type in which an equation is computed."""

# Constants by the names that they have in the C; ``docs/internals/robust.md`` has the reasons.
SLOTS = 32
"""Number of slots for estimates: senders whose ids are equal modulo 32 share one."""
CENTRE_START = 0.5
"""Centre of the votes before the first one."""
SPREAD_MIN = 2.0**-12
"""Smallest spread of votes or estimates."""
SPREAD_MAX = 0.25
"""Largest spread of votes or estimates, and the spread of the votes before the first vote."""
VOTES_MAX = 2**9
"""More votes are not counted, so that the gain does not fall below 2**-7."""
VOTES_OF_MAX_GAIN = 32
"""Up to 63 votes the gain is 1/8, as with 32 votes."""
TESTED_ESTIMATES_MIN = 5
"""Smallest number of estimates against which a robot tests itself: of five, two wrong ones are outvoted."""
HUBER_STEPS = 3
"""Steps from the median of the estimates to their Huber centre."""
REJECTED_SIGMAS_SQUARED = 12
"""The test rejects beyond sqrt(12) standard deviations."""
DISPERSION_MIN = 1.0
"""Smallest dispersion, and that before the first batch: observations are independent."""
DISPERSION_MAX = 2**8 - 2.0**-8
"""Largest dispersion."""
DISPERSION_SHIFT = 3
"""A batch of observations counts 2**-3 in the dispersion, and all batches before it the rest."""


# ---- Votes ----


@dataclass(frozen=True)
class Votes(Generic[Number]):
    """A summary of all votes so far, which are estimates of the share of black tiles.

    Attributes:
        centre: Centre of the votes, in [0, 1]: the robot's answer.
        spread: Median distance of the votes from the centre, in [SPREAD_MIN, SPREAD_MAX].
        count: Number of votes, up to VOTES_MAX.
    """

    centre: Number
    spread: Number
    count: int


def votes_after(votes: Votes[Number], x_hat: Number) -> Votes[Number]:
    """Return the summary of the votes with one more, ``x_hat`` in [0, 1]. O(1).

    The centre moves towards x_hat by a share of the distance, the gain, where a distance above the spread
    counts as one that equals it. The spread grows by gain / 2 of itself if the distance is above it, and
    shrinks by as much otherwise, so that it converges to the median of the distances; it stays within
    SPREAD_MIN .. SPREAD_MAX. The gain falls with the number of votes, this one included: it is 1/8 up to 63
    votes, 1/16 up to 127 votes, and so on to 1/128. More than VOTES_MAX votes are not counted.

    This is Robbins and Monro's stochastic approximation of Huber's M-estimate.
    """
    count = min(votes.count + 1, VOTES_MAX)
    # The gain is a power of two, so that the firmware shifts. A count of 6 bits, such as 32, gives 2**-3, one
    # of 7 bits, from 64 on, gives 2**-4, and so on. A count below 32 gives the same as 32.
    bits_of_count = max(count, VOTES_OF_MAX_GAIN).bit_length()
    inverse_gain = 2 ** (bits_of_count - 3)

    difference = x_hat - votes.centre
    # A vote farther away than the spread moves the centre no more than one at that distance.
    limited_difference = max(-votes.spread, min(difference, votes.spread))
    is_outside = abs(difference) > votes.spread
    spread_step = votes.spread / (2 * inverse_gain)
    new_spread = votes.spread + (spread_step if is_outside else -spread_step)
    return Votes(
        centre=votes.centre + limited_difference / inverse_gain,
        spread=limit_spread(new_spread),
        count=count,
    )


def limit_spread(spread: Number) -> Number:
    """Return the spread, or the nearer limit of SPREAD_MIN .. SPREAD_MAX if it is outside."""
    to_number = type(spread)
    return max(to_number(SPREAD_MIN), min(spread, to_number(SPREAD_MAX)))


# ---- The robot's own observations ----


@dataclass(frozen=True)
class Observations(Generic[Number]):
    """The observations of a robot, and how much they depend on each other.

    Attributes:
        n: Number of black ones.
        t: Number of all, at least 1.
        dispersion: Variance of n from batch to batch, as a multiple of the variance of independent
            observations; the phi of overdispersed binomial models. It is in [DISPERSION_MIN, DISPERSION_MAX].
    """

    n: int
    t: int
    dispersion: Number

    @property
    def share(self) -> Number:
        """Share of black observations, n/t."""
        to_number = type(self.dispersion)
        return to_number(self.n) / self.t


def dispersion_after_batch(
    observations: Observations[Number], batch_black_count: int, batch_count: int
) -> Number:
    """Return the dispersion after one more batch of observations. O(1).

    A batch is what a robot observes from one run of its filter to the next: here ``batch_count``
    observations, ``batch_black_count`` of them black. ``observations`` are all observations of the robot,
    with the batch's, and have the dispersion before the batch.

    The deviation is how far the number of black ones is from the expected one. Its square is divided by the
    mean square for independent observations. This ratio enters a moving average, the dispersion, with a
    weight of 1/8. A ratio above 12 times the dispersion before is an outlier, and counts as 12 times. The
    result is limited to DISPERSION_MIN .. DISPERSION_MAX. If the batch has no observations, or all
    observations of the robot are of one colour, the dispersion stays as it is.
    """
    to_number = type(observations.dispersion)
    dispersion = observations.dispersion
    share = observations.share
    variance = batch_count * share * (1 - share)
    if variance == 0:
        return dispersion
    deviation = batch_black_count - batch_count * share
    ratio: Number = deviation * deviation / variance
    limited_ratio = min(ratio, REJECTED_SIGMAS_SQUARED * dispersion)
    average = dispersion + (limited_ratio - dispersion) / (1 << DISPERSION_SHIFT)
    return max(to_number(DISPERSION_MIN), min(average, to_number(DISPERSION_MAX)))


# ---- The estimates in the slots ----


def spread_around(estimates: Sequence[Number], middle: Number) -> Number:
    """Return the median distance of estimates from their middle, limited to SPREAD_MIN .. SPREAD_MAX."""
    distances = [abs(estimate - middle) for estimate in estimates]
    median_distance: Number = median(distances)
    return limit_spread(median_distance)


def huber_centre(estimates: Sequence[Number], middle: Number, spread: Number) -> Number:
    """Return the Huber centre of m estimates in [0, 1]. O(m).

    It is the point where the distances of the estimates above and below balance, if none counts with more
    than ``spread``: a mean of the estimates near to it, which those far away move by a limited amount. It is
    computed by three steps of Newton's method from ``middle``, their median. After each step the centre is
    limited to [0, 1].
    """
    to_number = type(middle)
    centre = middle
    for _ in range(HUBER_STEPS):
        moved_centre = centre + huber_step(estimates, centre, spread)
        centre = max(to_number(0), min(moved_centre, to_number(1)))
    return centre


def huber_step(estimates: Sequence[Number], centre: Number, spread: Number) -> Number:
    """Return what one step of Newton's method adds to a centre on its way to the Huber centre of estimates.

    It is the sum of the differences of the estimates from the centre, each limited to -spread .. spread,
    divided by the number of those that need no limit, or by 1 if there are none. O(m) for m estimates.
    """
    limited_differences = [max(-spread, min(estimate - centre, spread)) for estimate in estimates]
    zero = type(centre)(0)  # a float or a Fraction, as the differences are
    balance = sum(limited_differences, start=zero)
    # The slope: where the centre moves up by 1, each of these estimates lowers the balance by 1.
    inside_count = sum(abs(estimate - centre) <= spread for estimate in estimates)
    slope = max(inside_count, 1)
    return balance / slope


# ---- The test ----


def probability_of_black(b: Number, fill_ratio: Number) -> Number:
    """Return the probability that a sensor of accuracy ``b`` names a tile black (eq. 1)."""
    return b * fill_ratio + (1 - b) * (1 - fill_ratio)


def robust_test_sides(
    observations: Observations[Number], b: Number, centre: Number, spread: Number
) -> tuple[Number, Number]:
    """Return both sides of the robust filter's test, which rejects ``b`` if the first is the larger. O(1).

    ``b`` is the accuracy that the robot assumed at its start. ``centre`` and ``spread`` are those of its
    neighbours' estimates. With n of t observations black, the sides are (n/t - p)**2 and 12 (dispersion v/t +
    (2 b - 1)**2 spread**2). There p is the probability of black by ``b`` and the centre, and v the larger of
    p (1 - p) and n/t (1 - n/t).
    """
    share = observations.share
    p = probability_of_black(b, centre)
    # Each of these estimates of v is 0 if its share is 0 or 1.
    v = max(p * (1 - p), share * (1 - share))
    variance_of_share = observations.dispersion * v / observations.t
    # The prediction is uncertain, too: it changes by 2 b - 1 where the centre changes by 1.
    variance_of_p = (2 * b - 1) ** 2 * spread**2
    return (share - p) ** 2, REJECTED_SIGMAS_SQUARED * (variance_of_share + variance_of_p)


def is_supported(
    observations: Observations[Number], b: Number, estimates: Sequence[Number], centre: Number
) -> bool:
    """Return whether more than 2/5 of m estimates support a robot with these observations. O(m).

    An estimate supports the robot if the share of black that it predicts is nearer to the robot's own share,
    n/t, than to the share that the ``centre`` of all estimates predicts. More than 2/5 are a party and not
    outliers: who is right cannot be known. ``b`` is the accuracy that the robot assumed at its start.
    """
    p_of_centre = probability_of_black(b, centre)
    p_of_estimates = [probability_of_black(b, estimate) for estimate in estimates]
    supporter_count = sum(abs(p - observations.share) < abs(p - p_of_centre) for p in p_of_estimates)
    return 5 * supporter_count > 2 * len(estimates)  # supporter_count / m > 2/5


# ---- The filter of a robot ----


@dataclass
class RobustReference:
    """The robust filter of a robot in float64.

    Attributes:
        initial_b_hat: The accuracy that the robot assumed at its start.
        estimates: The latest estimate of each sender, by slot.
        turn: Slot whose estimate is the next vote. If the slot is empty, the next filled slot votes.
        votes: Summary of the votes.
        dispersion: Dispersion of the robot's own observations.
        batch_t: Number of its observations when the present batch of them began.
        batch_n: Number of black ones among them at that time.
    """

    initial_b_hat: float
    estimates: dict[int, float] = field(default_factory=dict)
    turn: int = 0
    votes: Votes[float] = field(default_factory=lambda: Votes(CENTRE_START, SPREAD_MAX, 0))
    dispersion: float = DISPERSION_MIN
    batch_t: int = 0
    batch_n: int = 0

    def keep_estimate(self, sender: int, x_hat: float) -> None:
        """Put a neighbour's x_hat into the slot of its sender, in place of what was there."""
        self.estimates[sender % SLOTS] = x_hat

    def take_vote(self, own_x_hat: float, has_confidence: bool) -> None:
        """Choose the next vote among the estimates in the slots and the robot's own, and count it.

        The estimates in the slots vote in the order of the slots. After the last one the robot's own x_hat
        votes, if it has confidence; then the first slot again. The vote moves the centre and the spread of
        ``votes``, and ``turn`` goes on. Nothing happens while no slot has an estimate.
        """
        if not self.estimates:
            return
        remaining_slots = [slot for slot in self.estimates if slot >= self.turn]
        is_own_turn = not remaining_slots and has_confidence
        if is_own_turn:
            self.votes = votes_after(self.votes, own_x_hat)
            self.turn = 0
            return
        # Without confidence of its own the first slot with an estimate follows the last one at once.
        slot = min(remaining_slots) if remaining_slots else min(self.estimates)
        self.votes = votes_after(self.votes, self.estimates[slot])
        self.turn = slot + 1

    def begin_batch(self, n: int, t: int) -> None:
        """Begin a new batch of observations, after ``t`` observations of which ``n`` were black."""
        self.batch_t = t
        self.batch_n = n

    def end_batch(self, n: int, t: int) -> None:
        """Update the dispersion by the batch of observations that ends now, and begin the next batch.

        ``t`` is the number of all observations so far, and ``n`` the number of black ones.
        """
        observations = Observations(n, t, self.dispersion)
        self.dispersion = dispersion_after_batch(observations, n - self.batch_n, t - self.batch_t)
        self.begin_batch(n, t)

    def find_contradiction(self, n: int, t: int) -> float | None:
        """Return the Huber centre of the estimates if the robot's observations contradict it, else None.

        ``n`` of ``t`` observations were black. They contradict the centre if both hold:

        - They are too unlikely for a sensor of the initial b_hat where the centre is the share of black
          tiles: of the sides of ``robust_test_sides``, the first is the larger.
        - At most two fifths of the estimates support the robot, as ``is_supported`` counts them: they predict
          a share of black that is nearer to the robot's than to that which the centre predicts.

        There must be an estimate. O(m) for m estimates.
        """
        estimates = list(self.estimates.values())
        middle = median(estimates)
        spread = spread_around(estimates, middle)
        centre = huber_centre(estimates, middle, spread)

        observations = Observations(n, t, self.dispersion)
        squared_difference, limit = robust_test_sides(observations, self.initial_b_hat, centre, spread)
        is_rejected = squared_difference > limit
        if is_rejected and not is_supported(observations, self.initial_b_hat, estimates, centre):
            return centre
        return None
