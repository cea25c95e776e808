"""Robots refuse invalid messages, observations, images, settings and tables, and an error changes nothing."""

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
from mcp_asdf_tools.crosscheck.scenario import Call, edited_image, unpack_image
from robots import (
    ALPHA_MAX,
    HALF,
    IMAGE_SIZE,
    ONE,
    OWN_ID,
    PLAIN,
    TABLE,
    Firmware,
    FixedPointFirmware,
    for_every_firmware,
    for_fixed_point_firmwares,
    make_robot,
    observe_tiles,
    receive_estimates,
    receive_raw_messages,
    restore_robot,
)

EPSILON = 2.0**-20
ADAPTIVE = Config(table=TABLE, filter_period=1)

BELOW_0 = -1e-9
ABOVE_1 = math.nextafter(1, 2)


def visible_state(robot: Robot) -> tuple[object, ...]:
    """Return all that a robot shows of itself but the counter of rejected messages."""
    values = (robot.t, robot.n, robot.b_hat, robot.x_hat, robot.alpha, robot.x_bar, robot.beta, robot.x)
    return (*values, replace(robot.counters, rejected=0))


# --- Messages --------------------------------------------------------------------------------------------


def check_rejection(firmware: Firmware, sender: int, x_hat: float, status: Status, message: str) -> None:
    """Check that a robot rejects and counts a message, with this error, and that nothing else changes."""
    robot = make_robot(firmware)
    observe_tiles(robot, black=2, white=1)
    robot.receive(1, 0.25, 4.0)
    state_before = visible_state(robot)
    with pytest.raises(FirmwareError, match=re.escape(message)) as error:
        robot.receive(sender, x_hat, 1.0)
    assert error.value.status == status
    assert visible_state(robot) == state_before
    assert robot.counters.rejected == 1


# design: R5
@for_every_firmware
@pytest.mark.parametrize("sender", [OWN_ID, 128, -1, 256 + 4, 300])
def test_a_message_of_an_invalid_sender_is_rejected(firmware: Firmware, sender: int) -> None:
    check_rejection(firmware, sender, 0.5, Status.ERR_SENDER, f"sender is {sender};")


@for_every_firmware
@pytest.mark.parametrize("sender", [0, 127])
def test_the_smallest_and_the_largest_id_may_send(firmware: Firmware, sender: int) -> None:
    assert make_robot(firmware).receive(sender, 0.5, 1.0) == Status.OK


# design: R5
@for_every_firmware
@pytest.mark.parametrize("x_hat", [ABOVE_1, BELOW_0, math.nan, math.inf, 2.0])
def test_a_message_with_an_invalid_x_hat_is_rejected(firmware: Firmware, x_hat: float) -> None:
    check_rejection(firmware, 1, x_hat, Status.ERR_X_HAT, f"x_hat is {x_hat};")


@for_every_firmware
def test_the_sender_of_a_message_is_checked_first(firmware: Firmware) -> None:
    check_rejection(firmware, 128, 2.0, Status.ERR_SENDER, "sender is 128;")


@for_every_firmware
@pytest.mark.parametrize("alpha", [-0.0, -1.0, -5e-324, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("sender", "x_hat"), [(1, 0.5), (OWN_ID, 2.0)])
def test_an_alpha_that_is_no_confidence_raises_and_changes_nothing(
    firmware: Firmware, alpha: float, sender: int, x_hat: float
) -> None:
    """Frames with such an alpha do not reach a robot; a program that passes one has a fault."""
    robot = make_robot(firmware)
    observe_tiles(robot, black=2, white=1)
    state_before, counters_before = visible_state(robot), robot.counters
    with pytest.raises(ValueError, match="alpha is"):
        robot.receive(sender, x_hat, alpha)
    assert (visible_state(robot), robot.counters) == (state_before, counters_before)
    assert robot.receive(1, 0.5, 1.0) == Status.OK, "the sender has not been heard"


@for_fixed_point_firmwares
@pytest.mark.parametrize("sender", [-1, 255, 256 + 4, 2**40])
def test_a_raw_message_of_a_sender_that_no_c_type_holds_is_rejected(
    firmware: FixedPointFirmware, sender: int
) -> None:
    robot = firmware(PLAIN, OWN_ID, 0.75)
    state_before = robot.state()
    assert robot.receive_raw(sender, 0, 0) == Status.ERR_SENDER
    assert robot.state() == {**state_before, "rejected": 1}


@for_fixed_point_firmwares
@pytest.mark.parametrize("x_hat", [-1, ONE + 1, 2**32 + 5])
def test_a_raw_message_with_an_x_hat_that_no_c_type_holds_is_rejected(
    firmware: FixedPointFirmware, x_hat: int
) -> None:
    robot = firmware(PLAIN, OWN_ID, 0.75)
    state_before = robot.state()
    assert robot.receive_raw(4, x_hat, 0) == Status.ERR_X_HAT
    assert robot.state() == {**state_before, "rejected": 1}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha", [-1, 2**32])
def test_a_raw_alpha_that_has_not_32_bits_raises(firmware: FixedPointFirmware, alpha: int) -> None:
    robot = firmware(PLAIN, OWN_ID, 0.75)
    with pytest.raises(ValueError, match=f"alpha is {alpha}; the firmware's word has 32 bits"):
        robot.receive_raw(4, 0, alpha)


MESSAGES = [(1, HALF, 0x80000001), (1, ONE, 0x80000003), (OWN_ID, 0, 0x80000001), (2, ONE + 1, 0), (3, 5, 0)]
"""Raw messages: two are accepted, one is repeated, two are rejected."""


@for_fixed_point_firmwares
def test_messages_in_an_array_are_received_in_order(firmware: FixedPointFirmware) -> None:
    robot, other_robot = firmware(PLAIN, OWN_ID, 0.7), firmware(PLAIN, OWN_ID, 0.7)
    assert robot.receive_all(np.array(MESSAGES, np.uint32)) == 2
    receive_raw_messages(other_robot, MESSAGES)
    assert robot.save() == other_robot.save()
    assert robot.counters == Counters(accepted=2, repeated=1, rejected=2)


@for_fixed_point_firmwares
def test_an_array_of_another_type_shape_or_order_is_refused(firmware: FixedPointFirmware) -> None:
    robot, array = firmware(PLAIN, OWN_ID, 0.7), np.array(MESSAGES, np.uint32)
    for wrong in (array.astype("int64"), array[:, :2].copy(), array[::2, ::-1], array[:, 0].copy()):
        with pytest.raises(ValueError, match="give a C-contiguous one"):
            robot.receive_all(wrong)
    assert robot.counters == Counters()


# --- Observations ----------------------------------------------------------------------------------------


# design: R1, R11
@for_every_firmware
@pytest.mark.parametrize("z", [-1, 2, 2**32 + 1, 2**64])
def test_an_invalid_observation_changes_nothing_and_keeps_the_round_open(firmware: Firmware, z: Any) -> None:
    robot = make_robot(firmware, ADAPTIVE)
    robot.receive(1, 0.25, 1.0)
    robot.observe(Observation.BLACK)
    state_before = visible_state(robot)
    assert robot.step(z) == robot.observe(z) == Status.ERR_OBSERVATION
    assert visible_state(robot) == state_before
    robot.settle()
    assert robot.beta == 1.0


# --- Images ----------------------------------------------------------------------------------------------


FITTING = replace(PLAIN, filter_period=9, memory=84)
"""A config that fits `saved_image`."""


def saved_image(firmware: FixedPointFirmware) -> bytes:
    """Return the image of a robot with 80 observations and 8 rounds left to the filter."""
    return restore_robot(firmware, replace(PLAIN, filter_period=8), t=80, filter_left=8).save()


def restore_status(firmware: FixedPointFirmware, config: Config, image: bytes) -> Status:
    """Return the error with which an image is refused, or OK."""
    try:
        firmware.restore(config, image)
    except FirmwareError as error:
        return error.status
    return Status.OK


@for_fixed_point_firmwares
def test_an_image_may_be_any_bytes_like_object(firmware: FixedPointFirmware) -> None:
    image = saved_image(firmware)
    assert len(image) == IMAGE_SIZE
    assert firmware.restore(FITTING, memoryview(image)).save() == image  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        firmware.restore(FITTING, IMAGE_SIZE)  # type: ignore[arg-type]


# design: R31
@for_fixed_point_firmwares
def test_bytes_that_are_no_image_are_refused(firmware: FixedPointFirmware) -> None:
    """Damaged images of all kinds are tried by the cross-check, and by tests/third."""
    image = saved_image(firmware)
    wrong_images = [*(image[:size] for size in (0, 4, 120, 123)), image + b"\0", image * 8]
    wrong_images += [bytes(IMAGE_SIZE), image[::-1]]
    statuses = {restore_status(firmware, FITTING, wrong) for wrong in wrong_images}
    assert statuses == {Status.ERR_IMAGE}


# design: R31
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("config", "status"),
    [
        (FITTING, Status.OK),
        (replace(PLAIN, filter_period=8, memory=80), Status.ERR_IMAGE),
        (replace(PLAIN, filter_period=7), Status.ERR_IMAGE),
        (Config(filter=Filter.ROBUST), Status.ERR_IMAGE),
        (replace(PLAIN, memory=1), Status.ERR_CONFIG),
        (Config(table=None), Status.ERR_TABLE),
    ],
)
def test_an_image_is_refused_by_a_config_that_it_does_not_fit(
    firmware: FixedPointFirmware, config: Config, status: Status
) -> None:
    assert restore_status(firmware, config, saved_image(firmware)) == status


V2_IMAGE = bytes.fromhex("0253434d") + bytes(120)
"""An image of version 2: its first word, and 30 more."""
V2_ROBUST_IMAGE = bytes.fromhex("8253434d") + bytes(120)


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("mode", "image"), [(Filter.OFF, V2_IMAGE), (Filter.ROBUST, V2_ROBUST_IMAGE), (Filter.ROBUST, V2_IMAGE)]
)
def test_an_image_of_an_older_version_is_refused_by_name(
    firmware: FixedPointFirmware, mode: Filter, image: bytes
) -> None:
    with pytest.raises(FirmwareError, match="the image is of version 2, and this firmware reads version 3"):
        firmware.restore(Config(filter=mode), image)


# design: R31
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("saved_with", "restored_with", "message"),
    [
        (Filter.ROBUST, Filter.OFF, "is that of a robot with the robust filter"),
        (Filter.OFF, Filter.ROBUST, "is that of a robot with a filter other than the robust one"),
    ],
)
def test_an_image_of_another_filter_is_refused_by_name(
    firmware: FixedPointFirmware, saved_with: Filter, restored_with: Filter, message: str
) -> None:
    image = firmware(Config(filter=saved_with), OWN_ID, 0.75).save()
    with pytest.raises(FirmwareError, match=message):
        firmware.restore(Config(filter=restored_with), image)


@for_fixed_point_firmwares
def test_an_error_says_whether_an_image_is_damaged_or_impossible(firmware: FixedPointFirmware) -> None:
    image = saved_image(firmware)
    with pytest.raises(FirmwareError, match="the image is damaged"):
        firmware.restore(FITTING, image[:-1] + bytes([image[-1] ^ 1]))
    with pytest.raises(FirmwareError, match="does not fit the configuration"):
        firmware.restore(replace(FITTING, filter_period=7), image)


def state_or_error(firmware: FixedPointFirmware, config: Config, image: bytes) -> object:
    """Return the state of the robot that is restored from an image, or the error if it is refused."""
    try:
        return firmware.restore(config, image).state()
    except FirmwareError as error:
        return error.status


# design: R30
@pytest.mark.parametrize("mode", [Filter.OFF, Filter.ROBUST])
def test_mirror_and_c_agree_on_images_with_another_word(mode: Filter) -> None:
    """Each word takes values at the ends of ranges and beside its own; the checksum is made right."""
    config, outcomes = Config(filter=mode, filter_period=4), set[object]()
    robot = MirrorRobot(config, OWN_ID, 0.7)
    for tick in range(9):
        receive_estimates(robot, 0.4, 0.5, 0.6, 0.4, 0.5, 0.6)
        robot.step(Observation(tick % 3 == 1))
    robot.receive_raw(1, 1, ALPHA_MAX)
    image = robot.save()
    for word_index, word in enumerate(unpack_image(image)[:-1]):
        ends = (0, 1, 2**12, 2**18, 2**23, 2**28, 2**30, 2**31, 2**32, word, word ^ 1 << 16, word ^ 1 << 24)
        for value in ((end + offset) % 2**32 for end in ends for offset in (-1, 0, 1)):
            edited = edited_image(image, Call("restore", (word_index, value)))
            outcome = state_or_error(MirrorRobot, config, edited)
            assert outcome == state_or_error(NativeRobot, config, edited), (word_index, value)
            outcomes.add(str(outcome))
    assert len(outcomes) > 100


# --- Settings --------------------------------------------------------------------------------------------

VALID_TABLE = Table(omega_word=1 << 30, entries=(2**32 - 2, 3 << 26, (1 << 26) + 1))


def falling_entries(count: int) -> tuple[int, ...]:
    """Return so many entries that fall strictly and are above 9."""
    return tuple(range((9 << 26) + count, 9 << 26, -1))


INVALID_ENTRIES = (
    *(falling_entries(0), falling_entries(1), falling_entries(128), falling_entries(258)),
    *((3 << 26, (3 << 26) + 1), (3 << 26, 3 << 26), (4 << 26, 3 << 26, (3 << 26) + 1)),
    *((3 << 26, 1 << 26), (3 << 26, 1), (64 << 26, 2 << 26), (2**33 - 1, 2**31 + 1), (-1, 3 << 26), (-1, -2)),
)
VALID_ENTRIES = (((1 << 26) + 2, (1 << 26) + 1), (2**32 - 1, 2**32 - 2), falling_entries(127))
INVALID_MEMORY = (0, -64, 60, 62, 65, 66, 2**31 - 2, 2**31 + 4, 2**32 - 4, 2**32, 2**32 + 64)
INVALID_B_HAT = (EPSILON - 2.0**-33, 1 - EPSILON + 2.0**-53, 0.0, 1.0, -0.5, math.nan, math.inf)


def init_status(firmware: Firmware, **settings: Any) -> Status:
    """Return the status with which a robot of these settings, and others that are valid, is made.

    An error message must name the wrong value, or the status.
    """
    table_fields = {name: settings.pop(name) for name in ("omega_word", "entries") if name in settings}
    robot_id, b_hat = settings.pop("robot_id", OWN_ID), settings.pop("b_hat", 0.75)
    config = Config(**{"table": replace(VALID_TABLE, **table_fields)} | settings)
    try:
        firmware(config, robot_id, b_hat)
    except FirmwareError as error:
        value = {Status.ERR_ID: robot_id, Status.ERR_B_HAT: b_hat}.get(error.status, error.status.name)
        assert str(value) in str(error)
        return error.status
    return Status.OK


# design: R14
@for_every_firmware
@pytest.mark.parametrize(
    ("name", "status", "invalid", "valid"),
    [
        ("filter_period", Status.ERR_CONFIG, (0, -1, 2**32, 2**32 + 1), (1, 2**32 - 1)),
        ("memory", Status.ERR_CONFIG, INVALID_MEMORY, (64, 68, 2**31 - 4, 2**31)),
        ("filter", Status.ERR_CONFIG, (4, -1, 256), tuple(Filter)),
        ("omega_word", Status.ERR_TABLE, (0, -1, MAX_OMEGA_WORD + 1, 2**32 + 5), (1, MAX_OMEGA_WORD)),
        ("entries", Status.ERR_TABLE, INVALID_ENTRIES, VALID_ENTRIES),
        ("robot_id", Status.ERR_ID, (-1, 128, 255, 256), (0, 127)),
        ("b_hat", Status.ERR_B_HAT, INVALID_B_HAT, (EPSILON, 0.5, 1 - EPSILON)),
    ],
)
def test_settings_are_valid_up_to_the_ends_of_their_ranges(
    firmware: Firmware, name: str, status: Status, invalid: Sequence[Any], valid: Sequence[Any]
) -> None:
    assert [value for value in invalid if init_status(firmware, **{name: value}) != status] == []
    assert [value for value in valid if init_status(firmware, **{name: value}) != Status.OK] == []


# design: R14
@for_every_firmware
def test_of_several_wrong_settings_the_first_is_reported(firmware: Firmware) -> None:
    """Config, table, id, b_hat, in this order."""
    assert init_status(firmware, memory=1, table=None, robot_id=200, b_hat=0.0) == Status.ERR_CONFIG
    assert init_status(firmware, table=None, robot_id=200, b_hat=0.0) == Status.ERR_TABLE
    assert init_status(firmware, robot_id=200, b_hat=0.0) == Status.ERR_ID


@for_every_firmware
@pytest.mark.parametrize("mode", [Filter.ALWAYS, Filter.OFF])
def test_only_the_hypothesis_test_needs_a_table(firmware: Firmware, mode: Filter) -> None:
    assert init_status(firmware, filter=mode, table=None) == Status.OK
    assert init_status(firmware, filter=mode, entries=(3 << 26, 3 << 26)) == Status.OK


# --- Tables ----------------------------------------------------------------------------------------------


# design: R28
def test_each_flipped_bit_of_a_table_is_found() -> None:
    words = VALID_TABLE.words()
    for word_index, bit in itertools.product(range(len(words)), range(32)):
        damaged = (*words[:word_index], words[word_index] ^ 1 << bit, *words[word_index + 1 :])
        with pytest.raises(TableError):
            Table.from_words(damaged)


# design: R28
@pytest.mark.parametrize(
    "magic_and_q", [0x4D435303, 0x4D435503, 3, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400]
)
def test_a_table_of_another_format_or_q_is_refused_whatever_its_checksum(magic_and_q: int) -> None:
    words = (magic_and_q, *VALID_TABLE.words()[1:-1])
    with pytest.raises(TableError):
        Table.from_words((*words, checksum(words)))
