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
    ALPHA_MAX,
    ALPHA_MIN,
    ALPHA_ONE,
    HALF,
    ONE,
    OWN_ID,
    PLAIN,
    FixedPointFirmware,
    for_fixed_point_firmwares,
    receive_raw_messages,
    restore_robot,
)
from support import draws

pytestmark = pytest.mark.random

RawMessage = tuple[int, int, int]
"""Sender, x_hat in units of 2**-23, and alpha as an alpha word."""

thorough = settings(derandomize=True, deadline=None, max_examples=draws(400))

SPECIAL_ALPHA_WORDS = (
    *(0, 0x1F, ALPHA_MIN, 0x1E0, 0x101, 0x7FFFFF00, 0x80000000),
    *(ALPHA_ONE, 0xFFFFFF08, 0x80000009, ALPHA_MAX, 2**32 - 1),
)
x_hats = st.sampled_from((0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE)) | st.integers(0, ONE)
alpha_words = st.sampled_from(SPECIAL_ALPHA_WORDS) | st.integers(0, 2**32 - 1)
senders = st.integers(0, MAX_ID).filter(lambda sender: sender != OWN_ID)
message_lists = st.lists(
    st.tuples(senders, x_hats, alpha_words), max_size=30, unique_by=lambda message: message[0]
)
colours = st.sampled_from((Observation.WHITE, Observation.BLACK))
b_hats = (
    st.sampled_from((2**12, 2**30, 2**31 - 2**19, 2**31, 2**31 + 2**19, 3 << 30, 2**32 - 2**12))
    | st.integers(2**12, 2**32 - 2**12)
    | st.integers(12, 30).map(lambda bits: 2**32 - 2**bits)
)
observation_counts = st.integers(1, 2**31 - 2) | st.integers(1, 40) | st.integers(2**31 - 8, 2**31 - 2)
unit_counts = st.integers(0, 2**26) | st.builds(
    lambda exponent, offset: 2**exponent + offset, st.integers(1, 56), st.integers(-1, 1)
)

# --- Alpha words --------------------------------------------------------------------------------------------


@given(units=unit_counts)
@example(units=2**54)
def test_units_become_the_largest_alpha_word_not_above_them(units: int) -> None:
    word = alpha_word_from_units(units)
    mantissa, shift = word >> 8, word & 0xFF
    if units >= 2**55 - 2**31:
        assert word == ALPHA_MAX
    else:
        assert alpha_units(word) == mantissa << shift <= units < (mantissa + 1) << shift


@given(units=unit_counts)
@example(units=2**54)
def test_an_alpha_word_has_the_smallest_shift(units: int) -> None:
    word = alpha_word_from_units(units)
    mantissa, shift = word >> 8, word & 0xFF
    assert mantissa < 2**24 and shift <= 31
    assert shift == 0 or mantissa >= 2**23


@given(alpha=st.floats(0, 2.0**40))
def test_a_float_is_rounded_down_to_the_unit(alpha: float) -> None:
    units = int(Fraction(alpha) * 2**24)
    assert alpha_word_from_float(alpha) == alpha_word_from_units(min(units, 2**55))


# --- Messages and sums -----------------------------------------------------------------------------------


# design: R20
@for_fixed_point_firmwares
@thorough
@given(messages=message_lists, seed=st.integers(0, 2**32))
def test_the_order_of_messages_changes_no_bit(
    firmware: FixedPointFirmware, messages: list[RawMessage], seed: int
) -> None:
    """I12"""
    robot, other_robot = firmware(PLAIN, OWN_ID, 0.75), firmware(PLAIN, OWN_ID, 0.75)
    receive_raw_messages(robot, messages)
    receive_raw_messages(other_robot, random.Random(seed).sample(messages, len(messages)))
    assert robot.state() == other_robot.state()
    robot.step(Observation.BLACK)
    other_robot.step(Observation.BLACK)
    assert robot.state() == other_robot.state()
    assert (robot.x_raw, robot.x_bar_raw) == (other_robot.x_raw, other_robot.x_bar_raw)


# --- Symmetries ------------------------------------------------------------------------------------------


def estimate_after_observation(
    firmware: FixedPointFirmware, t: int, n: int, b_hat: int, z: Observation
) -> tuple[int, int]:
    """Return x_hat and alpha of a robot with these counts after one more observation."""
    robot = restore_robot(firmware, t=t, n=n, b_hat=b_hat)
    robot.observe(z)
    return robot.x_hat_raw, robot.alpha_raw


# design: R19
@for_fixed_point_firmwares
@thorough
@given(t=observation_counts, share=st.integers(0, 2**32), b_hat=b_hats, z=colours)
def test_colours_and_senses_of_the_sensor_are_mirror_images(
    firmware: FixedPointFirmware, t: int, share: int, b_hat: int, z: Observation
) -> None:
    """I15, I16: exchange the colours, the sense of the sensor, or both, at every t."""
    n = t * share >> 32
    x_hat, alpha = estimate_after_observation(firmware, t, n, b_hat, z)
    other_z, other_b_hat = Observation(1 - z), 2**32 - b_hat
    assert estimate_after_observation(firmware, t, t - n, b_hat, other_z) == (ONE - x_hat, alpha)
    assert estimate_after_observation(firmware, t, t - n, other_b_hat, other_z) == (x_hat, alpha)
    assert estimate_after_observation(firmware, t, n, other_b_hat, z) == (ONE - x_hat, alpha)
