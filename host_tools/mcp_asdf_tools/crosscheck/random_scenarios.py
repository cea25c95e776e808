"""Random scenarios for the cross-check, drawn from pools that are heavy with edges.

A scenario is a function of a seed and an index, for a robot with one of the paper's filters or with the
robust one. Uniform values would hardly ever meet the cases that the firmware treats apart, so the pools mix
them with both sides of each edge; counts jump to those of years of observations; and some rounds are built so
that the last bits of a threshold decide the hypothesis test, or whether x_bar, the neighbours' mean, is
informative.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from fractions import Fraction
from math import sqrt
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
from mcp_asdf_tools.crosscheck.crafted_rounds import (
    ALPHA_ONE,
    NeighbourEstimate,
    draw_normal_alpha,
    draw_x_hats_at_threshold,
)
from mcp_asdf_tools.crosscheck.scenario import Call, Scenario, Setup, TableChoice

TABLES = (TableChoice("0.05", 30), TableChoice("0.05", 127), TableChoice("0.9", 2), TableChoice("0.25", 5))
"""The tables that scenarios use."""

_MAX_16, _MAX_32 = 0xFFFF, 0xFFFFFFFF
"""Largest number of 16 and of 32 bits."""
_B_HAT_HALF = 1 << 31
_B_HAT_INFORMATIVE = 1 << 19
"""Distance of b_hat from 1/2 from which on an observation is informative, in units of 2**-32."""
_X_BAR_INFORMATIVE = 1 << 10
"""The same of x_bar, in units of 2**-23."""
_CENTRE_HALF, _CENTRE_ONE = 1 << 29, 1 << 30
_CENTRE_INFORMATIVE = 1 << 17
"""The same of the robust filter's centre, in units of 2**-30."""
_SPREAD_MIN, _SPREAD_MAX = 1 << 18, 1 << 28

# Indices of words in an image (``mcp_asdf_image.c``).
_B_HAT_WORD, _T_WORD, _N_WORD, _X_HAT_WORD, _ALPHA_WORD, _FILTER_LEFT_WORD = range(1, 7)
_CLOSED_WORD = 7
"""First word of the sums of the last closed round or, with the robust filter, of the crowd."""
_OPEN_WORD, _HEARD_WORD = 13, 23
_COUNTERS_WORD, _TESTS_WORD = 27, 28
_LAST_WORD = 29
_ID_SHIFT = 24
"""The last word has the robot's id above this shift."""
_UPDATED = 1 << 16
"""Flag in the last word: b_hat has changed, and x_hat and alpha need not be those of t, n and b_hat."""
_TESTS_AT_WRAP = _MAX_16 << 16
"""The counter of tests just before it wraps."""

_IGNORED_ALPHA_BITS = 0xE0
_SPECIAL_ALPHAS = (
    # No confidence, one unit, and 1.0, as different words
    *(0, 31, _IGNORED_ALPHA_BITS, _IGNORED_ALPHA_BITS | 31, 0x100, 0x1FF, 0x100 | 31),
    *(ALPHA_ONE, ALPHA_ONE | _IGNORED_ALPHA_BITS, 0x00010010),
    # The ends of the mantissa, and of 32-bit units
    *(0x7FFFFF00, 0x80000000, 0xFFFFFF00, 0x80000001, 0xFFFFFF07, 0xFFFFFF08, 0x80000009, 0x00000118),
    # The largest confidence, and those near it
    *(0x8000001F, ALPHA_MAX - 0x100, ALPHA_MAX - 1, ALPHA_MAX),
    *(ALPHA_MAX | _IGNORED_ALPHA_BITS, ALPHA_MAX & ~0xFF),
)

_CROWD_SIZES = (
    0,
    1,
    2,
    *range(30, 33),
    *range(62, 65),
    255,
    256,
    *range(511, 514),
    4095,
    *range(16382, 16385),
)
"""Votes of the robust filter's crowd, where its gain changes and where they no longer count."""

_SPECIAL_X_HATS = (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE, ONE + 1, _MAX_32)


def random_scenario(seed: int, index: int) -> Scenario:
    """Return a scenario of a robot with one of the paper's filters, of up to a few hundred calls.

    Each pair of ``seed`` and ``index`` gives another one, always the same.
    """
    rng = Random(f"{seed}/{index}")
    return _ScenarioWriter(rng, _draw_setup(rng)).write()


def robust_scenario(seed: int, index: int) -> Scenario:
    """Return a scenario of a robot with the robust filter, as ``random_scenario`` does for the paper's."""
    rng = Random(f"{seed}/robust/{index}")
    setup = replace(_draw_setup(rng), table=None, filter=int(Filter.ROBUST))
    return _RobustScenarioWriter(rng, setup).write()


class _ScenarioWriter:
    """Writes one scenario of a robot with one of the paper's filters.

    Its methods ``_add_...`` append calls to the scenario, ``_draw_...`` return values for them.
    """

    def __init__(self, rng: Random, setup: Setup) -> None:
        self._rng = rng
        self._setup = setup
        self._b_hat = setup.b_hat
        self._common_x_hat = rng.choice([rng.randint(0, ONE), 0, HALF, ONE])
        """An x_hat near which many neighbours are."""
        self._calls: list[Call] = []

    def write(self) -> Scenario:
        """Draw all calls, and return the scenario."""
        actions = (
            self._add_tick,
            self._add_observation_in_any_state,
            self._add_restore_of_changed_image,
            self._add_restore_at_limits,
            self._add_test_at_threshold,
            self._add_filter_near_one_half,
        )
        weights = self._rng.choice(
            [(20, 4, 2, 2, 4, 2), (1, 0, 0, 0, 0, 0), (1, 1, 0, 0, 0, 0), (2, 2, 2, 3, 12, 2)]
        )
        for add_calls in self._rng.choices(actions, weights, k=self._rng.choice([3, 10, 30])):
            add_calls()
        return Scenario(self._setup, tuple(self._calls))

    # --- Calls ---

    def _add_call(self, name: str, *numbers: int) -> None:
        """Append a call; ``numbers`` are those of ``Call``."""
        self._calls.append(Call(name, numbers))

    def _add_restore(self, words: dict[int, int]) -> None:
        """Save the robot, replace words of the image, given by index, and restore it."""
        self._add_call("restore", *(number for pair in words.items() for number in pair))

    def _add_tick(self) -> None:
        """Receive a few messages, observe and end the round in any order that a caller's timers may have."""
        rng = self._rng
        for _ in range(rng.choice([0, 0, 1, 2, 3, 10])):
            self._add_call("receive", self._draw_sender(), self._draw_x_hat(), _draw_alpha(rng))
        orders = (["step"], ["observe", "settle"], ["observe"], ["settle"], ["observe", "observe", "settle"])
        for name in rng.choice(orders):
            self._add_call(name, *([] if name == "settle" else [self._draw_observation()]))

    def _add_observation_in_any_state(self) -> None:
        """Observe with any t, n and b_hat, often with a share of black where eq. 3 changes its case."""
        rng, setup = self._rng, self._setup
        if rng.random() < 0.5:
            self._b_hat = _draw_b_hat(rng)
        t = _draw_t(rng, setup.memory)
        n = _draw_n(rng, t, self._b_hat)
        x_hat, alpha = estimate(t, n, accuracy_of(self._b_hat)) if t else (HALF, 0)
        updates = rng.choice([0, 0, 1, _MAX_16])
        last_word = self._last_word(updates)
        if rng.random() < 0.3:
            x_hat, alpha, last_word = self._draw_x_hat(), _draw_alpha(rng), last_word | _UPDATED
        self._add_restore(
            {
                _B_HAT_WORD: self._b_hat,
                _T_WORD: t,
                _N_WORD: n,
                _X_HAT_WORD: x_hat,
                _ALPHA_WORD: alpha,
                _LAST_WORD: last_word,
            }
        )
        self._add_call(rng.choice(["step", "observe"]), rng.randrange(2))

    def _add_restore_of_changed_image(self) -> None:
        """Restore the robot from an image with changes that make it just legal, or just not.

        A message follows, so that a wrong decision shows in the robot's state.
        """
        rng, setup = self._rng, self._setup
        own_id, counter = setup.robot_id, rng.choice([0, _MAX_16 - 1, _MAX_16])
        alpha, period = rng.choice(_SPECIAL_ALPHAS), setup.filter_period
        largest_beta = (MAX_ID * MANTISSA_MAX) << SHIFT_MAX
        beta = largest_beta + rng.randint(-1, 1)
        alpha_x_low = rng.choice([0, (1 << 30) - 1, 1 << 30, _MAX_32])
        changes: tuple[dict[int, int], ...] = (
            {},
            {_FILTER_LEFT_WORD: rng.choice([0, 1, 1, period, (period + 1) & _MAX_32])},
            {
                _COUNTERS_WORD: (counter << 16) | (_MAX_16 - counter),
                _TESTS_WORD: counter << 16,
                _LAST_WORD: self._last_word(counter),
            },
            {_COUNTERS_WORD: ((_MAX_16 - counter) << 16) | counter, _TESTS_WORD: counter},
            {
                _ALPHA_WORD: alpha,
                _X_HAT_WORD: self._draw_x_hat(),
                _LAST_WORD: self._last_word(rng.choice([0, _UPDATED, _UPDATED])),
            },
            {_CLOSED_WORD: beta & _MAX_32, _CLOSED_WORD + 1: beta >> 32, _CLOSED_WORD + 3: alpha_x_low},
            {_HEARD_WORD + (own_id >> 5): 1 << (own_id & 31)},
            {_LAST_WORD: self._last_word(rng.choice([0, 1, 2, 3, 128, 255]) << 16)},
            {_LAST_WORD: rng.choice([own_id ^ 1, 127, 128, 255]) << _ID_SHIFT},
            {_B_HAT_WORD: rng.choice([0, B_HAT_MIN - 1, B_HAT_MAX + 1, _draw_b_hat(rng)])},
            {_T_WORD: setup.memory - rng.randrange(2), _LAST_WORD: self._last_word(_UPDATED)},
            {rng.randint(_B_HAT_WORD, _LAST_WORD): rng.choice([0, 1, 1 << rng.randrange(32), _MAX_32])},
        )
        if rng.random() < 0.1:
            self._add_call("damage", rng.randrange(4 * IMAGE_WORDS), 1 << rng.randrange(8))
        else:
            self._add_restore(rng.choice(changes))
        self._add_call("receive", self._draw_sender(), self._draw_x_hat(), rng.choice([0, alpha]))

    def _add_restore_at_limits(self) -> None:
        """Restore a round, open or closed, whose sums are at their limits, or one of them beyond."""
        rng = self._rng
        sums = _draw_extreme_sums(rng)
        if rng.random() < 0.7:
            name = fields(Sums)[rng.randrange(len(fields(Sums)))].name
            setattr(sums, name, max(getattr(sums, name) + rng.choice([-1, 1, 1]), 0))
        self._add_call("settle")
        sums_of_64_bits = (sums.alpha, sums.alpha_x_low, sums.alpha_x_high, sums.x_squared)
        words = [word for number in sums_of_64_bits for word in (number & _MAX_32, number >> 32)]
        if rng.random() < 0.3:
            closed_words = words[:6]  # a closed round keeps no sum of squares
            self._add_restore(dict(enumerate(closed_words, _CLOSED_WORD)))
        else:
            others = ((1 << (MAX_ID + 1)) - 1) ^ (1 << self._setup.robot_id)
            heard_words = [(others >> (32 * index)) & _MAX_32 for index in range(4)]
            self._add_restore(dict(enumerate([*words, sums.x, sums.count, *heard_words], _OPEN_WORD)))

    def _add_test_at_threshold(self) -> None:
        """Run the hypothesis test on a round at its threshold; a tick if the robot has no test."""
        rng, table_choice = self._rng, self._setup.table
        if table_choice is None or self._setup.filter != Filter.ADAPTIVE:
            self._add_tick()
            return
        special_m = rng.choice([2, 3, table_choice.q, table_choice.q + 1, MAX_ID])
        m = min(rng.choice([special_m, special_m, rng.randint(2, MAX_ID)]), MAX_ID)
        table_entry = table_choice.build().entry(m)
        own_x_hat, rounds = 0, None
        while rounds is None:
            own_x_hat = rng.choice([0, HALF, ONE, rng.randint(0, ONE), rng.randint(0, ONE)])
            gap_share = rng.random() / (1 << rng.choice([0, 0, 0, rng.randrange(20)]))
            rounds = draw_x_hats_at_threshold(own_x_hat, table_entry, m, rng, gap_share)
        # The test must not reject at equality, either.
        x_hats = rng.choice([*rounds, *rounds, *rounds, [own_x_hat] * m])
        self._add_filter_run(
            own_x_hat, [NeighbourEstimate(x_hat, _draw_usual_alpha(rng)) for x_hat in x_hats]
        )

    def _add_filter_near_one_half(self) -> None:
        """Run the filter on an x_bar that is just informative, or just not, or almost 1/2.

        The last one is off by a few units of 2**-32, which rounding makes 1/2 to the bit.
        """
        rng = self._rng
        if rng.random() < 0.3:
            light_estimate = NeighbourEstimate(HALF + rng.choice([-1, 1]), rng.randint(0, 4) << 8)
            estimates = [NeighbourEstimate(HALF, 0xFF << 8), light_estimate]
        else:
            distance = _X_BAR_INFORMATIVE + rng.randint(-1, 1)
            x_hat = HALF + rng.choice([-distance, distance])
            m = rng.choice([1, 2, 2, 10])
            estimates = [
                NeighbourEstimate(x_hat + rng.randrange(2), _draw_usual_alpha(rng)) for _ in range(m)
            ]
        self._add_filter_run(rng.choice([0, ONE]), estimates)

    def _add_filter_run(self, own_x_hat: int, estimates: list[NeighbourEstimate]) -> None:
        """Restore a robot with this x_hat, and end a round of these estimates in which its filter runs."""
        rng, setup = self._rng, self._setup
        t = max(_draw_t(rng, setup.memory), 1)
        words = {
            _T_WORD: t,
            _N_WORD: _draw_n(rng, t, self._b_hat),
            _X_HAT_WORD: own_x_hat,
            _ALPHA_WORD: ALPHA_ONE,
        }
        words |= rng.choice([{}, {}, {_TESTS_WORD: _TESTS_AT_WRAP}])
        words |= {_LAST_WORD: self._last_word(_UPDATED), _FILTER_LEFT_WORD: 1}
        self._add_call("settle")
        self._add_restore(words)
        senders = [sender for sender in range(MAX_ID + 1) if sender != setup.robot_id]
        for sender, (x_hat, alpha) in zip(rng.sample(senders, len(estimates)), estimates, strict=True):
            self._add_call("receive", sender, x_hat, alpha)
        self._add_call("settle")

    # --- Values ---

    def _last_word(self, low_bits: int) -> int:
        """Return an image's last word with the robot's id and these other bits."""
        return (self._setup.robot_id << _ID_SHIFT) | low_bits

    def _draw_observation(self) -> int:
        """Draw white (0) or black (1), now and then a number that is neither."""
        rng = self._rng
        illegal = rng.choice([2, 2, 3, 255, 256, 1 << 31, _MAX_32])
        return illegal if rng.random() < 0.1 else rng.randrange(2)

    def _draw_sender(self) -> int:
        """Draw an id: a few come often, and some are illegal or the robot's own."""
        rng = self._rng
        return rng.choice([rng.randrange(10), rng.randrange(128), self._setup.robot_id, 127, 128, 255])

    def _draw_x_hat(self) -> int:
        """Draw an x_hat, often near that of the scenario, so that tests find agreement and difference."""
        rng = self._rng
        distance = rng.randint(-1, 1) * rng.randrange(1 << rng.randrange(1, 20))
        near = _clamp(self._common_x_hat + distance, 0, ONE)
        anywhere = rng.choice([rng.randint(0, ONE), rng.choice(_SPECIAL_X_HATS)])
        return rng.choice([near, anywhere])


@dataclass
class _CrowdWords:
    """Words of an image that hold the robust filter's crowd, in their order.

    Attributes:
        centre: Where the votes lie, in units of 2**-30. spread: Median of their distances from there, in
        units of 2**-30. voices: A bit for each sender's id modulo 32. initial_b_hat: Accuracy that the robot
        assumed at first. votes_and_trend: Number of votes, and above 16 bits the side of the centre on which
        the last ones were.
    """

    centre: int
    spread: int
    voices: int
    initial_b_hat: int
    votes_and_trend: int

    def by_index(self) -> dict[int, int]:
        """Return the words by their index in an image."""
        return dict(enumerate(vars(self).values(), _CLOSED_WORD))


class _RobustScenarioWriter(_ScenarioWriter):
    """Writes one scenario of a robot with the robust filter, which has a crowd in place of rounds."""

    _last_centre, _last_spread = 1 << 29, 1 << 28
    """Centre and spread of the last crowd that was drawn."""

    def _add_restore_at_limits(self) -> None:
        """Restore a crowd of which one word is at a limit or beyond, or that has another word behind it."""
        rng = self._rng
        word_index = rng.randrange(5)
        limits = (
            (0, _CENTRE_ONE),
            (_SPREAD_MIN, _SPREAD_MAX),
            (1, 1),
            (B_HAT_MIN, B_HAT_MAX),
            ((1 << 31) | 1, 1 << 14),
        )
        words = self._draw_crowd(rng.choice(_CROWD_SIZES)).by_index()
        limit = limits[word_index][rng.randrange(2)]
        words[_CLOSED_WORD + word_index] = max(limit + rng.choice([-1, 0, 0, 1]), 0)
        self._add_restore(words | rng.choice([{}, {}, {_CLOSED_WORD + 5: 1}]))

    def _add_test_at_threshold(self) -> None:
        """Run the robust filter's test on a count n at its threshold, on either side."""
        rng, crowd = self._rng, self._draw_crowd(votes=1 << 14)
        t = max(_draw_t(rng, self._setup.memory), 1)
        fill_ratio = Fraction(crowd.centre, 1 << 30)
        spread = Fraction(crowd.spread, 1 << 30)
        b_hat = Fraction(crowd.initial_b_hat, 1 << 32)
        predicted = b_hat * fill_ratio + (1 - b_hat) * (1 - fill_ratio)
        side = rng.choice([-1, 1])
        observed = predicted
        # The variance is the larger one of the two shares, so the threshold depends on the share that lies
        # there.
        for _ in range(8):
            variance = max(predicted * (1 - predicted), observed * (1 - observed)) / t
            limit_squared = 12 * (variance + (2 * b_hat - 1) ** 2 * spread**2)
            observed = predicted + side * Fraction(sqrt(limit_squared))
            observed = min(max(observed, Fraction(0)), Fraction(1))
        # At the prediction, at the threshold, and where the rounding of the test may decide
        scale = rng.choice([Fraction(0), Fraction(1), 1 + Fraction(rng.randint(-9, 9), 1 << 13)])
        n = round(t * (predicted + (observed - predicted) * scale)) + rng.choice([-1, 0, 1])
        present_b_hat = rng.choice([crowd.initial_b_hat, _draw_b_hat(rng)])
        self._add_filter_run_on_crowd(crowd, t, _clamp(n, 0, t), present_b_hat)

    def _add_filter_near_one_half(self) -> None:
        """Run the filter with a centre that is just informative, or just not, or almost 1/2."""
        rng, crowd = self._rng, self._draw_crowd(self._rng.choice(_CROWD_SIZES))
        side = rng.choice([-1, 1])
        crowd.centre = _CENTRE_HALF + side * (rng.choice([0, _CENTRE_INFORMATIVE]) + rng.randint(-1, 1))
        t = max(_draw_t(rng, self._setup.memory), 1)
        self._add_filter_run_on_crowd(crowd, t, rng.choice([0, t, t // 2]), _draw_b_hat(rng))

    def _add_filter_run_on_crowd(self, crowd: _CrowdWords, t: int, n: int, b_hat: int) -> None:
        """Restore a robot with this crowd and these counts, and run its filter; now and then after a vote."""
        rng = self._rng
        words = {
            _B_HAT_WORD: b_hat,
            _T_WORD: t,
            _N_WORD: n,
            _FILTER_LEFT_WORD: 1,
            _LAST_WORD: self._last_word(_UPDATED),
        }
        words |= rng.choice([{}, {}, {_TESTS_WORD: _TESTS_AT_WRAP}])
        self._add_restore(words | crowd.by_index())
        if rng.random() < 0.3:
            self._add_call("receive", self._draw_sender(), self._draw_x_hat(), _draw_alpha(rng))
        self._add_call("settle")

    def _draw_crowd(self, votes: int) -> _CrowdWords:
        """Draw a crowd: now and then one that moves one way, nearly so, or has too few voices."""
        rng = self._rng
        trend = rng.choice([1 << 15, 1 << 13, 7 << 13, rng.randrange(1 << 16)]) + rng.randint(-2, 1)
        voices = rng.choice([7, 7 << 29, _MAX_32, (1 << rng.randrange(32)) | 1])
        power_of_two = 1 << rng.randrange(18, 29)
        spread = power_of_two + rng.choice([-1, 0, 1, rng.randrange(power_of_two)])
        self._last_spread = _clamp(spread, _SPREAD_MIN, _SPREAD_MAX)
        self._last_centre = self._draw_centre()
        return _CrowdWords(
            centre=self._last_centre,
            spread=self._last_spread,
            voices=voices,
            initial_b_hat=_draw_b_hat(rng),
            votes_and_trend=votes | (_clamp(trend, 0, _MAX_16) << 16),
        )

    def _draw_centre(self) -> int:
        """Draw a centre: anywhere, at its ends, or near where messages are; half are multiples of 2**-23."""
        rng = self._rng
        near = (self._common_x_hat << 7) + rng.randint(-(1 << 20), 1 << 20)
        centre = rng.choice([near, rng.randint(0, _CENTRE_ONE), 0, _CENTRE_ONE])
        return _clamp(centre, 0, _CENTRE_ONE) & rng.choice([-1, -128])

    def _draw_x_hat(self) -> int:
        """Draw an x_hat: now and then at the last crowd's centre, or one spread from it."""
        rng = self._rng
        position = self._last_centre + rng.choice([-1, 0, 1]) * self._last_spread
        at_crowd = _clamp(position >> 7, 0, ONE)
        return at_crowd if rng.random() < 0.2 else super()._draw_x_hat()


def _draw_setup(rng: Random) -> Setup:
    """Draw the configuration of a robot, most often of one with the paper's filter and its test."""
    filter_kind = rng.choice([Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ADAPTIVE, Filter.ALWAYS, Filter.OFF])
    return Setup(
        table=rng.choice(TABLES) if filter_kind == Filter.ADAPTIVE else None,
        filter=int(filter_kind),
        filter_period=rng.choice([1, 1, 1, 2, 3, 20, _MAX_32]),
        memory=rng.choice([DEFAULT_MEMORY] * 3 + [64, 68, 1000, 1 << 16, DEFAULT_MEMORY - 4]),
        robot_id=rng.choice([0, 5, 31, 32, 127]),
        b_hat=_draw_b_hat(rng),
    )


def _draw_extreme_sums(rng: Random) -> Sums:
    """Draw sums that messages might have, each as large or as small as the ones drawn before it allow."""
    m = rng.choice([1, 2, 3, MAX_ID, rng.randint(1, MAX_ID)])
    x = rng.choice([0, 1, rng.randint(0, m * ONE), m * ONE - 1, m * ONE])
    largest_alpha = (m * MANTISSA_MAX) << SHIFT_MAX
    alpha = rng.choice([m, rng.randint(m, largest_alpha), largest_alpha, largest_alpha])
    alpha_x = rng.choice([0, rng.randint(0, alpha * ONE), alpha * ONE, alpha * ONE])
    # The sum of the upper bits of alpha times x, and that of the lower 32 bits.
    high = min(x * (MANTISSA_MAX >> 1), alpha_x >> 32)
    return Sums(
        alpha=alpha,
        alpha_x_low=min(x * _MAX_32, alpha_x - (high << 32), (1 << 62) - 1),
        alpha_x_high=high,
        x_squared=rng.choice([-(-x * x // m), x * ONE]),
        x=x,
        count=m,
    )


def _draw_alpha(rng: Random) -> int:
    """Draw an alpha word: often one as robots send them, also words of all other kinds."""
    usual = _draw_usual_alpha(rng)
    others = (
        rng.choice(_SPECIAL_ALPHAS),
        rng.randint(0, _MAX_32),
        usual | (_IGNORED_ALPHA_BITS & rng.randint(0, _MAX_32)),
        (rng.randrange(1 << rng.randrange(1, 25)) << 8) | rng.randrange(32),
        rng.randrange(256),
    )
    return rng.choice([usual, usual, usual, rng.choice(others)])


def _draw_usual_alpha(rng: Random) -> int:
    """Draw an alpha word as robots send them, of any size from 2**-24 to 2**31."""
    if rng.random() < 0.2:
        return rng.randrange(1, 1 << rng.randrange(1, 24)) << 8
    return draw_normal_alpha(rng, min_shift=0, max_shift=31)


def _draw_b_hat(rng: Random) -> int:
    """Draw a b_hat: anywhere, at the ends, at any distance from 1/2, or just informative."""
    distance = rng.choice([0, rng.randrange(1 << rng.randrange(1, 32)), _B_HAT_INFORMATIVE])
    offset = rng.choice([-1, 1]) * (distance + rng.randint(-1, 1))
    low_end = rng.choice([B_HAT_MIN + rng.randrange(1 << rng.randrange(31)), B_HAT_MIN])
    b_hat = rng.choice(
        [
            rng.randint(B_HAT_MIN, B_HAT_MAX),
            _B_HAT_HALF + offset,
            rng.choice([low_end, (1 << 32) - low_end]),
        ]
    )
    return _clamp(b_hat, B_HAT_MIN, B_HAT_MAX)


def _draw_t(rng: Random, memory: int) -> int:
    """Draw a number of observations, of any size up to where the next but one halves it, as ``memory`` says.

    Many are next to a power of two, or at the end of the memory.
    """
    power_of_two = 1 << rng.randrange(32)
    t = rng.choice(
        [rng.randrange(2 * power_of_two), power_of_two + rng.randint(-2, 1), memory - rng.randint(1, 3)]
    )
    return _clamp(t, 0, memory - 1)


def _draw_n(rng: Random, t: int, b_hat: int) -> int:
    """Draw how many of t observations are black: any number, none, all, half, t b_hat or t (1 - b_hat)."""
    corner = t * rng.choice([b_hat, (1 << 32) - b_hat]) >> 32
    n = rng.choice([rng.randint(0, t), rng.choice([0, t]), t // 2, corner, corner])
    return _clamp(n + rng.randint(-1, 1), 0, t)


def _clamp(value: int, minimum: int, maximum: int) -> int:
    """Return the value, or the limit that it exceeds."""
    return min(max(value, minimum), maximum)
