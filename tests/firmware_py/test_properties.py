"""Properties of every sequence of calls (docs/internals/properties.md), tried on mirror and C by Hypothesis.

Examples are derandomised: a failure prints the smallest calls that show it, and another run finds it again.
"""

from __future__ import annotations

import random
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mcp_asdf.fixed_point import alpha_units, alpha_word_from_float, alpha_word_from_units
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import MAX_ID, Config, Filter, Observation
from robots import (
    ALPHA_MAX,
    ALPHA_MIN,
    ALPHA_ONE,
    HALF,
    ONE,
    OWN_ID,
    PLAIN,
    ROBUST,
    FixedPoint,
    FixedPointFirmware,
    for_fixed_point_firmwares,
    receive_raw_messages,
    restore_robot,
    restore_robust_robot,
)
from support import draws, slow

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
robust_message_lists = st.lists(
    st.tuples(senders, x_hats, alpha_words), max_size=30, unique_by=lambda message: message[0] % 32
)
slot_estimates = st.sampled_from((0, 1, 2**15, 2**16 - 1)) | st.integers(0, 2**16 - 1)
centres = st.sampled_from((0, 1, 2**29, 2**30)) | st.integers(0, 2**30)
spreads = st.sampled_from((2**18, 2**28)) | st.integers(2**18, 2**28)
call_lists = st.lists(
    st.one_of(
        st.tuples(st.integers(0, 1)),  # observe
        st.tuples(senders, x_hats, alpha_words),  # receive
        st.tuples(),  # settle
    ),
    min_size=60,  # enough for tests and updates of the robust filter, and for halved counts
    max_size=200,
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


# design: R35
@for_fixed_point_firmwares
@thorough
@given(messages=robust_message_lists, seed=st.integers(0, 2**32))
def test_the_order_of_messages_changes_no_bit_of_the_robust_filter(
    firmware: FixedPointFirmware, messages: list[RawMessage], seed: int
) -> None:
    """I12, for senders whose ids differ modulo 32."""
    robot, other_robot = firmware(ROBUST, OWN_ID, 0.75), firmware(ROBUST, OWN_ID, 0.75)
    receive_raw_messages(robot, messages)
    receive_raw_messages(other_robot, random.Random(seed).sample(messages, len(messages)))
    assert robot.state() == other_robot.state()


# --- Votes -----------------------------------------------------------------------------------------------


# design: R35
@for_fixed_point_firmwares
@thorough
@given(vote=slot_estimates, centre=centres, spread=spreads, votes=st.integers(1, 512))
def test_a_vote_moves_the_centre_towards_it_and_never_beyond(
    firmware: FixedPointFirmware, vote: int, centre: int, spread: int, votes: int
) -> None:
    """I25"""
    robot = restore_robust_robot(firmware, estimates=[vote], centre=centre, spread=spread, votes=votes)
    robot.settle()
    new_centre, position = robot.state()["robust_centre"], vote << 14
    assert min(centre, position) <= new_centre <= max(centre, position)
    assert abs(new_centre - centre) <= spread / 8


@for_fixed_point_firmwares
@thorough
@given(vote=slot_estimates, centre=centres, spread=spreads, votes=st.integers(1, 512))
def test_a_vote_changes_the_spread_by_at_most_a_sixteenth(
    firmware: FixedPointFirmware, vote: int, centre: int, spread: int, votes: int
) -> None:
    """I25"""
    robot = restore_robust_robot(firmware, estimates=[vote], centre=centre, spread=spread, votes=votes)
    robot.settle()
    new_spread = robot.state()["robust_spread"]
    assert 2**18 <= new_spread <= 2**28
    assert abs(new_spread - spread) <= spread / 16


@for_fixed_point_firmwares
@thorough
@given(slots=st.sets(st.integers(0, 31), min_size=1), turn=st.integers(0, 32), has_confidence=st.booleans())
def test_all_slots_and_the_own_estimate_vote_equally_often(
    firmware: FixedPointFirmware, slots: set[int], turn: int, has_confidence: bool
) -> None:
    """I25: in so many rounds each votes once, wherever the turn is. The turn is after the one that voted."""
    filled_slots = sum(1 << slot for slot in slots | {(turn - 1) % 32})
    t = 1 if has_confidence else 0
    robot = restore_robust_robot(firmware, t=t, filled_slots=filled_slots, turn=turn, votes=1)
    turns = []
    for _ in range(filled_slots.bit_count() + t):
        robot.settle()
        turns.append(robot.state()["robust_turn"])
    expected_turns = [slot + 1 for slot in range(32) if filled_slots >> slot & 1]
    assert sorted(turns) == [0] * t + expected_turns


# --- Calls -----------------------------------------------------------------------------------------------


def make_calls(robot: FixedPoint, calls: list[tuple[int, ...]]) -> None:
    """Make calls of a robot: observe has one number, receive three, settle none."""
    for numbers in calls:
        if len(numbers) == 3:
            robot.receive_raw(*numbers)
        elif len(numbers) == 1:
            robot.observe(Observation(*numbers))
        else:
            robot.settle()


@for_fixed_point_firmwares
@pytest.mark.parametrize("mode", [Filter.ROBUST, *slow([Filter.ALWAYS])])
@thorough
@given(calls=call_lists)
def test_every_sequence_of_calls_keeps_the_invariants(
    firmware: FixedPointFirmware, mode: Filter, calls: list[tuple[int, ...]]
) -> None:
    """I11"""
    robot = firmware(Config(filter=mode, filter_period=1, memory=64), OWN_ID, 0.75)
    make_calls(robot, calls)
    assert robot.holds_invariants()


@for_fixed_point_firmwares
@pytest.mark.parametrize("mode", [Filter.ROBUST, *slow([Filter.ALWAYS])])
@thorough
@given(calls=call_lists)
def test_a_restored_robot_is_the_saved_one(
    firmware: FixedPointFirmware, mode: Filter, calls: list[tuple[int, ...]]
) -> None:
    """I17"""
    config = Config(filter=mode, filter_period=1, memory=64)
    robot = firmware(config, OWN_ID, 0.75)
    make_calls(robot, calls)
    assert firmware.restore(config, robot.save()).state() == robot.state()


@pytest.mark.parametrize("mode", [Filter.ROBUST, *slow([Filter.ALWAYS])])
@thorough
@given(calls=call_lists)
def test_mirror_and_c_are_equal_after_every_sequence_of_calls(
    mode: Filter, calls: list[tuple[int, ...]]
) -> None:
    """I23"""
    config = Config(filter=mode, filter_period=1, memory=64)
    mirror, native = MirrorRobot(config, OWN_ID, 0.75), NativeRobot(config, OWN_ID, 0.75)
    make_calls(mirror, calls)
    make_calls(native, calls)
    assert mirror.state() == native.state()


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
