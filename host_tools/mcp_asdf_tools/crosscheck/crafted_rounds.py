"""Estimates crafted for one robot: rounds at the threshold of its test, and others that decide something.

There are two users. The cross-check makes calls with these estimates, of the C firmware and of its mirror.
The verification of a controller sends them as frames, to the controller and to its model.

x_hat is in units of 2**-23. alpha, the confidence of an estimate, is an alpha word, as the firmware keeps it:
32 bits, with a mantissa in bits 8 to 31 and a shift in bits 0 to 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from math import isqrt
from random import Random
from typing import NamedTuple

from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    ONE,
    add_estimate,
    alpha_word_from_units,
)
from mcp_asdf.mirror import INFORMATIVE_G, Closed, asdf_test_rejects, reestimate, round_mean
from mcp_asdf.robot import Sums
from mcp_asdf.table import FRACTION_BITS, Table

ALPHA_ONE = 0x8000_0001
"""The alpha word of 1.0."""
ALPHA_LEAST = 0x0000_0100
"""The alpha word of 2**-24, the smallest above 0."""


class NeighbourEstimate(NamedTuple):
    """What a neighbour broadcasts, without its id: its local estimate, and the confidence in it."""

    x_hat: int
    alpha: int


class Update(Enum):
    """What becomes of b_hat, the accuracy that a robot assumes, at a test that rejects it.

    The value describes it in a verdict.
    """

    ABOVE = "b_hat above 1/2, off the limit"
    BELOW = "b_hat below 1/2, off the limit"
    MAXIMUM = "b_hat at its upper limit"
    MINIMUM = "b_hat at its lower limit"
    HALF = "b_hat at 1/2, where the robot knows nothing"
    FAINT = "b_hat just off 1/2"
    KEPT = "b_hat kept, as x_bar is 1/2"


_LITTLE_INFORMATION = 1 << 28
"""|2 b_hat - 1| below which observations carry hardly any information, in units of 2**-32."""


@dataclass(frozen=True)
class RobotState:
    """State of the robot that is to receive a round.

    Attributes:
        t: Number of its observations.
        n: Number of black ones among them.
        x_hat: Its local estimate in units of 2**-23.
        table: Thresholds of its test; None if it re-estimates b_hat without a test.
    """

    t: int
    n: int
    x_hat: int
    table: Table | None

    def update_after(self, estimates: Sequence[NeighbourEstimate]) -> Update | None:
        """Return what becomes of b_hat at the end of a round of these estimates; None if the test passes.

        The test passes if it does not reject the robot's x_hat by these estimates. Then b_hat is not
        re-estimated, and neither is it after a single estimate. A robot without a table has no test, and
        re-estimates b_hat in any case. `Update.KEPT` is returned if the mean of the estimates is too close to
        1/2 for a re-estimate.
        """
        sums = Sums()
        for estimate in estimates:
            add_estimate(sums, estimate.x_hat, estimate.alpha)
        if self.table is not None:
            # The variance of a single estimate is not defined, so that the test needs two.
            is_rejected = sums.count >= 2 and asdf_test_rejects(self.table, sums, self.x_hat)
            if not is_rejected:
                return None
        x_bar = round_mean(Closed(sums.alpha, sums.alpha_x_low, sums.alpha_x_high))
        return classify_update(reestimate(self.t, self.n, x_bar))


def classify_update(b_hat: int | None) -> Update:
    """Return the kind of update that sets b_hat, the accuracy that the robot assumes, to this value.

    The kinds are KEPT, both limits (MINIMUM and MAXIMUM), HALF for about 1/2, which carries no information,
    FAINT for values next to that, and ABOVE and BELOW for all others, by their side of 1/2. ``b_hat`` is in
    units of 2**-32; None means that the re-estimate has kept the old value.
    """
    if b_hat is None:
        return Update.KEPT
    if b_hat == B_HAT_MIN:
        return Update.MINIMUM
    if b_hat == B_HAT_MAX:
        return Update.MAXIMUM
    information = 2 * b_hat - (1 << 32)  # 2 b_hat - 1, in units of 2**-32
    if abs(information) < INFORMATIVE_G:
        return Update.HALF
    if abs(information) < _LITTLE_INFORMATION:
        return Update.FAINT
    return Update.ABOVE if information > 0 else Update.BELOW


# --- Confidences ---

ALPHA_SCALES = ((1, 4), (10, 20), (24, 28), (25, 41), (48, 55))
"""Smallest and largest number of bits of the confidences of a round, in units of 2**-24.

They have sums below 2**9 units, where eq. 8 shifts up instead of down, below 2**24 (alpha = 1), below 2**32,
sums as robots have them, and sums above 2**45.
"""


def draw_normal_alpha(rng: Random, min_shift: int = 1, max_shift: int = 17) -> int:
    """Draw an alpha word, a confidence, whose mantissa has all of its 24 bits and so no leading zeros.

    It stands for a confidence from 2**(min_shift - 1) to 2**max_shift: by default from 1 to 2**17.
    """
    mantissa = rng.randrange(1 << 23, 1 << 24)
    shift = rng.randint(min_shift, max_shift)
    return (mantissa << 8) | shift


def draw_alphas_of_one_scale(rng: Random, count: int, scale: tuple[int, int] | None = None) -> list[int]:
    """Draw ``count`` alpha words for confidences of similar size.

    ``scale`` is the smallest and the largest number of bits of a confidence in units of 2**-24. By default it
    is drawn from ``ALPHA_SCALES``.
    """
    min_bits, max_bits = rng.choice(ALPHA_SCALES) if scale is None else scale
    alphas = []
    for _ in range(count):
        bit_count = rng.randint(min_bits, max_bits)
        leading_one = 1 << (bit_count - 1)  # The bits below it are random.
        units = leading_one + rng.randrange(leading_one)
        alphas.append(alpha_word_from_units(units))
    return alphas


# --- Rounds at the threshold of the test ---

_ROOT_BITS = 100
"""Fraction bits of a square root, more than any fraction with a denominator of 24 bits can be near to it."""
_MANY_ESTIMATES = 100
"""Size of a round from which on its sums have more bits than a float64."""
_MAX_DRAWS = 1500
"""Pairs of rounds that are drawn to find one that serves.

Of a hundred pairs with many estimates, a test in float64 decides wrongly about one or two, and of pairs with
few estimates about none."""
_MIN_GAP_SHARE, _MIN_GAP_SHARE_OF_MANY = 0.05, 0.8
"""Smallest distance between two groups of x_hat, as a share of the largest possible one, and the same for
rounds of many estimates. These are wide, so that their large sums have bits that floats lose."""
_MIN_RANGE = 1 << 13
"""Smallest distance between the smallest and the largest x_hat of a round that serves.

One unit of 2**-23 then moves it so little that a threshold that is wrong by a millionth shows."""


RoundsAtThreshold = tuple[list[NeighbourEstimate], list[NeighbourEstimate]]
"""Two rounds that differ by so little that a robot's test passes the first and rejects the second."""


def draw_rounds_at_threshold(robot: RobotState, m: int, rng: Random) -> RoundsAtThreshold:
    """Draw two rounds of ``m`` estimates: the robot's test just rejects the second, and not the first.

    They are as close to the test's threshold as x_hat in units of 2**-23 can be, and the second one changes
    b_hat. For a hundred estimates or more, pairs of rounds are drawn until a test in float64 would decide
    wrongly about one of the two. If none of many pairs is like that, the first pair is returned. The robot
    must have a table.
    """
    has_many_estimates = m >= _MANY_ESTIMATES
    min_gap_share = _MIN_GAP_SHARE_OF_MANY if has_many_estimates else _MIN_GAP_SHARE
    first_rounds: RoundsAtThreshold | None = None
    for _ in range(_MAX_DRAWS):
        rounds = _draw_useful_rounds(robot, m, min_gap_share, rng)
        if rounds is None:
            continue
        if not has_many_estimates or _is_float_test_wrong(robot, rounds):
            return rounds
        if first_rounds is None:
            first_rounds = rounds
    assert first_rounds is not None, f"no round of {m} estimates lies at the threshold of {robot}"
    return first_rounds


def _draw_useful_rounds(
    robot: RobotState, m: int, min_gap_share: float, rng: Random
) -> RoundsAtThreshold | None:
    """Draw two rounds on both sides of the threshold of a robot's test; None if they would show too little.

    They must have x_hat so far apart that a threshold that is wrong by a millionth shows, and the second one,
    which the test rejects, must change b_hat. ``min_gap_share`` is the smallest distance between its two
    groups of x_hat, as a share of the largest possible one.
    """
    assert robot.table is not None
    gap_share = rng.uniform(min_gap_share, 1)
    x_hats = draw_x_hats_at_threshold(robot.x_hat, robot.table.entry(m), m, rng, gap_share)
    if x_hats is None:
        return None
    inside_x_hats, outside_x_hats = x_hats
    if max(inside_x_hats) - min(inside_x_hats) < _MIN_RANGE:
        return None
    alphas = draw_alphas_of_one_scale(rng, m)
    inside = list(map(NeighbourEstimate, inside_x_hats, alphas))
    outside = list(map(NeighbourEstimate, outside_x_hats, alphas))
    if robot.update_after(outside) is Update.KEPT:
        return None  # A b_hat that is kept would not show that the test has rejected.
    return inside, outside


@dataclass(frozen=True)
class _TwoGroups:
    """A round of two groups of equal x_hat: at distance u from the robot's own x_hat, and at u + gap.

    The distances are positive in the direction in which the far group lies. The test (eq. 12) rejects where

        (m u + far_count gap) / gap > sqrt(k_m near_count far_count),

    so that the ratio u / gap has a threshold, too.

    Attributes:
        own_x_hat: x_hat of the robot that receives the round.
        near_count: Number of x_hat at distance u.
        far_count: Number of x_hat at distance u + gap.
        direction: 1 if the far group lies above the near one, and -1 if below.
    """

    own_x_hat: int
    near_count: int
    far_count: int
    direction: int

    def threshold_of_ratio(self, table_entry: int) -> Fraction:
        """Return the ratio u / gap above which the test rejects; ``table_entry`` is k_m, as in a table.

        The near group is at distance u from the robot's own x_hat, and the far group at u + gap. The ratio is
        (sqrt(k_m near_count far_count) - far_count) / m, with the root rounded down to 100 bits.
        """
        # Entries of the table have FRACTION_BITS fraction bits, so this product has as many. A square whose
        # root is to have _ROOT_BITS needs twice as many as the root.
        product = table_entry * self.near_count * self.far_count
        scaled_root = isqrt(product << (2 * _ROOT_BITS - FRACTION_BITS))
        root = Fraction(scaled_root, 1 << _ROOT_BITS)
        m = self.near_count + self.far_count
        return (root - self.far_count) / m

    def largest_gap(self, ratio: Fraction) -> Fraction:
        """Return the largest gap between the groups for which all their x_hat are between 0 and 1.

        ``ratio`` is that of u to the gap. The near group is at distance u from the robot's own x_hat, and the
        far group at u + gap.
        """
        room_above, room_below = ONE - self.own_x_hat, self.own_x_hat
        # Ahead is the direction in which the far group lies.
        if self.direction > 0:
            room_ahead, room_behind = room_above, room_below
        else:
            room_ahead, room_behind = room_below, room_above
        # The far group is u + gap = (ratio + 1) gap ahead of the own x_hat.
        gap_of_room_ahead = room_ahead / (ratio + 1)
        if ratio >= 0:
            return gap_of_room_ahead  # no group is behind the own x_hat
        # The near group is -u = -ratio gap behind the own x_hat.
        gap_of_room_behind = room_behind / -ratio
        return min(gap_of_room_ahead, gap_of_room_behind)

    def make_x_hats(self, ratio: Fraction, max_gap: int) -> list[int]:
        """Return x_hat of both groups for a ratio of u to the gap, with the largest gap up to ``max_gap``.

        The near group is at distance u from the robot's own x_hat, and the far group at u + gap.

        Pairs of equal x_hat come first: the near group's pairs, then the far group's. At the end there is one
        x_hat of each group that has an odd size.
        """
        # The gap is a multiple of the ratio's denominator, so that u is a whole number, too.
        factor = max_gap // ratio.denominator
        gap = factor * ratio.denominator
        u = factor * ratio.numerator
        near = self.own_x_hat + self.direction * u
        far = near + self.direction * gap
        near_pairs, near_singles = divmod(self.near_count, 2)
        far_pairs, far_singles = divmod(self.far_count, 2)
        pairs = [near, near] * near_pairs + [far, far] * far_pairs
        return pairs + [near] * near_singles + [far] * far_singles


def draw_x_hats_at_threshold(
    own_x_hat: int, table_entry: int, m: int, rng: Random, gap_share: float
) -> tuple[list[int], list[int]] | None:
    """Draw x_hat of two rounds of ``m`` estimates: the test (eq. 12) just rejects the second, not the first.

    Each round has two groups of equal x_hat (`_TwoGroups`), whose ratio u / gap is the largest fraction below
    its threshold in the first round, and the smallest above it in the second. Then equal x_hat are moved
    apart in pairs, which changes the scatter of a round but not its sum, and so brings it still closer to the
    threshold.

    Args:
        own_x_hat: x_hat of the robot that receives the rounds.
        table_entry: k_m, the test's threshold for m estimates, as its table has it.
        m: Number of estimates, from 2.
        rng: Draws how many of them are near, and on which side of ``own_x_hat`` the far ones are.
        gap_share: Gap between the groups, as a share of the largest for which there is room, up to 1.

    Returns:
        The two lists of x_hat; None if there is no room for groups as drawn.
    """
    near_count = rng.randrange(1, m)
    groups = _TwoGroups(own_x_hat, near_count, m - near_count, direction=rng.choice([-1, 1]))
    threshold = groups.threshold_of_ratio(table_entry)
    max_gap = int(groups.largest_gap(threshold) * Fraction(gap_share))
    if max_gap < 1:
        return None
    ratio_below, ratio_above = fractions_around(threshold, max_gap)
    inside = groups.make_x_hats(ratio_below, max_gap)
    outside = groups.make_x_hats(ratio_above, max_gap)
    pair_count = groups.near_count // 2 + groups.far_count // 2
    if pair_count > 0:
        # Both rounds are made of the rejected one, by two different moves of its pairs.
        inside, outside = _bring_scatter_to_threshold(outside, pair_count, own_x_hat, table_entry)
    smallest_x_hat, largest_x_hat = min(inside + outside), max(inside + outside)
    if smallest_x_hat < 0 or largest_x_hat > ONE:
        return None
    return inside, outside


def _bring_scatter_to_threshold(
    rejected_x_hats: Sequence[int], pair_count: int, own_x_hat: int, table_entry: int
) -> tuple[list[int], list[int]]:
    """Return two rounds made of one that the test rejects: one just passes, and the other is just rejected.

    They have the sum of ``rejected_x_hats``, and a scatter on either side of the test's limit. For that the
    first ``pair_count`` pairs, of equal x_hat each, are moved apart. ``table_entry`` is k_m, as in a table.
    """
    # The test (eq. 12) in integers: it rejects if entry * scatter < difference**2 * 2**FRACTION_BITS.
    difference = sum(rejected_x_hats) - len(rejected_x_hats) * own_x_hat
    largest_rejected_scatter = (difference**2 * 2**FRACTION_BITS - 1) // table_entry
    inside = _move_apart_in_pairs(rejected_x_hats, pair_count, largest_rejected_scatter + 1, is_at_least=True)
    outside = _move_apart_in_pairs(rejected_x_hats, pair_count, largest_rejected_scatter, is_at_least=False)
    return inside, outside


def fractions_around(value: Fraction, max_denominator: int) -> tuple[Fraction, Fraction]:
    """Return the largest fraction that is not above ``value``, and the smallest above it.

    Their denominators are at most ``max_denominator``.
    """
    nearest = value.limit_denominator(max_denominator)
    if nearest <= value:
        return nearest, _next_fraction(nearest, max_denominator, direction=1)
    return _next_fraction(nearest, max_denominator, direction=-1), nearest


def _next_fraction(fraction: Fraction, max_denominator: int, direction: int) -> Fraction:
    """Return the next larger fraction for a ``direction`` of 1, and the next smaller one for -1.

    It is the next among the fractions with denominators of at most ``max_denominator``, and ``fraction`` must
    be one of these.
    """
    # The next fraction c/d to a/b has b c - a d = direction. So c = (a d + direction) / b, and for c to be a
    # whole number d must be -direction / a modulo b. The largest d up to the limit gives the nearest c/d.
    a, b = fraction.numerator, fraction.denominator
    inverse_of_a = pow(a, -1, b)  # modulo b
    d_modulo_b = (-direction * inverse_of_a) % b
    d = max_denominator - (max_denominator - d_modulo_b) % b
    c = (a * d + direction) // b
    return Fraction(c, d)


def scatter_of(x_hats: Sequence[int]) -> int:
    """Return m Sum x^2 - (Sum x)^2, which is m (m - 1) times the sample variance of the m x_hat."""
    m = len(x_hats)
    total = sum(x_hats)
    sum_of_squares = sum(x * x for x in x_hats)
    return m * sum_of_squares - total * total


def _move_apart_in_pairs(x_hats: Sequence[int], pair_count: int, target: int, is_at_least: bool) -> list[int]:
    """Return a copy of ``x_hats``, some moved apart in pairs, so that their scatter reaches a target.

    Their sum stays. The scatter, as `scatter_of` computes it, must not be above ``target`` before. It ends
    there or slightly above with ``is_at_least``, else there or slightly below. The first ``pair_count`` pairs
    are moved. Both values of such a pair must be equal. Each pair takes nearly all that the pairs before it
    have left.
    """
    m = len(x_hats)
    changed_x_hats = list(x_hats)
    missing_scatter = target - scatter_of(x_hats)
    for pair_index in range(pair_count):
        # Two equal values add 2 m move**2 to the scatter if one is moved down and the other up by ``move``.
        # This is the largest move that adds no more than is missing.
        move = isqrt(missing_scatter // (2 * m))
        is_last_pair = pair_index == pair_count - 1
        is_below_target = 2 * m * move**2 < missing_scatter
        if is_at_least and is_last_pair and is_below_target:
            move += 1  # no other pair can add the rest
        changed_x_hats[2 * pair_index] -= move
        changed_x_hats[2 * pair_index + 1] += move
        missing_scatter -= 2 * m * move**2
    return changed_x_hats


def _is_float_test_wrong(robot: RobotState, rounds: RoundsAtThreshold) -> bool:
    """Return whether eq. 12, the test, decides wrongly about one of these rounds if computed in float64.

    The right test passes the first round and rejects the second.
    """
    assert robot.table is not None
    for estimates, should_reject in zip(rounds, (False, True), strict=True):
        x_hats = [estimate.x_hat for estimate in estimates]
        m = len(x_hats)
        difference = sum(x_hats) - m * robot.x_hat
        threshold = robot.table.entry(m) / 2**FRACTION_BITS
        is_rejected = float(difference) ** 2 > threshold * float(scatter_of(x_hats))
        if is_rejected != should_reject:
            return True
    return False


# --- Rounds with another purpose ---

_X_BAR_RANGE_BY_UPDATE = {
    Update.ABOVE: (0.65, 0.98),
    Update.BELOW: (0.02, 0.35),
    Update.MAXIMUM: (0.51, 0.58),
    Update.MINIMUM: (0.42, 0.49),
    Update.HALF: (0.7, 0.95),
    Update.KEPT: (0.5, 0.5),
    Update.FAINT: (0.7, 0.95),
}
"""Range of x_bar, the mean of the neighbours' x_hat, that leads to each update.

That holds where a bit more than half of the observations are black; for HALF exactly half must be, for FAINT
nearly half."""
_MAX_DRAWS_FOR_UPDATE = 300
_MAX_DISTANCE_FROM_HALF = ONE >> 11
"""Largest distance from 1/2 of two estimates whose mean is 1/2, in units of 2**-23."""
_MAX_DISTANCE_FROM_X_BAR = ONE >> 7
"""Largest distance of estimates from the mean for which they are drawn, in units of 2**-23."""
_MAX_DISTANCE_FROM_END = ONE >> 11
"""Largest distance from 0 or 1 of estimates that are near it, in units of 2**-23."""


def draw_estimate(rng: Random, max_shift: int = 17) -> NeighbourEstimate:
    """Draw an estimate: any x_hat from 0 to 1, with a confidence from 1 to 2**max_shift."""
    return NeighbourEstimate(rng.randint(0, ONE), draw_normal_alpha(rng, max_shift=max_shift))


def draw_round_for_update(
    robot: RobotState, update: Update, rng: Random, m: int = 5
) -> list[NeighbourEstimate] | None:
    """Draw ``m`` estimates after which the robot's b_hat is updated in this way.

    For KEPT, which keeps b_hat, there are two, whatever ``m``. Returns None if none of many draws has this
    effect.
    """
    for _ in range(_MAX_DRAWS_FOR_UPDATE):
        if update is Update.KEPT:
            estimates = _draw_pair_around_half(rng)
        else:
            estimates = _draw_estimates_near_x_bar(_X_BAR_RANGE_BY_UPDATE[update], rng, m)
        if robot.update_after(estimates) is update:
            return estimates
    return None


def _draw_pair_around_half(rng: Random) -> list[NeighbourEstimate]:
    """Draw two estimates of the same confidence whose mean is exactly 1/2."""
    distance = rng.randint(1, _MAX_DISTANCE_FROM_HALF)
    alpha = draw_normal_alpha(rng)
    return [NeighbourEstimate(HALF - distance, alpha), NeighbourEstimate(HALF + distance, alpha)]


def _draw_estimates_near_x_bar(
    x_bar_range: tuple[float, float], rng: Random, m: int
) -> list[NeighbourEstimate]:
    """Draw ``m`` estimates of similar confidence, all of them near one x_bar that is drawn from a range.

    The range is from a smallest to a largest x_bar, between 0 and 1. The estimates are limited to 0 .. 1.
    """
    lowest_x_bar, highest_x_bar = x_bar_range
    x_bar = round(rng.uniform(lowest_x_bar, highest_x_bar) * ONE)  # in units of 2**-23
    max_distance = rng.randint(1, _MAX_DISTANCE_FROM_X_BAR)
    x_hats = [x_bar + rng.randint(-max_distance, max_distance) for _ in range(m)]
    limited_x_hats = [min(max(x_hat, 0), ONE) for x_hat in x_hats]
    alphas = draw_alphas_of_one_scale(rng, m)
    return list(map(NeighbourEstimate, limited_x_hats, alphas))


def draw_distant_estimates(robot: RobotState, rng: Random, m: int = 4) -> list[NeighbourEstimate]:
    """Draw ``m`` estimates near 0 or 1, whichever is farther from the robot's own x_hat.

    They are so far from it that a test against two or more of them rejects.
    """
    is_zero_farther = robot.x_hat > HALF
    estimates = []
    for _ in range(m):
        distance_from_end = rng.randint(0, _MAX_DISTANCE_FROM_END)
        x_hat = distance_from_end if is_zero_farther else ONE - distance_from_end
        estimates.append(NeighbourEstimate(x_hat, draw_normal_alpha(rng)))
    return estimates


_ESTIMATES_OF_LARGE_ROUND = 126
"""Number of all other robots, if one id is left out."""


def draw_round_of_large_scatter(robot: RobotState, rng: Random) -> list[NeighbourEstimate]:
    """Draw a round of 0 and 1 whose scatter, m Sum x^2 - (Sum x)^2, needs more than 56 bits.

    The robot's test passes it, and would reject it if a controller left out the bits from 2**56 on. The robot
    must have a table.
    """
    assert robot.table is not None
    m = _ESTIMATES_OF_LARGE_ROUND
    threshold: float = robot.table.entry(m) / 2**FRACTION_BITS

    def margin_of(count_of_ones: int) -> float:
        """Return by which factor the right scatter passes and the wrong one rejects, the smaller of both."""
        # In units of ONE**2, that is 2**46, the scatter of 0 and 1 is this product. Its bits from 2**56 on
        # are those from 2**10 on in these units.
        scatter = count_of_ones * (m - count_of_ones)
        # Where these two would be 0, nothing could be divided by them: there they are 1.
        scatter_without_bits = max(scatter % (1 << 10), 1)
        difference_squared = max((count_of_ones - m * robot.x_hat / ONE) ** 2, 1)
        # The test rejects if the squared difference is above threshold * scatter. The right scatter must
        # clearly pass, and the scatter without these bits clearly reject.
        margin_of_passing = threshold * scatter / difference_squared
        margin_of_rejecting = difference_squared / (threshold * scatter_without_bits)
        return min(margin_of_passing, margin_of_rejecting)

    best_count = max(range(1, m), key=margin_of)  # of ones
    x_hats = [ONE] * best_count + [0] * (m - best_count)
    return list(map(NeighbourEstimate, x_hats, draw_alphas_of_one_scale(rng, m)))


def draw_round_of_distant_sum(robot: RobotState, rng: Random) -> list[NeighbourEstimate]:
    """Draw a round that the robot's test rejects, but not if a controller cuts a square to 54 bits.

    It is the square of Sum x - m x_hat in eq. 12. That difference is a multiple of 2**27 here, so that its
    square is 0 without the bits from 2**54 on.
    """
    m = _ESTIMATES_OF_LARGE_ROUND
    unit_of_difference = 1 << 27
    sum_of_no_difference = m * robot.x_hat
    # The sum lies as far from m x_hat as there is room for, towards 0 or 1, whichever is farther away.
    if robot.x_hat < HALF:
        direction, room = 1, m * ONE - sum_of_no_difference
    else:
        direction, room = -1, sum_of_no_difference
    difference = room // unit_of_difference * unit_of_difference
    sum_of_x_hats = sum_of_no_difference + direction * difference
    # All x_hat are as near the mean as whole numbers with this sum can be.
    mean, remainder = divmod(sum_of_x_hats, m)
    x_hats = [mean + 1] * remainder + [mean] * (m - remainder)
    # Moving two of them apart gives a scatter above 0, but far below the square.
    x_hats[0] -= 8
    x_hats[1] += 8
    return list(map(NeighbourEstimate, x_hats, draw_alphas_of_one_scale(rng, m)))


EXTREME_ROUNDS: dict[str, list[NeighbourEstimate]] = {
    "confidences of 0": [NeighbourEstimate(ONE, 0), NeighbourEstimate(0, 0)],
    "one confidence of 0 among others": [
        NeighbourEstimate(ONE, 0),
        NeighbourEstimate(HALF, ALPHA_ONE),
        NeighbourEstimate(0, ALPHA_ONE),
    ],
    "the least confidence": [NeighbourEstimate(ONE, ALPHA_LEAST)],
    "the largest confidence": [NeighbourEstimate(0, ALPHA_MAX), NeighbourEstimate(ONE, ALPHA_ONE)],
    "confidences far apart": [
        NeighbourEstimate(ONE, ALPHA_LEAST),
        NeighbourEstimate(0, 0x8000_0010),
        NeighbourEstimate(HALF + 1, ALPHA_ONE),
    ],
    "estimates of 0 and 1": [NeighbourEstimate(x_hat, 0x8000_0005) for x_hat in (0, ONE, 1, ONE - 1)],
    "126 messages of the largest confidence": [NeighbourEstimate(ONE - 1, ALPHA_MAX)]
    * _ESTIMATES_OF_LARGE_ROUND,
}
"""Estimates at the ends of their ranges, for one round each, by what they have in common."""
