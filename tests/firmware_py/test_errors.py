"""What robots refuse, and how: messages, observations, images, settings and tables; an error changes nothing.

I1, I2, ... are the numbers of docs/invariants.md.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import MAX_OMEGA_WORD, Table, TableError, checksum
from mcp_asdf_tools.crosscheck.scenario import IMAGE, Call, edited_image
from robots import (
    ALPHA_MOST,
    HALF,
    IMAGE_SIZE,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    AnyType,
    FixedPointType,
    hear,
    new,
    of_every_kind,
    of_fixed_point,
    receive_all,
    robot_at,
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


# design: R31
@of_fixed_point
def test_an_image_must_be_one_and_fit_its_config(kind: FixedPointType) -> None:
    """Damaged ones of all kinds are tried by the cross-check, and by tests/third."""
    fits = replace(PLAIN, filter_period=9, memory=84)
    image = robot_at(kind, replace(PLAIN, filter_period=8), t=80, filter_left=8).save()
    restored = kind.restore(fits, memoryview(image))  # type: ignore[arg-type]
    assert restored.save() == image and len(image) == IMAGE_SIZE
    with pytest.raises(TypeError):
        kind.restore(fits, IMAGE_SIZE)  # type: ignore[arg-type]
    sizes = [*(image[:size] for size in (0, 4, 120, 123)), image + b"\0", image * 8]
    for config, wrong, status in (
        *((fits, each, Status.ERR_IMAGE) for each in (*sizes, bytes(IMAGE_SIZE), image[::-1])),
        (replace(PLAIN, filter_period=8, memory=80), image, Status.ERR_IMAGE),
        (replace(PLAIN, filter_period=7), image, Status.ERR_IMAGE),
        (Config(filter=Filter.ROBUST), image, Status.ERR_IMAGE),
        (replace(PLAIN, memory=1), image, Status.ERR_CONFIG),
        (Config(table=None), image, Status.ERR_TABLE),
    ):
        with pytest.raises(FirmwareError) as caught:
            kind.restore(config, wrong)
        assert caught.value.status == status


def restored(kind: FixedPointType, config: Config, image: bytes) -> object:
    """The robot's state, or why there is none."""
    try:
        return kind.restore(config, image).state()
    except FirmwareError as error:
        return error.status


# design: R30
@pytest.mark.parametrize("mode", (Filter.OFF, Filter.ROBUST))
def test_an_image_with_another_word_is_taken_or_refused_by_mirror_and_c_alike(mode: Filter) -> None:
    """Each word, at the ends of ranges and beside its own, under a right checksum."""
    config, seen = Config(filter=mode, filter_period=4), set[object]()
    robot = MirrorRobot(config, OWN_ID, 0.7)
    for tick in range(9):
        hear(robot, 0.4, 0.5, 0.6)
        robot.step(Observation(tick % 3 == 1))
    robot.receive_raw(1, 1, ALPHA_MOST)
    for place, word in enumerate(IMAGE.unpack(robot.save())[:-1]):
        ends = (0, 1, 2**12, 2**18, 2**23, 2**28, 2**30, 2**31, 2**32, word, word ^ 1 << 16, word ^ 1 << 24)
        for value in (end + step & 2**32 - 1 for end in ends for step in (-1, 0, 1)):
            image = edited_image(robot.save(), Call("restore", (place, value)))
            outcome = restored(MirrorRobot, config, image)
            assert outcome == restored(NativeRobot, config, image), (place, value)
            seen.add(str(outcome))
    assert len(seen) > 100


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


# design: R28
def test_words_of_a_damaged_table_or_one_of_another_make_are_none() -> None:
    """The checksum sees each flipped bit; under a right one word 0 itself must be looked at: format and q."""
    good = GOOD.words()
    flips = itertools.product(range(len(good)), range(32))
    wrong = [(*good[:at], good[at] ^ 1 << bit, *good[at + 1 :]) for at, bit in flips]
    for first in (0x4D435303, 0x4D435503, 3, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400):
        body = (first, *good[1:-1])
        wrong.append((*body, checksum(body)))
    for words in wrong:
        with pytest.raises(TableError):
            Table.from_words(words)
