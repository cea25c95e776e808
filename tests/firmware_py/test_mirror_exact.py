"""The firmware against exact rationals: every limit of ``tests/exact.py`` holds, and is nearly reached.

The mirror stands for the C here, which gives the same bits (the cross-check compares them). Seeds are fixed;
a failure names the observations, the accuracy and the messages, which are all that a formula needs.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain, product

import pytest

import exact
from mcp_asdf import mirror
from mcp_asdf.fixed_point import alpha_to_word, sums_add, word_to_alpha
from mcp_asdf.mirror import Closed, MirrorRobot, accuracy_of, estimate, reestimate
from mcp_asdf.robot import Config, Filter, Observation, Sums
from mcp_asdf.table import Table
from robots import ALPHA_LEAST, ALPHA_MOST, ALPHA_ONE, HALF, ONE, OWN_ID, PLAIN, robot_at
from support import draws

pytestmark = pytest.mark.random

T_MOST = 2**31 - 1
B_LEAST, B_MOST = 2**12, 2**32 - 2**12
INFORMATIVE = 2**19
"""Distance of b_hat from 1/2, in units of 2**-32, from which on it says something."""
EDGES = (B_LEAST, B_LEAST + 1, 2**28, 2**30, 2**30 + 1, 2**31 - INFORMATIVE - 1, 2**31 - INFORMATIVE)
"""Accuracies below 1/2, of which 1 - b_hat is another."""


def log_uniform(stream: random.Random, least: int, most: int) -> int:
    """An integer of a random length."""
    return min(max(round(2 ** stream.uniform(least.bit_length() - 1, most.bit_length())), least), most)


def accuracies(stream: random.Random) -> int:
    """b_hat: anywhere, near a clamp, near 1/2, or an edge; inverted half of the time."""
    kind = stream.randrange(4)
    if kind == 0:
        c = stream.randrange(B_LEAST, 2**31 - INFORMATIVE + 1)
    elif kind == 1:
        c = log_uniform(stream, B_LEAST, 2**30)
    elif kind == 2:
        c = 2**31 - log_uniform(stream, INFORMATIVE, 2**30)
    else:
        c = stream.choice(EDGES)
    return c if stream.random() < 0.5 else 2**32 - c


def observations(stream: random.Random, b: int) -> tuple[int, int]:
    """(n, t): anywhere, of few of one colour, or where eq. 3 leaves an end of the scale."""
    t = log_uniform(stream, 1, T_MOST)
    kind, c = stream.randrange(3), min(b, 2**32 - b)
    if kind == 0:
        n = stream.randrange(t + 1)
    elif kind == 1:
        n = min(log_uniform(stream, 1, t) - 1, t)
    else:
        n = min(max((t * c >> 32) + stream.randrange(-2, 4), 0), t)
    return (n if stream.random() < 0.5 else t - n), t


def cases(seed: int, count: int) -> Iterator[tuple[int, int, int]]:
    """(n, t, b_hat in units of 2**-32): at random, and around c t at every length of t for every edge."""
    stream = random.Random(seed)
    for _ in range(count):
        b = accuracies(stream)
        yield *observations(stream, b), b
    for c, power, below in product(EDGES, range(1, 32), (0, 1, 2)):
        t = max(2**power - 1 - below, 1)
        for n in (0, 1, t // 2, t * c >> 32, min((t * c >> 32) + 1, t)):
            yield n, t, c
            yield n, t, 2**32 - c


def own(n: int, t: int, raw: int) -> tuple[Fraction, Fraction]:
    """The firmware's x_hat and alpha."""
    x_hat, word = estimate(t, n, accuracy_of(raw))
    return x_hat * exact.Q23, exact.of_word(word)


# --- Estimates -------------------------------------------------------------------------------------------


def test_x_hat_is_within_its_limits() -> None:
    for n, t, raw in cases(1, draws(12000)):
        least, most = exact.x_hat_limits(n, t, raw * exact.Q32)
        assert least <= own(n, t, raw)[0] <= most, (n, t, raw)


def test_alpha_is_within_its_limits() -> None:
    for n, t, raw in cases(2, draws(12000)):
        least, most = exact.alpha_limits(n, t, raw * exact.Q32)
        assert least <= own(n, t, raw)[1] <= most, (n, t, raw)


@pytest.mark.slow
@pytest.mark.parametrize("raw", [*EDGES, *(2**32 - c for c in EDGES), 3 << 30, 2**31 + 1])
def test_every_count_of_few_observations(raw: int) -> None:
    b = raw * exact.Q32
    for t in range(1, 70):
        for n in range(t + 1):
            x_hat, alpha = own(n, t, raw)
            (least_x, most_x), (least, most) = exact.x_hat_limits(n, t, b), exact.alpha_limits(n, t, b)
            assert least_x <= x_hat <= most_x and least <= alpha <= most, (n, t)


def drift(n: int, t: int, raw: int) -> Fraction:
    """How much nearer to 1/2 x_hat is than eq. 3 has it, in units of x_hat."""
    value = exact.x_hat(n, t, raw * exact.Q32)
    return (abs(value - exact.HALF) - abs(own(n, t, raw)[0] - exact.HALF)) / exact.Q23


def test_x_hat_nearly_reaches_its_limits() -> None:
    """Almost a unit towards an end of the scale; and almost 16 away from it near b_hat = 1/2, where what c t
    loses counts 2**12 times, if it loses almost 1."""
    least = 2**31 - INFORMATIVE
    away = [drift((least * t >> 32) + 2, t, least) for t in range(2**30 + 1, 2**30 + 2**18, 2**12)]
    assert 14 < max(away) < 16
    assert Fraction(999, 1000) < -min(drift(*each) for each in cases(3, 3000)) < 1


def test_alpha_nearly_reaches_its_limits() -> None:
    """Inside, the mantissa below and c t above; at an end two squares of quotients and the mantissa."""
    shares = {"inside": Fraction(0), "above": Fraction(0), "end": Fraction(0)}
    for n, t, raw in cases(4, 8000):
        b = raw * exact.Q32
        value, found = exact.alpha(n, t, b), own(n, t, raw)[1]
        below, above = exact.alpha_error(n, t, b)
        if not 1 <= value < exact.ALPHA_MOST:
            continue
        place = "inside" if below < exact.Q23 else "end"
        shares[place] = max(shares[place], (1 - found / value) / (below + exact.Q23))
        if above > exact.Q23:
            shares["above"] = max(shares["above"], (found / value - 1) / above)
    assert Fraction(9, 10) < shares["inside"] < 1
    assert Fraction(7, 10) < shares["end"] < 1
    assert Fraction(3, 4) < shares["above"] < 1


def test_the_ends_and_the_middle_are_exact() -> None:
    """Every case distinction of eq. 3 is made on exact numbers, and half of all is 1/2 at every t."""
    middles = ((half, 2 * half, raw) for raw in EDGES for half in (1, 2**29 + 1, 2**30 - 1))
    for n, t, raw in chain(cases(5, draws(8000)), middles):
        value, x_hat = exact.x_hat(n, t, raw * exact.Q32), own(n, t, raw)[0]
        if value in (0, exact.HALF, 1):
            assert x_hat == value, (n, t, raw)


@pytest.mark.parametrize("raw", [2**31 - INFORMATIVE, 2**31 + INFORMATIVE])
def test_the_least_confidence_is_not_lost(raw: int) -> None:
    """One observation, b_hat as near to 1/2 as says something: just below 2**-22, so 3 units of 2**-24."""
    for n in (0, 1):
        value = exact.alpha(n, 1, raw * exact.Q32)
        assert exact.Q24 * 3 < value < exact.Q24 * 4
        assert own(n, 1, raw)[1] == exact.Q24 * 3


def test_own_alphas_are_canonical_and_survive_the_bus() -> None:
    """The smallest shift, no bit that receivers ignore, and binary32 holds each of them exactly."""
    for n, t, raw in cases(6, 4000):
        word = estimate(t, n, accuracy_of(raw))[1]
        assert word == exact.to_word(exact.of_word(word)) and word & 0xE0 == 0, (n, t, raw)
        assert word >> 31 or word & 31 == 0, (n, t, raw)
        (carried,) = struct.unpack("<f", struct.pack("<f", word_to_alpha(word)))
        assert carried == exact.of_word(word) and alpha_to_word(carried) == word, (n, t, raw)


def test_colours_and_senses_are_mirror_images() -> None:
    """(n, b), (t - n, 1 - b) and, but for x_hat, (t - n, b): the same bits at every t."""
    for n, t, raw in cases(7, 5000):
        x_hat, word = estimate(t, n, accuracy_of(raw))
        assert estimate(t, t - n, accuracy_of(2**32 - raw)) == (x_hat, word), (n, t, raw)
        assert estimate(t, t - n, accuracy_of(raw)) == (ONE - x_hat, word), (n, t, raw)


# --- Means -----------------------------------------------------------------------------------------------


def random_round(stream: random.Random) -> list[tuple[int, int]]:
    """(x_hat, alpha word) of up to 127 messages; confidences of all sizes, or all of one."""
    alphas = [stream.randrange(2**32) for _ in range(3)] + [ALPHA_ONE, ALPHA_LEAST, ALPHA_MOST, 0x9F]
    count = stream.choice((1, 2, 3, 20, 127))
    if stream.random() < 0.5:
        alphas = alphas[stream.randrange(len(alphas)) :][:1]
    return [(stream.choice((stream.randrange(ONE + 1), ONE, 0)), stream.choice(alphas)) for _ in range(count)]


def quantised(messages: list[tuple[int, int]]) -> list[tuple[Fraction, Fraction]]:
    """The values that messages stand for."""
    return [(x * exact.Q23, exact.of_word(word)) for x, word in messages]


@pytest.mark.parametrize("seed", range(100))
def test_x_bar_and_x_are_exact_quotients_rounded_down(seed: int) -> None:
    stream = random.Random(seed)
    robot, messages = MirrorRobot(PLAIN, 127, 0.75), random_round(stream)
    for sender, message in enumerate(messages):
        robot.receive_raw(sender, *message)
    robot.settle()
    values = quantised(messages)
    assert robot.beta_raw * exact.Q24 == sum(alpha for _, alpha in values)
    if robot.beta_raw:
        assert robot.x_bar_raw * exact.Q23 == exact.floor_to(exact.weighted_mean(values), exact.Q23)
    for _ in range(stream.randrange(1, 4)):
        robot.observe(Observation(stream.randrange(2)))
        own = (robot.x_hat_raw * exact.Q23, exact.of_word(robot.alpha_raw))
        assert robot.x_raw * exact.Q23 == exact.floor_to(exact.weighted_mean([own, *values]), exact.Q23)


def test_the_mean_s_two_parts_need_no_carry() -> None:
    """Sums of low and high words apart are the sum of the whole products."""
    stream = random.Random(8)
    for _ in range(400):
        sums, messages = Sums(), random_round(stream)
        for message in messages:
            sums_add(sums, *message)
        total = sum(alpha * x for x, alpha in quantised(messages)) / exact.Q23 / exact.Q24
        assert (sums.alpha_x_high << 32) + sums.alpha_x_low == total
        assert sums.count == sum(alpha > 0 for _, alpha in quantised(messages))


def robot_of(g: Fraction, stream: random.Random) -> tuple[int, int, int]:
    """(n, t, b_hat) with |2 b - 1| >= g, and a confidence below the largest."""
    while True:
        gap = round((g + (1 - g) * Fraction(stream.random()) ** stream.choice((1, 8))) * 2**31)
        raw = stream.choice((2**31 + gap, 2**31 - gap))
        n, t = observations(stream, raw)
        if B_LEAST <= raw <= B_MOST and exact.alpha(n, t, raw * exact.Q32) < exact.ALPHA_MOST:
            return n, t, raw


def error_of_x(robots: list[tuple[int, int, int]]) -> Fraction:
    """x of a round against the mean of the exact estimates with their exact confidences."""
    closed, (own_x, own_alpha) = Sums(), estimate(robots[0][1], robots[0][0], accuracy_of(robots[0][2]))
    for n, t, raw in robots[1:]:
        sums_add(closed, *estimate(t, n, accuracy_of(raw)))
    found = mirror.informed_estimate(
        Closed(closed.alpha, closed.alpha_x_low, closed.alpha_x_high), own_x, own_alpha
    )
    values = [
        (exact.x_hat(n, t, raw * exact.Q32), exact.alpha(n, t, raw * exact.Q32)) for n, t, raw in robots
    ]
    return found * exact.Q23 - exact.weighted_mean(values)


GAPS = [Fraction(1, 5), Fraction(9, 10), Fraction(1, 50), Fraction(1, 2**12)]


@pytest.mark.parametrize("g", GAPS, ids=str)
def test_x_is_near_that_of_exact_arithmetic(g: Fraction) -> None:
    """Of rounds without saturated confidences; within 1e-6 for |2 b - 1| from 0.2 on."""
    stream = random.Random(9)
    for _ in range(400):
        robots = [robot_of(g, stream) for _ in range(stream.choice((1, 2, 3, 12)))]
        assert abs(error_of_x(robots)) <= exact.x_error(g), robots
    assert g < Fraction(1, 5) or exact.x_error(g) < Fraction(1, 10**6)


def test_x_nearly_reaches_its_limit() -> None:
    """One robot saw white, one black, the same number of times; the confidence of one is cut to its grid by
    almost a unit, that of the other by almost none: a third of all that may happen at once."""
    stream, g = random.Random(10), Fraction(1, 5)
    found = []
    for _ in range(4000):
        raw = 2**31 + round(g * 2**31) + stream.randrange(2**26)
        value = exact.alpha(0, 1, raw * exact.Q32)
        found.append((own(0, 1, raw)[1] / value, raw))
    low, high = min(found)[1], max(found)[1]
    worst = max(abs(error_of_x([(1, 1, one), (0, 1, other)])) for one, other in ((low, high), (high, low)))
    assert Fraction(1, 3) * exact.x_error(g) < worst < exact.x_error(g)


# --- The test of eq. 12 ----------------------------------------------------------------------------------


def thresholds(stream: random.Random, own: int, xs: list[int]) -> list[int]:
    """Entries around the one at which the decision turns, where there is one."""
    m, total = len(xs), sum(xs)
    spread = m * sum(x * x for x in xs) - total**2
    edge = ((total - m * own) ** 2 << 26) // spread if spread else 1 << 26
    picks = [edge - 1, edge, edge + 1, stream.randrange(1 << 26, 2**32)]
    return [min(max(k, 1), 2**32 - 1) for k in picks]


@pytest.mark.parametrize("m", [2, 3, 4, 19, 127])
def test_every_decision_is_that_of_exact_arithmetic(m: int) -> None:
    """Given the table's own entry; entries are put on both sides of the threshold, and on it."""
    stream, decisions = random.Random(m), set()
    for _ in range(120):
        near, width = stream.randrange(ONE + 1), log_uniform(stream, 1, ONE)
        xs = [min(max(near + stream.randrange(-width, width + 1), 0), ONE) for _ in range(m)]
        own, sums = stream.choice((near, stream.randrange(ONE + 1), ONE, 0)), Sums()
        for x in xs:
            sums_add(sums, x, ALPHA_ONE)
        for k in thresholds(stream, own, xs):
            table = Table(1, (k, k))
            expected = exact.rejects(own * exact.Q23, [x * exact.Q23 for x in xs], Fraction(k, 1 << 26))
            assert mirror.rejects(table, sums, own) == expected, (own, xs, k)
            decisions.add(expected)
    assert decisions == {False, True}


# --- Re-estimates ----------------------------------------------------------------------------------------


def closed_round(weight: int, moment: int) -> Closed:
    """Sums of alpha and of alpha x_hat, in their units."""
    return Closed(weight, moment & 0xFFFFFFFF, moment >> 32)


def re_estimates(seed: int, count: int) -> Iterator[tuple[int, int, Closed]]:
    """n, t and sums of any size; x_bar anywhere, near 0, 1/2 and 1, and n / t near x_bar or 1 - x_bar, where
    the quotient is near 1 or 0."""
    stream = random.Random(seed)
    for _ in range(count):
        t, weight = log_uniform(stream, 1, T_MOST), log_uniform(stream, 1, 2**62 - 1)
        weight = stream.choice((weight, 1 << weight.bit_length() - 1))
        distance = log_uniform(stream, 1, 2**52) * weight >> 30
        moment = stream.choice((stream.randrange((weight << 23) + 1), distance, (weight << 22) - distance))
        moment = min(max(moment, 0), weight << 23)
        near = moment * t // (weight << 23)
        n = stream.choice((stream.randrange(t + 1), near, t - near, min(near + 1, t), t, 0))
        if stream.random() < 0.5:
            n, moment = t - n, (weight << 23) - moment
        yield n, t, closed_round(weight, moment)


def hardest_re_estimates(seed: int, count: int, x_bar: Fraction) -> Iterator[tuple[int, int, Closed]]:
    """Sums of alpha that are a power of two, so that the divisor is rounded up by the most, a dividend that
    loses most of a bit, and n / t that makes b_hat nearly 0 or 1."""
    stream = random.Random(seed)
    for _ in range(count):
        weight = 1 << stream.randrange(34, 62)
        lost = weight >> 9  # units of the moment in the last bit that is left of it
        moment = (int(x_bar * weight * 2**23) // lost + stream.randrange(2**20)) * lost + lost - 1
        t = stream.randrange(2**30, T_MOST)
        share = stream.choice((1 - x_bar, x_bar))
        yield int(t * share) + stream.randrange(2**11), t, closed_round(weight, moment)


def mean_of(closed: Closed) -> Fraction:
    return Fraction(closed.alpha_x(), closed.alpha << 23)


def error_of_b_hat(n: int, t: int, closed: Closed) -> Fraction | None:
    """Against eq. 8 with the exact x_bar, which must allow what was found, as a share of its limit."""
    x_bar, raw = mean_of(closed), reestimate(t, n, closed)
    assert exact.updates(x_bar) in (None, raw is not None), (n, t, closed)
    if raw is None or exact.updates(x_bar) is None:
        return None
    least, most = exact.b_hat_limits(n, t, x_bar)
    assert least <= raw * exact.Q32 <= most, (n, t, closed)
    error, limit = abs(raw * exact.Q32 - exact.b_hat(n, t, x_bar)), exact.b_hat_error(x_bar)
    assert error <= limit, (n, t, closed)
    return error / limit


def test_b_hat_is_within_its_limits() -> None:
    for n, t, closed in re_estimates(11, draws(12000)):
        error_of_b_hat(n, t, closed)


@pytest.mark.parametrize("x_bar", [Fraction(11, 20), Fraction(9, 20)], ids=str)
def test_b_hat_is_within_2_26_where_x_bar_says_enough(x_bar: Fraction) -> None:
    """|2 x_bar - 1| >= 0.1; the limit is proven to be below, and the hardest cases come near it."""
    assert exact.b_hat_error(x_bar) < Fraction(1, 2**26)
    shares = [error_of_b_hat(*each) for each in hardest_re_estimates(12, 5000, x_bar)]
    assert Fraction(7, 10) < max(share for share in shares if share is not None) <= 1


def test_a_social_estimate_near_one_half_updates_nothing() -> None:
    """|2 x_bar - 1| < 2**-12, from either side, in units of x_hat: at most 1023 from 1/2."""
    for weight in (1, 2**24, 2**32 - 1, 2**40 + 1, 127 * (2**55 - 2**31)):
        for distance in (0, 1, 511, 1023, -1, -1023):
            assert reestimate(7, 3, closed_round(weight, weight * (HALF + distance))) is None
        for distance in (1025, -1025, 2000, -HALF, HALF):
            assert reestimate(7, 3, closed_round(weight, weight * (HALF + distance))) is not None


def test_b_hat_explains_x_bar() -> None:
    """Eq. 8 turns eq. 3 around: the new b_hat makes x_bar of x_hat, unless it is clamped or says nothing."""
    explained = 0
    for n, t, closed in re_estimates(13, draws(6000)):
        raw, x_bar = reestimate(t, n, closed), mean_of(closed)
        if raw is None or raw in (B_LEAST, B_MOST) or not exact.is_informative(raw * exact.Q32):
            continue
        slope = abs(2 * x_bar - 1) / abs(2 * raw * exact.Q32 - 1)  # of x_hat, in b_hat, twice
        tolerance = 2 * exact.Q23 + exact.Q31 * slope + 4 * slope * exact.b_hat_error(x_bar)
        tolerance += exact.Q31 / abs(2 * raw * exact.Q32 - 1)
        assert abs(own(n, t, raw)[0] - x_bar) <= tolerance, (n, t, closed)
        explained += 1
    assert explained > draws(500)


@pytest.mark.parametrize("seed", range(20))
def test_a_filter_s_update_is_eq_8(seed: int) -> None:
    """Through the interface: x_bar from messages, t and n from observations, b_hat shown after settle."""
    stream = random.Random(seed)
    t = log_uniform(stream, 1, T_MOST)
    n = stream.randrange(t + 1)
    robot = robot_at(MirrorRobot, Config(filter=Filter.ALWAYS, filter_period=1), t=t, n=n, filter_left=1)
    messages = [(stream.randrange(ONE + 1), stream.randrange(2**32)) for _ in range(3)]
    for sender, message in enumerate(messages, OWN_ID + 1):
        robot.receive_raw(sender, *message)
    robot.settle()
    least, most = exact.b_hat_limits(n, t, exact.weighted_mean(quantised(messages)))
    assert least <= robot.b_hat_raw * exact.Q32 <= most
