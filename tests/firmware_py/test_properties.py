"""What holds for every sequence of calls (docs/invariants.md), tried by Hypothesis on the mirror and the C.

Examples are derandomised: a failure prints the smallest calls that show it, and another run finds it again.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import (
    ALPHA_ONE,
    FIXED_POINT,
    HALF,
    LAYOUT,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    AnyType,
    FixedPoint,
    FixedPointType,
    of_every_kind,
    of_fixed_point,
    receive_all,
    rewritten,
    robot_at,
    unpack,
)

from firmware_py.mirror import MirrorRobot, sums_add
from firmware_py.native import NativeRobot
from firmware_py.robot import MAX_ID, Config, Filter, FirmwareError, Observation, Status, Sums

Message = tuple[int, int, int]
"""Sender, x_hat and alpha, raw."""

quick = settings(derandomize=True, deadline=None, max_examples=20)
thorough = settings(derandomize=True, deadline=None, max_examples=150)

ALPHA_MOST = 0x4EFFFFFF
ALPHA_ENDS = (
    0,
    1,
    0x337FFFFF,
    0x33800000,
    0x3EFFFFFF,
    0x3F000001,
    ALPHA_ONE,
    ALPHA_MOST,
    0x4F000000,
    0x7F7FFFFF,
)
x_hats = st.sampled_from((0, 1, HALF - 1, HALF, HALF + 1, ONE - 1, ONE)) | st.integers(0, ONE)
alphas = st.sampled_from(ALPHA_ENDS) | st.integers(0, 0x7F7FFFFF)
others = st.integers(0, MAX_ID).filter(lambda sender: sender != OWN_ID)
messages = st.lists(st.tuples(others, x_hats, alphas), max_size=30, unique_by=lambda message: message[0])
colours = st.sampled_from((Observation.WHITE, Observation.BLACK))
ticks = st.lists(st.sampled_from(Observation), max_size=40)
b_hats = (
    st.sampled_from((2**12, 2**30, 2**31 - 2**19, 2**31, 2**31 + 2**19, 3 << 30, 2**32 - 2**12))
    | st.integers(2**12, 2**32 - 2**12)
    | st.integers(12, 30).map(lambda bits: 2**32 - 2**bits)
)
counts = st.integers(1, 2**32 - 4) | st.integers(1, 40) | st.integers(2**31 - 3, 2**31 + 3)
configs = st.builds(
    lambda mode, comms, rounds, memory: Config(TABLE, mode, comms, comms * rounds, memory),
    st.sampled_from(Filter),
    st.integers(1, 4),
    st.integers(1, 4),
    st.sampled_from((64, 66, 2**32 - 2)),
)


def exact_sums(heard: Iterable[Message]) -> Sums:
    """Sums as an engine beside the robots makes them."""
    sums = Sums()
    for _, x_hat, alpha in heard:
        sums_add(sums, x_hat, alpha)
    return sums


def combined(left: Sums, right: Sums, sign: int = 1) -> Sums:
    """Member by member: left + right, or left - right."""
    return Sums(**{m.name: getattr(left, m.name) + sign * getattr(right, m.name) for m in fields(Sums)})


def without_senders(robot: FixedPoint) -> dict[str, int]:
    return {name: value for name, value in robot.state().items() if not name.startswith("heard")}


def exchange(swarm: Sequence[FixedPoint], seen: Sequence[Observation]) -> None:
    """A tick of a lossless, fully connected swarm with latency 0."""
    for robot, z in zip(swarm, seen, strict=True):
        robot.observe(z)
    broadcast = [(i, robot.x_hat_raw, robot.alpha_raw) for i, robot in enumerate(swarm)]
    for i, robot in enumerate(swarm):
        receive_all(robot, broadcast[:i] + broadcast[i + 1 :])
    for robot in swarm:
        robot.settle()


# --- Messages and sums -----------------------------------------------------------------------------------


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


@of_fixed_point
@thorough
@given(heard=messages, cut=st.integers(0, 30), config=configs)
def test_sums_at_once_are_messages_one_by_one(
    kind: FixedPointType, heard: list[Message], cut: int, config: Config
) -> None:
    """I13: some by receive, some by add_round, or all in one or two calls."""
    robot, other = kind(config, OWN_ID, 0.75), kind(config, OWN_ID, 0.75)
    receive_all(robot, heard)
    receive_all(other, heard[:cut])
    assert other.add_round(exact_sums(heard[cut:]), len(heard[cut:])) == Status.OK
    assert without_senders(robot) == without_senders(other)
    assert robot.counters == other.counters
    for _ in range(config.comms_period):
        assert robot.step(Observation.BLACK) == other.step(Observation.BLACK)
    assert robot.state() == other.state(), "the senders are forgotten, too"


@of_fixed_point
@thorough
@given(heard=st.lists(messages, min_size=1, max_size=4))
def test_sums_of_groups_add(kind: FixedPointType, heard: list[list[Message]]) -> None:
    """I13"""
    robot, other = kind(PLAIN, OWN_ID, 0.75), kind(PLAIN, OWN_ID, 0.75)
    whole = Sums()
    for group in heard:
        assert robot.add_round(exact_sums(group), len(group)) == Status.OK
        whole = combined(whole, exact_sums(group))
    assert other.add_round(whole, sum(map(len, heard))) == Status.OK
    assert robot.state() == other.state()
    assert robot.holds_invariants()


@of_fixed_point
@quick
@given(size=st.integers(2, 20), seed=st.integers(0, 2**32), mode=st.sampled_from(Filter))
def test_all_less_one_is_receiving_one_by_one(
    kind: FixedPointType, size: int, seed: int, mode: Filter
) -> None:
    """I13: a simulator sums the swarm once and takes each robot's own share out."""
    stream, config = random.Random(seed), Config(TABLE, mode, filter_period=3, memory=64)
    swarm, other = ([kind(config, i, 0.55 + 0.02 * i) for i in range(size)] for _ in range(2))
    for _ in range(12):
        seen = [Observation(stream.randrange(2)) for _ in range(size)]
        exchange(swarm, seen)
        for robot, z in zip(other, seen, strict=True):
            robot.observe(z)
        broadcast = [(i, robot.x_hat_raw, robot.alpha_raw) for i, robot in enumerate(other)]
        everything = exact_sums(broadcast)
        for i, robot in enumerate(other):
            own = exact_sums(broadcast[i : i + 1])
            assert robot.add_round(combined(everything, own, -1), size - 1) == Status.OK
            robot.settle()
        assert [robot.state() for robot in swarm] == [robot.state() for robot in other]


# --- Swarms ----------------------------------------------------------------------------------------------


@of_fixed_point
@quick
@given(size=st.integers(2, 12), seed=st.integers(0, 2**32), mode=st.sampled_from(Filter))
def test_a_fully_connected_swarm_agrees_to_the_bit(
    kind: FixedPointType, size: int, seed: int, mode: Filter
) -> None:
    """I14: every robot divides the same two integers, whatever it assumes of its sensor."""
    stream = random.Random(seed)
    config = Config(TABLE, mode, filter_period=3, memory=64)
    swarm = [kind(config, i, stream.uniform(0.001, 0.999)) for i in range(size)]
    for _ in range(70):
        exchange(swarm, [Observation(stream.randrange(3)) for _ in range(size)])
        assert len({robot.x_raw for robot in swarm}) == 1


@of_every_kind
def test_a_fully_connected_swarm_agrees_in_every_arithmetic(kind: AnyType) -> None:
    """I14, through the interface that all robots share; sums of float64 are correctly rounded."""
    stream = random.Random(0)
    config = Config(TABLE, Filter.ALWAYS, filter_period=3)
    swarm = [kind(config, i, stream.uniform(0.6, 0.99)) for i in range(10)]
    for _ in range(100):
        for robot in swarm:
            robot.observe(Observation(stream.randrange(2)))
        broadcast = [(robot.x_hat, robot.alpha) for robot in swarm]
        for i, robot in enumerate(swarm):
            for sender, message in enumerate(broadcast):
                if sender != i:
                    robot.receive(sender, *message)
        for robot in swarm:
            robot.settle()
        assert len({robot.x for robot in swarm}) == 1


# --- Symmetries ------------------------------------------------------------------------------------------


def at(kind: FixedPointType, t: int, n: int, b_hat: int, z: Observation) -> tuple[int, int]:
    """x_hat and alpha after one more observation."""
    robot = robot_at(kind, t=t, n=n, b_hat=b_hat)
    robot.observe(z)
    return robot.x_hat_raw, robot.alpha_raw


@of_fixed_point
@thorough
@given(t=counts, share=st.integers(0, 2**32), b_hat=b_hats, z=colours)
def test_colours_are_mirror_images(
    kind: FixedPointType, t: int, share: int, b_hat: int, z: Observation
) -> None:
    """I15, I16: exchange the colours, the sense of the sensor, or both."""
    n, other = t * share >> 32, Observation(1 - z)
    assume(t + 1 < 2**31 or 2 * (n + z) != t + 1)  # see test_half_of_many_blacks_are_one_half
    x_hat, alpha = at(kind, t, n, b_hat, z)
    assert at(kind, t, t - n, b_hat, other) == (ONE - x_hat, alpha)
    assert at(kind, t, t - n, 2**32 - b_hat, other) == (x_hat, alpha)
    assert at(kind, t, n, 2**32 - b_hat, z) == (ONE - x_hat, alpha)


@of_fixed_point
@thorough
@given(heard=messages, seen=ticks, b_hat=b_hats)
def test_estimates_stay_within_what_was_said(
    kind: FixedPointType, heard: list[Message], seen: list[Observation], b_hat: int
) -> None:
    """I20: x and x_bar are means."""
    robot = robot_at(kind, b_hat=b_hat)
    for z in seen:
        robot.step(z)
    robot.observe(Observation.NONE)
    receive_all(robot, heard)
    robot.settle()
    said = [x_hat for _, x_hat, alpha in heard if alpha >= 0x33800000]
    if said:
        assert min(said) <= robot.x_bar_raw <= max(said)
    weighty = said + ([robot.x_hat_raw] if robot.alpha_raw or not said else [])
    assert min(weighty) <= robot.x_raw <= max(weighty)


# --- Any calls at all ------------------------------------------------------------------------------------

Call = tuple[str, tuple[object, ...]]
any_word = st.integers(0, 2**32 - 1)
calls = st.lists(
    st.one_of(
        st.tuples(st.just("observe"), st.tuples(st.integers(0, 3))),
        st.tuples(st.just("step"), st.tuples(st.integers(0, 2))),
        st.tuples(st.just("settle"), st.tuples()),
        st.tuples(st.just("receive_raw"), st.tuples(st.integers(0, 130), x_hats, alphas)),
        st.tuples(st.just("receive_raw"), st.tuples(st.integers(0, 255), any_word, any_word)),
        st.tuples(st.just("add_round"), st.lists(st.tuples(x_hats, alphas), max_size=3)),
    ),
    max_size=60,
)

MAY_CHANGE = {
    "observe": ("t", "n", "x_hat", "alpha", "comms_left"),
    "receive_raw": ("heard", "open", "silent", "repeated", "rejected"),
    "add_round": ("open", "silent"),
    "settle": (
        *("settled", "closed", "open", "heard", "silent", "comms_left", "filter_left"),
        *("accepted", "tests", "updates", "b_hat", "accuracy"),
    ),
}
MAY_CHANGE["step"] = MAY_CHANGE["observe"] + MAY_CHANGE["settle"]
"""First words of the members that a call may change (I19)."""


def perform(robot: FixedPoint, call: Call) -> Status:
    name, arguments = call
    if name == "add_round":
        sums = exact_sums([(0, *pair) for pair in arguments])  # type: ignore[misc]
        return robot.add_round(sums, len(arguments))
    return Status(getattr(robot, name)(*arguments))


def is_error_free(before: dict[str, int], after: dict[str, int], status: Status) -> bool:
    """I11: an error leaves everything but the counter of rejected messages as it was."""
    return status >= Status.OK or {**before, "rejected": 0} == {**after, "rejected": 0}


@thorough
@given(config=configs, b_hat=st.floats(2**-20, 1 - 2**-20), sequence=calls)
def test_any_calls_keep_the_invariants_and_the_bits(
    config: Config, b_hat: float, sequence: list[Call]
) -> None:
    """I11, I18, I19, I21, I22, I23, after every call."""
    mirror, native = MirrorRobot(config, OWN_ID, b_hat), NativeRobot(config, OWN_ID, b_hat)
    state = mirror.state()
    for call in sequence:
        before, counters = state, mirror.counters
        status = perform(mirror, call)
        state = mirror.state()
        assert (status, state) == (perform(native, call), native.state())
        assert (mirror.x_raw, mirror.x_bar_raw, mirror.counters) == (
            native.x_raw,
            native.x_bar_raw,
            native.counters,
        )
        assert mirror.holds_invariants() and native.holds_invariants()
        changed = [name for name in state if state[name] != before[name]]
        assert all(name.startswith(MAY_CHANGE[call[0]]) for name in changed)
        assert is_error_free(before, state, status)
        assert all(getattr(mirror.counters, m.name) >= getattr(counters, m.name) for m in fields(counters))
        assert call[0] != "settle" or state["comms_left"] >= 1
        assert state["t"] > 0 or (state["x_hat"], state["alpha"]) == (HALF, 0)


@of_fixed_point
@thorough
@given(config=configs, first=calls, rest=calls)
def test_saving_and_restoring_is_not_noticed(
    kind: FixedPointType, config: Config, first: list[Call], rest: list[Call]
) -> None:
    """I17"""
    robot = kind(config, OWN_ID, 0.8)
    for call in first:
        perform(robot, call)
    copy = kind.restore(config, robot.save())
    assert copy.state() == robot.state()
    for call in rest:
        assert perform(copy, call) == perform(robot, call)
    assert (copy.state(), copy.x_raw) == (robot.state(), robot.x_raw)


def is_refused(kind: FixedPointType, config: Config, image: bytes) -> bool:
    try:
        kind.restore(config, image)
    except FirmwareError as error:
        assert error.status == Status.ERR_IMAGE
        return True
    return False


FREE = {"accepted", "repeated", "rejected", "tests", "updates"}
"""Fields of an image in which every value is possible."""


@of_fixed_point
@pytest.mark.parametrize("name", sorted(LAYOUT))
@quick
@given(sequence=calls)
def test_each_field_has_a_value_that_is_refused(
    kind: FixedPointType, name: str, sequence: list[Call]
) -> None:
    """I1 to I10: all ones, in an image that is otherwise sound, of any robot."""
    config = Config(filter=Filter.ALWAYS, comms_period=2, filter_period=4, memory=64)
    robot = kind(config, OWN_ID, 0.8)
    for call in sequence:
        perform(robot, call)
    image = rewritten(robot.save(), **{name: (1 << LAYOUT[name]) - 1})
    assert is_refused(kind, config, image) == (name not in FREE)


LEAST_WRONG: dict[str, Callable[[dict[str, int]], int]] = {
    "t": lambda s: 64,
    "n": lambda s: s["t"] + 1,
    "b_hat": lambda s: 2**32 - 2**12 + 1,
    "x_hat": lambda s: ONE + 1 if s["alpha"] else HALF + 1,
    "settled_x_hat": lambda s: ONE + 1 if s["settled_alpha"] else HALF - 1,
    "alpha": lambda s: ALPHA_MOST + 1 if s["x_hat"] == HALF else 0,
    "closed_alpha_x_low": lambda s: (s["closed_alpha"] << 23) - (s["closed_alpha_x_high"] << 32) + 1,
    "open_alpha": lambda s: s["open_count"] * (2**55 - 2**31) + 1,
    "open_x": lambda s: s["open_count"] * ONE + 1,
    "open_x_squared": lambda s: s["open_x"] * ONE + 1,
    "open_alpha_x_low": lambda s: s["open_x"] * (2**32 - 1) + 1,
    "open_alpha_x_high": lambda s: s["open_x"] * (2**23 - 1) + 1,
    "silent": lambda s: 128 + sum(s[f"heard_{i}"].bit_count() for i in range(4)),
    "comms_left": lambda s: 3,
    "filter_left": lambda s: s["filter_left"] + 1,
    "id": lambda s: 128,
}
"""The value next to what the invariants allow, given the other fields; comms_period is 2, memory 64."""


@of_fixed_point
@pytest.mark.parametrize("name", sorted(LEAST_WRONG))
@quick
@given(sequence=calls)
def test_the_first_impossible_value_is_refused(kind: FixedPointType, name: str, sequence: list[Call]) -> None:
    """I1 to I10, one step beyond the largest value that is possible."""
    config = Config(filter=Filter.ALWAYS, comms_period=2, filter_period=4, memory=64)
    robot = kind(config, OWN_ID, 0.8)
    for call in sequence:
        perform(robot, call)
    state = unpack(robot.save())
    wrong = LEAST_WRONG[name](state)
    if 0 <= wrong < 1 << LAYOUT[name] and wrong != state[name]:
        assert is_refused(kind, config, rewritten(robot.save(), **{name: wrong}))


@pytest.mark.parametrize("kind", FIXED_POINT)
def test_a_flawless_state_is_accepted_whatever_the_counters(kind: FixedPointType) -> None:
    image = kind(replace(PLAIN, memory=64), OWN_ID, 0.75).save()
    for name in FREE:
        restored = kind.restore(replace(PLAIN, memory=64), rewritten(image, **{name: 65535}))
        assert getattr(restored.counters, name) == 65535
    assert kind(PLAIN, OWN_ID, 0.75).holds_invariants()
