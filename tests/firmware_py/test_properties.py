"""Properties of every sequence of calls (docs/invariants.md), tried by Hypothesis on the mirror and the C.

Examples are derandomised: a failure prints the smallest calls that show it, and another run finds it again.
"""

from __future__ import annotations

import random
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import alpha_units, alpha_word_from_float, alpha_word_from_units
from mcp_asdf.robot import MAX_ID, Observation
from robots import (
    ALPHA_LEAST,
    ALPHA_MOST,
    ALPHA_ONE,
    HALF,
    ONE,
    OWN_ID,
    PLAIN,
    FixedPointType,
    of_fixed_point,
    receive_all,
    robot_at,
)
from support import draws

pytestmark = pytest.mark.random

Message = tuple[int, int, int]
"""Sender, x_hat and alpha, raw."""

thorough = settings(derandomize=True, deadline=None, max_examples=draws(400))

ALPHA_ENDS = (
    *(0, 0x1F, ALPHA_LEAST, 0x1E0, 0x101, 0x7FFFFF00, 0x80000000),
    *(ALPHA_ONE, 0xFFFFFF08, 0x80000009, ALPHA_MOST, 2**32 - 1),
)
x_hats = st.sampled_from((0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE)) | st.integers(0, ONE)
alphas = st.sampled_from(ALPHA_ENDS) | st.integers(0, 2**32 - 1)
others = st.integers(0, MAX_ID).filter(lambda sender: sender != OWN_ID)
messages = st.lists(st.tuples(others, x_hats, alphas), max_size=30, unique_by=lambda message: message[0])
colours = st.sampled_from((Observation.WHITE, Observation.BLACK))
b_hats = (
    st.sampled_from((2**12, 2**30, 2**31 - 2**19, 2**31, 2**31 + 2**19, 3 << 30, 2**32 - 2**12))
    | st.integers(2**12, 2**32 - 2**12)
    | st.integers(12, 30).map(lambda bits: 2**32 - 2**bits)
)
counts = st.integers(1, 2**31 - 2) | st.integers(1, 40) | st.integers(2**31 - 8, 2**31 - 2)


# --- Confidences --------------------------------------------------------------------------------------------

units_of_alpha = st.integers(0, 2**26) | st.builds(
    lambda e, d: 2**e + d, st.integers(1, 56), st.integers(-1, 1)
)


@given(units=units_of_alpha)
@example(units=2**54)
def test_a_confidence_becomes_the_largest_word_not_above_it(units: int) -> None:
    word = alpha_word_from_units(units)
    mantissa, shift = word >> 8, word & 0xFF
    if units >= 2**55 - 2**31:
        assert word == ALPHA_MOST
        return
    assert alpha_units(word) == mantissa << shift <= units < (mantissa + 1) << shift
    assert mantissa < 2**24 and (shift == 0 or mantissa >= 2**23) and 0 <= shift <= 31


@given(alpha=st.floats(0, 2.0**40))
def test_a_float_is_rounded_down_to_the_unit(alpha: float) -> None:
    assert alpha_word_from_float(alpha) == alpha_word_from_units(min(int(Fraction(alpha) * 2**24), 2**55))


# --- Messages and sums -----------------------------------------------------------------------------------


# design: R20
@of_fixed_point
@thorough
@given(heard=messages, seed=st.integers(0, 2**32))
def test_the_order_of_messages_changes_no_bit(kind: FixedPointType, heard: list[Message], seed: int) -> None:
    """I12"""
    robot, other = (kind(PLAIN, OWN_ID, 0.75) for _ in range(2))
    receive_all(robot, heard)
    receive_all(other, random.Random(seed).sample(heard, len(heard)))
    assert robot.state() == other.state()
    for each in (robot, other):
        each.step(Observation.BLACK)
    assert (robot.state(), robot.x_raw, robot.x_bar_raw) == (other.state(), other.x_raw, other.x_bar_raw)


# --- Symmetries ------------------------------------------------------------------------------------------


def at(kind: FixedPointType, t: int, n: int, b_hat: int, z: Observation) -> tuple[int, int]:
    """x_hat and alpha after one more observation."""
    robot = robot_at(kind, t=t, n=n, b_hat=b_hat)
    robot.observe(z)
    return robot.x_hat_raw, robot.alpha_raw


# design: R19
@of_fixed_point
@thorough
@given(t=counts, share=st.integers(0, 2**32), b_hat=b_hats, z=colours)
def test_colours_are_mirror_images(
    kind: FixedPointType, t: int, share: int, b_hat: int, z: Observation
) -> None:
    """I15, I16: exchange the colours, the sense of the sensor, or both, at every t."""
    n, other = t * share >> 32, Observation(1 - z)
    x_hat, alpha = at(kind, t, n, b_hat, z)
    assert at(kind, t, t - n, b_hat, other) == (ONE - x_hat, alpha)
    assert at(kind, t, t - n, 2**32 - b_hat, other) == (x_hat, alpha)
    assert at(kind, t, n, 2**32 - b_hat, z) == (ONE - x_hat, alpha)
