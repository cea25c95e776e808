"""Estimates for rounds with a purpose: just inside or outside the test's threshold, or for some b_hat."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import isqrt

from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    ONE,
    add_estimate,
    alpha_word_from_units,
)
from mcp_asdf.mirror import Closed, asdf_test_rejects, reestimate, round_mean
from mcp_asdf.robot import Sums
from mcp_asdf.table import FRACTION_BITS, Table

Content = tuple[int, int]
"""A neighbour's estimate: x_hat in units of 2**-23, and alpha as the firmware's word (mantissa and shift)."""

CRAFTED_SIZES = (2, 3, 5, 10, 30, 126)
"""Numbers of estimates in the rounds that lie just inside and just outside the threshold."""


class Update(Enum):
    """What becomes of b_hat after a test that rejects. The value describes it in a verdict."""

    ABOVE = "b_hat above 1/2, off the limit"
    BELOW = "b_hat below 1/2, off the limit"
    MAXIMUM = "b_hat at its upper limit"
    MINIMUM = "b_hat at its lower limit"
    HALF = "b_hat at 1/2, where the robot knows nothing"
    FAINT = "b_hat just off 1/2"
    KEPT = "b_hat kept, as x_bar is 1/2"


_NO_INFORMATION, _FAINT = 1 << 20, 1 << 28
"""|2 b_hat - 1| below which a robot knows nothing, or hardly anything, in units of 2**-32."""
_MAX_TRIES = 300
"""Rounds that are drawn to find one that serves."""
_MIN_DISTANCE = 1 << 15
"""Smallest distance between the robot's x_hat and the mean at a threshold, in units of 2**-23.

One unit then moves a round by at most a ten-thousandth of k_m, the threshold for m estimates."""
_MIN_SPREAD, _MAX_SKEW = 0.05, 6
"""Estimates at a threshold are spread over this share of the room and more, most of them near its beginning:
around their mean they would not fit where the own estimate is 0 or 1."""
_X_BAR_RANGES = {
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
SCALES = ((1, 4), (10, 20), (24, 28), (25, 41), (48, 55))
"""Bits of the confidences of a round, in units of 2**-24.

Five of them have sums below 2**9 units, where eq. 8 shifts up instead of down, below 2**24 (alpha = 1), below
2**32, sums as robots have them, and above 2**45.
"""
_MIN_ESTIMATES_FOR_PAIRS = 4
"""Smallest round at a threshold that has pairs of nearly equal estimates."""
_TRIES_FOR_FLOATS, _LARGE_ROUND = 60, 100
"""Rounds that are drawn to find one about which a test in float64 errs, below so many messages."""
_LARGE_TRIES = 1500
"""The same from there on, where sums have more bits than a float64: of a hundred draws one or two serve."""


@dataclass(frozen=True)
class Situation:
    """State of a robot for which the estimates of a round are chosen.

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

    def update(self, estimates: Sequence[Content]) -> Update | None:
        """Return what becomes of b_hat at the end of a round of these estimates; None if the test passes."""
        sums = Sums()
        for x_hat, alpha in estimates:
            add_estimate(sums, x_hat, alpha)
        if self.table is not None:
            # The variance of a single estimate is not defined, so that the test needs two.
            is_rejected = sums.count >= 2 and asdf_test_rejects(self.table, sums, self.x_hat)
            if not is_rejected:
                return None
        x_bar = round_mean(Closed(sums.alpha, sums.alpha_x_low, sums.alpha_x_high))
        return update_of(reestimate(self.t, self.n, x_bar))


def update_of(b_hat: int | None) -> Update:
    """Return the kind of update that sets b_hat, the accuracy that the robot assumes, to this value.

    ``b_hat`` is in units of 2**-32; None means that the re-estimate has kept the old value.
    """
    if b_hat is None:
        return Update.KEPT
    if b_hat == B_HAT_MIN:
        return Update.MINIMUM
    if b_hat == B_HAT_MAX:
        return Update.MAXIMUM
    information = 2 * b_hat - (1 << 32)  # 2 b_hat - 1
    if abs(information) < _NO_INFORMATION:
        return Update.HALF
    if abs(information) < _FAINT:
        return Update.FAINT
    return Update.ABOVE if information > 0 else Update.BELOW


def ordinary_alpha(draw: random.Random, max_shift: int = 17) -> int:
    """Draw a confidence as robots have it, from 1 to 2**max_shift, and return it as the firmware's word."""
    mantissa = (1 << 23) | draw.getrandbits(23)
    shift = draw.randint(1, max_shift)
    return (mantissa << 8) | shift


def scaled_alphas(draw: random.Random, m: int, scale: tuple[int, int] | None = None) -> list[int]:
    """Draw the confidences of ``m`` estimates, and return them as the firmware's words.

    All are of one scale, the least and the largest number of bits in units of 2**-24; by default it is one of
    ``SCALES``.
    """
    min_bits, max_bits = draw.choice(SCALES) if scale is None else scale
    bit_counts = [draw.randint(min_bits, max_bits) for _ in range(m)]
    alphas = []
    for bit_count in bit_counts:
        lower_bits = draw.getrandbits(bit_count - 1)
        alphas.append(alpha_word_from_units((1 << (bit_count - 1)) | lower_bits))
    return alphas


def any_content(draw: random.Random, max_shift: int = 17) -> Content:
    """Draw an estimate: any x_hat from 0 to 1, with a confidence as ``ordinary_alpha`` draws it."""
    return draw.randint(0, ONE), ordinary_alpha(draw, max_shift)


def at_threshold(
    situation: Situation, m: int, wanted_update: Update, draw: random.Random
) -> tuple[list[Content], list[Content]]:
    """Return two rounds of ``m`` messages as close to the threshold as estimates of 2**-23 can be.

    The test passes the first one and rejects the second. Rounds about which a test in floating point errs are
    preferred, and among them those whose re-estimate is ``wanted_update``.
    """
    best: tuple[list[Content], list[Content]] | None = None
    best_rank = (-1, False)
    most_tries, tries_for_floats = _MAX_TRIES, _TRIES_FOR_FLOATS
    if m >= _LARGE_ROUND:
        most_tries = tries_for_floats = _LARGE_TRIES
    for tries in range(most_tries):
        values = _values_at_threshold(situation, m, draw)
        if values is None:
            continue
        alphas = scaled_alphas(draw, m)
        inside, outside = (list(zip(estimates, alphas, strict=True)) for estimates in values)
        update = situation.update(outside)
        if update is Update.KEPT:
            continue  # would not show that the test has rejected
        rank = (_misled_float_tests(situation, values), update is wanted_update)
        if rank > best_rank:
            best, best_rank = (inside, outside), rank
        if best_rank == (2, True) or (best_rank[1] and tries >= tries_for_floats):
            break
    assert best is not None, f"no round of {m} messages lies at the threshold of {situation}"
    return best


def _values_at_threshold(
    situation: Situation, m: int, draw: random.Random
) -> tuple[list[int], list[int]] | None:
    """Return estimates just inside and just outside the threshold; None if those drawn leave [0, 1]."""
    assert situation.table is not None
    own = situation.x_hat
    entry = situation.table.entry(m)
    is_above = own < HALF or (own == HALF and draw.random() < 0.5)
    step = 1 if is_above else -1
    # Rounds with the largest sums are those of which floats lose bits.
    least_spread = 0.8 if m >= _LARGE_ROUND else _MIN_SPREAD
    width, power = max(own, ONE - own) * draw.uniform(least_spread, 1), draw.uniform(1, _MAX_SKEW)
    # Of many estimates most are equal in pairs: moving such a pair apart changes the scatter in fine steps.
    distinct = m if m < _MIN_ESTIMATES_FOR_PAIRS else (m + 1) // 2
    distances = [step * round(width * draw.random() ** power) for _ in range(distinct)]
    spread = sorted(distances + distances[: m - distinct])
    least = isqrt(entry * _scatter(spread) >> FRACTION_BITS) + 1  # of |Sum x - m x_hat| that rejects
    if least < m * _MIN_DISTANCE:
        return None
    # The smallest shift whose sum is far enough from the own estimate, upwards or downwards.
    total = sum(spread)
    shift = -((total - least) // m) if is_above else (-least - total) // m
    values = [own + distance + shift for distance in spread]
    difference = sum(values) - m * own
    # Eq. 12 rejects while entry * scatter < difference**2 * 2**FRACTION_BITS.
    largest_rejected = ((difference * difference << FRACTION_BITS) - 1) // entry
    missing = largest_rejected - _scatter(values)
    if missing < 0:
        return None
    outside = _with_scatter(values, largest_rejected, False)
    inside = _with_scatter(values, largest_rejected + 1, True)
    if not all(0 <= x <= ONE for x in (*inside, *outside)):
        return None
    return inside, outside


def _scatter(values: Sequence[int]) -> int:
    """Return m Sum x^2 - (Sum x)^2, which is m (m - 1) times the variance of ``values``."""
    total = sum(values)
    return len(values) * sum(x * x for x in values) - total * total


def _with_scatter(values: Sequence[int], target_scatter: int, is_at_least: bool) -> list[int]:
    """Move estimates apart in pairs, so that their sum stays, until their scatter just reaches a target.

    The scatter ends at ``target_scatter`` or slightly above with ``is_at_least``, else there or slightly
    below. It must not be above before. Each pair takes nearly all of what the pairs before it have left.
    """
    m = len(values)
    changed, missing = list(values), target_scatter - _scatter(values)
    last_pair = (m // 2 - 1) * 2
    for low in range(0, last_pair + 1, 2):
        # Moving two estimates apart by ``move`` each adds 2 m move (gap + move) to the scatter.
        gap = changed[low + 1] - changed[low]
        move = (isqrt(gap * gap + 2 * missing // m) - gap) // 2
        if is_at_least and low == last_pair:
            while 2 * m * move * (gap + move) < missing:
                move += 1
        changed[low] -= move
        changed[low + 1] += move
        missing -= 2 * m * move * (gap + move)
    return changed


def _misled_float_tests(situation: Situation, rounds: Sequence[Sequence[int]]) -> int:
    """Return how many of two tests in float64 do not tell a round inside the threshold from one outside.

    The first computes all of eq. 12 in float64, the second its right side alone.
    """
    assert situation.table is not None
    factor = situation.table.entry(len(rounds[0])) / 2**FRACTION_BITS
    first_test, second_test = [], []
    for values in rounds:
        difference = sum(values) - len(values) * situation.x_hat
        limit = factor * float(_scatter(values))
        first_test.append(float(difference) * float(difference) > limit)
        second_test.append(difference * difference > int(limit))
    return (first_test != [False, True]) + (second_test != [False, True])


def for_update(
    situation: Situation, wanted_update: Update, draw: random.Random, m: int = 5
) -> list[Content] | None:
    """Draw ``m`` estimates after which the test makes the wanted update; for KEPT two.

    Returns None if none of many draws has this effect.
    """
    for _ in range(_MAX_TRIES):
        target = round(draw.uniform(*_X_BAR_RANGES[wanted_update]) * ONE)
        if wanted_update is Update.KEPT:
            contents = _balanced(draw)
        else:
            spread = draw.randint(1, 1 << 16)
            values = [min(max(target + draw.randint(-spread, spread), 0), ONE) for _ in range(m)]
            contents = list(zip(values, scaled_alphas(draw, m), strict=True))
        if situation.update(contents) is wanted_update:
            return contents
    return None


def _balanced(draw: random.Random) -> list[Content]:
    """Draw two estimates of the same confidence whose mean is 1/2."""
    distance = draw.randint(1, 1 << 12)
    alpha = ordinary_alpha(draw)
    return [(HALF - distance, alpha), (HALF + distance, alpha)]


def far_away(situation: Situation, draw: random.Random, m: int = 4) -> list[Content]:
    """Draw ``m`` estimates that the test rejects: near 0 or 1, whichever is further from x_hat."""
    end = 0 if situation.x_hat > HALF else ONE
    values = [abs(end - draw.randint(0, 1 << 12)) for _ in range(m)]
    return [(value, ordinary_alpha(draw)) for value in values]


def with_large_sums(situation: Situation, draw: random.Random) -> dict[str, list[Content]]:
    """Rounds of most messages, by what would decide otherwise about them: their spread without bits from
    2**56 up, which is small then, and the square of their sum's distance without bits from 2**54 up, 0 then.
    """
    m, own = 126, situation.x_hat
    fits = [n for n in (34, 92) if m // 16 * ONE < abs(n * ONE - m * own) < m * 7 // 16 * ONE]
    ones = fits[0] if fits else m // 2  # whose spread is 1/4 smaller, but fits where the others do not
    step = 1 << 27
    end = ONE if own < HALF else 0
    distance = abs(m * end - m * own) // step * step  # of the sum, at least 7 steps
    mean, rest = divmod(m * own + (distance if end else -distance), m)
    values = [mean + (place < rest) for place in range(m)]
    values[0], values[1] = values[0] - 8, values[1] + 8
    wide = [ONE] * ones + [0] * (m - ones)
    return {
        name: list(zip(each, scaled_alphas(draw, m), strict=True))
        for name, each in (("a spread of 2^57", wide), ("a distance of the sum above 2^27", values))
    }


EXTREMES: dict[str, list[Content]] = {
    "confidences of 0": [(ONE, 0), (0, 0)],
    "one confidence of 0 among others": [(ONE, 0), (HALF, 0x8000_0001), (0, 0x8000_0001)],
    "the least confidence": [(ONE, 0x0000_0100)],
    "the largest confidence": [(0, ALPHA_MAX), (ONE, 0x8000_0001)],
    "confidences far apart": [(ONE, 0x0000_0100), (0, 0x8000_0010), (HALF + 1, 0x8000_0001)],
    "estimates of 0 and 1": [(0, 0x8000_0005), (ONE, 0x8000_0005), (1, 0x8000_0005), (ONE - 1, 0x8000_0005)],
    "126 messages of the largest confidence": [(ONE - 1, ALPHA_MAX)] * 126,
}
"""Estimates at the ends of their ranges, for one round each, by what they have in common."""

FOREIGN_ALPHAS = {
    "a confidence above the largest": 0x7F7F_FFFF,
    "a confidence between two multiples of 2^-24": 0x3300_0001 + (1 << 23),
    "a confidence nearer to the next multiple of 2^-24": 0x3400_0000 - (1 << 21),
    "a subnormal confidence": 0x0000_0001,
}
"""Confidences that the firmware's word cannot hold, as binary32 bits: a receiver must round or limit them."""
