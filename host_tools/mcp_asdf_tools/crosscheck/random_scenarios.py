"""Random scenarios for the cross-check, drawn from pools that are heavy with edges.

A scenario is a function of a seed and a number, for the paper's filters or for the robust one. Uniform values
would hardly ever meet the cases that the firmware treats apart, so the pools mix them with both sides of each
edge; counts jump to those of years of observations; and some rounds are built so that the last bits of a
threshold decide the hypothesis test, or whether x_bar is informative.
"""

from __future__ import annotations

from dataclasses import astuple, replace
from fractions import Fraction
from math import ceil, isqrt, sqrt
from random import Random

from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    HALF,
    MANTISSA_MAX,
    ONE,
    SHIFT_MAX,
)
from mcp_asdf.mirror import IMAGE_WORDS, accuracy_of, estimate
from mcp_asdf.robot import DEFAULT_MEMORY, MAX_ID, Filter, Sums
from mcp_asdf.table import FRACTION_BITS, Table
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, Setup, TableChoice

TABLES = (("0.05", 30), ("0.05", 127), ("0.9", 2), ("0.25", 5))
"""Omega and q of the tables that scenarios use."""

_BITS_16, _BITS_32 = 0xFFFF, 0xFFFFFFFF
_B_HAT_HALF, _INFORMATIVE = 1 << 31, 1 << 19
"""b_hat = 1/2, and how far from it an observation is informative."""
_X_BAR_INFORMATIVE = 1 << 10
"""Distance from 1/2 at which x_bar is informative, in units of 2**-23."""

# Words of an image (``mcp_asdf_image.c``).
_B_HAT, _T, _N, _X_HAT, _ALPHA, _FILTER_LEFT, _CLOSED = 1, 2, 3, 4, 5, 6, 7
_OPEN, _HEARD, _COUNTERS, _LAST = 13, 23, 27, 29
_UPDATED = 1 << 16
"""In the last word: b_hat has changed, and x_hat and alpha need not be those of t, n and b_hat."""

_JUNK = 0xE0
"""Bits of an alpha word that are ignored."""
_ALPHA_ONE = 0x80000001
_ALPHAS = (
    *(0, 31, _JUNK, _JUNK | 31, 0x100, 0x1FF, 0x100 | 31, _ALPHA_ONE, _ALPHA_ONE | _JUNK, 0x00010010),
    *(0x7FFFFF00, 0x80000000, 0xFFFFFF00, 0x80000001, 0xFFFFFF07, 0xFFFFFF08, 0x80000009, 0x00000118),
    *(0x8000001F, ALPHA_MAX - 0x100, ALPHA_MAX - 1, ALPHA_MAX, ALPHA_MAX | _JUNK, ALPHA_MAX & ~0xFF),
)
"""Nothing, one unit, 1.0 and the largest, as different words; ends of the mantissa, and of 32-bit units."""

_VOTES = (0, 1, 2, *range(30, 33), *range(62, 65), 255, 256, *range(511, 514), 4095, *range(16382, 16385))
"""Messages of the robust filter's crowd, where its gain changes and where it no longer counts."""

_X_HATS = (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE, ONE + 1, _BITS_32)


def random_scenario(seed: int, number: int) -> Scenario:
    """Scenario ``number`` of those that ``seed`` gives, a robot with one of the paper's filters; up to a few
    hundred calls."""
    source = Random(f"{seed}/{number}")
    return _Author(source, _setup(source)).write()


def robust_scenario(seed: int, number: int) -> Scenario:
    """The same of a robot with the robust filter."""
    source = Random(f"{seed}/robust/{number}")
    return _RobustAuthor(source, replace(_setup(source), table=None, filter=int(Filter.ROBUST))).write()


class _Author:
    """Writes one scenario."""

    def __init__(self, source: Random, setup: Setup) -> None:
        self._source = source
        self._setup = setup
        self._b_hat = self._setup.b_hat
        self._centre = source.choice([source.randint(0, ONE), 0, HALF, ONE])
        self._calls: list[Call] = []

    def write(self) -> Scenario:
        """The scenario."""
        source = self._source
        actions = (self._tick, self._jump, self._image, self._forge, self._decide, self._hesitate)
        weights = source.choice(
            [(20, 4, 2, 2, 4, 2), (1, 0, 0, 0, 0, 0), (1, 1, 0, 0, 0, 0), (2, 2, 2, 3, 12, 2)]
        )
        for action in source.choices(actions, weights, k=source.choice([3, 10, 30])):
            action()
        return Scenario(self._setup, tuple(self._calls))

    def _call(self, name: str, *numbers: int) -> None:
        self._calls.append(Call(name, numbers))

    def _tick(self) -> None:
        """A few messages, and observations and the end of a round as a caller's timers may order them."""
        source = self._source
        for _ in range(source.choice([0, 0, 1, 2, 3, 10])):
            self._call("receive", self._sender(), self._x_hat(), _alpha(source))
        orders = (["step"], ["observe", "settle"], ["observe"], ["settle"], ["observe", "observe", "settle"])
        for name in source.choice(orders):
            self._call(name, *([] if name == "settle" else [self._observation()]))

    def _observation(self) -> int:
        source = self._source
        wrong = source.choice([2, 2, 3, 255, 256, 1 << 31, _BITS_32])
        return wrong if source.random() < 0.1 else source.randrange(2)

    def _sender(self) -> int:
        source, own = self._source, self._setup.robot_id
        return source.choice([source.randrange(10), source.randrange(128), own, 127, 128, 255])

    def _x_hat(self) -> int:
        """Often near the scenario's centre, so that tests find agreement and difference."""
        source = self._source
        near = self._centre + source.randint(-1, 1) * source.randrange(1 << source.randrange(1, 20))
        anywhere = source.choice([source.randint(0, ONE), source.choice(_X_HATS)])
        return source.choice([min(max(near, 0), ONE), anywhere])

    def _jump(self) -> None:
        """Observe at any time, with any b_hat, with a share of black where eq. 3 changes its case."""
        source, setup = self._source, self._setup
        if source.random() < 0.5:
            self._b_hat = _b_hat(source)
        t = _observations(source, setup.memory)
        n = _blacks(source, t, self._b_hat)
        x_hat, alpha = estimate(t, n, accuracy_of(self._b_hat)) if t else (HALF, 0)
        last = setup.robot_id << 24 | source.choice([0, 0, 1, _BITS_16])
        if source.random() < 0.3:
            x_hat, alpha, last = self._x_hat(), _alpha(source), last | _UPDATED
        self._call("restore", _B_HAT, self._b_hat, _T, t, _N, n, _X_HAT, x_hat, _ALPHA, alpha, _LAST, last)
        self._call(source.choice(["step", "observe"]), source.randrange(2))

    def _image(self) -> None:
        """Save and restore, with words of the image changed so that it should or should not be refused."""
        source, setup = self._source, self._setup
        own, edge = setup.robot_id, source.choice([0, _BITS_16 - 1, _BITS_16])
        alpha, period = source.choice(_ALPHAS), setup.filter_period
        beta = (MAX_ID * 0xFFFFFF << 31) + source.randint(-1, 1)
        low = source.choice([0, (1 << 30) - 1, 1 << 30, _BITS_32])
        changes = (
            (),
            (_FILTER_LEFT, source.choice([0, 1, 1, period, period + 1 & _BITS_32])),
            (_COUNTERS, edge << 16 | _BITS_16 - edge, _COUNTERS + 1, edge << 16, _LAST, own << 24 | edge),
            (_COUNTERS, _BITS_16 - edge << 16 | edge, _COUNTERS + 1, edge),
            (_ALPHA, alpha, _X_HAT, self._x_hat(), _LAST, own << 24 | source.choice([0, _UPDATED, _UPDATED])),
            (_CLOSED, beta & _BITS_32, _CLOSED + 1, beta >> 32, _CLOSED + 3, low),
            (_HEARD + (own >> 5), 1 << (own & 31)),
            (_LAST, own << 24 | source.choice([0, 1, 2, 3, 128, 255]) << 16),
            (_LAST, source.choice([own ^ 1, 127, 128, 255]) << 24),
            (_B_HAT, source.choice([0, B_HAT_MIN - 1, B_HAT_MAX + 1, _b_hat(source)])),
            (_T, setup.memory - source.randrange(2), _LAST, own << 24 | _UPDATED),
            (source.randint(_B_HAT, _LAST), source.choice([0, 1, 1 << source.randrange(32), _BITS_32])),
        )
        if source.random() < 0.1:
            self._call("damage", source.randrange(4 * IMAGE_WORDS), 1 << source.randrange(8))
        else:
            self._call("restore", *source.choice(changes))
        self._call("receive", self._sender(), self._x_hat(), source.choice([0, alpha]))

    def _forge(self) -> None:
        """Restore a round, open or closed, whose sums are at their limits, or beyond."""
        source = self._source
        numbers = list(astuple(_extreme_sums(source)))
        if source.random() < 0.7:
            member = source.randrange(len(numbers))
            numbers[member] = max(numbers[member] + source.choice([-1, 1, 1]), 0)
        self._call("settle")
        words = [word for number in numbers[:4] for word in (number & _BITS_32, number >> 32)]
        if source.random() < 0.3:
            self._restore(_CLOSED, words[:6])
        else:
            heard = (1 << MAX_ID + 1) - 1 ^ 1 << self._setup.robot_id
            senders = [heard >> 32 * place & _BITS_32 for place in range(4)]
            self._restore(_OPEN, [*words, *numbers[4:], *senders])

    def _restore(self, start: int, words: list[int]) -> None:
        """Replace words of the image that follow each other."""
        self._call("restore", *(number for pair in enumerate(words, start) for number in pair))

    def _decide(self) -> None:
        """Run the hypothesis test on a round at its threshold, where there is one."""
        source, choice = self._source, self._setup.table
        if choice is None or self._setup.filter != Filter.ADAPTIVE:
            self._tick()
            return
        edge = source.choice([2, 3, choice.q, choice.q + 1, MAX_ID])
        m = min(source.choice([edge, edge, source.randint(2, MAX_ID)]), MAX_ID)
        x_hats, own = round_at_threshold(source, choice.build(), m)
        self._filter_at(own, [(x_hat, _positive_alpha(source)) for x_hat in x_hats])

    def _hesitate(self) -> None:
        """Run the filter on a mean that is as far from 1/2 as an informative one, or hardly at all: by a few
        units of 2^-32, which rounding makes 1/2 to the bit."""
        source = self._source
        if source.random() < 0.3:
            light = HALF + source.choice([-1, 1]), source.randint(0, 4) << 8
            heard = [(HALF, 0xFF << 8), light]
        else:
            distance = _X_BAR_INFORMATIVE + source.randint(-1, 1)
            x_hat = HALF + source.choice([-distance, distance])
            m = source.choice([1, 2, 2, 10])
            heard = [(x_hat + source.randrange(2), _positive_alpha(source)) for _ in range(m)]
        self._filter_at(source.choice([0, ONE]), heard)

    def _filter_at(self, own: int, heard: list[tuple[int, int]]) -> None:
        """Run the filter on a round of these messages, x_hat and alpha, and the own x_hat."""
        source, setup = self._source, self._setup
        t = max(_observations(source, setup.memory), 1)
        words = [_T, t, _N, _blacks(source, t, self._b_hat), _X_HAT, own, _ALPHA, _ALPHA_ONE]
        words += source.choice([[], [], [_COUNTERS + 1, _BITS_16 << 16]])  # the next test wraps its counter
        self._call("settle")
        self._call("restore", *words, _LAST, setup.robot_id << 24 | _UPDATED, _FILTER_LEFT, 1)
        senders = [sender for sender in range(MAX_ID + 1) if sender != setup.robot_id]
        for sender, message in zip(source.sample(senders, len(heard)), heard, strict=True):
            self._call("receive", sender, *message)
        self._call("settle")


class _RobustAuthor(_Author):
    """Writes one scenario of a robot with the robust filter, which has a crowd in place of rounds."""

    _last = 1 << 29, 1 << 28
    """Centre and spread of the last crowd."""

    def _forge(self) -> None:
        """Restore a crowd with a member at its limits or beyond, or with something behind it."""
        source = self._source
        member = source.randrange(5)
        ends = ((0, 1 << 30), (1 << 18, 1 << 28), (1, 1), (B_HAT_MIN, B_HAT_MAX), (1 << 31 | 1, 1 << 14))
        words = self._crowd(source.choice(_VOTES))
        words[member] = max(ends[member][source.randrange(2)] + source.choice([-1, 0, 0, 1]), 0)
        self._restore(_CLOSED, [*words, *source.choice([[], [], [1]])])

    def _crowd(self, votes: int) -> list[int]:
        """Words of a crowd: now and then one that goes one way, nearly so, or has too few voices."""
        source = self._source
        trend = source.choice([1 << 15, 1 << 13, 7 << 13, source.randrange(1 << 16)]) + source.randint(-2, 1)
        voices = source.choice([7, 7 << 29, _BITS_32, 1 << source.randrange(32) | 1])
        power = 1 << source.randrange(18, 29)
        spread = min(max(power + source.choice([-1, 0, 1, source.randrange(power)]), 1 << 18), 1 << 28)
        self._last = self._middle(), spread
        return [*self._last, voices, _b_hat(source), votes | min(max(trend, 0), _BITS_16) << 16]

    def _x_hat(self) -> int:
        """Now and then at the last crowd's centre, or one spread from it."""
        place = self._last[0] + self._source.choice([-1, 0, 1]) * self._last[1] >> 7
        return min(max(place, 0), ONE) if self._source.random() < 0.2 else super()._x_hat()

    def _middle(self) -> int:
        """A centre: anywhere, at its ends, or near where messages are; half of them such as can be said."""
        near = (self._centre << 7) + self._source.randint(-1 << 20, 1 << 20)
        place = self._source.choice([near, self._source.randint(0, 1 << 30), 0, 1 << 30])
        return min(max(place, 0), 1 << 30) & self._source.choice([-1, -128])

    def _decide(self) -> None:
        """Run the test on a count at its threshold, on either side."""
        source, crowd = self._source, self._crowd(1 << 14)
        t = max(_observations(source, self._setup.memory), 1)
        r, s, b = (Fraction(crowd[0], 1 << 30), Fraction(crowd[1], 1 << 30), Fraction(crowd[3], 1 << 32))
        p = b * r + (1 - b) * (1 - r)
        seen, side = p, source.choice([-1, 1])
        for _ in range(8):  # the variance is of the larger of both
            variance = max(p * (1 - p), seen * (1 - seen)) / t + (2 * b - 1) ** 2 * s**2
            seen = min(max(p + side * Fraction(sqrt(12 * variance)), Fraction(0)), Fraction(1))
        scale = source.choice([Fraction(0), Fraction(1), 1 + Fraction(source.randint(-9, 9), 1 << 13)])
        n = round(t * (p + (seen - p) * scale)) + source.choice([-1, 0, 1])
        self._filter_with(crowd, t, min(max(n, 0), t), source.choice([crowd[3], _b_hat(source)]))

    def _hesitate(self) -> None:
        """Run the filter where the centre is as far from 1/2 as an informative one, or 1/2."""
        source, crowd = self._source, self._crowd(self._source.choice(_VOTES))
        crowd[0] = (1 << 29) + source.choice([-1, 1]) * (source.choice([0, 1 << 17]) + source.randint(-1, 1))
        t = max(_observations(source, self._setup.memory), 1)
        self._filter_with(crowd, t, source.choice([0, t, t // 2]), _b_hat(source))

    def _filter_with(self, crowd: list[int], t: int, n: int, b_hat: int) -> None:
        """Run the filter on this crowd and these counts, after a message now and then."""
        source, setup = self._source, self._setup
        last = setup.robot_id << 24 | _UPDATED
        words = [_B_HAT, b_hat, _T, t, _N, n, _FILTER_LEFT, 1, _LAST, last]
        words += source.choice([[], [], [_COUNTERS + 1, _BITS_16 << 16]])
        self._call("restore", *words, *(number for pair in enumerate(crowd, _CLOSED) for number in pair))
        if source.random() < 0.3:
            self._call("receive", self._sender(), self._x_hat(), _alpha(source))
        self._call("settle")


def _extreme_sums(source: Random) -> Sums:
    """Sums that messages might have, each as large or as small as the others before it allow."""
    m = source.choice([1, 2, 3, MAX_ID, source.randint(1, MAX_ID)])
    x = source.choice([0, 1, source.randint(0, m * ONE), m * ONE - 1, m * ONE])
    largest = m * MANTISSA_MAX << SHIFT_MAX
    alpha = source.choice([m, source.randint(m, largest), largest, largest])
    total = source.choice([0, source.randint(0, alpha * ONE), alpha * ONE, alpha * ONE])
    high = min(x * (MANTISSA_MAX >> 1), total >> 32)
    return Sums(
        alpha=alpha,
        alpha_x_low=min(x * _BITS_32, total - (high << 32), (1 << 62) - 1),
        alpha_x_high=high,
        x_squared=source.choice([-(-x * x // m), x * ONE]),
        x=x,
        count=m,
    )


def round_at_threshold(source: Random, table: Table, m: int) -> tuple[list[int], int]:
    """x_hat of ``m`` messages and the robot's own, close to where eq. 12 turns, on either side.

    With p messages at a and m - p at a + m d, and the own x_hat at distance e from their mean, eq. 12 is
    e/d > sqrt(k p (m - p)): the best rational approximations of that root come close, some within the
    rounding of the table's entry.
    """
    p = source.randrange(1, m)
    scale = 60
    root = isqrt((table.entry(m) * p * (m - p)) << (2 * scale - FRACTION_BITS))
    ratio = Fraction(root, 1 << scale)
    most = ONE // (m + ceil(ratio))
    near = ratio.limit_denominator(source.randint(1, max(most >> source.randrange(6), 1)))
    factor = source.choice([0, 1, 1, 1, source.randint(1, max(most // near.denominator, 1))])
    d, e = factor * near.denominator, factor * near.numerator
    own = d * (m - p) + source.choice([-e, e])
    low, high = min(0, own), max(m * d, own)
    start = source.randint(-low, max(ONE - high, -low))
    x_hats = [min(start + m * d * (i >= p), ONE) for i in range(m)]
    return x_hats, min(start + own, ONE)


def _setup(source: Random) -> Setup:
    mode = source.choice([Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF])
    return Setup(
        table=TableChoice(*source.choice(TABLES)) if mode == Filter.ADAPTIVE else None,
        filter=int(mode),
        filter_period=source.choice([1, 1, 1, 2, 3, 20, _BITS_32]),
        memory=source.choice([DEFAULT_MEMORY] * 3 + [64, 68, 1000, 1 << 16, DEFAULT_MEMORY - 4]),
        robot_id=source.choice([0, 5, 31, 32, 127]),
        b_hat=_b_hat(source),
    )


def _alpha(source: Random) -> int:
    """A confidence: often a canonical word of any size, also other words of all kinds."""
    usual = _positive_alpha(source)
    others = (
        source.choice(_ALPHAS),
        source.randint(0, _BITS_32),
        usual | _JUNK & source.randint(0, _BITS_32),
        source.randrange(1 << source.randrange(1, 25)) << 8 | source.randrange(32),
        source.randrange(256),
    )
    return source.choice([usual, usual, usual, source.choice(others)])


def _positive_alpha(source: Random) -> int:
    """The word of a confidence as robots send it, of any size from 2**-24 to 2**31."""
    if source.random() < 0.2:
        return source.randrange(1, 1 << source.randrange(1, 24)) << 8
    return source.randrange(1 << 23, 1 << 24) << 8 | source.randrange(32)


def _b_hat(source: Random) -> int:
    """Anywhere, at the ends, around 1/2 at every distance, and at the edge of saying nothing."""
    away = source.choice([0, source.randrange(1 << source.randrange(1, 32)), _INFORMATIVE])
    nearby = source.choice([-1, 1]) * (away + source.randint(-1, 1))
    end = source.choice([B_HAT_MIN + source.randrange(1 << source.randrange(31)), B_HAT_MIN])
    b_hat = source.choice(
        [source.randint(B_HAT_MIN, B_HAT_MAX), _B_HAT_HALF + nearby, source.choice([end, (1 << 32) - end])]
    )
    return min(max(b_hat, B_HAT_MIN), B_HAT_MAX)


def _observations(source: Random, memory: int) -> int:
    """t before the next observation, of any size: around powers of two, and where the memory halves it."""
    power = 1 << source.randrange(32)
    t = source.choice(
        [source.randrange(2 * power), power + source.randint(-2, 1), memory - source.randint(1, 3)]
    )
    return min(max(t, 0), memory - 1)


def _blacks(source: Random, t: int, b_hat: int) -> int:
    """n of t: anywhere, at the ends, at one half, and around t b_hat and t (1 - b_hat)."""
    corner = t * source.choice([b_hat, (1 << 32) - b_hat]) >> 32
    n = source.choice([source.randint(0, t), source.choice([0, t]), t // 2, corner, corner])
    return min(max(n + source.randint(-1, 1), 0), t)
