"""Rounds of messages made for a purpose: close to a threshold of the test, or for a certain re-estimate."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import isqrt

from mcp_asdf.fixed_point import ALPHA_MAX, B_HAT_MAX, B_HAT_MIN, HALF, ONE, add_estimate
from mcp_asdf.mirror import Closed, asdf_test_rejects, reestimate, round_mean
from mcp_asdf.robot import Sums
from mcp_asdf.table import FRACTION_BITS, Table

Content = tuple[int, int]
"""x_hat in units of 2**-23 and alpha as the firmware's word."""

CRAFTED_SIZES = (2, 3, 5, 10, 30, 126)
"""Messages of the rounds that lie just inside and just outside their threshold."""


class Update(Enum):
    """Effect on b_hat of a test that rejects; the value describes it."""

    ABOVE = "b_hat above 1/2, off the limit"
    BELOW = "b_hat below 1/2, off the limit"
    MAXIMUM = "b_hat at its upper limit"
    MINIMUM = "b_hat at its lower limit"
    HALF = "b_hat at 1/2, where the robot knows nothing"
    FAINT = "b_hat just off 1/2"
    KEPT = "b_hat kept, as x_bar is 1/2"


_NO_INFORMATION, _FAINT = 1 << 20, 1 << 28
"""|2 b_hat - 1| below which a robot knows nothing, or hardly anything, in units of 2**-32."""
_TRIES = 300
_LEAST_DISTANCE = 1 << 15
"""Between own estimate and mean at a threshold, so that one unit is at most a ten-thousandth of k_m."""
_LEAST_SPREAD, _MOST_SKEW = 0.05, 6
"""Estimates at a threshold are spread over this share of the room and more, most of them near its beginning:
around their mean they would not fit where the own estimate is 0 or 1."""
_TARGETS = {
    Update.ABOVE: (0.65, 0.98),
    Update.BELOW: (0.02, 0.35),
    Update.MAXIMUM: (0.51, 0.58),
    Update.MINIMUM: (0.42, 0.49),
    Update.HALF: (0.7, 0.95),
    Update.KEPT: (0.5, 0.5),
    Update.FAINT: (0.7, 0.95),
}
"""x_bar for each update where a bit more than half of the observations are black; exactly half for HALF, and
nearly half for FAINT."""
_SCALES = ((0, 4), (1, 17), (24, 31))
"""Shifts of the confidences of a round: with sums below 2**32 units, those of robots, and above 2**45."""


@dataclass(frozen=True)
class Situation:
    """State of a robot for which a round is crafted.

    Attributes:
        t: Observations.
        n: Black ones among them.
        x_hat: Own estimate in units of 2**-23.
        table: Its thresholds; None if it re-estimates without a test.
    """

    t: int
    n: int
    x_hat: int
    table: Table | None

    def update(self, contents: Sequence[Content]) -> Update | None:
        """The update that a test of these messages makes; None if it does not reject."""
        sums = Sums()
        for x_hat, alpha in contents:
            add_estimate(sums, x_hat, alpha)
        if self.table is not None and (sums.count < 2 or not asdf_test_rejects(self.table, sums, self.x_hat)):
            return None
        closed = Closed(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
        return update_of(reestimate(self.t, self.n, round_mean(closed)))


def update_of(b_hat: int | None) -> Update:
    """The kind of update to ``b_hat``, in units of 2**-32; None is no update."""
    if b_hat is None:
        return Update.KEPT
    if b_hat in (B_HAT_MIN, B_HAT_MAX):
        return Update.MINIMUM if b_hat == B_HAT_MIN else Update.MAXIMUM
    if abs(2 * b_hat - (1 << 32)) < _FAINT:
        return Update.HALF if abs(2 * b_hat - (1 << 32)) < _NO_INFORMATION else Update.FAINT
    return Update.ABOVE if 2 * b_hat > 1 << 32 else Update.BELOW


def ordinary_alpha(draw: random.Random, most: int = 17) -> int:
    """A confidence as robots have it: 1 to 2**(most - 1)."""
    return (1 << 23 | draw.getrandbits(23)) << 8 | draw.randint(1, most)


def scaled_alphas(draw: random.Random, m: int) -> list[int]:
    """Confidences of a round, all of one scale: small, as robots have them, or large."""
    least, most = draw.choice(_SCALES)
    return [(1 << 23 | draw.getrandbits(23)) << 8 | draw.randint(least, most) for _ in range(m)]


def any_content(draw: random.Random, most: int = 17) -> Content:
    """A message of any estimate, with an ordinary confidence."""
    return draw.randint(0, ONE), ordinary_alpha(draw, most)


def at_threshold(
    situation: Situation, m: int, wanted: Update, draw: random.Random
) -> tuple[list[Content], list[Content]]:
    """Two rounds of ``m`` messages, of which the test passes one and rejects the other.

    They differ in one unit of 2**-23 of every estimate. The update of the second is the ``wanted`` one if
    confidences can be found for it.
    """
    found: tuple[list[Content], list[Content]] | None = None
    for _ in range(_TRIES):
        values = _values_at_threshold(situation, m, draw)
        if values is None:
            continue
        alphas = scaled_alphas(draw, m)
        inside, outside = (list(zip(each, alphas, strict=True)) for each in values)
        update = situation.update(outside)
        if update is wanted or (found is None and update is not Update.KEPT):
            found = inside, outside
        if update is wanted:
            break
    assert found is not None, f"no round of {m} messages lies at the threshold of {situation}"
    return found


def _values_at_threshold(
    situation: Situation, m: int, draw: random.Random
) -> tuple[list[int], list[int]] | None:
    """Estimates just inside and just outside the threshold; None if those drawn do not fit into [0, 1]."""
    assert situation.table is not None
    own = situation.x_hat
    is_above = own < HALF or (own == HALF and draw.random() < 0.5)
    step = 1 if is_above else -1
    width, power = max(own, ONE - own) * draw.uniform(_LEAST_SPREAD, 1), draw.uniform(1, _MOST_SKEW)
    spread = [step * round(width * draw.random() ** power) for _ in range(m)]
    total = sum(spread)
    square = m * sum(each * each for each in spread) - total * total
    least = isqrt(situation.table.entry(m) * square >> FRACTION_BITS) + 1  # of |Sum x - m x_hat| that rejects
    if least < m * _LEAST_DISTANCE:
        return None
    # The smallest shift whose sum is far enough from the own estimate, upwards or downwards.
    shift = -((total - least) // m) if is_above else (-least - total) // m
    outside = [own + each + shift for each in spread]
    inside = [each - step for each in outside]
    return (inside, outside) if all(0 <= each <= ONE for each in (*inside, *outside)) else None


def for_update(situation: Situation, wanted: Update, draw: random.Random, m: int = 5) -> list[Content] | None:
    """A round of ``m`` messages for which the test makes the ``wanted`` update; None if none is found."""
    for _ in range(_TRIES):
        target = round(draw.uniform(*_TARGETS[wanted]) * ONE)
        if wanted is Update.KEPT:
            contents = _balanced(draw)
        else:
            spread = draw.randint(1, 1 << 16)
            values = [min(max(target + draw.randint(-spread, spread), 0), ONE) for _ in range(m)]
            contents = list(zip(values, scaled_alphas(draw, m), strict=True))
        if situation.update(contents) is wanted:
            return contents
    return None


def _balanced(draw: random.Random) -> list[Content]:
    """Two messages whose mean is 1/2."""
    away, alpha = draw.randint(1, 1 << 12), ordinary_alpha(draw)
    return [(HALF - away, alpha), (HALF + away, alpha)]


def far_away(situation: Situation, draw: random.Random, m: int = 4) -> list[Content]:
    """A round of ``m`` messages that a test rejects."""
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
"""Rounds of messages at the ends of the ranges."""

FOREIGN_ALPHAS = {
    "a confidence above the largest": 0x7F7F_FFFF,
    "a confidence between two multiples of 2^-24": 0x3300_0001 + (1 << 23),
    "a confidence nearer to the next multiple of 2^-24": 0x3400_0000 - (1 << 21),
    "a subnormal confidence": 0x0000_0001,
}
"""binary32 bits that the codec brings to the firmware's grid."""
