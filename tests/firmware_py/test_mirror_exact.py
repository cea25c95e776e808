"""The firmware against exact rationals: every limit of ``tests/exact.py`` holds, and is nearly reached.

The mirror stands for the C here, which gives the same bits (the cross-check compares them). Seeds are fixed;
a failure names the observations, the accuracy and the messages, which are all that a formula needs.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain

import exact
import pytest
from robots import ALPHA_ONE, HALF, ONE, OWN_ID, PLAIN, robot_at

from firmware_py import mirror
from firmware_py.mirror import MirrorRobot, accuracy_of, alpha_units, estimate, mean, reestimate, sums_add
from firmware_py.robot import Config, Filter, Observation, Sums
from firmware_py.table import Table

T_MOST = 2**32 - 3
B_LEAST, B_MOST = 2**12, 2**32 - 2**12
INFORMATIVE = 2**19
"""Distance of b_hat from 1/2, in units of 2**-32, from which on it says something."""


def log_uniform(stream: random.Random, least: int, most: int) -> int:
    """An integer of a random length."""
    return min(max(round(2 ** stream.uniform(least.bit_length() - 1, most.bit_length())), least), most)


def accuracies(stream: random.Random) -> int:
    """b_hat: anywhere, near a clamp, near 1/2, or an end; inverted half of the time."""
    kind = stream.randrange(4)
    if kind == 0:
        c = stream.randrange(B_LEAST, 2**31 - INFORMATIVE + 1)
    elif kind == 1:
        c = log_uniform(stream, B_LEAST, 2**30)
    elif kind == 2:
        c = 2**31 - log_uniform(stream, INFORMATIVE, 2**30)
    else:
        c = stream.choice((B_LEAST, 2**31 - INFORMATIVE, 2**30, 2**28, 2**12 + 1))
    return c if stream.random() < 0.5 else 2**32 - c


def observations(stream: random.Random, b: int, least: int, most: int) -> tuple[int, int]:
    """(n, t): anywhere, of few of one colour, or where eq. 3 leaves an end of the scale."""
    t = log_uniform(stream, least, most)
    kind, c = stream.randrange(3), min(b, 2**32 - b)
    if kind == 0:
        n = stream.randrange(t + 1)
    elif kind == 1:
        n = min(log_uniform(stream, 1, t) - 1, t)
    else:
        n = min(max((t * c >> 32) + stream.randrange(-2, 4), 0), t)
    return (n if stream.random() < 0.5 else t - n), t


def cases(seed: int, count: int, least: int, most: int) -> Iterator[tuple[int, int, int]]:
    """(n, t, b_hat in units of 2**-32)."""
    stream = random.Random(seed)
    for _ in range(count):
        b = accuracies(stream)
        yield *observations(stream, b, least, most), b


# --- Estimates -------------------------------------------------------------------------------------------

REGIONS = {"t below 2**31": (1, 2**31 - 1), "t from 2**31 on": (2**31, T_MOST)}


@pytest.mark.parametrize("region", REGIONS)
def test_x_hat_is_within_its_limits(region: str) -> None:
    for n, t, raw in cases(1, 12000, *REGIONS[region]):
        least, most = exact.x_hat_limits(n, t, raw * exact.Q32)
        assert least <= estimate(t, n, accuracy_of(raw))[0] * exact.Q23 <= most, (n, t, raw)


@pytest.mark.parametrize("region", REGIONS)
def test_alpha_is_within_its_limits(region: str) -> None:
    for n, t, raw in cases(2, 12000, *REGIONS[region]):
        least, most = exact.alpha_limits(n, t, raw * exact.Q32)
        assert least <= exact.of_bits(estimate(t, n, accuracy_of(raw))[1]) <= most, (n, t, raw)


def test_x_hat_nearly_reaches_its_limit() -> None:
    """Near b_hat = 1/2 what n / t lost to 32 bits counts 2**12 times."""
    worst = Fraction(0)
    for n, t, raw in cases(3, 10000, 1, 2**31 - 1):
        b = raw * exact.Q32
        error = abs(estimate(t, n, accuracy_of(raw))[0] * exact.Q23 - exact.x_hat(n, t, b))
        worst = max(worst, error / (exact.Q23 + exact.Q32 / abs(2 * b - 1)))
    assert Fraction(9, 10) < worst < 1


def test_alpha_nearly_reaches_its_limits() -> None:
    """Below, 23 bits are kept inside, and an end's three roundings seldom meet; above, a small nu (1 - nu)
    in 32 bits decides."""
    below, above = {"inside": Fraction(0), "end": Fraction(0)}, Fraction(0)
    for n, t, raw in cases(4, 15000, 1, 2**31 - 1):
        value, found = exact.alpha(n, t, raw * exact.Q32), exact.of_bits(estimate(t, n, accuracy_of(raw))[1])
        less, more = exact.alpha_error(n, t, raw * exact.Q32)
        if 1 <= value < exact.ALPHA_MOST:
            place = "inside" if less < Fraction(1, 2**21) else "end"
            below[place] = max(below[place], (1 - found / value) / less)
            above = max(above, (found / value - 1) / more)
    assert Fraction(17, 20) < below["inside"] < 1
    assert Fraction(1, 2) < below["end"] < 1
    assert Fraction(8, 10) < above < 1


def test_x_hat_at_an_end_is_exact() -> None:
    """While t < 2**31 the case distinction of eq. 3 is made on exact numbers."""
    for n, t, raw in cases(5, 10000, 1, 2**31 - 1):
        value = exact.x_hat(n, t, raw * exact.Q32)
        x_hat = estimate(t, n, accuracy_of(raw))[0] * exact.Q23
        if value in (0, exact.HALF, 1):
            assert x_hat == value, (n, t, raw)


@pytest.mark.parametrize("raw", [2**31 - INFORMATIVE, 2**31 + INFORMATIVE])
def test_the_least_confidence_is_not_lost(raw: int) -> None:
    """One observation, b_hat as near to 1/2 as says something: just below 2**-22, so 3 units of 2**-24."""
    for n in (0, 1):
        value, units = exact.alpha(n, 1, raw * exact.Q32), alpha_units(estimate(1, n, accuracy_of(raw))[1])
        assert exact.Q24 * 3 < value < exact.Q24 * 4
        assert units == 3


# --- Means -----------------------------------------------------------------------------------------------


def random_round(stream: random.Random) -> list[tuple[int, int]]:
    """(x_hat, alpha bits) of up to 127 messages; confidences of all sizes, or all of one."""
    alphas = [stream.randrange(0x7F800000) for _ in range(3)] + [ALPHA_ONE, 0x33800000, 0x4EFFFFFF]
    count = stream.choice((1, 2, 3, 20, 127))
    if stream.random() < 0.5:
        alphas = alphas[stream.randrange(6) :][:1]
    return [(stream.choice((stream.randrange(ONE + 1), ONE, 0)), stream.choice(alphas)) for _ in range(count)]


def quantised(messages: list[tuple[int, int]]) -> list[tuple[Fraction, Fraction]]:
    """The values that the firmware takes the messages for (docs/design.md section 3)."""
    return [(x * exact.Q23, exact.alpha_on_grid(exact.of_bits(bits))) for x, bits in messages]


@pytest.mark.parametrize("seed", range(100))
def test_x_bar_and_x_are_exact_quotients_rounded_down(seed: int) -> None:
    stream = random.Random(seed)
    robot, messages = MirrorRobot(PLAIN, 127, 0.75), random_round(stream)
    for sender, message in enumerate(messages):
        robot.receive_raw(sender, *message)
    for _ in range(stream.randrange(1, 4)):
        robot.observe(Observation(stream.randrange(2)))
    robot.settle()
    values = quantised(messages)
    own = (robot.x_hat_raw * exact.Q23, exact.of_bits(robot.alpha_raw))
    assert robot.beta_raw * exact.Q24 == sum(alpha for _, alpha in values)
    if robot.beta_raw:
        assert robot.x_bar_raw * exact.Q23 == exact.floor_to(exact.weighted_mean(values), exact.Q23)
    assert robot.x_raw * exact.Q23 == exact.floor_to(exact.weighted_mean([own, *values]), exact.Q23)


def test_the_mean_s_two_parts_need_no_carry() -> None:
    """Sums of low and high words apart give the same quotient as the whole."""
    stream = random.Random(6)
    for _ in range(2000):
        sums, values = Sums(), random_round(stream)
        entered = [sums_add(sums, *message) for message in values]
        total = sum(alpha * x for x, alpha in quantised(values)) / exact.Q23 / exact.Q24
        assert (sums.alpha_x_high << 32) + sums.alpha_x_low == total
        assert sums.count == sum(entered) == sum(alpha > 0 for _, alpha in quantised(values))
        if sums.alpha:
            assert mean(sums.alpha, sums.alpha_x_low, sums.alpha_x_high) == total // sums.alpha


# --- The test of eq. 12 ----------------------------------------------------------------------------------


def thresholds(stream: random.Random, own: int, xs: list[int], fraction_bits: int) -> list[int]:
    """Entries around the one at which the decision turns, where there is one."""
    m, total = len(xs), sum(xs)
    spread = m * sum(x * x for x in xs) - total**2
    edge = ((total - m * own) ** 2 << fraction_bits) // spread if spread else 1 << fraction_bits
    most = min(64 << fraction_bits, 2**32) - 1
    picks = [edge - 1, edge, edge + 1, stream.randrange(1 << fraction_bits, most)]
    return [min(max(k, 1), most) for k in picks]


@pytest.mark.parametrize("fraction_bits", range(1, 32))
def test_every_decision_is_that_of_exact_arithmetic(fraction_bits: int) -> None:
    """Given the table's own entry; entries are put on both sides of the threshold, and on it."""
    stream = random.Random(fraction_bits)
    for m in (2, 3, 4, 19, 127):
        for _ in range(4):
            near, width = stream.randrange(ONE + 1), log_uniform(stream, 1, ONE)
            xs = [min(max(near + stream.randrange(-width, width + 1), 0), ONE) for _ in range(m)]
            own, sums = stream.choice((near, stream.randrange(ONE + 1), ONE, 0)), Sums()
            for x in xs:
                sums_add(sums, x, ALPHA_ONE)
            for k in thresholds(stream, own, xs, fraction_bits):
                table = Table(1, fraction_bits, (k, k))
                expected = exact.rejects(
                    own * exact.Q23, [x * exact.Q23 for x in xs], Fraction(k, 1 << fraction_bits)
                )
                assert mirror.rejects(table, sums, own) == expected, (own, xs, k)


# --- Re-estimates ----------------------------------------------------------------------------------------


def re_estimates(seed: int, count: int) -> Iterator[tuple[int, int, int]]:
    """(n, t, x_bar): anywhere, near 0, 1/2 and 1, and n / t near x_bar, where the quotient is near 1."""
    stream = random.Random(seed)
    for _ in range(count):
        t = log_uniform(stream, 1, T_MOST)
        x_bar = stream.choice(
            (stream.randrange(ONE + 1), log_uniform(stream, 1, HALF), HALF - log_uniform(stream, 1, HALF))
        )
        n = stream.choice((stream.randrange(t + 1), x_bar * t >> 23, t - (x_bar * t >> 23), t, 0))
        mirrored = stream.random() < 0.5
        yield (t - n, t, ONE - x_bar) if mirrored else (n, t, x_bar)


def worst_re_estimates(seed: int, count: int) -> Iterator[tuple[int, int, int]]:
    """Denominators just above 2**54, where the upper 31 bits are worth the most, and quotients near 1."""
    stream = random.Random(seed)
    for _ in range(count):
        t = 2**31 + log_uniform(stream, 1, 2**27)
        yield t - log_uniform(stream, 1, 2**24), t, ONE - log_uniform(stream, 1, 2**12)


def test_b_hat_is_within_its_limits() -> None:
    worst = Fraction(0)
    for n, t, x_bar in chain(re_estimates(7, 20000), worst_re_estimates(9, 30000)):
        raw = reestimate(t, n, x_bar)
        if x_bar == HALF:
            assert raw is None
            continue
        assert raw is not None
        least, most = exact.b_hat_limits(n, t, x_bar * exact.Q23)
        assert least <= raw * exact.Q32 <= most, (n, t, x_bar)
        worst = max(worst, most / exact.Q32 - raw)
    assert Fraction(15, 2) < worst < 8, "the limit should nearly be reached"


def test_b_hat_explains_x_bar() -> None:
    """Eq. 8 turns eq. 3 around: the new b_hat makes x_bar of x_hat, unless it is clamped or says nothing."""
    for n, t, x_bar in re_estimates(8, 4000):
        raw = reestimate(t, n, x_bar)
        if raw is None or raw in (B_LEAST, B_MOST) or not exact.is_informative(raw * exact.Q32):
            continue
        b = raw * exact.Q32
        tolerance = 2 * exact.Q23 + 16 * exact.Q32 / abs(2 * b - 1)
        if n + 2 < t < exact.LONG:
            assert abs(estimate(t, n, accuracy_of(raw))[0] - x_bar) * exact.Q23 <= tolerance, (n, t, x_bar)


@pytest.mark.parametrize("seed", range(20))
def test_a_filter_s_update_is_eq_8(seed: int) -> None:
    """Through the interface: x_bar from messages, t and n from observations, b_hat shown after settle."""
    stream = random.Random(seed)
    t = log_uniform(stream, 1, T_MOST)
    n = stream.randrange(t + 1)
    config = Config(filter=Filter.ALWAYS, filter_period=1)
    robot = robot_at(MirrorRobot, config, t=t, n=n, filter_left=1, comms_left=1)
    x_bar = stream.randrange(ONE + 1)
    robot.receive_raw(OWN_ID + 1, x_bar, ALPHA_ONE)
    robot.step(Observation.NONE)
    least, most = exact.b_hat_limits(n, t, x_bar * exact.Q23)
    assert robot.x_bar_raw == x_bar
    assert least <= robot.b_hat_raw * exact.Q32 <= most
