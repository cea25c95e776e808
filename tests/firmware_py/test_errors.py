"""Robots refuse invalid messages, observations, images, settings and tables, and an error changes nothing."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mcp_asdf.image_format import unpack_image
from mcp_asdf.mirror import MirrorRobot
from mcp_asdf.native import NativeRobot
from mcp_asdf.robot import Config, Counters, Filter, FirmwareError, Observation, Robot, Status
from mcp_asdf.table import MAX_OMEGA_WORD, Table, TableError, checksum
from robots import (
    ALPHA_MAX,
    ALPHA_ONE,
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

B_HAT_MARGIN = 2.0**-20
"""How far an accuracy has to be from 0 and 1."""

BELOW_0 = -1e-9
ABOVE_1 = math.nextafter(1, 2)


def visible_state_without_rejected_count(robot: Robot) -> dict[str, object]:
    """Return by name all that a robot shows of itself, except the number of rejected messages."""
    names = ("t", "n", "b_hat", "x_hat", "alpha", "x_bar", "beta", "x")
    values: dict[str, object] = {name: getattr(robot, name) for name in names}
    return {**values, "counters": replace(robot.counters, rejected=0)}


# --- Messages --------------------------------------------------------------------------------------------


def make_used_robot(firmware: Firmware) -> Robot:
    """Make a robot that has seen three tiles and received a message, which an error must not change."""
    robot = make_robot(firmware)
    observe_tiles(robot, black=2, white=1)
    robot.receive(sender=1, x_hat=0.25, alpha=4.0)
    return robot


# design: R5
@for_every_firmware
@pytest.mark.parametrize("sender", [OWN_ID, 128, -1, 256 + 4])  # the last is 4 in a byte of C
def test_a_message_of_an_invalid_sender_is_rejected(firmware: Firmware, sender: int) -> None:
    """An invalid sender is the robot's own id or outside 0 to 127. The error names it."""
    robot = make_robot(firmware)

    with pytest.raises(FirmwareError, match=f"sender is {sender};") as error:
        robot.receive(sender, x_hat=0.5, alpha=1.0)

    assert error.value.status == Status.ERR_SENDER


@for_every_firmware
@pytest.mark.parametrize("sender", [0, 127])
def test_the_smallest_and_the_largest_id_may_send(firmware: Firmware, sender: int) -> None:
    """These ids are 0 and 127."""
    robot = make_robot(firmware)
    assert robot.receive(sender, x_hat=0.5, alpha=1.0) == Status.OK


# design: R5
@for_every_firmware
@pytest.mark.parametrize("x_hat", [ABOVE_1, BELOW_0, math.nan, math.inf])
def test_a_message_with_an_estimate_beyond_0_and_1_is_rejected(firmware: Firmware, x_hat: float) -> None:
    """x_hat is the share of black tiles that the sender estimates.

    Here it is just below 0, just above 1, infinite or not a number. The error names it.
    """
    robot = make_robot(firmware)

    with pytest.raises(FirmwareError, match=re.escape(f"x_hat is {x_hat};")) as error:
        robot.receive(sender=1, x_hat=x_hat, alpha=1.0)

    assert error.value.status == Status.ERR_X_HAT


@for_every_firmware
def test_if_sender_and_estimate_are_wrong_the_sender_is_reported(firmware: Firmware) -> None:
    """Ids are 0 to 127, and estimates 0 to 1."""
    robot = make_robot(firmware)
    with pytest.raises(FirmwareError, match="sender is 128;"):
        robot.receive(sender=128, x_hat=2.0, alpha=1.0)


# design: R5
@for_every_firmware
@pytest.mark.parametrize(("sender", "x_hat"), [(128, 0.5), (1, 2.0)], ids=["wrong sender", "wrong x_hat"])
def test_a_rejected_message_is_counted_and_changes_nothing_else(
    firmware: Firmware, sender: int, x_hat: float
) -> None:
    """The message has a sender above 127, or an estimate x_hat above 1. It raises an error, too."""
    robot = make_used_robot(firmware)
    state_before = visible_state_without_rejected_count(robot)

    with pytest.raises(FirmwareError):
        robot.receive(sender, x_hat, alpha=1.0)

    assert robot.counters.rejected == 1
    assert visible_state_without_rejected_count(robot) == state_before


@for_every_firmware
@pytest.mark.parametrize("alpha", [-0.0, -5e-324, math.nan, math.inf])
@pytest.mark.parametrize(("sender", "x_hat"), [(2, 0.5), (OWN_ID, 2.0)], ids=["valid", "wrong sender"])
def test_an_alpha_that_is_no_confidence_raises_and_changes_nothing(
    firmware: Firmware, alpha: float, sender: int, x_hat: float
) -> None:
    """A confidence is finite and not negative; here alpha is -0.0, below 0, infinite or not a number.

    No bus can carry such an alpha, only a wrong program can pass it. So the message is not even counted as
    rejected, whether its sender and its x_hat are valid or both are not.
    """
    robot = make_used_robot(firmware)
    state_before = visible_state_without_rejected_count(robot)
    counters_before = robot.counters

    with pytest.raises(ValueError, match="alpha is"):
        robot.receive(sender, x_hat, alpha)

    assert visible_state_without_rejected_count(robot) == state_before
    assert robot.counters == counters_before
    # REPEATED would show that the robot had received a message of sender 2.
    assert robot.receive(sender=2, x_hat=0.5, alpha=1.0) == Status.OK


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("sender", "x_hat", "expected_error"),
    [
        (-1, 0, Status.ERR_SENDER),
        (255, 0, Status.ERR_SENDER),
        (256 + 4, 0, Status.ERR_SENDER),  # in a byte of C it would be the valid id 4
        (2**40, 0, Status.ERR_SENDER),
        (4, -1, Status.ERR_X_HAT),
        (4, ONE + 1, Status.ERR_X_HAT),
        (4, 2**32 + 5, Status.ERR_X_HAT),  # in 32 bits of C it would be the valid 5
    ],
)
def test_a_raw_message_with_a_number_out_of_range_or_too_long_for_c_is_rejected(
    firmware: FixedPointFirmware, sender: int, x_hat: int, expected_error: Status
) -> None:
    """A raw message has whole numbers: a sender from 0 to 127, and x_hat from 0 to 2**23, which stands for 1.

    Some numbers here would be valid if C cut off their high bits, such as sender 260, which is 4 in a byte.
    """
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.75)
    state_before = robot.state()

    status = robot.receive_raw(sender, x_hat, alpha=0)

    assert status == expected_error
    state_after = robot.state()
    assert state_after == {**state_before, "rejected": 1}, "nothing else changes"


@for_fixed_point_firmwares
@pytest.mark.parametrize("alpha", [-1, 2**32])
def test_a_raw_alpha_that_has_not_32_bits_raises(firmware: FixedPointFirmware, alpha: int) -> None:
    """Here it is -1 or 2**32. The error names it."""
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.75)
    with pytest.raises(ValueError, match=f"alpha is {alpha}; the firmware's word has 32 bits"):
        robot.receive_raw(sender=4, x_hat=0, alpha=alpha)


@for_fixed_point_firmwares
def test_messages_in_an_array_are_received_in_order(firmware: FixedPointFirmware) -> None:
    """A robot that receives the rows one by one is the same afterwards, byte for byte.

    Each row has sender, x_hat and alpha as whole numbers. The number of accepted messages is returned.
    """
    messages = [
        (1, HALF, ALPHA_ONE),  # accepted
        (1, ONE, ALPHA_ONE),  # repeated: the same sender
        (OWN_ID, 0, ALPHA_ONE),  # rejected: the robot's own id
        (2, ONE + 1, 0),  # rejected: an estimate above 1
        (3, 5, 0),  # accepted
    ]
    robot_with_array = firmware(NO_FILTER, OWN_ID, b_hat=0.7)
    accepted_count = robot_with_array.receive_all(np.array(messages, np.uint32))

    robot_one_by_one = firmware(NO_FILTER, OWN_ID, b_hat=0.7)
    receive_raw_messages(robot_one_by_one, messages)

    assert accepted_count == 2
    assert robot_with_array.counters == Counters(accepted=2, repeated=1, rejected=2)
    assert robot_with_array.save() == robot_one_by_one.save()


@for_fixed_point_firmwares
@pytest.mark.parametrize(
    "wrong_array",
    [
        pytest.param(np.zeros((4, 3), np.int64), id="another type"),
        pytest.param(np.zeros((4, 2), np.uint32), id="two columns"),
        pytest.param(np.zeros(3, np.uint32), id="one dimension"),
        pytest.param(np.zeros((3, 4), np.uint32).T, id="another order in memory"),
    ],
)
def test_an_array_of_another_type_shape_or_order_is_refused(
    firmware: FixedPointFirmware, wrong_array: np.ndarray[Any, Any]
) -> None:
    """An array of messages has three columns of 32 unsigned bits, and its rows follow in order in memory."""
    robot = firmware(NO_FILTER, OWN_ID, b_hat=0.7)

    with pytest.raises(ValueError, match="give a C-contiguous one"):
        robot.receive_all(wrong_array)

    assert robot.counters == Counters(accepted=0, repeated=0, rejected=0)


# --- Observations ----------------------------------------------------------------------------------------


# design: R1, R11
@for_every_firmware
@pytest.mark.parametrize("z", [-1, 2, 2**32 + 1, 2**64])
@pytest.mark.parametrize("method_name", ["step", "observe"])
def test_an_observation_that_is_neither_black_nor_white_changes_nothing(
    firmware: Firmware, method_name: str, z: Any
) -> None:
    """White is 0 and black is 1. Some numbers, such as 2**32 + 1, would be 0 or 1 if C cut off high bits.

    The method ``observe`` counts an observation. ``step`` would also end the round, and so change beta, the
    sum of the confidences that were received in the last round that ended.
    """
    robot = make_robot(firmware, Config(TABLE, Filter.ADAPTIVE, filter_period=1))
    robot.receive(sender=1, x_hat=0.25, alpha=1.0)
    robot.observe(Observation.BLACK)
    state_before = visible_state_without_rejected_count(robot)

    method = getattr(robot, method_name)
    status = method(z)

    assert status == Status.ERR_OBSERVATION
    assert visible_state_without_rejected_count(robot) == state_before


# --- Images ----------------------------------------------------------------------------------------------


FITTING_CONFIG = replace(NO_FILTER, filter_period=9, memory=84)
"""A config that an image with 80 observations and 8 rounds left fits: it has room for more of both."""


def image_with_80_observations_and_8_rounds_left(firmware: FixedPointFirmware) -> bytes:
    """Return the image of a robot with 80 observations and 8 rounds left to the filter."""
    return restore_robot(firmware, replace(NO_FILTER, filter_period=8), t=80, filter_left=8).save()


def status_of_restore(firmware: FixedPointFirmware, config: Config, image: bytes) -> Status:
    """Restore a robot from an image, and return OK, or the error with which the image is refused."""
    try:
        firmware.restore(config, image)
    except FirmwareError as error:
        return error.status
    return Status.OK


@for_fixed_point_firmwares
def test_a_robot_is_restored_from_any_bytes_like_object(firmware: FixedPointFirmware) -> None:
    """An image is the bytes of a saved robot. The annotation allows bytes alone, and views work, too."""
    image = image_with_80_observations_and_8_rounds_left(firmware)
    view_of_image: Any = memoryview(image)

    robot = firmware.restore(FITTING_CONFIG, view_of_image)

    assert robot.save() == image


@for_fixed_point_firmwares
def test_restoring_a_robot_from_a_number_raises(firmware: FixedPointFirmware) -> None:
    """``bytes(124)`` are 124 zeros: if ``restore`` converted its argument, it would take 124 for an image."""
    number_of_bytes_of_an_image: Any = 124
    with pytest.raises(TypeError):
        firmware.restore(FITTING_CONFIG, number_of_bytes_of_an_image)


# design: R31
@for_fixed_point_firmwares
def test_no_robot_is_restored_from_bytes_that_no_robot_saved(firmware: FixedPointFirmware) -> None:
    """An image is the bytes of a saved robot. Here it is too short, too long, all zeros, or backwards."""
    image = image_with_80_observations_and_8_rounds_left(firmware)
    without_last_byte = image[:-1]
    with_a_byte_more = image + b"\0"
    all_zeros = bytes(IMAGE_SIZE)
    backwards = bytes(reversed(image))

    for wrong_image in (b"", without_last_byte, with_a_byte_more, all_zeros, backwards):
        assert status_of_restore(firmware, FITTING_CONFIG, wrong_image) == Status.ERR_IMAGE, wrong_image.hex()


# design: R31
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("config", "expected_status"),
    [
        pytest.param(FITTING_CONFIG, Status.OK, id="it fits"),
        pytest.param(replace(FITTING_CONFIG, memory=80), Status.ERR_IMAGE, id="t has to be below the memory"),
        pytest.param(
            replace(FITTING_CONFIG, filter_period=7), Status.ERR_IMAGE, id="more rounds left than a period"
        ),
        pytest.param(Config(filter=Filter.ROBUST), Status.ERR_IMAGE, id="saved with another filter"),
        pytest.param(replace(FITTING_CONFIG, memory=1), Status.ERR_CONFIG, id="no robot has this memory"),
        pytest.param(Config(table=None), Status.ERR_TABLE, id="this filter needs a table"),
    ],
)
def test_an_image_is_restored_only_with_a_config_that_it_fits(
    firmware: FixedPointFirmware, config: Config, expected_status: Status
) -> None:
    """The image is that of a robot with 80 observations and 8 rounds left until its filter runs.

    So it fits a config with a memory above 80, a filter period of at least 8, and a filter other than the
    robust one. Other configs, and invalid ones, are refused.
    """
    image = image_with_80_observations_and_8_rounds_left(firmware)

    status = status_of_restore(firmware, config, image)

    assert status == expected_status


def image_of_version_2(filter_mark: int) -> bytes:
    """Return 31 words that begin as an image of version 2.

    The first byte is the version, to which the mark of the filter is added.
    """
    return bytes([2 + filter_mark]) + b"SCM" + bytes(120)


ROBUST_MARK = 128
"""Bit of an image's first byte with the robust filter."""
USUAL_IMAGE = image_with_80_observations_and_8_rounds_left(MirrorRobot)
ROBUST_IMAGE = MirrorRobot(Config(filter=Filter.ROBUST), OWN_ID, b_hat=0.75).save()
OLDER_VERSION = "the image is of version 2, and this firmware reads version 3"


# design: R31
@for_fixed_point_firmwares
@pytest.mark.parametrize(
    ("image", "config", "expected_message"),
    [
        pytest.param(image_of_version_2(0), FITTING_CONFIG, OLDER_VERSION, id="older version"),
        pytest.param(
            image_of_version_2(ROBUST_MARK),
            Config(filter=Filter.ROBUST),
            OLDER_VERSION,
            id="older version with the robust filter",
        ),
        pytest.param(
            ROBUST_IMAGE, FITTING_CONFIG, "is that of a robot with the robust filter", id="robust filter"
        ),
        pytest.param(
            USUAL_IMAGE,
            Config(filter=Filter.ROBUST),
            "is that of a robot with a filter other than the robust one",
            id="no robust filter",
        ),
        pytest.param(
            USUAL_IMAGE[:-1] + bytes([USUAL_IMAGE[-1] ^ 1]),
            FITTING_CONFIG,
            "the image is damaged",
            id="a flipped bit in the checksum at the end",
        ),
        pytest.param(
            USUAL_IMAGE,
            replace(FITTING_CONFIG, filter_period=7),
            "does not fit the configuration",
            id="8 rounds left until a filter runs that runs every 7 rounds",
        ),
    ],
)
def test_the_error_for_an_image_that_is_refused_says_why(
    firmware: FixedPointFirmware, image: bytes, config: Config, expected_message: str
) -> None:
    """An image is the bytes of a saved robot, which a robot with this config refuses."""
    with pytest.raises(FirmwareError, match=expected_message):
        firmware.restore(config, image)


def state_or_error(firmware: FixedPointFirmware, config: Config, image: bytes) -> object:
    """Return the state of the robot that is restored from an image, or the error if it is refused."""
    try:
        return firmware.restore(config, image).state()
    except FirmwareError as error:
        return error.status


def image_of_used_robot(config: Config) -> bytes:
    """Return the image of a robot that has observed, received messages and run its filter."""
    robot = MirrorRobot(config, OWN_ID, b_hat=0.7)
    for z in [Observation.WHITE, Observation.BLACK, Observation.WHITE] * 3:
        receive_estimates(robot, 0.4, 0.5, 0.6, 0.4, 0.5, 0.6)
        robot.step(z)
    robot.receive_raw(sender=1, x_hat=1, alpha=ALPHA_MAX)
    return robot.save()


def images_with_one_changed_word(image: bytes) -> Iterator[bytes]:
    """Yield images in which one word is changed, and the checksum fits.

    The word is at an end of the range that a word may have, or differs little from the image's own.
    """
    *words, _checksum = unpack_image(image)
    for index, word in enumerate(words):
        ends_of_ranges = (0, 1, 2**12, 2**18, 2**23, 2**28, 2**30, 2**31, 2**32)
        for value in (*ends_of_ranges, word, word ^ 1 << 16, word ^ 1 << 24):
            for changed_word in (value - 1, value, value + 1):
                changed_words = [*words[:index], changed_word % 2**32, *words[index + 1 :]]
                yield struct.pack(f"<{len(words) + 1}I", *changed_words, checksum(changed_words))


# design: R30
@pytest.mark.parametrize("mode", [Filter.OFF, Filter.ROBUST])
def test_the_c_and_the_python_robot_refuse_the_same_images_and_restore_the_same_robots(mode: Filter) -> None:
    """An image is the 31 or 39 words of a saved robot. Here each word is replaced by 36 others in turn.

    The robots that are restored are compared by their state, and the refusals by their error code.
    """
    config = Config(filter=mode, filter_period=4)
    image_of_robot = image_of_used_robot(config)

    different_outcomes = set[str]()
    for image in images_with_one_changed_word(image_of_robot):
        python_outcome = state_or_error(MirrorRobot, config, image)
        c_outcome = state_or_error(NativeRobot, config, image)
        assert python_outcome == c_outcome, image.hex()
        different_outcomes.add(str(python_outcome))

    assert len(different_outcomes) > 100, "otherwise nearly all images were refused"


# --- Settings --------------------------------------------------------------------------------------------

VALID_TABLE = Table(omega_word=1 << 30, entries=(2**32 - 2, 3 << 26, (1 << 26) + 1))
"""A table for an omega of 1/4, whose entries fall from nearly 64 to just above 1, in units of 2**-26."""


def falling_entries(count: int) -> tuple[int, ...]:
    """Return so many entries that fall strictly and are above 9, in units of 2**-26."""
    return tuple(range((9 << 26) + count, 9 << 26, -1))


INVALID_ENTRIES = (
    *(falling_entries(count) for count in (0, 1, 128, 258)),  # too few or too many
    *((3 << 26, (3 << 26) + 1), (3 << 26, 3 << 26), (4 << 26, 3 << 26, (3 << 26) + 1)),  # not falling
    *((3 << 26, 1 << 26), (3 << 26, 1)),  # not above 1
    *((64 << 26, 2 << 26), (2**33 - 1, 2**31 + 1), (-1, 3 << 26), (-1, -2)),  # not of 32 bits
)
VALID_ENTRIES = (((1 << 26) + 2, (1 << 26) + 1), (2**32 - 1, 2**32 - 2), falling_entries(127))
INVALID_MEMORY = (0, -64, 60, 62, 65, 66, 2**31 - 2, 2**31 + 4, 2**32 - 4, 2**32, 2**32 + 64)
"""A memory is a multiple of 4, from 64 to 2**31."""
INVALID_B_HAT = (B_HAT_MARGIN - 2.0**-33, 1 - B_HAT_MARGIN + 2.0**-53, 0.0, 1.0, -0.5, math.nan, math.inf)


def status_of_init(firmware: Firmware, **settings: Any) -> Status:
    """Make a robot with these settings, and others that are valid; return OK, or the status of the error.

    An error message must name the wrong value, or the status.
    """
    robot_id, b_hat = settings.pop("robot_id", OWN_ID), settings.pop("b_hat", 0.75)
    omega_word = settings.pop("omega_word", VALID_TABLE.omega_word)
    entries = settings.pop("entries", VALID_TABLE.entries)
    config = Config(**{"table": Table(omega_word, entries)} | settings)
    try:
        firmware(config, robot_id, b_hat)
    except FirmwareError as error:
        wrong_values = {Status.ERR_ID: robot_id, Status.ERR_B_HAT: b_hat}
        value_or_status = wrong_values.get(error.status, error.status.name)
        assert str(value_or_status) in str(error)
        return error.status
    return Status.OK


# design: R14
@for_every_firmware
@pytest.mark.parametrize(
    ("setting", "expected_error", "invalid_values", "valid_values"),
    [
        ("filter_period", Status.ERR_CONFIG, (0, -1, 2**32, 2**32 + 1), (1, 2**32 - 1)),
        ("memory", Status.ERR_CONFIG, INVALID_MEMORY, (64, 68, 2**31 - 4, 2**31)),
        ("filter", Status.ERR_CONFIG, (4, -1, 256), tuple(Filter)),
        ("omega_word", Status.ERR_TABLE, (0, -1, MAX_OMEGA_WORD + 1, 2**32 + 5), (1, MAX_OMEGA_WORD)),
        ("entries", Status.ERR_TABLE, INVALID_ENTRIES, VALID_ENTRIES),
        ("robot_id", Status.ERR_ID, (-1, 128, 255, 256), (0, 127)),
        ("b_hat", Status.ERR_B_HAT, INVALID_B_HAT, (B_HAT_MARGIN, 0.5, 1 - B_HAT_MARGIN)),
    ],
)
def test_settings_are_valid_up_to_the_ends_of_their_ranges(
    firmware: Firmware,
    setting: str,
    expected_error: Status,
    invalid_values: Sequence[Any],
    valid_values: Sequence[Any],
) -> None:
    """``setting`` is the name of a setting, of which some values just outside and inside its range are tried.

    The other settings are valid.
    """
    for value in invalid_values:
        assert status_of_init(firmware, **{setting: value}) == expected_error, value
    for value in valid_values:
        assert status_of_init(firmware, **{setting: value}) == Status.OK, value


# design: R14
@for_every_firmware
def test_if_several_settings_are_wrong_the_first_is_reported(firmware: Firmware) -> None:
    """The order is: config, of which the memory is a part, then table, id and b_hat.

    All values here are wrong, and the settings that are not mentioned are valid.
    """
    status = status_of_init(firmware, memory=1, table=None, robot_id=200, b_hat=0.0)
    assert status == Status.ERR_CONFIG
    status = status_of_init(firmware, table=None, robot_id=200, b_hat=0.0)
    assert status == Status.ERR_TABLE
    status = status_of_init(firmware, robot_id=200, b_hat=0.0)
    assert status == Status.ERR_ID


@for_every_firmware
@pytest.mark.parametrize("mode", [Filter.ALWAYS, Filter.OFF])
def test_filters_without_a_hypothesis_test_ignore_the_table(firmware: Firmware, mode: Filter) -> None:
    """A table has the thresholds of the test. It may be missing, or invalid: its entries have to fall."""
    assert status_of_init(firmware, filter=mode, table=None) == Status.OK

    equal_entries = (3 << 26, 3 << 26)
    assert status_of_init(firmware, filter=mode, entries=equal_entries) == Status.OK


# --- Tables ----------------------------------------------------------------------------------------------


# design: R28
def test_a_table_with_any_flipped_bit_is_refused() -> None:
    """A table has the limits of a robot's test of its accuracy. It is words of 32 bits, the last a checksum.

    With a damaged table a robot would keep a wrong accuracy, or replace a right one.
    """
    words = VALID_TABLE.words()
    for index in range(len(words)):
        for bit in range(32):
            damaged_words = list(words)
            damaged_words[index] ^= 1 << bit
            with pytest.raises(TableError):
                Table.from_words(tuple(damaged_words))


# design: R28
@pytest.mark.parametrize(
    "wrong_first_word",
    [
        pytest.param(0x4D435303, id="MCS instead of MCT"),
        pytest.param(0x00000003, id="no MCT"),
        pytest.param(0x4D435404, id="4 entries, and 3 are there"),
        pytest.param(0x4D435402, id="2 entries, and 3 are there"),
        pytest.param(0x4D4354FF, id="255 entries"),
        pytest.param(0x4D435400, id="no entries"),
    ],
)
def test_a_table_whose_first_word_is_wrong_is_refused_although_its_checksum_is_right(
    wrong_first_word: int,
) -> None:
    """The first word of a table is "MCT" and the number of its entries, here 3. The last is a checksum."""
    _right_first_word, *omega_and_entries, _old_checksum = VALID_TABLE.words()
    words_before_checksum = (wrong_first_word, *omega_and_entries)
    right_checksum = checksum(words_before_checksum)

    with pytest.raises(TableError):
        Table.from_words((*words_before_checksum, right_checksum))
