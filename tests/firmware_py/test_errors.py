"""What robots refuse, and how: messages, observations, images, settings and tables; an error changes nothing.

I1, I2, ... are the numbers of docs/invariants.md.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import MAX_OMEGA_WORD, Table, checksum
from robots import (
    ALPHA_MOST,
    HALF,
    IMAGE_SIZE,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    AnyType,
    FixedPoint,
    FixedPointType,
    new,
    of_every_kind,
    of_fixed_point,
    pack,
    receive_all,
    rewritten,
    robot_at,
    unpack,
    watch,
)

EPSILON = 2.0**-20
ADAPTIVE = Config(table=TABLE, filter_period=1)
BUSY, ROBUST = replace(ADAPTIVE, filter_period=4), Config(filter=Filter.ROBUST, filter_period=4)


def view(robot: Robot) -> tuple[object, ...]:
    """All that can be seen of a robot, but the counter of rejected messages."""
    values = (robot.t, robot.n, robot.b_hat, robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x)
    return (*values, replace(robot.counters, rejected=0))


# --- Messages and observations ---------------------------------------------------------------------------


# design: R5
@of_every_kind
@pytest.mark.parametrize(
    ("message", "told"),
    [
        *(((sender, 0.5, 1.0), f"sender is {sender};") for sender in (OWN_ID, 128, -1, 256 + 4, 300)),
        *(((1, x, 1.0), f"x_hat is {x};") for x in (math.nextafter(1, 2), -1e-9, math.nan, math.inf)),
        *(((128, 2.0, 0.0), "sender is 128;"), ((1, 2.0, 0.0), "x_hat is 2.0;")),
    ],
)
def test_invalid_messages_count_and_change_nothing(
    kind: AnyType, message: tuple[int, float, float], told: str
) -> None:
    robot = new(kind)
    watch(robot, 2, 1)
    robot.receive(1, 0.25, 4.0)
    before = view(robot)
    with pytest.raises(FirmwareError, match=re.escape(told)) as refused:
        robot.receive(*message)
    assert refused.value.status == (Status.ERR_SENDER if "sender" in told else Status.ERR_X_HAT)
    assert (view(robot), robot.counters.rejected) == (before, 1)


@of_every_kind
@pytest.mark.parametrize("alpha", [-0.0, -1.0, -5e-324, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("sender", "x_hat"), [(1, 0.5), (OWN_ID, 2.0)])
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
def test_raw_messages_that_no_c_type_holds_are_refused(kind: FixedPointType) -> None:
    robot = kind(PLAIN, OWN_ID, 0.75)
    before = robot.state()
    bad = [
        *((sender, 0, 0) for sender in (-1, 255, 256 + 4, 2**40)),
        *((4, x, 0) for x in (-1, ONE + 1, 2**32 + 5)),
    ]
    for count, (sender, x_hat, alpha) in enumerate(bad, 1):
        status = Status.ERR_X_HAT if sender == 4 else Status.ERR_SENDER
        assert robot.receive_raw(sender, x_hat, alpha) == status
        assert robot.state() == {**before, "rejected": count}
    for alpha in (-1, 2**32):
        with pytest.raises(ValueError, match=f"alpha is {alpha}; the firmware's word has 32 bits"):
            robot.receive_raw(4, 0, alpha)


@of_fixed_point
def test_messages_in_an_array_are_received_in_order_and_the_accepted_ones_counted(
    kind: FixedPointType,
) -> None:
    robot, other = (kind(PLAIN, OWN_ID, 0.7) for _ in range(2))
    messages = [
        (1, HALF, 0x80000001),
        (1, ONE, 0x80000003),
        (OWN_ID, 0, 0x80000001),
        (2, ONE + 1, 0),
        (3, 5, 0),
    ]
    array = np.array(messages, np.uint32)
    assert robot.receive_all(array) == 2
    receive_all(other, messages)
    for wrong in (array.astype("int64"), array[:, :2].copy(), array[::2, ::-1], array[:, 0].copy()):
        with pytest.raises(ValueError, match="give a C-contiguous one"):
            robot.receive_all(wrong)
    assert robot.save() == other.save()
    assert robot.counters == Counters(accepted=2, repeated=1, rejected=2)


# design: R1, R11
@of_every_kind
@pytest.mark.parametrize("z", [-1, 2, 2**32 + 1, 2**64])
def test_an_invalid_observation_changes_nothing(kind: AnyType, z: Any) -> None:
    robot = new(kind, ADAPTIVE)
    robot.receive(1, 0.25, 1.0)
    robot.observe(Observation.BLACK)
    before = view(robot)
    assert robot.step(z) == robot.observe(z) == Status.ERR_OBSERVATION
    assert view(robot) == before
    robot.settle()
    assert robot.beta == 1.0, "the round was still open"


# --- Saving ----------------------------------------------------------------------------------------------


def busy_robot(kind: FixedPointType, config: Config = BUSY) -> FixedPoint:
    """In the middle of a round, with something in every field of the state."""
    robot = kind(config, OWN_ID, 0.7)
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


NEW_CROWD = {
    "crowd_centre": 1 << 29,
    "crowd_spread": 1 << 28,
    "crowd_voices": 0,
    "crowd_first": 0,
    "crowd_votes": 0,
    "crowd_trend": 1 << 15,
}
"""What a robot without the robust filter has, always."""


# design: R29
@of_fixed_point
@pytest.mark.parametrize(("robust", "magic"), [(False, 0x4D435302), (True, 0x4D435382)])
def test_an_image_holds_every_field(kind: FixedPointType, robust: bool, magic: int) -> None:
    """The image is the one docs/design.md describes, field by field; what is not there is as if new."""
    robot = busy_robot(kind, ROBUST) if robust else busy_robot(kind)
    image, state = robot.save(), robot.state()
    found = unpack(image)
    assert len(image) == IMAGE_SIZE == 124
    assert found.pop("magic") == magic, "version 2"
    assert found.pop("b_hat") == state["accuracy_b_hat"]
    assert [found.pop(f"nothing_{number}") for number in range(11 * robust)] == [0] * 11 * robust
    rounds = {name: 0 for name in state if name.startswith(("open", "closed"))}
    left = {name: value for name, value in state.items() if not name.startswith("accuracy_")}
    assert found | (rounds if robust else NEW_CROWD) == left
    assert pack(unpack(image)) == image
    zero = [name for name, value in found.items() if not value]
    assert zero == [*["updates"] * robust, "updated"], "the others can be told apart"


def check_refused(
    kind: FixedPointType, config: Config, image: bytes, status: Status = Status.ERR_IMAGE
) -> None:
    with pytest.raises(FirmwareError) as caught:
        kind.restore(config, image)
    assert caught.value.status == status


def relabelled(image: bytes, magic: int) -> bytes:
    """The image with another first word, and the checksum that belongs to it."""
    words = [magic, *(word for (word,) in struct.iter_unpack("<I", image[4:-4]))]
    return struct.pack("<31I", *words, checksum(words))


# design: R30
@of_fixed_point
@pytest.mark.parametrize(("config", "other"), [(BUSY, 0x4D435382), (ROBUST, 0x4D435302)])
def test_damaged_images_and_those_of_another_size_or_make_are_refused(
    kind: FixedPointType, config: Config, other: int
) -> None:
    """I17; ``other`` begins images of robots with the other kinds of filter."""
    robot = busy_robot(kind, config)
    image = robot.save()
    flipped = [
        image[: bit // 8] + bytes([image[bit // 8] ^ 1 << bit % 8]) + image[bit // 8 + 1 :]
        for bit in range(8 * len(image))
    ]
    sizes = [image[:size] for size in (0, 4, 120, 123)] + [image + b"\0", image * 8]
    others = [
        relabelled(image, magic) for magic in (0x4D435300, 0x4D435301, 0x4D435303, 0x4D435402, 0, other)
    ]
    wrong = rewritten(image)[:-4] + struct.pack("<I", checksum([0]))
    for each in (*flipped, *sizes, *others, wrong, bytes(124), b"\xff" * 124, image[::-1]):
        check_refused(kind, robot.config, each)
    assert robot.save() == image


IMPOSSIBLE = {
    "I1": [{"id": 128}, {"id": 255}],
    "I2": [{"t": 100}, {"t": 0, "n": 1}, {"n": 2**32 - 1}, {"t": 2**32 - 1}],
    "I3": [{"b_hat": 2**12 - 1}, {"b_hat": 2**32 - 2**12 + 1}, {"b_hat": 0}],
    "I5": [
        *({"x_hat": ONE + 1}, {"x_hat": ONE + 1, "updated": 1}, {"x_hat": HALF + 1}, {"updated": 2}),
        *({"alpha": alpha, "updated": 1} for alpha in (1, 0x20, 0x80000080, 0x00000101, 0x7FFFFF1F)),
        *({"alpha": 0}, {"alpha": ALPHA_MOST}, {"t": 42}, {"n": 13}, {"b_hat": 3 << 30}, {"updated": 255}),
        *({"t": 0, "n": 0}, {"t": 0, "n": 0, "x_hat": HALF, "alpha": 0, "updated": 1}),
    ],
    "I6": [
        {"closed_alpha": 0, "closed_alpha_x_low": 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 3, "closed_alpha_x_low": 3 * ONE + 1, "closed_alpha_x_high": 0},
        {"closed_alpha": 127 * (2**55 - 2**31) + 1},
        {"closed_alpha": 2**61, "closed_alpha_x_high": 2**53},
        {"closed_alpha": 2**61, "closed_alpha_x_low": 2**62},
    ],
    "I7": [
        *({"open_alpha": 2**62}, {"open_alpha": 2}, {"open_x": 4 * ONE}),
        *({"open_x_squared": 2**53}, {"open_x_squared": 2**40}),
        *({"open_alpha_x_low": 2**62}, {"open_alpha_x_high": 2**53}, {"open_count": 128}, {"open_count": 0}),
    ],
    "I8": [{"heard_0": 0, "heard_1": 0}, {"heard_2": 0, "heard_3": 0}, {"open_count": 5}],
    "I9": [{"heard_0": 1 << OWN_ID}, {"heard_0": 2**32 - 1}],
    "I10": [{"filter_left": 0}, {"filter_left": 5}, {"filter_left": 2**32 - 1}],
    "I24": [
        *({"crowd_centre": 2**30 + 1}, {"crowd_centre": 2**32 - 1}, {"crowd_spread": 2**18 - 1}),
        *({"crowd_spread": 2**28 + 1}, {"crowd_spread": 0}, {"crowd_votes": 2**14 + 1}, {"crowd_voices": 0}),
        *({"crowd_first": 2**12 - 1}, {"crowd_first": 2**32 - 2**12 + 1}, {"crowd_votes": 0}),
        *(NEW_CROWD | {"crowd_first": 3 << 30}, NEW_CROWD | {"crowd_votes": 1, "crowd_first": 3 << 30}),
        *({f"nothing_{number}": 1} for number in range(11)),
    ],
}
"""Fields of the busy robot's image that no sequence of calls can have, by the invariant they break."""


# design: R30
@of_fixed_point
@pytest.mark.parametrize("settings", (BUSY, ROBUST))
@pytest.mark.parametrize("invariant", IMPOSSIBLE)
def test_impossible_states_are_refused(kind: FixedPointType, invariant: str, settings: Config) -> None:
    """With a right checksum, so the invariants themselves must refuse; as far as the image has the fields
    (I8: a count of messages)."""
    config, image = replace(settings, memory=100), busy_robot(kind, settings).save()
    has = unpack(image).keys()
    for fields in IMPOSSIBLE[invariant]:
        if fields.keys() <= has and (invariant != "I8" or "open_count" in has):
            check_refused(kind, config, rewritten(image, **fields))
    assert kind.restore(config, memoryview(image)).save() == image  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        kind.restore(config, 124)  # type: ignore[arg-type]


# design: R31
@of_fixed_point
def test_an_image_must_fit_its_config(kind: FixedPointType) -> None:
    image = robot_at(kind, replace(PLAIN, filter_period=8), t=80, filter_left=8).save()
    kind.restore(replace(PLAIN, filter_period=9, memory=84), image)
    check_refused(kind, replace(PLAIN, filter_period=8, memory=80), image)
    check_refused(kind, replace(PLAIN, filter_period=7), image)
    check_refused(kind, replace(PLAIN, memory=1), image, Status.ERR_CONFIG)
    check_refused(kind, Config(table=None), image, Status.ERR_TABLE)


# --- Settings --------------------------------------------------------------------------------------------

GOOD = Table(omega_word=1 << 30, entries=(2**32 - 2, 3 << 26, (1 << 26) + 1))


def entries(count: int) -> tuple[int, ...]:
    return tuple(range((9 << 26) + count, 9 << 26, -1))


WRONG_ENTRIES = (
    *(entries(0), entries(1), entries(128), entries(258)),
    *((3 << 26, (3 << 26) + 1), (3 << 26, 3 << 26), (4 << 26, 3 << 26, (3 << 26) + 1)),
    *((3 << 26, 1 << 26), (3 << 26, 1), (64 << 26, 2 << 26), (2**33 - 1, 2**31 + 1), (-1, 3 << 26), (-1, -2)),
)
LEGAL_ENTRIES = (((1 << 26) + 2, (1 << 26) + 1), (2**32 - 1, 2**32 - 2), entries(127))
WRONG_MEMORY = (0, -64, 60, 62, 65, 66, 2**31 - 2, 2**31 + 4, 2**32 - 4, 2**32, 2**32 + 64)
WRONG_B_HAT = (EPSILON - 2.0**-33, 1 - EPSILON + 2.0**-53, 0.0, 1.0, -0.5, math.nan, math.inf)


def made(kind: AnyType, **given: Any) -> Status:
    """The status with which a robot of these settings, and others that are sound, is made."""
    table = replace(GOOD, **{name: given.pop(name) for name in ("omega_word", "entries") if name in given})
    robot_id, b_hat = given.pop("robot_id", OWN_ID), given.pop("b_hat", 0.75)
    try:
        kind(Config(**{"table": table} | given), robot_id, b_hat)
    except FirmwareError as error:
        named = {Status.ERR_ID: robot_id, Status.ERR_B_HAT: b_hat}.get(error.status, error.status.name)
        assert str(named) in str(error)
        return error.status
    return Status.OK


# design: R14
@of_every_kind
@pytest.mark.parametrize(
    ("name", "status", "wrong", "legal"),
    [
        ("filter_period", Status.ERR_CONFIG, (0, -1, 2**32, 2**32 + 1), (1, 2**32 - 1)),
        ("memory", Status.ERR_CONFIG, WRONG_MEMORY, (64, 68, 2**31 - 4, 2**31)),
        ("filter", Status.ERR_CONFIG, (4, -1, 256), tuple(Filter)),
        ("omega_word", Status.ERR_TABLE, (0, -1, MAX_OMEGA_WORD + 1, 2**32 + 5), (1, MAX_OMEGA_WORD)),
        ("entries", Status.ERR_TABLE, WRONG_ENTRIES, LEGAL_ENTRIES),
        ("robot_id", Status.ERR_ID, (-1, 128, 255, 256), (0, 127)),
        ("b_hat", Status.ERR_B_HAT, WRONG_B_HAT, (EPSILON, 0.5, 1 - EPSILON)),
    ],
)
def test_settings_are_legal_up_to_their_ends(
    kind: AnyType, name: str, status: Status, wrong: Sequence[Any], legal: Sequence[Any]
) -> None:
    assert [value for value in wrong if made(kind, **{name: value}) != status] == []
    assert [value for value in legal if made(kind, **{name: value}) != Status.OK] == []


# design: R14
@of_every_kind
def test_the_first_error_is_told_and_a_table_is_needed_for_the_test_alone(kind: AnyType) -> None:
    """Config, table, id, b_hat, in this order."""
    assert made(kind, memory=1, table=None, robot_id=200, b_hat=0.0) == Status.ERR_CONFIG
    assert made(kind, table=None, robot_id=200, b_hat=0.0) == Status.ERR_TABLE
    assert made(kind, robot_id=200, b_hat=0.0) == Status.ERR_ID
    for mode in (Filter.ALWAYS, Filter.OFF):
        assert made(kind, filter=mode, table=None) == Status.OK
        assert made(kind, filter=mode, entries=(3 << 26, 3 << 26)) == Status.OK


@dataclass(frozen=True)
class Spoilt(Table):
    """A table whose words are not those of its entries."""

    given: tuple[int, ...]

    def words(self) -> tuple[int, ...]:
        return self.given


# design: R28
@of_every_kind
def test_a_damaged_table_or_one_of_another_make_is_refused(kind: AnyType) -> None:
    """The checksum sees each flipped bit; under a right one word 0 itself must be looked at: format and q."""
    good = GOOD.words()
    flips = itertools.product(range(len(good)), range(32))
    wrong = [(*good[:at], good[at] ^ 1 << bit, *good[at + 1 :]) for at, bit in flips]
    for first in (0x4D435303, 0x4D435503, 3, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400):
        body = (first, *good[1:-1])
        wrong.append((*body, checksum(body)))
    statuses = [made(kind, table=Spoilt(GOOD.omega_word, GOOD.entries, words)) for words in wrong]
    assert statuses == [Status.ERR_TABLE] * len(wrong)
