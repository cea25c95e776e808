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
    NO_FILTER,
    ONE,
    OWN_ID,
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


def visible_state(robot: Robot) -> dict[str, object]:
    """Return all that a robot shows of itself but the counter of rejected messages."""
    names = ("t", "n", "b_hat", "x_hat", "alpha", "x_bar", "beta", "x")
    values: dict[str, object] = {name: getattr(robot, name) for name in names}
    return {**values, "counters": replace(robot.counters, rejected=0)}


# --- Messages --------------------------------------------------------------------------------------------


def check_rejection(firmware: Firmware, sender: int, x_hat: float, status: Status, message: str) -> None:
    """Check that a robot rejects and counts a message, with this error, and that nothing else changes."""
    robot = make_robot(firmware)
    observe_tiles(robot, black=2, white=1)
    robot.receive(sender=1, x_hat=0.25, alpha=4.0)
    state_before = visible_state(robot)

    with pytest.raises(FirmwareError, match=re.escape(message)) as error:
        robot.receive(sender, x_hat, alpha=1.0)

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
    assert make_robot(firmware).receive(sender=sender, x_hat=0.5, alpha=1.0) == Status.OK


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
    """Whether or not sender and x_hat are valid: no bus brings it, so it is the fault of a program."""
    robot = make_robot(firmware)
    observe_tiles(robot, black=2, white=1)
    state_before, counters_before = visible_state(robot), robot.counters

    with pytest.raises(ValueError, match="alpha is"):
        robot.receive(sender, x_hat, alpha)

    assert visible_state(robot) == state_before
    assert robot.counters == counters_before
    # REPEATED would show that sender 1 had been received.
    assert robot.receive(sender=1, x_hat=0.5, alpha=1.0) == Status.OK


@for_fixed_point_firmwares
@pytest.mark.parametrize("sender", [-1, 255, 256 + 4, 2**40])
def test_a_raw_message_of_a_sender_that_no_c_type_holds_is_rejected(
    firmware: FixedPointFirmware, sender: int
) -> None:
    """A conversion to C's byte would make 256 + 4 a valid id."""
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.75)
    state_before = robot.state()

    status = robot.receive_raw(sender, x_hat=0, alpha=0)

    assert status == Status.ERR_SENDER
    assert robot.state() == {**state_before, "rejected": 1}


@for_fixed_point_firmwares
@pytest.mark.parametrize("x_hat", [-1, ONE + 1, 2**32 + 5])
def test_a_raw_message_with_an_x_hat_that_no_c_type_holds_is_rejected(
    firmware: FixedPointFirmware, x_hat: int
) -> None:
    """A conversion to C's 32 bits would make 2**32 + 5 a valid estimate."""
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.75)
    state_before = robot.state()

    status = robot.receive_raw(4, x_hat, alpha=0)

    assert status == Status.ERR_X_HAT
    assert robot.state() == {**state_before, "rejected": 1}


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha", [-1, 2**32])
def test_a_raw_alpha_that_has_not_32_bits_raises(firmware: FixedPointFirmware, alpha: int) -> None:
    robot = firmware(NO_FILTER, OWN_ID, 0.75)
    with pytest.raises(ValueError, match=f"alpha is {alpha}; the firmware's word has 32 bits"):
        robot.receive_raw(4, 0, alpha)


MESSAGES = [(1, HALF, 0x80000001), (1, ONE, 0x80000003), (OWN_ID, 0, 0x80000001), (2, ONE + 1, 0), (3, 5, 0)]
"""Raw messages: two are accepted, one is repeated, two are rejected."""


@for_fixed_point_firmwares
def test_messages_in_an_array_are_received_in_order(firmware: FixedPointFirmware) -> None:
    """As one by one: the robots are equal in the end, and count alike."""
    robot, other_robot = (firmware(NO_FILTER, OWN_ID, b_hat=0.7) for _ in range(2))

    accepted = robot.receive_all(np.array(MESSAGES, np.uint32))
    receive_raw_messages(other_robot, MESSAGES)

    assert accepted == 2
    assert robot.save() == other_robot.save()
    assert robot.counters == Counters(accepted=2, repeated=1, rejected=2)


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "array",
    [
        pytest.param(np.array(MESSAGES, np.int64), id="another type"),
        pytest.param(np.array(MESSAGES, np.uint32)[:, :2].copy(), id="two columns"),
        pytest.param(np.array(MESSAGES, np.uint32)[:, 0].copy(), id="one dimension"),
        pytest.param(np.array(MESSAGES, np.uint32)[::2, ::-1], id="another order in memory"),
    ],
)
def test_an_array_of_another_type_shape_or_order_is_refused(
    firmware: FixedPointFirmware, array: np.ndarray[Any, Any]
) -> None:
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.7)

    with pytest.raises(ValueError, match="give a C-contiguous one"):
        robot.receive_all(array)

    assert robot.counters == Counters()


# --- Observations ----------------------------------------------------------------------------------------


# design: R1, R11
@for_every_firmware
@pytest.mark.parametrize("z", [-1, 2, 2**32 + 1, 2**64])
@pytest.mark.parametrize("method", ["step", "observe"])
def test_an_observation_that_is_neither_black_nor_white_changes_nothing(
    firmware: Firmware, method: str, z: Any
) -> None:
    robot = make_robot(firmware, ADAPTIVE)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.observe(Observation.BLACK)
    state_before = visible_state(robot)

    status = getattr(robot, method)(z)

    assert status == Status.ERR_OBSERVATION
    assert visible_state(robot) == state_before


# design: R1, R11
@for_every_firmware
def test_a_step_with_an_invalid_observation_does_not_end_the_round(firmware: Firmware) -> None:
    """Ended twice, the round would lose its message, and the robot its confidence in others, beta."""
    robot = make_robot(firmware, ADAPTIVE)
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    neither_black_nor_white: Any = 2

    robot.step(neither_black_nor_white)
    robot.settle()  # ends the round

    assert robot.beta == 1.0


# --- Images ----------------------------------------------------------------------------------------------


FITTING = replace(NO_FILTER, filter_period=9, memory=84)
"""A config that fits `saved_image`."""


def saved_image(firmware: FixedPointFirmware) -> bytes:
    """Return the image of a robot with 80 observations and 8 rounds left to the filter."""
    return restore_robot(firmware, replace(NO_FILTER, filter_period=8), t=80, filter_left=8).save()


def restore_status(firmware: FixedPointFirmware, config: Config, image: bytes) -> Status:
    """Return the error with which an image is refused, or OK."""
    try:
        firmware.restore(config, image)
    except FirmwareError as error:
        return error.status
    return Status.OK


@for_fixed_point_firmwares
def test_a_robot_is_restored_from_any_bytes_like_object(firmware: FixedPointFirmware) -> None:
    image = saved_image(firmware)
    assert len(image) == IMAGE_SIZE

    robot = firmware.restore(FITTING, memoryview(image))  # type: ignore[arg-type]

    assert robot.save() == image


@for_fixed_point_firmwares
def test_restoring_a_robot_from_a_number_raises(firmware: FixedPointFirmware) -> None:
    """Python itself would make so many zeros of it."""
    with pytest.raises(TypeError):
        firmware.restore(FITTING, IMAGE_SIZE)  # type: ignore[arg-type]


# design: R31
@for_fixed_point_firmwares
def test_no_robot_is_restored_from_bytes_that_no_robot_saved(firmware: FixedPointFirmware) -> None:
    """Damaged images of all kinds are tried by the cross-check, and by tests/third."""
    image = saved_image(firmware)
    too_short = [image[:size] for size in (0, 4, 120, 123)]
    too_long = [image + b"\0", image * 8]
    of_the_right_size = [bytes(IMAGE_SIZE), image[::-1]]

    for wrong_image in [*too_short, *too_long, *of_the_right_size]:
        assert restore_status(firmware, FITTING, wrong_image) == Status.ERR_IMAGE, wrong_image.hex()


# design: R31
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("config", "status"),
    [
        (FITTING, Status.OK),
        (replace(NO_FILTER, filter_period=8, memory=80), Status.ERR_IMAGE),
        (replace(NO_FILTER, filter_period=7), Status.ERR_IMAGE),
        (Config(filter=Filter.ROBUST), Status.ERR_IMAGE),
        (replace(NO_FILTER, memory=1), Status.ERR_CONFIG),
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
def test_the_error_for_a_saved_robot_with_a_wrong_bit_says_that_it_is_damaged(
    firmware: FixedPointFirmware,
) -> None:
    image = bytearray(saved_image(firmware))
    image[-1] ^= 1

    with pytest.raises(FirmwareError, match="the image is damaged"):
        firmware.restore(FITTING, bytes(image))


@for_fixed_point_firmwares
def test_the_error_for_a_saved_robot_of_other_settings_says_that_it_does_not_fit(
    firmware: FixedPointFirmware,
) -> None:
    """Eight rounds are left until its filter runs, so the filter's period is no shorter."""
    image = saved_image(firmware)

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
def test_the_c_and_the_python_robot_refuse_the_same_changed_images(mode: Filter) -> None:
    """And of those that they accept they restore the same robot.

    Each word of a saved robot takes values at the ends of ranges and beside its own; the checksum fits.
    """
    config = Config(filter=mode, filter_period=4)
    robot = MirrorRobot(config, OWN_ID, b_hat=0.7)
    for tick in range(9):
        receive_estimates(robot, 0.4, 0.5, 0.6, 0.4, 0.5, 0.6)
        robot.step(Observation(tick % 3 == 1))
    robot.receive_raw(1, 1, ALPHA_MAX)
    image = robot.save()
    *words, _checksum = unpack_image(image)

    outcomes = set[str]()
    for word_index, word in enumerate(words):
        ends = (0, 1, 2**12, 2**18, 2**23, 2**28, 2**30, 2**31, 2**32, word, word ^ 1 << 16, word ^ 1 << 24)
        for end, offset in itertools.product(ends, (-1, 0, 1)):
            value = (end + offset) % 2**32
            changed_image = edited_image(image, Call("restore", (word_index, value)))
            outcome = state_or_error(MirrorRobot, config, changed_image)
            assert outcome == state_or_error(NativeRobot, config, changed_image), (word_index, value)
            outcomes.add(str(outcome))
    assert len(outcomes) > 100, "robots and errors of many kinds"


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
    """The invalid values of the setting ``name`` are refused with this status, and the others are taken."""
    for value in invalid:
        assert init_status(firmware, **{name: value}) == status, value
    for value in valid:
        assert init_status(firmware, **{name: value}) == Status.OK, value


# design: R14
@for_every_firmware
def test_of_several_wrong_settings_the_first_is_reported(firmware: Firmware) -> None:
    """The order is: config, table, id, b_hat."""
    wrong_table_id_and_b_hat = {"table": None, "robot_id": 200, "b_hat": 0.0}

    assert init_status(firmware, memory=1, **wrong_table_id_and_b_hat) == Status.ERR_CONFIG
    assert init_status(firmware, **wrong_table_id_and_b_hat) == Status.ERR_TABLE
    assert init_status(firmware, robot_id=200, b_hat=0.0) == Status.ERR_ID


@for_every_firmware
@pytest.mark.parametrize("mode", [Filter.ALWAYS, Filter.OFF])
def test_only_the_hypothesis_test_needs_a_table(firmware: Firmware, mode: Filter) -> None:
    assert init_status(firmware, filter=mode, table=None) == Status.OK
    assert init_status(firmware, filter=mode, entries=(3 << 26, 3 << 26)) == Status.OK


# --- Tables ----------------------------------------------------------------------------------------------


# design: R28
def test_a_table_with_any_flipped_bit_is_refused() -> None:
    words = VALID_TABLE.words()
    for word_index, bit in itertools.product(range(len(words)), range(32)):
        damaged_words = list(words)
        damaged_words[word_index] ^= 1 << bit

        with pytest.raises(TableError):
            Table.from_words(tuple(damaged_words))


# design: R28
@pytest.mark.parametrize(
    "magic_and_q", [0x4D435303, 0x4D435503, 3, 0x4D435404, 0x4D435402, 0x4D4354FF, 0x4D435400]
)
def test_a_table_of_another_format_or_q_is_refused_whatever_its_checksum(magic_and_q: int) -> None:
    words = (magic_and_q, *VALID_TABLE.words()[1:-1])
    with pytest.raises(TableError):
        Table.from_words((*words, checksum(words)))
