"""Each edge of the step on its own, for every robot that shares the meaning (docs/design.md).

Expected values come from the paper's formulas on exact rationals (``tests/exact.py``). The float64 robot
takes part where nothing is rounded to the firmware's grids, or within 1e-12. I1, I2, ... are the numbers of
docs/invariants.md.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields, replace
from fractions import Fraction

import pytest

import exact
from mcp_asdf.fixed_point import alpha_to_word, word_to_alpha
from mcp_asdf.reference import ReferenceRobot
from mcp_asdf.robot import (
    MAX_FILTER_PERIOD,
    Config,
    Counters,
    Filter,
    FirmwareError,
    Observation,
    Robot,
    Status,
    Sums,
)
from mcp_asdf.table import MAX_OMEGA_WORD, Table, checksum
from robots import (
    ALPHA_LEAST,
    ALPHA_MOST,
    ALPHA_ONE,
    FIXED_POINT,
    HALF,
    IMAGE_SIZE,
    LAYOUT,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    AnyType,
    FixedPoint,
    FixedPointType,
    hear,
    new,
    of_every_kind,
    of_fixed_point,
    pack,
    receive_all,
    rewritten,
    robot_at,
    status_of_receive,
    unpack,
    watch,
)

WHITE, BLACK = Observation.WHITE, Observation.BLACK
EPSILON = 2.0**-20
DISTANCE = 2.0**-13
"""Of b_hat from 1/2, from which on it says something."""
ADAPTIVE = Config(table=TABLE, filter_period=1)
ALWAYS = Config(filter=Filter.ALWAYS, filter_period=1)


def check_estimate(robot: Robot, n: int, t: int, b_hat: float) -> None:
    """x_hat and alpha are those of eq. 3 and 4, as exactly as the robot computes."""
    b = Fraction(b_hat)
    if isinstance(robot, ReferenceRobot) and exact.is_informative(b):
        x, alpha = exact.x_hat(n, t, b), exact.alpha(n, t, b)
        assert abs(robot.x_hat - x) <= 1e-12 and abs(robot.alpha - alpha) <= 1e-12 * alpha
        return
    least, most = exact.x_hat_limits(n, t, b)
    assert least <= robot.x_hat <= most
    least, most = exact.alpha_limits(n, t, b)
    assert least <= robot.alpha <= most


def view(robot: Robot) -> tuple[object, ...]:
    """All that can be seen of a robot, but the counter of rejected messages."""
    values = (robot.t, robot.n, robot.b_hat, robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x)
    return (*values, replace(robot.counters, rejected=0))


# --- Observations ----------------------------------------------------------------------------------------


@of_every_kind
def test_before_the_first_observation(kind: AnyType) -> None:
    """t = 0: x_hat = 1/2, alpha = 0; rounds without messages change nothing of that."""
    robot = new(kind)
    for _ in range(3):
        assert (robot.t, robot.n, robot.x_hat, robot.alpha) == (0, 0, 0.5, 0.0)
        assert (robot.x_bar, robot.beta, robot.x, robot.counters) == (0.5, 0.0, 0.5, Counters())
        assert robot.settle() == Status.OK


@of_every_kind
@pytest.mark.parametrize("b_hat", [0.75, 0.95, 0.3, EPSILON, 1 - EPSILON, 0.5 + DISTANCE])
@pytest.mark.parametrize(
    ("black", "white"), [(0, 1), (1, 0), (0, 40), (40, 0), (1, 40), (40, 1), (20, 20), (13, 27)]
)
def test_estimates_of_few_observations(kind: AnyType, b_hat: float, black: int, white: int) -> None:
    """n = 0, n = t, n = t / 2 and between, b_hat at both clamps and below 1/2."""
    robot = new(kind, b_hat=b_hat)
    watch(robot, black, white)
    assert (robot.n, robot.t) == (black, black + white)
    check_estimate(robot, black, black + white, b_hat)


@of_every_kind
@pytest.mark.parametrize("b_hat", [0.75, 0.1875, 0.5625, 1 - 2.0**-14, EPSILON, 0.5 - DISTANCE])
def test_half_blacks_are_one_half_exactly(kind: AnyType, b_hat: float) -> None:
    robot = new(kind, b_hat=b_hat)
    for _ in range(50):
        watch(robot, 1, 1)
        assert robot.x_hat == 0.5


@of_every_kind
def test_x_hat_is_exact_where_its_format_can_be(kind: AnyType) -> None:
    """(3/8 - 1/4) / (1/2) = 1/4, and its mirror image."""
    robot = new(kind)
    watch(robot, 3, 5)
    assert robot.x_hat == 0.25
    watch(robot, 7, 1)
    assert (robot.n, robot.x_hat) == (10, 0.75)


@of_every_kind
def test_rounds_without_an_observation_keep_the_own_estimate(kind: AnyType) -> None:
    """A tick without an observation does not call observe(): t, n, x_hat and alpha stay, rounds go on."""
    robot = new(kind)
    watch(robot, 1, 2)
    before = robot.t, robot.n, robot.x_hat, robot.alpha
    for x_bar in (0.25, 0.75, 0.125):
        hear(robot, x_bar)
        assert robot.settle() == Status.OK
        assert (robot.x_bar, robot.beta) == (x_bar, 1.0)
        assert (robot.t, robot.n, robot.x_hat, robot.alpha) == before


@of_every_kind
@pytest.mark.parametrize("z", [2, 3, -1, 255, 2**32, 2**40])
def test_what_is_no_colour_changes_nothing(kind: AnyType, z: int) -> None:
    """2 among them, which means no observation on the bus: the firmware is not asked then."""
    robot = new(kind)
    watch(robot, 1, 0)
    before = view(robot)
    wrong: Observation = z  # type: ignore[assignment]
    assert robot.observe(wrong) == robot.step(wrong) == Status.ERR_OBSERVATION
    assert view(robot) == before


@of_every_kind
def test_an_error_settles_nothing(kind: AnyType) -> None:
    """step() with a wrong observation closes no round, and is none to the filter."""
    robot = new(kind, replace(ALWAYS, filter_period=2))
    watch(robot, 3, 1)
    robot.receive(1, 0.25, 1.0)
    assert robot.step(2) == robot.step(3) == Status.ERR_OBSERVATION  # type: ignore[arg-type]
    assert (robot.beta, robot.t) == (0, 4)
    assert robot.settle() == Status.OK
    assert robot.beta == 1
    robot.receive(1, 0.25, 1.0)
    assert robot.settle() == Status.UPDATED, "the second round"


# --- The halving -----------------------------------------------------------------------------------------


@of_every_kind
@pytest.mark.parametrize("black", range(65))
def test_halving_rounds_to_nearest_ties_to_even(kind: AnyType, black: int) -> None:
    """At t = 64 = memory; then the estimate is of 32 observations."""
    robot = new(kind, replace(PLAIN, memory=64))
    watch(robot, black, 64 - black)
    assert (robot.t, robot.n) == (32, round(Fraction(black, 2)))
    check_estimate(robot, robot.n, 32, 0.75)


@of_every_kind
def test_memory_is_used_again_and_again(kind: AnyType) -> None:
    robot, counts = new(kind, replace(PLAIN, memory=68)), []
    for _ in range(200):
        robot.observe(BLACK)
        assert robot.n == robot.t
        counts.append(robot.t)
    assert max(counts) == 67 and counts[67:69] == [34, 35] and counts.count(34) == 1 + 1 + (200 - 68) // 34


@of_every_kind
@pytest.mark.parametrize("memory", [64, 68, 100])
@pytest.mark.parametrize("every", [2, 3, 5, 7])
def test_halving_mirrors_the_colours(kind: AnyType, memory: int, every: int) -> None:
    """n and t - n halve to numbers that still add up to t, for memory is a multiple of 4."""
    robot, other = (new(kind, replace(PLAIN, memory=memory)) for _ in range(2))
    for tick in range(4 * memory):
        z = Observation(tick % every == 0)
        robot.observe(z)
        other.observe(Observation(1 - z))
        assert robot.n + other.n == robot.t == other.t
        assert robot.x_hat == pytest.approx(1 - other.x_hat, abs=1e-15)


@of_fixed_point
@pytest.mark.parametrize(
    ("n", "z", "halved"),
    [(0, 0, 0), (2**31 - 1, 1, 2**30), (5, 0, 2), (5, 1, 3), (6, 1, 4), (2**31 - 6, 0, 2**30 - 3)],
)
def test_halving_at_the_largest_memory(kind: FixedPointType, n: int, z: int, halved: int) -> None:
    """And the other colour's number, with which it makes 2**31, is halved to what is left of 2**30."""
    for black, seen, left in ((n, z, halved), (2**31 - 1 - n, 1 - z, 2**30 - halved)):
        robot = robot_at(kind, t=2**31 - 1, n=black)
        robot.observe(Observation(seen))
        assert (robot.t, robot.n) == (2**30, left)
        check_estimate(robot, left, 2**30, 0.75)


@of_fixed_point
@pytest.mark.parametrize("t", [2**30 - 1, 2**30, 2**30 + 1, 3 * 2**29 + 1, 2**31 - 2, 2**31 - 1])
@pytest.mark.parametrize("share", [Fraction(0), Fraction(1, 4), Fraction(1, 3), Fraction(1, 2), Fraction(1)])
@pytest.mark.parametrize("b_hat", [0.75, 0.1, 0.5 + DISTANCE, 1 - EPSILON])
def test_estimates_where_t_fills_its_word(
    kind: FixedPointType, t: int, share: Fraction, b_hat: float
) -> None:
    n = math.ceil(t * share)
    robot = robot_at(kind, t=t - 1, n=n - (n > 0), b_hat=round(b_hat * 2**32))
    robot.observe(BLACK if n else WHITE)
    check_estimate(robot, n, t, b_hat)


@of_fixed_point
@pytest.mark.parametrize("z", [WHITE, BLACK])
@pytest.mark.parametrize("half", [2**29, 2**29 + 1, 3 * 2**28 + 1, 2**30 - 2, 2**30 - 1])
def test_half_of_many_blacks_are_one_half(kind: FixedPointType, half: int, z: Observation) -> None:
    """I15: half of all is its own mirror image, up to the largest t that is even."""
    for b_hat in (0.75, 0.1, 0.5 + DISTANCE, 1 - EPSILON):
        robot = robot_at(kind, t=2 * half - 1, n=half - z, b_hat=round(b_hat * 2**32))
        robot.observe(z)
        assert 2 * robot.n == robot.t == 2 * half
        assert robot.x_hat_raw == HALF


# --- Accuracies ------------------------------------------------------------------------------------------


@of_every_kind
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("off", [0.0, 2.0**-32, 2.0**-20, DISTANCE / 2, DISTANCE - 2.0**-32])
def test_a_coin_says_nothing(kind: AnyType, sign: int, off: float) -> None:
    """|2 b_hat - 1| < 2^-12: x_hat = 1/2 and alpha = 0 exactly, whatever was seen."""
    robot = new(kind, b_hat=0.5 + sign * off)
    for z in (BLACK, BLACK, WHITE, BLACK):
        robot.step(z)
        assert (robot.x_hat, robot.alpha, robot.x) == (0.5, 0.0, 0.5)
    assert (robot.t, robot.n) == (4, 3)


@of_every_kind
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("off", [DISTANCE, DISTANCE + 2.0**-32, 2 * DISTANCE])
def test_just_better_than_a_coin_says_something(kind: AnyType, sign: int, off: float) -> None:
    robot = new(kind, b_hat=0.5 + sign * off)
    watch(robot, 1, 0)
    assert robot.x_hat == (1.0 if sign > 0 else 0.0)
    assert robot.alpha > 0
    check_estimate(robot, 1, 1, 0.5 + sign * off)


@of_every_kind
@pytest.mark.parametrize("b_hat", [EPSILON, 0.0625, 0.3125, 0.5 - DISTANCE])
def test_an_inverted_sensor_sees_the_colours_exchanged(kind: AnyType, b_hat: float) -> None:
    """I16: (n, b_hat) and (t - n, 1 - b_hat) are one robot; to the bit in fixed point."""
    robot, other = new(kind, b_hat=b_hat), new(kind, b_hat=1 - b_hat)
    for z in (1, 1, 0, 1, 0, 0, 0, 1, 1, 1, 1, 0):
        robot.observe(Observation(z))
        other.observe(Observation(1 - z))
        if kind is ReferenceRobot:
            assert robot.x_hat == pytest.approx(other.x_hat, abs=1e-15)
            assert robot.alpha == pytest.approx(other.alpha, rel=1e-12)
        else:
            assert (robot.x_hat, robot.alpha, robot.x) == (other.x_hat, other.alpha, other.x)


# --- Confidences as words --------------------------------------------------------------------------------


@of_fixed_point
@pytest.mark.parametrize("b_hat", [1 - EPSILON, EPSILON])
def test_alpha_stops_at_its_largest(kind: FixedPointType, b_hat: float) -> None:
    """Many observations of a nearly perfect sensor; then fewer, where it is still below."""
    raw = round(b_hat * 2**32)
    robot = robot_at(kind, t=2**31 - 10, n=2**30, b_hat=raw)
    robot.observe(BLACK)
    assert (robot.alpha_raw, robot.alpha) == (ALPHA_MOST, 2.0**31 - 2**7)
    robot = robot_at(kind, t=2**29 - 2**16, n=2**28, b_hat=raw)
    robot.observe(BLACK)
    assert robot.alpha < 2.0**31 - 2**7
    check_estimate(robot, 2**28 + 1, 2**29 - 2**16 + 1, b_hat)


@of_fixed_point
def test_own_alpha_is_on_its_grid(kind: FixedPointType) -> None:
    """Below 1/2 the last bits are worth less than 2^-24 and go; the least is 3 units."""
    for extra in range(0, 2**20, 2**13 + 1):
        robot = kind(PLAIN, OWN_ID, 0.5 + (2**19 + extra) / 2**32)
        for _ in range(4):
            robot.observe(BLACK)
            units = exact.of_word(robot.alpha_raw) / exact.Q24
            assert units.denominator == 1 and units >= 3
            check_estimate(robot, robot.n, robot.t, robot.b_hat)


@of_fixed_point
@pytest.mark.parametrize("b_hat", [0.5 + DISTANCE, 0.51, 0.6, 0.25, 0.99, 1 - EPSILON])
def test_own_alpha_is_canonical(kind: FixedPointType, b_hat: float) -> None:
    """The word with the smallest shift, bits 7..5 clear; binary32 holds it, and gives the same word back."""
    for t in (1, 2, 3, 10, 1000, 2**20 - 1, 2**31 - 1):
        for n in {0, min(1, t - 1), t // 3, t // 2}:
            robot = robot_at(kind, t=t - 1, n=n, b_hat=round(b_hat * 2**32))
            robot.observe(WHITE)
            word = robot.alpha_raw
            assert word == exact.to_word(exact.of_word(word))
            assert word >> 31 or word & 0xFF == 0
            (carried,) = struct.unpack("<f", struct.pack("<f", robot.alpha))
            assert carried == robot.alpha == exact.of_word(word)
            assert alpha_to_word(carried) == word


RECEIVED = {
    0x00000000: 0,
    0x0000001F: 0,
    0x000000FF: 0,
    0x00000100: 1,
    0x000001E0: 1,
    0x00000101: 2,
    0x00000200: 2,
    0x00000118: 2**24,
    0x7FFFFF00: 2**23 - 1,
    0x80000000: 2**23,
    0x80000001: 2**24,
    0x80000009: 2**32,
    0xFFFFFF08: 2**32 - 2**8,
    0x0000011F: 2**31,
    0x000001FF: 2**31,
    0xFFFFFF1E: 2**54 - 2**30,
    0xFFFFFF1F: 2**55 - 2**31,
    0xFFFFFFFF: 2**55 - 2**31,
}
"""Words of a received alpha and the units of 2^-24 that they are worth: a mantissa of 0 says nothing whatever
the shift, bits 7..5 are ignored, and no word is too large."""


@of_fixed_point
@pytest.mark.parametrize(("word", "units"), RECEIVED.items())
def test_every_word_is_a_confidence(kind: FixedPointType, word: int, units: int) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    assert robot.receive_raw(1, ONE, word) == Status.OK
    assert robot.state()["open_count"] == (units > 0)
    robot.settle()
    assert robot.beta_raw == units == exact.of_word(word) / exact.Q24
    assert word_to_alpha(word) == exact.of_word(word)
    assert robot.x_bar_raw == (ONE if units else HALF)
    assert robot.counters == Counters(accepted=1)


@of_fixed_point
@pytest.mark.parametrize("word", [0, 0x1F, 0x100, ALPHA_ONE, 0x8000031D, ALPHA_MOST])
def test_bits_7_to_5_of_a_word_are_ignored(kind: FixedPointType, word: int) -> None:
    states = []
    for ignored in range(8):
        robot = kind(PLAIN, OWN_ID, 0.75)
        robot.receive_raw(1, HALF + 5, word | ignored << 5)
        states.append(robot.state())
    assert all(state == states[0] for state in states)


@of_fixed_point
@pytest.mark.parametrize("alpha", [-1, 2**32, 2**32 + ALPHA_ONE, 2**64])
def test_what_is_no_word_raises_and_changes_nothing(kind: FixedPointType, alpha: int) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    before = robot.state()
    with pytest.raises(ValueError, match="alpha is"):
        robot.receive_raw(1, HALF, alpha)
    assert robot.state() == before


@of_fixed_point
@pytest.mark.parametrize(
    "alpha",
    [
        *(
            0.0,
            5e-324,
            2.0**-25,
            2.0**-24 * (1 - 2.0**-53),
            2.0**-24,
            2.0**-24 * 1.75,
            1e-3,
            0.1,
            0.5 - 2.0**-50,
        ),
        *(1.0, 1.0 + 2.0**-24, 1000.7, 2.0**31 - 2**7 - 1, 2.0**31 - 2**7, 2.0**31 - 1, 2.0**31, 1e300),
    ],
)
def test_floats_are_rounded_down_to_the_grid(kind: FixedPointType, alpha: float) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    assert robot.receive(1, 1.0, alpha) == Status.OK
    robot.settle()
    assert robot.beta_raw * exact.Q24 == exact.alpha_on_grid(Fraction(alpha))
    assert alpha_to_word(alpha) == exact.to_word(exact.alpha_on_grid(Fraction(alpha)))


# --- Messages --------------------------------------------------------------------------------------------

REFUSED = {
    Status.ERR_SENDER: [
        (OWN_ID, 0.5, 1.0),
        (128, 0.5, 1.0),
        (-1, 0.5, 1.0),
        (300, 0.5, 1.0),
        (128, 2.0, 0.0),
    ],
    Status.ERR_X_HAT: [
        (1, 1.0001, 1.0),
        (1, -0.1, 1.0),
        (1, math.nan, 1.0),
        (1, math.inf, 1.0),
        (1, 2.0, 0.0),
    ],
}


@of_every_kind
@pytest.mark.parametrize(("status", "message"), [(s, m) for s, rows in REFUSED.items() for m in rows])
def test_invalid_messages_count_and_change_nothing(
    kind: AnyType, status: Status, message: tuple[int, float, float]
) -> None:
    robot = new(kind)
    watch(robot, 2, 1)
    robot.receive(1, 0.25, 4.0)
    before = view(robot)
    sender, x_hat, _ = message
    wrong = f"sender is {sender};" if status == Status.ERR_SENDER else f"x_hat is {x_hat};"
    with pytest.raises(FirmwareError, match=re.escape(wrong)) as refused:
        robot.receive(*message)
    assert refused.value.status == status
    assert view(robot) == before
    assert robot.counters.rejected == 1
    following = message[0] % 128 + 1
    assert status_of_receive(robot, following, 0.5, 1.0) != Status.OK or robot.counters.accepted == 2


@of_every_kind
def test_a_robot_shows_its_state(kind: AnyType) -> None:
    robot = new(kind, b_hat=0.75)
    watch(robot, 3, 1)
    name = kind.__name__
    assert repr(robot) == f"<{name} {OWN_ID}: t=4 n=3 b_hat=0.75 x_hat=1 alpha=5.33333 x=1>"
    assert robot.id == OWN_ID


@of_every_kind
@pytest.mark.parametrize("alpha", [-0.0, -1.0, -1e-40, -5e-324, -1e300, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("sender", "x_hat"), [(1, 0.5), (OWN_ID, 0.5), (1, 2.0)])
def test_what_is_no_confidence_raises_and_changes_nothing(
    kind: AnyType, alpha: float, sender: int, x_hat: float
) -> None:
    """Frames with such an alpha do not reach a robot; a program that passes one has a fault."""
    robot = new(kind)
    watch(robot, 2, 1)
    before, counters = view(robot), robot.counters
    with pytest.raises(ValueError, match="alpha is"):
        robot.receive(sender, x_hat, alpha)
    assert (view(robot), robot.counters) == (before, counters)
    assert robot.receive(1, 0.5, 1.0) == Status.OK, "it has not been heard"


@of_fixed_point
@pytest.mark.parametrize(
    ("status", "message"),
    [
        (Status.ERR_X_HAT, (1, ONE + 1, ALPHA_ONE)),
        (Status.ERR_X_HAT, (1, 2**32 - 1, 2**32 - 1)),
        (Status.ERR_X_HAT, (1, 2**40, ALPHA_ONE)),
        (Status.ERR_X_HAT, (1, -1, ALPHA_ONE)),
        (Status.ERR_SENDER, (OWN_ID, 0, 0)),
        (Status.ERR_SENDER, (128, ONE + 1, ALPHA_ONE)),
        (Status.ERR_SENDER, (256 + 1, 0, ALPHA_ONE)),
    ],
)
def test_invalid_raw_messages_change_no_bit(
    kind: FixedPointType, status: Status, message: tuple[int, int, int]
) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    watch(robot, 2, 1)
    robot.receive_raw(1, 7, ALPHA_ONE)
    before = robot.state()
    assert robot.receive_raw(*message) == status
    assert robot.state() == {**before, "rejected": 1}


@of_every_kind
@pytest.mark.parametrize("alpha", [0.0, 5e-324, 2.0**-24, 2.0**31 - 2**7, 2.0**31, (2 - 2.0**-23) * 2.0**127])
def test_any_confidence_is_taken(kind: AnyType, alpha: float) -> None:
    robot = new(kind)
    assert robot.receive(1, 0.5, alpha) == Status.OK
    assert robot.counters == Counters(accepted=1), "counted when it is received"


@of_every_kind
def test_the_first_message_of_a_sender_counts(kind: AnyType) -> None:
    robot = new(kind)
    assert robot.receive(1, 0.25, 1.0) == Status.OK
    assert robot.receive(1, 0.75, 9.0) == Status.REPEATED
    robot.settle()
    assert (robot.x_bar, robot.beta) == (0.25, 1.0)
    assert robot.receive(1, 0.75, 9.0) == Status.OK, "a new round has begun"
    robot.settle()
    assert (robot.x_bar, robot.beta) == (0.75, 9.0)
    assert robot.counters == Counters(accepted=2, repeated=1)


@of_every_kind
def test_a_message_without_confidence_was_heard(kind: AnyType) -> None:
    """It is accepted, and the sender's next one a repeat; it enters no sum and is none of the m."""
    robot = new(kind, ADAPTIVE)
    watch(robot, 8, 0)
    assert [robot.receive(sender, 0.0, 0.0) for sender in (1, 2, 3)] == [Status.OK] * 3
    assert robot.receive(1, 0.0, 9.0) == Status.REPEATED
    hear(robot, 0.0)
    assert robot.settle() == Status.OK
    assert (robot.x_bar, robot.beta) == (0.0, 1.0)
    assert robot.counters == Counters(accepted=4, repeated=1), "no test with m = 1"


@of_every_kind
def test_every_id_but_the_own_is_a_sender(kind: AnyType) -> None:
    """m = 127, the most: ids 0 and 127 and those at the ends of words included."""
    robot = new(kind)
    statuses = [status_of_receive(robot, sender, 0.5, 1.0) for sender in range(128)]
    assert [i for i, status in enumerate(statuses) if status != Status.OK] == [OWN_ID]
    assert {robot.receive(sender, 0.5, 1.0) for sender in range(128) if sender != OWN_ID} == {Status.REPEATED}
    robot.settle()
    assert (robot.beta, robot.x_bar) == (127.0, 0.5)
    assert robot.counters == Counters(accepted=127, repeated=127, rejected=1)


@of_every_kind
def test_the_order_of_messages_does_not_matter(kind: AnyType) -> None:
    """I12, over all orders of five messages whose float64 sums would depend on it."""
    messages = [(1, 0.125, 3e-7), (2, 0.9, 1e9), (3, 0.3, 12345.678), (4, 1.0, 0.0), (127, 0.0, 1.5)]
    results = set()
    for order in itertools.permutations(messages):
        robot = new(kind)
        watch(robot, 2, 1)
        for message in order:
            robot.receive(*message)
        robot.step(BLACK)
        results.add(view(robot))
    assert len(results) == 1


# --- Rounds ----------------------------------------------------------------------------------------------


@of_every_kind
def test_x_bar_is_undefined_without_confidence(kind: AnyType) -> None:
    """No message, or none with alpha > 0: beta = 0, x_bar reads 1/2, x = x_hat; nothing of the last round."""
    robot = new(kind)
    watch(robot, 3, 5)
    robot.receive(1, 0.875, 64.0)
    robot.settle()
    assert (robot.x_bar, robot.beta) == (0.875, 64.0) and robot.x > robot.x_hat
    robot.settle()
    assert (robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, robot.x_hat)
    robot.receive(1, 0.875, 0.0)
    robot.receive(2, 0.0, 0.0)
    robot.settle()
    assert (robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, robot.x_hat)
    assert robot.counters.accepted == 3


@of_every_kind
def test_all_confidences_zero(kind: AnyType) -> None:
    """Own and neighbours': x = x_hat = 1/2."""
    robot = new(kind, b_hat=0.5)
    watch(robot, 3, 0)
    robot.receive(1, 0.875, 0.0)
    robot.step(BLACK)
    assert (robot.x_hat, robot.alpha, robot.beta, robot.x) == (0.5, 0.0, 0.0, 0.5)


@of_every_kind
def test_without_an_own_confidence_x_is_x_bar(kind: AnyType) -> None:
    robot = new(kind)
    robot.receive(1, 0.125, 0.5)
    robot.receive(2, 0.375, 1.5)
    robot.settle()
    assert robot.x == robot.x_bar == 0.3125


@of_fixed_point
@pytest.mark.parametrize("x_bar", [0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE])
def test_x_bar_at_its_ends(kind: FixedPointType, x_bar: int) -> None:
    words = (0, ALPHA_LEAST, ALPHA_ONE, ALPHA_MOST, 0x80000007)
    for start in range(5):
        robot = kind(PLAIN, OWN_ID, 0.75)
        receive_all(robot, [(sender, x_bar, word) for sender, word in enumerate(words[start:])])
        robot.settle()
        assert robot.x_bar_raw == robot.x_raw == x_bar


@of_fixed_point
def test_127_largest_messages_and_the_own(kind: FixedPointType) -> None:
    """I7: the sums keep below 2^62, and x is still the exact mean."""
    robot = robot_at(kind, t=2**31 - 10, n=2**30, b_hat=2**32 - 2**12)
    robot.observe(BLACK)
    receive_all(robot, [(sender, ONE, ALPHA_MOST) for sender in range(128)])
    robot.settle()
    assert robot.alpha_raw == ALPHA_MOST
    assert robot.beta_raw == 127 * (2**55 - 2**31) < 2**62
    assert robot.x_raw == (127 * ONE + robot.x_hat_raw) // 128
    assert robot.holds_invariants()


@of_every_kind
def test_a_round_lasts_until_settle(kind: AnyType) -> None:
    """Whatever is observed or heard meanwhile: x_bar and beta are of the last one that closed."""
    robot = new(kind)
    seen = []
    for tick in range(1, 10):
        assert robot.observe(BLACK) == Status.OK
        assert robot.receive(1, tick / 16, 1.0) == (Status.OK if tick in (1, 4, 7) else Status.REPEATED)
        if tick % 3 == 0:
            robot.settle()
        seen.append(robot.x_bar)
    assert seen == [0.5, 0.5, 1 / 16, 1 / 16, 1 / 16, 4 / 16, 4 / 16, 4 / 16, 7 / 16]
    assert robot.t == 9


@of_every_kind
def test_x_follows_the_own_estimate_between_rounds(kind: AnyType) -> None:
    """x is of the present x_hat and alpha and the last closed round: it moves with each observation, and not
    with messages until their round closes."""
    robot = new(kind)
    watch(robot, 2, 3)
    hear(robot, 0.875, 0.625, alpha=4.0)
    robot.settle()
    hear(robot, 0.125)
    seen = []
    for z in (BLACK, WHITE, BLACK, WHITE, WHITE):
        robot.observe(z)
        own = Fraction(robot.x_hat), Fraction(robot.alpha)
        mean = exact.weighted_mean([own, (Fraction(3, 4), Fraction(8))])
        assert robot.x == (
            pytest.approx(float(mean)) if kind is ReferenceRobot else exact.floor_to(mean, exact.Q23)
        )
        seen.append(robot.x)
    assert len(set(seen)) == 5
    robot.settle()
    assert robot.x_bar == 0.125 and robot.x != seen[-1]


@of_every_kind
def test_a_settle_without_messages_is_a_round(kind: AnyType) -> None:
    """It empties the social values, and the filter counts it."""
    robot = new(kind, replace(ALWAYS, filter_period=3))
    watch(robot, 7, 1)
    hear(robot, 0.25)
    assert robot.settle() == Status.OK
    assert robot.beta == 1.0
    assert robot.settle() == Status.OK
    assert (robot.x_bar, robot.beta, robot.x) == (0.5, 0.0, robot.x_hat)
    hear(robot, 0.25)
    assert robot.settle() == Status.UPDATED


@of_every_kind
def test_step_is_observe_then_settle(kind: AnyType) -> None:
    config = replace(ALWAYS, filter_period=2, memory=64)
    robot, other = new(kind, config), new(kind, config)
    found = set()
    for tick in range(300):
        z = Observation(tick * 7 % 3 % 2)
        for each in (robot, other):
            each.receive(tick % 11 + 6, tick % 17 / 16, 0.75)
        assert other.observe(z) == Status.OK
        status = robot.step(z)
        assert status == other.settle()
        assert view(robot) == view(other)
        found.add(status)
    assert found == {Status.OK, Status.UPDATED}


# --- The filter ------------------------------------------------------------------------------------------


def meet(robot: Robot, *estimates: float) -> Status:
    """A round of messages with these estimates."""
    hear(robot, *estimates)
    return robot.settle()


@of_every_kind
@pytest.mark.parametrize(
    "x_bar",
    [
        0.0,
        2.0**-23,
        0.25,
        0.5 - DISTANCE - 2.0**-23,
        0.5 + DISTANCE + 2.0**-23,
        0.55,
        0.8125,
        1 - 2.0**-23,
        1.0,
    ],
)
@pytest.mark.parametrize("black", [0, 1, 4, 7, 8])
def test_an_update_is_eq_8(kind: AnyType, x_bar: float, black: int) -> None:
    """Both clamps among them: x_bar = 0 and 1 with n = 0 and t, x_bar near 1/2 with any n but t / 2."""
    robot = new(kind, ALWAYS)
    watch(robot, black, 8 - black)
    assert meet(robot, x_bar) == Status.UPDATED
    assert robot.counters.updates == 1
    if kind is ReferenceRobot:
        assert abs(robot.b_hat - exact.b_hat(black, 8, Fraction(x_bar))) < 1e-11
    else:
        least, most = exact.b_hat_limits(black, 8, Fraction(robot.x_bar))
        assert least <= robot.b_hat <= most


@of_every_kind
@pytest.mark.parametrize("config", [ALWAYS, ADAPTIVE])
@pytest.mark.parametrize("off", [0.0, 2.0**-23, DISTANCE / 2, DISTANCE - 2.0**-23])
@pytest.mark.parametrize("sign", [-1, 1])
def test_an_x_bar_that_says_nothing_updates_nothing(
    kind: AnyType, config: Config, off: float, sign: int
) -> None:
    """|2 x_bar - 1| < 2^-12; the test counts as run all the same."""
    robot = new(kind, config)
    watch(robot, 8, 0)
    assert meet(robot, 0.5 + sign * off, 0.5 + sign * off) == Status.OK
    assert (robot.b_hat, robot.counters.updates) == (0.75, 0)
    assert robot.counters.tests == (config.filter == Filter.ADAPTIVE)


@of_every_kind
def test_an_undefined_x_bar_updates_nothing(kind: AnyType) -> None:
    robot = new(kind, ALWAYS)
    watch(robot, 8, 0)
    robot.receive(1, 1.0, 0.0)
    assert robot.settle() == Status.OK
    assert meet(robot) == Status.OK
    assert (robot.b_hat, robot.counters.updates) == (0.75, 0)


@of_every_kind
@pytest.mark.parametrize("config", [ALWAYS, ADAPTIVE])
def test_without_observations_there_is_no_filter(kind: AnyType, config: Config) -> None:
    """Rounds count all the same: the one after the filter's turn is the first of the next period."""
    robot = new(kind, replace(config, filter_period=2))
    assert meet(robot, 0.0, 0.0, 0.0) == meet(robot, 0.0, 0.0, 0.0) == Status.OK
    assert robot.counters == Counters(accepted=6)
    watch(robot, 8, 0)
    assert meet(robot, 0.0, 0.0, 0.0) == Status.OK
    assert meet(robot, 0.0, 0.0, 0.0) == Status.UPDATED


@of_every_kind
def test_rounds_before_the_first_observation_count(kind: AnyType) -> None:
    robot = new(kind, replace(ALWAYS, filter_period=3))
    meet(robot, 0.0)
    meet(robot)
    watch(robot, 8, 0)
    assert meet(robot, 0.0) == Status.UPDATED


@of_every_kind
def test_off_never_updates(kind: AnyType) -> None:
    robot = new(kind, replace(PLAIN, filter_period=1))
    watch(robot, 8, 0)
    assert meet(robot, 0.0, 0.0, 0.0) == Status.OK
    assert (robot.b_hat, robot.counters) == (0.75, Counters(accepted=3))


@of_every_kind
def test_always_asks_no_test(kind: AnyType) -> None:
    """m = 1 is enough, and equal estimates are."""
    robot = new(kind, ALWAYS)
    watch(robot, 8, 0)
    assert meet(robot, 1.0) == Status.UPDATED
    assert robot.counters == Counters(accepted=1, updates=1)


@of_every_kind
@pytest.mark.parametrize("estimates", [(), (0.0,)])
def test_fewer_than_two_messages_are_no_test(kind: AnyType, estimates: tuple[float, ...]) -> None:
    robot = new(kind, ADAPTIVE)
    watch(robot, 8, 0)
    robot.receive(100, 0.0, 0.0)  # says nothing, so is none of the m
    robot.receive(101, 0.0, 0.0)
    assert meet(robot, *estimates) == Status.OK
    assert (robot.counters.tests, robot.counters.updates) == (0, 0)


@of_every_kind
@pytest.mark.parametrize("m", [2, 4, 5, 127])
def test_agreement_rejects_nothing(kind: AnyType, m: int) -> None:
    """S = 0 and all equal to the own estimate: eq. 12 is strict."""
    robot = new(kind, ADAPTIVE)
    watch(robot, 3, 5)
    for sender in [i for i in range(128) if i != OWN_ID][:m]:
        robot.receive(sender, robot.x_hat, 1.0)
    assert robot.settle() == Status.OK
    assert (robot.b_hat, robot.counters.updates) == (0.75, 0)
    assert robot.counters.tests == 1


@of_fixed_point
@pytest.mark.parametrize("off", [-1, 1])
def test_the_least_difference_from_an_agreement_rejects(kind: FixedPointType, off: int) -> None:
    robot = robot_at(kind, ADAPTIVE, t=8, n=3, x_hat=HALF // 2, alpha=ALPHA_ONE)
    receive_all(robot, [(1, HALF // 2 + off, ALPHA_ONE), (2, HALF // 2 + off, ALPHA_ONE)])
    assert robot.settle() == Status.UPDATED


def spread_out(m: int) -> list[int]:
    """m estimates of two kinds, as even as can be."""
    return [HALF // 2 + (i % 2) * 2**15 for i in range(m)]


def decides(kind: FixedPointType, own: int, xs: list[int]) -> bool:
    """True if a robot of this x_hat that hears these estimates re-estimates b_hat."""
    robot = robot_at(kind, ADAPTIVE, t=8, n=3, x_hat=own, alpha=ALPHA_ONE)
    receive_all(
        robot, [(s, x, ALPHA_ONE) for s, x in zip((i for i in range(128) if i != OWN_ID), xs, strict=False)]
    )
    status = robot.settle()
    assert robot.counters.tests == 1
    return status == Status.UPDATED


@of_fixed_point
@pytest.mark.parametrize(("m", "k"), [(2, 9), (3, 4), (4, 2), (5, 1), (6, 1), (127, 1)])
def test_the_entry_for_m_decides(kind: FixedPointType, m: int, k: int) -> None:
    """m = 2, q - 1, q, q + 1 and 127 for q = 4: on both sides of the threshold, to the bit."""
    xs = spread_out(m)
    entry = Fraction(TABLE.entries[min(m, 5) - 2], 1 << 26)
    assert round(entry) == k
    low, high = min(xs), ONE
    while high - low > 1:  # where exact arithmetic turns from "as the others" to "differs"
        middle = (low + high) // 2
        differs = exact.rejects(middle * exact.Q23, [x * exact.Q23 for x in xs], entry)
        low, high = (low, middle) if differs else (middle, high)
    assert not decides(kind, low, xs)
    assert decides(kind, high, xs)


@of_every_kind
@pytest.mark.parametrize("period", [1, 2, 3, 7])
def test_the_filter_runs_every_filter_period(kind: AnyType, period: int) -> None:
    """Rounds, not observations; the first time after that many, on the round that closes then."""
    robot = new(kind, replace(ALWAYS, filter_period=period))
    statuses = []
    for number in range(1, 22):
        watch(robot, number % 3, 1)
        statuses.append(meet(robot, 0.9375 - number / 64))
    updated = [number for number, status in enumerate(statuses, 1) if status == Status.UPDATED]
    assert updated == list(range(period, 22, period))
    assert robot.counters.updates == len(updated)


@of_fixed_point
@pytest.mark.parametrize("mode", [Filter.ALWAYS, Filter.OFF])
def test_the_longest_filter_period(kind: FixedPointType, mode: Filter) -> None:
    """2^32 - 1 rounds, counted down whatever the filter does."""
    config = Config(filter=mode, filter_period=MAX_FILTER_PERIOD)
    robot = kind(config, OWN_ID, 0.75)
    assert robot.state()["filter_left"] == 2**32 - 1
    assert meet(robot, 0.25) == Status.OK
    assert robot.state()["filter_left"] == 2**32 - 2
    robot = robot_at(kind, config, t=8, n=8, filter_left=2)
    assert meet(robot, 0.25) == Status.OK
    assert meet(robot, 0.25) == (Status.UPDATED if mode == Filter.ALWAYS else Status.OK)
    assert robot.state()["filter_left"] == 2**32 - 1


@of_every_kind
def test_the_test_takes_the_round_that_closes(kind: AnyType) -> None:
    """Not one before: agreement in the round that closes at tau stands against earlier disagreement."""
    robot = new(kind, replace(ADAPTIVE, filter_period=2))
    watch(robot, 3, 5)
    meet(robot, 1.0, 1.0)
    assert meet(robot, 0.25, 0.25) == Status.OK
    meet(robot, 0.25, 0.25)
    assert meet(robot, 1.0, 1.0) == Status.UPDATED
    assert robot.counters.tests == 2


@of_every_kind
def test_a_new_accuracy_shows_at_the_next_observation(kind: AnyType) -> None:
    """Until then the robot broadcasts, tests and uses what it has: x is of the old alpha, too."""
    robot = new(kind, ALWAYS)
    watch(robot, 6, 2)
    before = robot.x_hat, robot.alpha
    assert meet(robot, 0.9375) == Status.UPDATED
    b_hat, x = robot.b_hat, (robot.alpha * robot.x_hat + 0.9375) / (robot.alpha + 1)
    assert (robot.x_hat, robot.alpha) == before and b_hat != 0.75
    assert robot.x == pytest.approx(x, abs=2.0**-23)
    robot.settle()
    assert (robot.x_hat, robot.alpha, robot.b_hat) == (*before, b_hat)
    robot.observe(BLACK)
    check_estimate(robot, 7, 9, b_hat)


# --- Counters --------------------------------------------------------------------------------------------


@of_fixed_point
def test_counters_wrap(kind: FixedPointType) -> None:
    """I18: each from 65534 over 65535 to 0 and on, and no other with it."""
    names = ("accepted", "repeated", "rejected", "tests", "updates")
    robot = robot_at(kind, ADAPTIVE, t=8, n=3, x_hat=0, alpha=ALPHA_ONE, **dict.fromkeys(names, 65534))
    for rounds in (1, 2, 3):
        receive_all(robot, [(1, ONE, ALPHA_ONE), (2, ONE, ALPHA_ONE)])
        receive_all(robot, [(1, ONE, ALPHA_ONE), (OWN_ID, ONE, ALPHA_ONE)])
        assert robot.settle() == Status.UPDATED
        expected = [65534 + rounds * step for step in (2, 1, 1, 1, 1)]
        assert [*astuple(robot.counters)] == [value % 65536 for value in expected]
        assert robot.holds_invariants()


@of_fixed_point
def test_a_whole_round_at_once_wraps_accepted(kind: FixedPointType) -> None:
    robot = robot_at(kind, accepted=65535)
    robot.add_round(Sums(), 127)
    assert robot.counters == Counters(accepted=126)


# --- Saving ----------------------------------------------------------------------------------------------


def busy_robot(kind: FixedPointType) -> FixedPoint:
    """In the middle of a round, with something in every field of the state."""
    robot = kind(replace(ADAPTIVE, filter_period=4), OWN_ID, 0.7)
    for tick in range(41):
        robot.observe(Observation(tick % 3 == 1))
        receive_all(
            robot, [(i * 13 % 128, 5 * 2**20 + 2**17 * i, 0x80000001 + 259 * i) for i in range(tick % 7)]
        )
        receive_all(robot, [(9, 5, 0), (OWN_ID, 5, 0), (9, 5, 0)])
        if tick % 2:
            robot.settle()
    robot.settle()
    receive_all(
        robot, [(3, 2**21, 0x80123417), (40, 2**21 + 9, 0xFF123417), (70, 3, 0x80000007), (127, 7, 0)]
    )
    return robot


@of_fixed_point
def test_an_image_holds_every_field(kind: FixedPointType) -> None:
    """The image is the one docs/design.md describes, field by field."""
    robot = busy_robot(kind)
    image, state = robot.save(), robot.state()
    found = unpack(image)
    assert len(image) == IMAGE_SIZE == 124
    assert found.pop("magic") == 0x4D435302, "version 2"
    assert found.pop("b_hat") == state["accuracy_b_hat"]
    assert found == {name: value for name, value in state.items() if not name.startswith("accuracy_")}
    assert pack(unpack(image)) == image
    assert [name for name, value in found.items() if not value] == ["updated"], "the others can be told apart"


@pytest.mark.parametrize(("source", "target"), list(itertools.product(FIXED_POINT, repeat=2)))
def test_images_are_the_same_everywhere(source: FixedPointType, target: FixedPointType) -> None:
    robot = busy_robot(source)
    restored = target.restore(robot.config, robot.save())
    assert restored.state() == robot.state()
    assert restored.save() == robot.save()


MOMENTS = [
    "new",
    "observed",
    "open round",
    "closed",
    "halved",
    "updated",
    "updated, open round",
    "nothing said",
]


def robot_at_moment(kind: FixedPointType, moment: str) -> FixedPoint:
    robot = kind(replace(ALWAYS, filter_period=2, memory=64), OWN_ID, 0.8)
    ticks = {"new": 0, "halved": 64}.get(moment, 12)
    for tick in range(ticks):
        robot.receive_raw(9, 2**21 + tick, ALPHA_ONE)
        robot.observe(BLACK if tick % 3 else WHITE)
        if tick % 2:
            robot.settle()
    if moment not in ("new", "halved", "updated", "updated, open round"):
        robot.observe(WHITE)
    if "open round" in moment:
        receive_all(robot, [(1, 3, ALPHA_ONE), (127, ONE, ALPHA_MOST)])
    if moment == "closed":
        robot.settle()
    if moment == "nothing said":
        receive_all(robot, [(1, 3, 0), (2, 3, 0x1F)])
    return robot


@of_fixed_point
@pytest.mark.parametrize("moment", MOMENTS)
def test_restored_at_any_moment_it_goes_on_the_same(kind: FixedPointType, moment: str) -> None:
    """I17"""
    robot = robot_at_moment(kind, moment)
    copy = kind.restore(robot.config, robot.save())
    assert (moment == "halved") == (robot.t == 32)
    assert robot.state()["updated"] == moment.startswith(("updated", "halved"))
    for tick in range(70):
        assert copy.state() == robot.state()
        assert copy.holds_invariants()
        for each in (robot, copy):
            receive_all(each, [(tick % 5, 2**22 + 2**14 * tick, ALPHA_ONE), (1, 0, ALPHA_MOST)])
        if tick % 4:
            assert copy.observe(Observation(tick % 3 == 1)) == robot.observe(Observation(tick % 3 == 1))
        assert copy.settle() == robot.settle()
        assert copy.x_raw == robot.x_raw


def check_refused(kind: FixedPointType, config: Config, image: bytes) -> None:
    with pytest.raises(FirmwareError) as caught:
        kind.restore(config, image)
    assert caught.value.status == Status.ERR_IMAGE


@of_fixed_point
def test_every_flipped_bit_of_an_image_is_refused(kind: FixedPointType) -> None:
    """I17"""
    robot = busy_robot(kind)
    image = robot.save()
    for bit in range(8 * len(image)):
        damaged = bytearray(image)
        damaged[bit // 8] ^= 1 << bit % 8
        check_refused(kind, robot.config, bytes(damaged))
    assert robot.save() == image


@of_fixed_point
def test_images_of_another_size_or_make_are_refused(kind: FixedPointType) -> None:
    robot = busy_robot(kind)
    image = robot.save()
    for size in (0, 4, 120, 123):
        check_refused(kind, robot.config, image[:size])
    check_refused(kind, robot.config, image + b"\0")
    check_refused(kind, robot.config, bytes(124))
    check_refused(kind, robot.config, b"\xff" * 124)
    check_refused(kind, robot.config, image[::-1])
    for magic in (0x4D435300, 0x4D435301, 0x4D435303, 0x4D435402, 0):
        check_refused(kind, robot.config, rewritten(image, magic=magic))
    check_refused(kind, robot.config, rewritten(image)[:-4] + struct.pack("<I", checksum([0])))


IMPOSSIBLE = {
    "I1": [{"id": 128}, {"id": 255}],
    "I2": [{"t": 100}, {"t": 0, "n": 1}, {"n": 2**32 - 1}, {"t": 2**32 - 1}],
    "I3": [{"b_hat": 2**12 - 1}, {"b_hat": 2**32 - 2**12 + 1}, {"b_hat": 0}],
    "I5": [
        {"x_hat": ONE + 1},
        {"x_hat": ONE + 1, "updated": 1},
        {"alpha": 0x20, "updated": 1},
        {"alpha": 0x80000080, "updated": 1},
        {"alpha": 0x00000101, "updated": 1},
        {"alpha": 0x7FFFFF1F, "updated": 1},
        {"alpha": 1, "updated": 1},
        {"x_hat": HALF + 1},
        {"alpha": 0},
        {"alpha": ALPHA_MOST},
        {"t": 42},
        {"n": 13},
        {"b_hat": 3 << 30},
        {"updated": 2},
        {"updated": 255},
        {"t": 0, "n": 0},
        {"t": 0, "n": 0, "x_hat": HALF, "alpha": 0, "updated": 1},
    ],
    "I6": [
        {"closed_alpha": 0, "closed_alpha_x_low": 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 3, "closed_alpha_x_low": 3 * ONE + 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 127 * (2**55 - 2**31) + 1},
        {"closed_alpha": 2**61, "closed_alpha_x_high": 2**53},
        {"closed_alpha": 2**61, "closed_alpha_x_low": 2**62},
    ],
    "I7": [
        {"open_alpha": 2**62},
        {"open_alpha": 2},
        {"open_x": 4 * ONE},
        {"open_x_squared": 2**53},
        {"open_x_squared": 2**40},
        {"open_alpha_x_low": 2**62},
        {"open_alpha_x_high": 2**53},
        {"open_count": 128},
        {"open_count": 0},
    ],
    "I8": [{"heard_0": 0, "heard_1": 0}, {"heard_2": 0, "heard_3": 0}, {"open_count": 5}],
    "I9": [{"heard_0": 1 << OWN_ID}, {"heard_0": 2**32 - 1}],
    "I10": [{"filter_left": 0}, {"filter_left": 5}, {"filter_left": 2**32 - 1}],
}
"""Fields of the busy robot's image that no sequence of calls can have, by the invariant they break."""


@of_fixed_point
@pytest.mark.parametrize(("invariant", "fields"), [(i, f) for i, rows in IMPOSSIBLE.items() for f in rows])
def test_impossible_states_are_refused(kind: FixedPointType, invariant: str, fields: dict[str, int]) -> None:
    """With a right checksum, so the invariants themselves must refuse."""
    robot = busy_robot(kind)
    config = replace(robot.config, memory=100)
    kind.restore(config, robot.save())
    check_refused(kind, config, rewritten(robot.save(), **fields))


@of_fixed_point
def test_after_an_update_x_hat_and_alpha_may_be_any_that_robots_form(kind: FixedPointType) -> None:
    """I5: they are of the b_hat before, which is forgotten."""
    words = (0, ALPHA_LEAST, 0x7FFFFF00, 0x80000000, ALPHA_ONE, 0x8000001F, ALPHA_MOST)
    for x_hat, alpha in itertools.product((0, 1, HALF, ONE), words):
        robot = robot_at(kind, t=8, n=3, x_hat=x_hat, alpha=alpha)
        assert robot.holds_invariants()
        assert (robot.x_hat_raw, robot.alpha_raw) == (x_hat, alpha)
        robot.observe(WHITE)
        check_estimate(robot, 3, 9, 0.75)
        assert robot.holds_invariants()


@of_fixed_point
def test_an_image_must_fit_its_new_config(kind: FixedPointType) -> None:
    robot = robot_at(kind, replace(PLAIN, filter_period=8), t=80, filter_left=8)
    image = robot.save()
    kind.restore(replace(PLAIN, filter_period=9, memory=84), image)
    check_refused(kind, replace(PLAIN, filter_period=8, memory=80), image)
    check_refused(kind, replace(PLAIN, filter_period=7), image)


# --- Sums of a round at once -----------------------------------------------------------------------------

ONE_MESSAGE = Sums(alpha=2**24, alpha_x_low=2**47, alpha_x_high=0, x_squared=2**46, x=2**23, count=1)
TWO_MESSAGES = Sums(
    alpha=2**25, alpha_x_low=3 * 2**46, alpha_x_high=0, x_squared=9 * 2**43, x=3 * 2**22, count=2
)


def check_not_added(robot: FixedPoint, sums: Sums, messages: int) -> None:
    before, image = robot.state(), robot.save()
    with pytest.raises(ValueError, match="cannot sum up to"):
        robot.add_round(sums, messages)
    assert (robot.state(), robot.save()) == (before, image)


@of_fixed_point
def test_sums_of_messages_are_taken(kind: FixedPointType) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    robot.add_round(ONE_MESSAGE, 1)
    robot.add_round(TWO_MESSAGES, 5)
    robot.add_round(Sums(), 0)
    assert robot.counters.accepted == 6
    robot.settle()
    assert (robot.beta, robot.x_bar_raw) == (3.0, ONE * 5 // 6)


@of_fixed_point
def test_the_senders_of_a_sum_are_the_lowest_ids_not_heard(kind: FixedPointType) -> None:
    """All at once is one by one from them, in every member of the state."""
    robot, other = (kind(PLAIN, 2, 0.75) for _ in range(2))
    receive_all(robot, [(1, HALF, ALPHA_ONE), (4, HALF, 0)])
    receive_all(other, [(1, HALF, ALPHA_ONE), (4, HALF, 0)])
    robot.add_round(TWO_MESSAGES, 3)
    receive_all(other, [(0, ONE, ALPHA_ONE), (3, HALF, ALPHA_ONE), (5, HALF, 0)])
    assert robot.state() == {**other.state(), "open_x_squared": other.state()["open_x_squared"] - 2**43}
    assert robot.receive_raw(5, 0, 0) == Status.REPEATED
    assert robot.receive_raw(6, 0, 0) == Status.OK


@of_fixed_point
@pytest.mark.parametrize(
    ("sums", "messages"),
    [
        (ONE_MESSAGE, 0),
        (Sums(), 128),
        (replace(ONE_MESSAGE, alpha=2**55), 1),
        (replace(ONE_MESSAGE, alpha_x_low=2**56), 1),
        (replace(ONE_MESSAGE, alpha_x_high=2**47), 1),
        (replace(ONE_MESSAGE, x_squared=2**46 + 1), 1),
        (replace(ONE_MESSAGE, x=2**23 + 1), 1),
        (replace(ONE_MESSAGE, count=0), 1),
        (replace(ONE_MESSAGE, count=128), 127),
    ],
)
def test_sums_too_large_for_their_messages_are_refused(
    kind: FixedPointType, sums: Sums, messages: int
) -> None:
    check_not_added(kind(PLAIN, OWN_ID, 0.75), sums, messages)


C_BITS = {field.name: 64 for field in fields(Sums)} | {"x": 32, "count": 32}
"""Of the members of ``mcp_asdf_open_t``."""


@of_fixed_point
@pytest.mark.parametrize("base", [Sums(), ONE_MESSAGE, TWO_MESSAGES], ids=["none", "one", "two"])
@pytest.mark.parametrize("name", C_BITS)
def test_sums_that_c_cannot_hold_are_refused(kind: FixedPointType, name: str, base: Sums) -> None:
    """I11: negative, too large, or what C would cut to a value that is right."""
    robot, right = kind(PLAIN, OWN_ID, 0.75), getattr(base, name)
    modulus = 1 << C_BITS[name]
    for wrong in (
        -1,
        -5,
        -modulus,
        right - modulus,
        right + modulus,
        modulus - 1,
        modulus,
        2**200,
        -(2**200),
    ):
        check_not_added(robot, replace(base, **{name: wrong}), max(base.count, 1))
    robot.add_round(base, base.count)


@of_fixed_point
@pytest.mark.parametrize("messages", [-1, 0, 128, 129, 256, 257, -255, 2**64 + 1])
def test_as_many_messages_as_no_round_has_are_refused(kind: FixedPointType, messages: int) -> None:
    check_not_added(kind(PLAIN, OWN_ID, 0.75), ONE_MESSAGE, messages)


@of_fixed_point
def test_a_round_has_no_more_senders_than_there_are_robots(kind: FixedPointType) -> None:
    """I8, I11: 127 besides the robot itself, heard one by one or in sums."""
    robot = kind(PLAIN, OWN_ID, 0.75)
    receive_all(robot, [(0, HALF, ALPHA_ONE), (127, HALF, 0)])
    check_not_added(robot, ONE_MESSAGE, 126)
    robot.add_round(ONE_MESSAGE, 125)
    check_not_added(robot, Sums(), 1)
    receive_all(robot, [(sender, ONE, ALPHA_ONE) for sender in range(128)])
    assert robot.counters == Counters(accepted=127, repeated=127, rejected=1)
    assert robot.holds_invariants()
    robot.settle()
    robot.add_round(Sums(), 127)


@of_fixed_point
@pytest.mark.parametrize("m", [1, 2, 5, 127])
def test_each_message_that_counts_has_confidence(kind: FixedPointType, m: int) -> None:
    """I7: m messages of x_hat = 0 with one unit of alpha each are the least, as sums and in an image."""
    robot = kind(PLAIN, OWN_ID, 0.75)
    for alpha in (0, m - 1):
        check_not_added(robot, Sums(alpha=alpha, count=m), m)
    robot.add_round(Sums(alpha=m, count=m), m)
    assert robot.holds_invariants()
    kind.restore(PLAIN, robot.save())
    check_refused(kind, PLAIN, rewritten(robot.save(), open_alpha=m - 1))


CONTRADICTIONS = {
    "mean above 1": replace(ONE_MESSAGE, alpha_x_low=2**47 + 1),
    "mean far above 1": replace(ONE_MESSAGE, alpha=1),
    "no weight": replace(ONE_MESSAGE, alpha=0),
    "mean of two above 1": replace(TWO_MESSAGES, alpha=3 * 2**23 - 1),
    "variance below 0": replace(TWO_MESSAGES, x_squared=9 * 2**43 - 1),
    "no squares": replace(TWO_MESSAGES, x_squared=0),
}
"""Sums that are each small enough for their messages, but that no messages can give together."""


@of_fixed_point
@pytest.mark.parametrize("sums", CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_contradicting_sums_are_refused(kind: FixedPointType, sums: Sums) -> None:
    """I11: no robot, no image and no round has them."""
    robot = kind(PLAIN, OWN_ID, 0.75)
    check_not_added(robot, sums, sums.count)
    robot.add_round(TWO_MESSAGES, 2)
    members = {f"open_{name}": value for name, value in vars(sums).items()}
    check_refused(kind, PLAIN, rewritten(robot.save(), **members))


# --- Settings --------------------------------------------------------------------------------------------


def check_not_made(
    kind: AnyType, status: Status, config: Config, robot_id: int = OWN_ID, b_hat: float = 0.75
) -> None:
    with pytest.raises(FirmwareError) as caught:
        kind(config, robot_id, b_hat)
    assert caught.value.status == status


@of_every_kind
@pytest.mark.parametrize(
    "wrong",
    [
        {"filter_period": 0},
        {"filter_period": -1},
        {"filter_period": 2**32},
        {"filter_period": 2**32 + 1},
        {"memory": 0},
        {"memory": -64},
        {"memory": 60},
        {"memory": 62},
        {"memory": 65},
        {"memory": 66},
        {"memory": 2**31 - 2},
        {"memory": 2**31 + 4},
        {"memory": 2**32 - 4},
        {"memory": 2**32},
        {"memory": 2**32 + 64},
        {"filter": 3},
        {"filter": -1},
        {"filter": 256},
    ],
    ids=str,
)
def test_config_errors(kind: AnyType, wrong: dict[str, int]) -> None:
    values: dict[str, object] = {"filter": Filter.OFF, **wrong}
    check_not_made(kind, Status.ERR_CONFIG, Config(**values))  # type: ignore[arg-type]


@of_every_kind
def test_the_ends_of_the_settings_are_legal(kind: AnyType) -> None:
    kind(replace(PLAIN, filter_period=2**32 - 1, memory=2**31), 127, EPSILON)
    kind(replace(PLAIN, filter_period=1, memory=64), 0, 1 - EPSILON)
    kind(replace(PLAIN, memory=68), 0, 1 - EPSILON)
    kind(replace(PLAIN, memory=2**31 - 4), 0, 1 - EPSILON)
    kind(Config(table=None, filter=Filter.ALWAYS), 1, 0.5)


@of_every_kind
@pytest.mark.parametrize("robot_id", [-1, 128, 255, 256])
def test_id_errors(kind: AnyType, robot_id: int) -> None:
    check_not_made(kind, Status.ERR_ID, PLAIN, robot_id)


@of_every_kind
@pytest.mark.parametrize(
    "b_hat", [EPSILON - 2.0**-33, 1 - EPSILON + 2.0**-33, 0.0, 1.0, -0.5, 2.0, math.nan, math.inf]
)
def test_b_hat_errors(kind: AnyType, b_hat: float) -> None:
    check_not_made(kind, Status.ERR_B_HAT, PLAIN, b_hat=b_hat)


GOOD = Table(omega_word=1 << 30, entries=(2**32 - 2, 3 << 26, (1 << 26) + 1))
BAD_TABLES = {
    "none": None,
    "omega 0": replace(GOOD, omega_word=0),
    "omega above 0.9": replace(GOOD, omega_word=MAX_OMEGA_WORD + 1),
    "q = 1": replace(GOOD, entries=GOOD.entries[:1]),
    "q = 128": replace(GOOD, entries=tuple(range((9 << 26) + 128, 9 << 26, -1))),
    "no entries": replace(GOOD, entries=()),
    "rising": replace(GOOD, entries=(3 << 26, (3 << 26) + 1)),
    "equal": replace(GOOD, entries=(3 << 26, 3 << 26)),
    "rising at the end": replace(GOOD, entries=(4 << 26, 3 << 26, (3 << 26) + 1)),
    "1.0": replace(GOOD, entries=(3 << 26, 1 << 26)),
    "below 1.0": replace(GOOD, entries=(3 << 26, 1)),
    "64.0": replace(GOOD, entries=(64 << 26, 2 << 26)),
    "33 bits": replace(GOOD, entries=(2**33 - 1, 2**31 + 1)),
    "below 0, but the largest of 32 bits": replace(GOOD, entries=(-1, 3 << 26)),
    "below 0, of a fallen row": replace(GOOD, entries=(-1, -2)),
    "omega below 0": replace(GOOD, omega_word=-1),
    "omega of 33 bits": replace(GOOD, omega_word=2**32 + 5),
    "q = 2 claimed of 258": replace(GOOD, entries=tuple(range((9 << 26) + 258, 9 << 26, -1))),
}


@of_every_kind
@pytest.mark.parametrize("fault", BAD_TABLES)
def test_table_errors(kind: AnyType, fault: str) -> None:
    check_not_made(kind, Status.ERR_TABLE, Config(table=BAD_TABLES[fault]))


@of_every_kind
@pytest.mark.parametrize(
    "table",
    [
        GOOD,
        replace(GOOD, omega_word=1),
        replace(GOOD, omega_word=MAX_OMEGA_WORD),
        replace(GOOD, entries=((1 << 26) + 2, (1 << 26) + 1)),
        replace(GOOD, entries=(2**32 - 1, 2**32 - 2)),
        replace(GOOD, entries=tuple(range((9 << 26) + 127, 9 << 26, -1))),
    ],
)
def test_the_ends_of_a_table_s_fields_are_legal(kind: AnyType, table: Table) -> None:
    kind(Config(table=table), OWN_ID, 0.75)


@dataclass(frozen=True)
class Spoilt(Table):
    """A table whose words are not those of its entries."""

    given: tuple[int, ...]

    def words(self) -> tuple[int, ...]:
        return self.given


def table_of(words: Sequence[int]) -> Table:
    return Spoilt(words[1], tuple(words[2:-1]), tuple(words))


@of_every_kind
@pytest.mark.parametrize("place", range(len(GOOD.words())))
def test_every_flipped_bit_of_a_table_is_refused(kind: AnyType, place: int) -> None:
    """Its checksum sees it, whichever word; also where word 0 then claims another q or format."""
    for bit in range(32):
        words = list(GOOD.words())
        words[place] ^= 1 << bit
        check_not_made(kind, Status.ERR_TABLE, Config(table=table_of(words)))


@of_every_kind
@pytest.mark.parametrize(
    "first", [0x4D435303, 0x4D435503, 0x00000003, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400]
)
def test_a_table_of_another_make_is_refused(kind: AnyType, first: int) -> None:
    """With a right checksum, so word 0 itself must be looked at: other formats, other q."""
    body = (first, *GOOD.words()[1:-1])
    check_not_made(kind, Status.ERR_TABLE, Config(table=table_of((*body, checksum(body)))))


@of_every_kind
def test_a_table_is_not_needed_without_a_test(kind: AnyType) -> None:
    for mode in (Filter.ALWAYS, Filter.OFF):
        kind(Config(table=BAD_TABLES["rising"], filter=mode), OWN_ID, 0.75)


@of_every_kind
def test_the_first_error_is_told(kind: AnyType) -> None:
    """Config, table, id, b_hat, in this order."""
    bad_table = Config(table=None)
    check_not_made(kind, Status.ERR_CONFIG, replace(bad_table, memory=1), 200, 0.0)
    check_not_made(kind, Status.ERR_TABLE, bad_table, 200, 0.0)
    check_not_made(kind, Status.ERR_ID, PLAIN, 200, 0.0)


@of_fixed_point
def test_a_bad_config_restores_nothing(kind: FixedPointType) -> None:
    image = kind(PLAIN, OWN_ID, 0.75).save()
    for config, status in (
        (replace(PLAIN, memory=1), Status.ERR_CONFIG),
        (Config(table=None), Status.ERR_TABLE),
    ):
        with pytest.raises(FirmwareError) as caught:
            kind.restore(config, image)
        assert caught.value.status == status


def test_the_table_s_checksum_is_fnv_1a_over_words() -> None:
    words = GOOD.words()
    value = 0x811C9DC5
    for word in words[:-1]:
        value = (value ^ word) * 0x01000193 % 2**32
    assert words[-1] == value and words[0] == 0x4D435403
    assert set(LAYOUT.values()) == {8, 16, 32, 64}
