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
from functools import partial
from math import isqrt, sqrt
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


def draw_normal_alpha(rng: Random, max_shift: int = 17) -> int:
    """Draw an alpha word, a confidence, whose mantissa has all of its 24 bits and so no leading zeros.

    It stands for a confidence from 1 to 2**max_shift.
    """
    mantissa = rng.randrange(1 << 23, 1 << 24)
    shift = rng.randint(1, max_shift)
    return (mantissa << 8) | shift


def draw_alpha_of_bits(rng: Random, min_bits: int, max_bits: int) -> int:
    """Draw an alpha word as robots send them, for a confidence of so many bits in units of 2**-24.

    Confidences that a word can hold have 1 to 55 bits: they are from 2**-24 to nearly 2**31.
    """
    bit_count = rng.randint(min_bits, max_bits)
    leading_one = 1 << (bit_count - 1)  # The bits below it are random.
    return alpha_word_from_units(leading_one + rng.randrange(leading_one))


def draw_alphas_of_one_scale(rng: Random, count: int, scale: tuple[int, int] | None = None) -> list[int]:
    """Draw ``count`` alpha words for confidences of similar size.

    ``scale`` is the smallest and the largest number of bits of a confidence in units of 2**-24. By default it
    is drawn from ``ALPHA_SCALES``.
    """
    min_bits, max_bits = rng.choice(ALPHA_SCALES) if scale is None else scale
    return [draw_alpha_of_bits(rng, min_bits, max_bits) for _ in range(count)]


# --- Rounds at the threshold of the test ---

_MAX_ESTIMATES_TRIED = 1000
"""Number of estimates that the tried rounds have together at most; the nearest to the threshold is chosen."""
_MANY_ESTIMATES = 100
"""Size of a round from which on its sums have more bits than a float64."""
_MAX_DRAWS = 200
"""Pairs of rounds that are drawn to find one that serves.

With many estimates, a test in float64 decides wrongly about some ten of a hundred pairs, and with few
estimates, or an x_hat of the robot next to 0 or 1, about none."""
_MIN_DISTANCE_SHARE = 0.5
"""Smallest distance of a round's mean from the robot's x_hat, as a share of the largest possible one.

So large sums have bits that floats lose."""
_MIN_DISTANCE = 1 << 19
"""Smallest distance from the robot's x_hat that the mean of a round may have.

A unit of 2**-23 is then so small a part of the distance that a threshold wrong by a millionth shows. On one
side of any x_hat there is room for so large a distance."""


RoundsAtThreshold = tuple[list[NeighbourEstimate], list[NeighbourEstimate]]
"""Two rounds next to the threshold of a robot's test, which passes the first and rejects the second."""


def draw_rounds_at_threshold(robot: RobotState, m: int, rng: Random) -> RoundsAtThreshold:
    """Draw two rounds of ``m`` estimates: the robot's test just rejects the second, and not the first.

    They are so close to the test's threshold that a threshold that is wrong by a millionth shows, and the
    second one changes b_hat. For a hundred estimates or more, pairs of rounds are drawn until a test in
    float64 would decide wrongly about one of the two. If none of many pairs is like that, the first pair is
    returned. The robot must have a table.
    """
    first_rounds: RoundsAtThreshold | None = None
    for _ in range(_MAX_DRAWS):
        rounds = _draw_useful_rounds(robot, m, rng)
        if rounds is None:
            continue
        if m < _MANY_ESTIMATES or _is_float_test_wrong(robot, rounds):
            return rounds
        if first_rounds is None:
            first_rounds = rounds
    assert first_rounds is not None, f"no round of {m} estimates lies at the threshold of {robot}"
    return first_rounds


def _draw_useful_rounds(robot: RobotState, m: int, rng: Random) -> RoundsAtThreshold | None:
    """Draw two rounds on both sides of the threshold of a robot's test; None if they would show too little.

    Their x_hat must be so far from the robot's that a threshold that is wrong by a millionth shows, and the
    second one, which the test rejects, must change b_hat.
    """
    assert robot.table is not None
    distance_share = rng.uniform(_MIN_DISTANCE_SHARE, 1)
    x_hats = draw_x_hats_at_threshold(robot.x_hat, robot.table.entry(m), m, rng, distance_share)
    if x_hats is None:
        return None
    passed_x_hats, rejected_x_hats = x_hats
    mean = sum(passed_x_hats) // m
    if abs(mean - robot.x_hat) < _MIN_DISTANCE:
        return None
    alphas = draw_alphas_of_one_scale(rng, m)
    passed_round = list(map(NeighbourEstimate, passed_x_hats, alphas))
    rejected_round = list(map(NeighbourEstimate, rejected_x_hats, alphas))
    if robot.update_after(rejected_round) is Update.KEPT:
        return None  # A b_hat that is kept would not show that the test has rejected.
    return passed_round, rejected_round


def draw_x_hats_at_threshold(
    own_x_hat: int, table_entry: int, m: int, rng: Random, distance_share: float
) -> tuple[list[int], list[int]] | None:
    """Draw x_hat of two rounds of ``m`` estimates: the test (eq. 12) just rejects the second, not the first.

    The x_hat of a round lie around their mean, in groups. The distance of the mean from the robot's own x_hat
    decides at which scatter the test no longer rejects, and the groups are scattered by just that.

    Args:
        own_x_hat: x_hat of the robot that receives the rounds.
        table_entry: k_m, the test's threshold for m estimates, as its table has it.
        m: Number of estimates, from 2.
        rng: Draws on which side of ``own_x_hat`` the means are.
        distance_share: Distance of the means from ``own_x_hat``, as a share of the largest for which there is
            room, up to 1.

    Returns:
        The two lists of x_hat; None if there is no room on the side that was drawn.
    """
    direction = rng.choice([-1, 1])
    room = ONE - own_x_hat if direction > 0 else own_x_hat
    groups = _groups_around_mean(m, direction)
    test = _TestOfRound(own_x_hat, table_entry)
    passed_rounds, rejected_rounds = [], []
    for distance in _distances_to_try(test, groups, distance_share * room):
        mean = own_x_hat + direction * distance
        largest_rejected_scatter = test.largest_rejected_scatter(m * distance)
        # One unit of scatter decides between the two rounds.
        passed_rounds.append(_x_hats_with_scatter(mean, groups, largest_rejected_scatter + 1, True))
        rejected_rounds.append(_x_hats_with_scatter(mean, groups, largest_rejected_scatter, False))
    passed = test.nearest_to_threshold(passed_rounds)
    rejected = test.nearest_to_threshold(rejected_rounds)
    if passed is None or rejected is None:
        return None
    return passed, rejected


@dataclass(frozen=True)
class _TestOfRound:
    """The test (eq. 12) of a robot's x_hat against rounds of a fixed number m of estimates.

    In integers it rejects if table_entry * scatter < difference**2 * 2**FRACTION_BITS. The difference is that
    of the sum of the round's x_hat from m times the robot's own.

    Attributes:
        own_x_hat: The robot's own x_hat.
        table_entry: k_m, the threshold, as a table has it.
    """

    own_x_hat: int
    table_entry: int

    def largest_rejected_scatter(self, difference: int) -> int:
        """Return the largest scatter at which the test still rejects a round with this difference."""
        return ((difference**2 << FRACTION_BITS) - 1) // self.table_entry

    def distance_from_threshold(self, x_hats: Sequence[int]) -> float:
        """Return how far both sides of the inequality are apart, as a share of the right side."""
        difference = sum(x_hats) - len(x_hats) * self.own_x_hat
        return abs(self.table_entry * scatter_of(x_hats) / (difference**2 << FRACTION_BITS) - 1)

    def nearest_to_threshold(self, rounds: Sequence[list[int] | None]) -> list[int] | None:
        """Return the x_hat of the round that is the nearest to the threshold; None if all are None."""
        possible_rounds = [x_hats for x_hats in rounds if x_hats is not None]
        return min(possible_rounds, key=self.distance_from_threshold, default=None)


def _distances_to_try(test: _TestOfRound, groups: Sequence[tuple[int, ...]], room: float) -> range:
    """Return distances of a mean from the robot's x_hat: the largest that leave room for groups around it.

    ``room`` is how far an x_hat may be from the robot's. `_groups_around_mean` returns such ``groups``. A
    single group hardly meets the threshold for one distance, but it does for one of many. For rounds of many
    estimates one or a few distances suffice.
    """
    # If all groups are moved alike, at the threshold a move is about this share of the mean's distance.
    relative_move = sqrt(2**FRACTION_BITS / test.table_entry)
    # The first group has the x_hat that is the farthest from the mean. It may be that much beyond the mean.
    largest_step = max(map(abs, groups[0]))
    max_distance = int(room / (1 + largest_step * relative_move))
    m = sum(map(len, groups))
    min_distance = max(max_distance - _MAX_ESTIMATES_TRIED // m, 1)
    return range(min_distance, max_distance + 1)


def _groups_around_mean(m: int, direction: int) -> list[tuple[int, ...]]:
    """Divide ``m`` x_hat into groups around their mean, and return the groups.

    All x_hat of a group are moved away from the mean by multiples of the same move, and the group is the
    tuple of these multiples. All groups are pairs, but for an odd ``m`` the first one has three x_hat. Two of
    these lie on the side of the robot's own x_hat, where there is less room if that is near 0 or 1.
    ``direction`` is 1 if the mean is above the robot's own x_hat, and -1 if it is below.
    """
    pair = (1, -1)
    if m % 2 == 0:
        return [pair] * (m // 2)
    triple = (2 * direction, -direction, -direction)
    return [triple] + [pair] * ((m - 3) // 2)


def scatter_of(x_hats: Sequence[int]) -> int:
    """Return m Sum x^2 - (Sum x)^2, which is m (m - 1) times the sample variance of the m x_hat."""
    m = len(x_hats)
    total = sum(x_hats)
    sum_of_squares = sum(x * x for x in x_hats)
    return m * sum_of_squares - total * total


def _x_hats_with_scatter(
    mean: int, groups: Sequence[tuple[int, ...]], target: int, is_at_least: bool
) -> list[int] | None:
    """Return x_hat with this mean whose scatter, as `scatter_of` computes it, reaches a target.

    The scatter is the target or slightly above with ``is_at_least``, else the target or slightly below. The
    ``groups`` are as `_groups_around_mean` returns them. Each group in turn is moved by as much as is still
    missing, or as there is room for between 0 and 1. Returns None if there is no room to spare for the last
    group.
    """
    m = sum(map(len, groups))
    moves: list[int] = []
    missing_scatter = target
    for group in groups:
        scatter_of_unit = m * sum(step**2 for step in group)  # of a move by 1; it grows with the square
        largest_move_to_target = isqrt(missing_scatter // scatter_of_unit)
        move = min(largest_move_to_target, _largest_move_in_range(mean, group))
        missing_scatter -= scatter_of_unit * move**2
        moves.append(move)
    last_group = groups[-1]
    if moves[-1] == _largest_move_in_range(mean, last_group):
        return None
    # The last move was limited by the target and not by its room. So one unit more leads beyond the target.
    if is_at_least and missing_scatter > 0:
        moves[-1] += 1
    x_hats: list[int] = []
    for group, move in zip(groups, moves, strict=True):
        x_hats += [mean + step * move for step in group]
    return x_hats


def _largest_move_in_range(mean: int, group: tuple[int, ...]) -> int:
    """Return the largest move of a group away from this mean for which all of its x_hat are in 0 .. 1.

    The group has the x_hat as multiples of the move, some above 0 and some below.
    """
    multiple_down, multiple_up = -min(group), max(group)
    return min(mean // multiple_down, (ONE - mean) // multiple_up)


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
    m = _ESTIMATES_OF_LARGE_ROUND
    counts_of_ones = range(1, m)
    best_count = max(counts_of_ones, key=partial(_margin_of_large_scatter, robot))
    x_hats = [ONE] * best_count + [0] * (m - best_count)
    return list(map(NeighbourEstimate, x_hats, draw_alphas_of_one_scale(rng, m)))


def _margin_of_large_scatter(robot: RobotState, count_of_ones: int) -> float:
    """Return how clearly a round shows that a controller leaves out the bits of a scatter from 2**56 on.

    The round has ``count_of_ones`` x_hat of 1, and all others are 0. The robot's test must pass by the right
    scatter, and reject by the wrong one. Each time one side of the test's inequality exceeds the other by a
    factor, and the smaller of both factors is returned. It is below 1 if the round does not show the mistake.
    """
    assert robot.table is not None
    m = _ESTIMATES_OF_LARGE_ROUND
    threshold: float = robot.table.entry(m) / 2**FRACTION_BITS
    # m Sum x**2 - (Sum x)**2, where each x is 0 or 1. Its unit is ONE**2, that is 2**46, so that its bits
    # from 2**56 on are those from 2**10 on here.
    scatter = count_of_ones * (m - count_of_ones)
    # At least 1, as the margins are divided by these two.
    scatter_without_bits = max(scatter % (1 << 10), 1)
    difference_squared = max((count_of_ones - m * robot.x_hat / ONE) ** 2, 1)
    # The test rejects if the squared difference is above threshold * scatter.
    margin_of_passing = threshold * scatter / difference_squared
    margin_of_rejecting = difference_squared / (threshold * scatter_without_bits)
    return min(margin_of_passing, margin_of_rejecting)


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
