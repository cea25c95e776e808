"""Properties of every sequence of calls (docs/internals/properties.md), tried on mirror and C by Hypothesis.

Examples are derandomised: a failure prints the smallest calls that show it, and another run finds it again.
"""

from __future__ import annotations

import random
from fractions import Fraction
from typing import Any

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
    NO_FILTER,
    ONE,
    OWN_ID,
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
"""Their mantissa, above 8 bits of a shift, is 0, small, nearly full or full. Some shifts are too large."""
SPECIAL_X_HATS = (0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE)
x_hats = st.sampled_from(SPECIAL_X_HATS) | st.integers(0, ONE)
alpha_words = st.sampled_from(SPECIAL_ALPHA_WORDS) | st.integers(0, 2**32 - 1)
senders = st.integers(0, MAX_ID).filter(lambda sender: sender != OWN_ID)
message_lists = st.lists(
    st.tuples(senders, x_hats, alpha_words), max_size=30, unique_by=lambda message: message[0] % 32
)
slot_estimates = st.sampled_from((0, 1, 2**15, 2**16 - 1)) | st.integers(0, 2**16 - 1)
centres = st.sampled_from((0, 1, 2**29, 2**30)) | st.integers(0, 2**30)
LEAST_SPREAD, LARGEST_SPREAD = 2**30 // 2**12, 2**30 // 4
"""2**-12 and 1/4 in units of 2**-30."""
spreads = st.sampled_from((LEAST_SPREAD, LARGEST_SPREAD)) | st.integers(LEAST_SPREAD, LARGEST_SPREAD)


def random_messages(count: int) -> list[RawMessage]:
    """Return so many valid raw messages with a special or a random x_hat and alpha."""
    rng = random.Random(0)
    other_ids = [robot_id for robot_id in range(MAX_ID + 1) if robot_id != OWN_ID]
    return [
        (
            rng.choice(other_ids),
            rng.choice([rng.choice(SPECIAL_X_HATS), rng.randint(0, ONE)]),
            rng.choice([rng.choice(SPECIAL_ALPHA_WORDS), rng.getrandbits(32)]),
        )
        for _ in range(count)
    ]


RobotCall = tuple[Any, ...]
"""Name of a robot's method, and the arguments of a call."""
observe_calls = st.sampled_from([("observe", Observation.WHITE), ("observe", Observation.BLACK)])
# To choose among given calls is several times as fast as to draw the numbers of each call.
receive_calls = st.sampled_from([("receive_raw", *message) for message in random_messages(5000)])
call_lists = st.lists(
    observe_calls | receive_calls | st.just(("settle",)),
    min_size=60,  # enough for tests and updates of the robust filter, and for halved counts
    max_size=200,
)
colours = st.sampled_from((Observation.WHITE, Observation.BLACK))
# In units of 2**-32: ends of the range, 1/4, 3/4, 1/2 and 2**-13 beside it, any number, and numbers near 1.
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
def test_a_confidence_becomes_the_largest_alpha_word_not_above_it(units: int) -> None:
    """An alpha word has 32 bits: a mantissa of 24 bits, and a shift of 0 to 31. A unit of alpha is 2**-24.

    A shift loses low bits, so it is 0 unless the mantissa needs all of its 24 bits. A confidence above the
    largest alpha word becomes that one.
    """
    word = alpha_word_from_units(units)

    mantissa, shift = word >> 8, word & 0xFF
    units_of_word = mantissa << shift
    units_of_next_word = (mantissa + 1) << shift
    units_of_largest_word = (2**24 - 1) << 31  # the largest mantissa and the largest shift
    assert alpha_units(word) == units_of_word
    assert mantissa < 2**24
    assert shift <= 31
    assert shift == 0 or mantissa >= 2**23
    if units < units_of_largest_word:
        assert units_of_word <= units < units_of_next_word
    else:
        assert units_of_word == units_of_largest_word
        assert word == ALPHA_MAX


@given(alpha=st.floats(0, 2.0**40))
def test_a_confidence_that_is_a_float_is_rounded_down_to_whole_units(alpha: float) -> None:
    """A unit is 2**-24. All confidences of 2**55 units or more become the largest alpha word."""
    whole_units = int(Fraction(alpha) * 2**24)
    assert alpha_word_from_float(alpha) == alpha_word_from_units(min(whole_units, 2**55))


# --- Messages and sums -----------------------------------------------------------------------------------


# design: R20, R35
@for_fixed_point_firmwares
@pytest.mark.parametrize("config", [NO_FILTER, ROBUST], ids=["sums", "slots of the robust filter"])
@thorough
@given(messages=message_lists, seed=st.integers(0, 2**32))
def test_the_order_of_messages_changes_no_bit(
    firmware: FixedPointFirmware, config: Config, messages: list[RawMessage], seed: int
) -> None:
    """Property I12: two robots that receive the same messages in another order remember the same.

    They believe the same, too: x and x_bar are computed from what they remember, and need no order. The ids
    of senders differ modulo 32, as those that are equal share a slot of the robust filter.
    """
    robot = firmware(config, OWN_ID, b_hat=0.75)
    receive_raw_messages(robot, messages)

    messages_in_another_order = random.Random(seed).sample(messages, len(messages))
    other_robot = firmware(config, OWN_ID, b_hat=0.75)
    receive_raw_messages(other_robot, messages_in_another_order)

    assert robot.state() == other_robot.state()


# --- Votes -----------------------------------------------------------------------------------------------


# design: R35
@for_fixed_point_firmwares
@thorough
@given(vote=slot_estimates, centre=centres, spread=spreads, votes=st.integers(1, 512))
def test_a_neighbour_s_vote_moves_centre_and_spread_of_the_votes_a_little_and_never_too_far(
    firmware: FixedPointFirmware, vote: int, centre: int, spread: int, votes: int
) -> None:
    """Property I25: the centre moves towards the vote by an eighth of the spread at most.

    The spread changes by a sixteenth at most, and stays between 2**-12 and 1/4. A vote is in units of 2**-16,
    centre and spread in units of 2**-30; ``votes`` is how many there were.
    """
    robot = restore_robust_robot(firmware, estimates=[vote], centre=centre, spread=spread, votes=votes)

    robot.settle()  # the neighbour votes

    new_centre = robot.state()["robust_centre"]
    vote_in_units_of_centre = vote * 2**14  # from 2**-16 to 2**-30
    lower, upper = sorted((centre, vote_in_units_of_centre))
    assert lower <= new_centre <= upper
    assert abs(new_centre - centre) <= spread / 8
    new_spread = robot.state()["robust_spread"]
    assert LEAST_SPREAD <= new_spread <= LARGEST_SPREAD
    assert abs(new_spread - spread) <= spread / 16


@for_fixed_point_firmwares
@thorough
@given(slots=st.sets(st.integers(0, 31), min_size=1), turn=st.integers(0, 32), has_confidence=st.booleans())
def test_all_neighbours_and_the_robot_itself_vote_equally_often(
    firmware: FixedPointFirmware, slots: set[int], turn: int, has_confidence: bool
) -> None:
    """Property I25: in as many rounds as there are voters each votes once, whoever begins.

    Neighbours vote whose estimate is in one of the 32 slots, and the robot itself if it has confidence, which
    it has once it has observed a tile. After the vote of slot i the turn is i + 1, and after the robot's own
    vote it is 0.
    """
    slot_of_last_vote = (turn - 1) % 32  # it is filled, or no robot could have this turn
    filled_slots = slots | {slot_of_last_vote}
    mask_of_filled_slots = sum(1 << slot for slot in filled_slots)
    observation_count = 1 if has_confidence else 0
    robot = restore_robust_robot(
        firmware, t=observation_count, filled_slots=mask_of_filled_slots, turn=turn, votes=1
    )
    turns_after_votes = [slot + 1 for slot in sorted(filled_slots)]
    if has_confidence:
        turns_after_votes.append(0)

    turns = []
    for _ in turns_after_votes:
        robot.settle()  # a neighbour or the robot itself votes
        turns.append(robot.state()["robust_turn"])

    assert sorted(turns) == sorted(turns_after_votes)


# --- Calls -----------------------------------------------------------------------------------------------


def make_calls(robot: FixedPoint, calls: list[RobotCall]) -> None:
    """Call methods of a robot in order."""
    for name, *arguments in calls:
        getattr(robot, name)(*arguments)


@for_fixed_point_firmwares
@pytest.mark.parametrize("mode", [Filter.ROBUST, *slow([Filter.ALWAYS])])
@thorough
@given(calls=call_lists)
def test_a_robot_has_undamaged_memory_and_is_restored_with_it_after_every_sequence_of_calls(
    firmware: FixedPointFirmware, mode: Filter, calls: list[RobotCall]
) -> None:
    """``holds_invariants`` says whether calls alone can have led to a robot's memory (property I11).

    The robot that is restored from what it saves has the same memory (property I17).
    """
    config = Config(filter=mode, filter_period=1, memory=64)
    robot = firmware(config, OWN_ID, b_hat=0.75)

    make_calls(robot, calls)

    assert robot.holds_invariants()
    restored_robot = firmware.restore(config, robot.save())
    assert restored_robot.state() == robot.state()


@pytest.mark.parametrize("mode", [Filter.ROBUST, *slow([Filter.ALWAYS])])
@thorough
@given(calls=call_lists)
def test_the_python_and_the_c_robot_are_equal_after_every_sequence_of_calls(
    mode: Filter, calls: list[RobotCall]
) -> None:
    """They agree in every number that they remember (property I23)."""
    config = Config(filter=mode, filter_period=1, memory=64)
    python_robot = MirrorRobot(config, OWN_ID, b_hat=0.75)
    c_robot = NativeRobot(config, OWN_ID, b_hat=0.75)

    make_calls(python_robot, calls)
    make_calls(c_robot, calls)

    assert python_robot.state() == c_robot.state()


# --- Symmetries ------------------------------------------------------------------------------------------


def estimate_after_observation(
    firmware: FixedPointFirmware, t: int, n: int, b_hat: int, z: Observation
) -> tuple[int, int]:
    """Return x_hat and alpha of a robot with these counts after one more observation."""
    robot = restore_robot(firmware, NO_FILTER, b_hat, t=t, n=n)
    robot.observe(z)
    return robot.x_hat_raw, robot.alpha_raw


# design: R19
@for_fixed_point_firmwares
@thorough
@given(t=observation_counts, share=st.integers(0, 2**32), b_hat=b_hats, z=colours)
def test_black_and_white_are_treated_alike(
    firmware: FixedPointFirmware, t: int, share: int, b_hat: int, z: Observation
) -> None:
    """Properties I15 and I16: with the colours exchanged the robot estimates the share of the other colour.

    So it does with a sensor that shows the other colour, and with both exchanged it estimates the same. b_hat
    is in units of 2**-32, and ``share`` the share of black observations in the same units. ``z`` is one more
    observation, after which the robot estimates.
    """
    n = t * share // 2**32
    x_hat, alpha = estimate_after_observation(firmware, t, n, b_hat, z)

    # What was black is white, and a sensor that is right in a share b_hat is right in 1 - b_hat.
    other_n = t - n
    other_z = Observation(1 - z)
    other_b_hat = 2**32 - b_hat
    with_other_colours = estimate_after_observation(firmware, t, other_n, b_hat, other_z)
    with_other_sensor = estimate_after_observation(firmware, t, n, other_b_hat, z)
    with_both = estimate_after_observation(firmware, t, other_n, other_b_hat, other_z)

    # The confidence alpha is always the same.
    assert with_other_colours == (ONE - x_hat, alpha)
    assert with_other_sensor == (ONE - x_hat, alpha)
    assert with_both == (x_hat, alpha)
