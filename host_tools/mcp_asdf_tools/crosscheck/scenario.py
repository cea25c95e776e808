"""A scenario of the cross-check: a robot and the calls made to it, as one line of text that replays it.

A line is a list of items separated by commas; an item is a word and its whole numbers, joined by colons::

    table:0.05:30,robot:0:5:2147483648:7:3006477107,observe:1,receive:3:4194304:2147483649,settle

``table`` gives omega and q; without it the robot has no table. ``robot`` gives filter, filter_period, memory,
id and b_hat. All that follows are calls (see ``Call``). Numbers are the firmware's raw integers and may be as
wrong as their C types allow.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import cast

from mcp_asdf.image_format import image_word_count, unpack_image
from mcp_asdf.robot import Config, Filter, FixedPointRobot, Observation, Status
from mcp_asdf.table import Table, checksum
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.tables.thresholds import check_q, generate, parse_omega

_MAX_8_BITS, _MAX_32_BITS = 2**8 - 1, 2**32 - 1
"""Largest number of 8 and of 32 bits."""
_LARGEST_IMAGE_WORDS = max(image_word_count(robot_filter) for robot_filter in Filter)
_LARGEST_NUMBERS_OF_ITEM = {
    "robot": (_MAX_8_BITS, _MAX_32_BITS, _MAX_32_BITS, _MAX_8_BITS, _MAX_32_BITS),
    "observe": (_MAX_32_BITS,),
    "step": (_MAX_32_BITS,),
    "settle": (),
    "receive": (_MAX_8_BITS, _MAX_32_BITS, _MAX_32_BITS),
    "damage": (4 * _LARGEST_IMAGE_WORDS - 1, _MAX_8_BITS),
}
"""The largest value of every number of an item, by the item's name: ``robot``, which makes the robot, or that
of a call. ``restore`` is not here, as it takes any number of pairs."""
_CALL_NAMES = ("restore", "observe", "step", "settle", "receive", "damage")
"""Names of all calls, in the order in which an error lists them."""
_MAX_DIGITS = 20
"""Digits of a number in a line, more than any legal one has."""

CALLS_THAT_REPLACE_ROBOT = ("restore", "damage")
"""Calls after which the robot is another one, restored from an image."""

State = dict[str, int]
"""Fields of a robot's state, and results of its methods, after a call, by name."""


@dataclass(frozen=True)
class Call:
    """One call of a robot.

    Attributes:
        name: The method, with ``numbers``:
            observe, step: the observation.
            settle: none.
            receive: sender, x_hat, alpha.
            restore: The robot is saved and replaced by the robot restored from its image, in which words were
                replaced and the checksum made right again. If that is refused it stays as it was. Numbers are
                pairs of an index, from 1 to the index of the last word before the checksum, and a value.
            damage: As restore, but the byte at an index is changed by exclusive or with a mask and the
                checksum left as it is.
    """

    name: str
    numbers: tuple[int, ...] = ()

    def __str__(self) -> str:
        """Return the item of a line, such as ``receive:3:4194304:257``."""
        return ":".join([self.name, *map(str, self.numbers)])

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of index and value of a ``restore``."""
        return _group_in_pairs(self.numbers)


@dataclass(frozen=True)
class TableChoice:
    """A table to be generated: omega is the test's type II error probability, q its number of entries."""

    omega: str
    q: int

    def __str__(self) -> str:
        """Return the item of a line, such as ``table:0.05:30``."""
        return f"table:{self.omega}:{self.q}"

    def build(self) -> Table:
        """Return the table of thresholds."""
        return generate(parse_omega(self.omega), self.q)


@dataclass(frozen=True)
class Setup:
    """Arguments with which a firmware makes a robot; those of ``Config`` and two more.

    Attributes:
        table: Thresholds of the paper's test; None if the robot has none.
        filter: Value of a ``Filter``, or any other number, which a firmware must refuse.
        filter_period: Rounds from one test to the next.
        memory: Number of observations at which their counts are halved.
        robot_id: Id of the robot.
        b_hat: Accuracy that it assumes of its sensor, in units of 2**-32.
    """

    table: TableChoice | None
    filter: int
    filter_period: int
    memory: int
    robot_id: int
    b_hat: int

    def __str__(self) -> str:
        """Return the items of a line: ``table:...`` if there is a table, and ``robot:...`` with numbers."""
        robot = f"robot:{self.filter}:{self.filter_period}:{self.memory}:{self.robot_id}:{self.b_hat}"
        if self.table is None:
            return robot
        return f"{self.table},{robot}"

    def config(self) -> Config:
        """Return table, filter, filter period and memory as firmwares take them; they may be illegal."""
        table = None if self.table is None else self.table.build()
        return Config(table, cast(Filter, self.filter), self.filter_period, self.memory)


@dataclass(frozen=True)
class Scenario:
    """A robot and the calls made to it, in order."""

    setup: Setup
    calls: tuple[Call, ...]

    def __str__(self) -> str:
        """Return the line that ``parse_scenario`` reads back."""
        return ",".join([str(self.setup), *map(str, self.calls)])

    def replace_calls(self, calls: tuple[Call, ...]) -> Scenario:
        """Return a scenario of the same robot with other calls."""
        return replace(self, calls=calls)


@dataclass(frozen=True)
class CallResult:
    """Outcome of a call, and the robot after it.

    Attributes:
        outcome: Name of a `Status`, or the exception that was raised instead.
        state: State of the robot; empty if there is no robot, or the call raised an exception.
        image: The state as ``save`` returns it; empty likewise.
    """

    outcome: str
    state: State
    image: bytes


def _group_in_pairs(numbers: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return numbers in pairs: the first with the second, and so on. There must be an even number of them."""
    first_numbers, second_numbers = numbers[::2], numbers[1::2]
    return list(zip(first_numbers, second_numbers, strict=True))


# --- Scenarios from text ---


def parse_scenario(line: str) -> Scenario:
    """Read a scenario from its line of text, such as ``robot:2:1:64:0:2147483648,observe:1,settle``.

    Raises UsageError, which names the wrong item.
    """
    items = line.strip().split(",")
    # The first item may be a table, the next one must be the robot, and all others are calls.
    table = None
    if _first_word_of(items[0]) == "table":
        table = _parse_table(items[0])
        items = items[1:]
    if not items or _first_word_of(items[0]) != "robot":
        raise UsageError("a scenario starts with table:... and robot:..., or with robot:... alone")
    robot_item, *call_items = items
    # The numbers of the item are in the order of the attributes of Setup.
    setup = Setup(table, *_parse_numbers(robot_item))
    image_words = image_word_count(setup.filter)
    calls = [_parse_call(call_item, image_words) for call_item in call_items]
    return Scenario(setup, tuple(calls))


def _first_word_of(item: str) -> str:
    """Return the word with which an item begins, which is all up to its first colon."""
    return item.partition(":")[0]


def _parse_table(item: str) -> TableChoice:
    """Read the item of a table, such as ``table:0.05:30``. Raises UsageError if it is wrong."""
    _, *values = item.split(":")
    if len(values) != 2:
        raise UsageError(f"{item} needs omega and q, for example table:0.05:30")
    omega, q = values
    return TableChoice(str(parse_omega(omega)), check_q(_parse_integer(q, item)))


def _parse_call(item: str, image_words: int) -> Call:
    """Read the item of a call, such as ``observe:1``: a name, and numbers after colons.

    An image of the robot has ``image_words`` words of 4 bytes, and a call must not name one beyond. The names
    are observe, step, settle, receive, damage and restore; `Call` lists their numbers. Raises UsageError for
    another name, too few or too many numbers, a number that is out of range, or a text that is no number.
    """
    name, *texts = item.split(":")
    if name == "restore":
        numbers = tuple(_parse_integer(text, item) for text in texts)
        if not _are_replacements_legal(numbers, image_words):
            raise UsageError(f"{item} needs pairs of an index, 1 to {image_words - 2}, and a 32-bit word")
        return Call(name, numbers)
    if name not in _CALL_NAMES:
        raise UsageError(f"{item!r} is no call; there are {', '.join(_CALL_NAMES)}")
    numbers = _parse_numbers(item)
    image_bytes = 4 * image_words
    if name == "damage" and numbers[0] >= image_bytes:
        raise UsageError(f"{item}: {numbers[0]} is too large; the limit there is {image_bytes - 1}")
    return Call(name, numbers)


def _are_replacements_legal(numbers: tuple[int, ...], image_words: int) -> bool:
    """Return whether numbers of a ``restore`` are pairs of an index into an image and a word of 32 bits.

    There may be any number of pairs. Word 0 of the image marks the version, and the last of the
    ``image_words`` words is the checksum: these two must not be replaced.
    """
    if len(numbers) % 2 != 0:
        return False
    last_index = image_words - 2  # that of the word before the checksum
    for index, word in _group_in_pairs(numbers):
        if not 1 <= index <= last_index or word > _MAX_32_BITS:
            return False
    return True


def _parse_numbers(item: str) -> tuple[int, ...]:
    """Read the numbers of an item, such as ``receive:3:4194304:257``, whose name must be known.

    Raises UsageError if there are not as many as the name takes, if one is too large, or if one is none.
    """
    name, *texts = item.split(":")
    numbers = tuple(_parse_integer(text, item) for text in texts)
    max_numbers = _LARGEST_NUMBERS_OF_ITEM[name]
    if len(numbers) != len(max_numbers):
        raise UsageError(f"{item} has {len(numbers)} numbers; {name} takes {len(max_numbers)}")
    for number, max_number in zip(numbers, max_numbers, strict=True):
        if number > max_number:
            raise UsageError(f"{item}: {number} is too large; the limit there is {max_number}")
    return numbers


def _parse_integer(text: str, item: str) -> int:
    """Read a whole number, ``text``, of an ``item``, which the error names.

    Raises UsageError for anything but up to 20 decimal digits.
    """
    is_number = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
    if not is_number:
        raise UsageError(f"{item}: {text!r} is no whole number of decimal digits")
    return int(text)


# --- Calls ---


def edit_image(image: bytes, call: Call) -> bytes:
    """Return a copy of a saved image with the changes that a ``restore`` or ``damage`` call makes.

    ``restore`` replaces words and computes the checksum anew; ``damage`` flips bits of one byte and leaves
    the checksum as it is.
    """
    if call.name == "damage":
        byte_index, mask = call.numbers
        damaged_image = bytearray(image)
        damaged_image[byte_index] ^= mask
        return bytes(damaged_image)
    # Otherwise the call is a restore.
    words = unpack_image(image)
    for index, value in call.pairs:
        words[index] = value
    words[-1] = checksum(words[:-1])
    return struct.pack(f"<{len(words)}I", *words)


def make_call(robot: FixedPointRobot, call: Call) -> Status:
    """Make a call on ``robot``, and return the status with which it answers.

    The call must not be ``restore`` or ``damage``, which make another robot. Its numbers are passed on as
    they are, also those that the firmware must refuse: the status then says so.
    """
    if call.name == "settle":
        return robot.settle()
    if call.name == "receive":
        sender, x_hat, alpha = call.numbers
        return robot.receive_raw(sender, x_hat, alpha)
    [number] = call.numbers
    observation = cast(Observation, number)
    return robot.observe(observation) if call.name == "observe" else robot.step(observation)
