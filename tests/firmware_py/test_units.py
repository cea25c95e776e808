"""Readings in units of 1, and confidences as words: each conversion against exact numbers."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mcp_asdf import Config, MirrorRobot, NativeRobot, Observation, Sums, Table, mirror
from mcp_asdf.fixed_point import (
    ALPHA_MAX,
    B_HAT_MAX,
    B_HAT_MIN,
    ONE,
    alpha_to_word,
    alpha_units,
    alpha_word,
    sums_add,
)
from wire import TABLE

LONG = st.one_of(
    st.integers(0, 2**26),
    st.integers(0, 2**56),
    st.builds(lambda e, d: 2**e + d, st.integers(1, 56), st.integers(-1, 1)),
)


@given(units=LONG)
@example(units=2**54)
def test_a_confidence_becomes_the_largest_word_not_above_it(units: int) -> None:
    word = alpha_word(units)
    mantissa, shift = word >> 8, word & 0xFF
    if units >= 2**55 - 2**31:
        assert word == ALPHA_MAX == 0xFFFFFF1F
        return
    assert alpha_units(word) == mantissa << shift <= units < (mantissa + 1) << shift
    assert mantissa < 2**24 and (shift == 0 or mantissa >= 2**23) and 0 <= shift <= 31


@given(alpha=st.floats(0, 2.0**40))
def test_a_float_is_rounded_down_to_the_unit(alpha: float) -> None:
    assert alpha_to_word(alpha) == alpha_word(min(int(Fraction(alpha) * 2**24), 2**55))


@pytest.mark.parametrize("kind", [MirrorRobot, NativeRobot])
def test_readings_are_the_firmwares_integers_in_units_of_1(
    kind: type[MirrorRobot] | type[NativeRobot],
) -> None:
    robot = kind(Config(table=TABLE), 7, 0.8)
    for tick in range(40):
        robot.observe(Observation(tick % 3 == 0))
        robot.receive(sender=1, x_hat=0.25, alpha=3.5)
        robot.receive(sender=2, x_hat=0.75, alpha=2.0**-20)
        robot.settle()
    assert robot.b_hat == pytest.approx(0.8, abs=2**-32)
    assert Fraction(robot.b_hat) == Fraction(robot.b_hat_raw, 2**32)
    assert robot.x_bar == pytest.approx(0.25, abs=2**-20) and robot.x_bar == robot.x_bar_raw / 2**23
    assert robot.beta == 3.5 + 2.0**-20 == robot.beta_raw / 2**24
    assert (robot.x_hat, robot.x) == (robot.x_hat_raw / 2**23, robot.x_raw / 2**23)
    assert Fraction(robot.alpha) == Fraction(alpha_units(robot.alpha_raw), 2**24) > 1


class Measured(int):
    """An integer that remembers the widest of all that were computed from it, one by one."""

    widest = 0


def _measured(name: str) -> Callable[[int, int], int]:
    plain = getattr(int, name)

    def operate(left: int, right: int) -> int:
        result = Measured(plain(left, right))
        Measured.widest = max(Measured.widest, result.bit_length())
        return result

    return operate


for _name in ("add", "sub", "mul", "floordiv", "lshift", "rshift", "and", "or"):
    setattr(Measured, f"__{_name}__", _measured(f"__{_name}__"))
    setattr(Measured, f"__r{_name}__", _measured(f"__r{_name}__"))


def extreme(source: Random, most: int) -> Measured:
    """A number up to ``most``, often one of the ends."""
    return Measured(source.choice([0, 1, most >> 1, most - 1, most, most, source.randint(0, most)]))


def test_no_intermediate_of_the_mirror_is_wider_than_the_words_of_the_c() -> None:
    """Three words of 32 bits hold each, and some need them: an instruction takes a bounded time."""
    source, table = Random(1), Table(1 << 30, (2**32 - 1, 2**32 - 2))
    Measured.widest = 0
    for _ in range(300):
        sums = Sums()
        for _ in range(source.choice([1, 2, 127])):
            alpha = source.choice([0x100, ALPHA_MAX, extreme(source, 2**24 - 1) << 8 | 31])
            sums_add(sums, extreme(source, ONE), alpha)
        closed = mirror.Closed(sums.alpha, sums.alpha_x_low, sums.alpha_x_high)
        t, x_hat = extreme(source, 2**31 - 2) + 1, extreme(source, ONE)
        n = extreme(source, t)
        mirror.estimate(t, n, mirror.accuracy_of(extreme(source, B_HAT_MAX - B_HAT_MIN) + B_HAT_MIN))
        mirror.informed_estimate(closed, x_hat, ALPHA_MAX)
        mirror.reestimate(t, n, closed)
        mirror.rejects(table, sums, x_hat)
    assert 85 < Measured.widest <= 96
