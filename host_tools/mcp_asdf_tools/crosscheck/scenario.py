"""A scenario of the cross-check: a robot and the calls made to it, as one line of text that replays it.

A line is a list of items separated by commas; an item is a word and its whole numbers, joined by colons::

    table:0.05:30,robot:0:5:2147483648:7:3006477107,observe:1,receive:3:4194304:2147483649,settle

``table`` gives omega and q; without it the robot has no table. ``robot`` gives filter, filter_period, memory,
id and b_hat. All that follows are calls (see ``Call``). Numbers are the firmware's raw integers and may be as
wrong as their C types allow.
"""

from __future__ import annotations

import struct
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from typing import cast

from mcp_asdf.mirror import IMAGE_WORDS
from mcp_asdf.robot import Config, Filter, FixedPointRobot, Observation, Status
from mcp_asdf.table import Table, checksum
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.tables.thresholds import check_q, generate, parse_omega

IMAGE = struct.Struct(f"<{IMAGE_WORDS}I")
"""A saved robot, as words."""

_U8, _U32 = 2**8 - 1, 2**32 - 1
_LARGEST = {
    "robot": (_U8, _U32, _U32, _U8, _U32),
    "observe": (_U32,),
    "step": (_U32,),
    "settle": (),
    "receive": (_U8, _U32, _U32),
    "damage": (4 * IMAGE_WORDS - 1, _U8),
}
"""The largest value of every number of an item; the pairs of ``restore`` are apart."""

REPLACING = ("restore", "damage")
"""Calls that put another robot in the place of the one that is there."""


@dataclass(frozen=True)
class Call:
    """One call of a robot.

    Attributes:
        name: The method, with ``numbers``:
            observe, step: the observation.
            settle: none.
            receive: sender, x_hat, alpha.
            restore: The robot is saved and replaced by the robot restored from its image, in which words were
                replaced (pairs of index, 1 .. 29, and value) and the checksum made right again. If that is
                refused it stays as it was.
            damage: As restore, but the byte at an index is changed by exclusive or with a mask and the
                checksum left as it is.
    """

    name: str
    numbers: tuple[int, ...] = ()

    def __str__(self) -> str:
        return ":".join([self.name, *map(str, self.numbers)])

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of a ``restore``."""
        return _pairs(self.numbers)


@dataclass(frozen=True)
class TableChoice:
    """A table to be generated, for an omega and a q."""

    omega: str
    q: int

    def __str__(self) -> str:
        return f"table:{self.omega}:{self.q}"

    def build(self) -> Table:
        """The table. O(1) after the first of an omega and q."""
        return _generated(self.omega, self.q)


@lru_cache(maxsize=64)
def _generated(omega: str, q: int) -> Table:
    return generate(parse_omega(omega), q)


@dataclass(frozen=True)
class Setup:
    """How a robot is made: the members of ``Config``, its id and b_hat."""

    table: TableChoice | None
    filter: int
    filter_period: int
    memory: int
    robot_id: int
    b_hat: int

    def __str__(self) -> str:
        table = [] if self.table is None else [str(self.table)]
        return ",".join([*table, ":".join(["robot", *map(str, astuple(self)[1:])])])

    def config(self) -> Config:
        """The settings as firmwares take them; a filter may be any number."""
        table = None if self.table is None else self.table.build()
        return Config(table, cast(Filter, self.filter), self.filter_period, self.memory)


@dataclass(frozen=True)
class Scenario:
    """A robot and the calls made to it."""

    setup: Setup
    calls: tuple[Call, ...]

    def __str__(self) -> str:
        return ",".join([str(self.setup), *map(str, self.calls)])

    def with_calls(self, calls: tuple[Call, ...]) -> Scenario:
        """The same robot with other calls."""
        return replace(self, calls=calls)


def _pairs(numbers: tuple[int, ...]) -> list[tuple[int, int]]:
    """Numbers two by two."""
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def parse_scenario(line: str) -> Scenario:
    """Read a scenario's line. Raises UsageError naming the item that is wrong."""
    items = [item.split(":") for item in line.strip().split(",")]
    table = _table(items.pop(0)) if items[0][0] == "table" else None
    if not items or items[0][0] != "robot":
        raise UsageError("a scenario starts with table:... and robot:..., or with robot:... alone")
    robot = _numbers(items[0])
    return Scenario(Setup(table, *robot), tuple(_call(item) for item in items[1:]))


def _table(item: list[str]) -> TableChoice:
    if len(item) != 3:
        raise UsageError(f"{':'.join(item)} needs omega and q, for example table:0.05:30")
    return TableChoice(str(parse_omega(item[1])), check_q(*_integers(item, 2)))


def _call(item: list[str]) -> Call:
    if item[0] == "restore":
        numbers = _integers(item, 1)
        if len(numbers) % 2 or any(not 1 <= i < IMAGE_WORDS - 1 or v > _U32 for i, v in _pairs(numbers)):
            raise UsageError(
                f"{':'.join(item)} needs pairs of an index, 1 to {IMAGE_WORDS - 2}, and a 32-bit word"
            )
        return Call("restore", numbers)
    if item[0] == "robot" or item[0] not in _LARGEST:
        calls = ", ".join(["restore", *list(_LARGEST)[1:]])
        raise UsageError(f"{':'.join(item)!r} is no call; there are {calls}")
    return Call(item[0], _numbers(item))


def _numbers(item: list[str]) -> tuple[int, ...]:
    """An item's numbers, as many as it takes and none too large for its C type."""
    largest, numbers = _LARGEST[item[0]], _integers(item, 1)
    if len(numbers) != len(largest):
        raise UsageError(f"{':'.join(item)} has {len(numbers)} numbers; {item[0]} takes {len(largest)}")
    for number, limit in zip(numbers, largest, strict=True):
        if number > limit:
            raise UsageError(f"{':'.join(item)}: {number} is too large; the limit there is {limit}")
    return numbers


def _integers(item: list[str], start: int) -> tuple[int, ...]:
    for text in item[start:]:
        if not (text.isascii() and text.isdigit() and len(text) <= 20):
            raise UsageError(f"{':'.join(item)}: {text!r} is no whole number of decimal digits")
    return tuple(int(text) for text in item[start:])


def edited_image(image: bytes, call: Call) -> bytes:
    """The image that a ``restore`` or ``damage`` call hands to the firmware, made from one it saved."""
    if call.name == "damage":
        index, mask = call.numbers
        return image[:index] + bytes([image[index] ^ mask]) + image[index + 1 :]
    words = list(IMAGE.unpack(image))
    for index, value in call.pairs:
        words[index] = value
    return IMAGE.pack(*words[:-1], checksum(words[:-1]))


def perform(robot: FixedPointRobot, call: Call) -> Status:
    """Make any call of ``robot`` but those in REPLACING."""
    numbers = call.numbers
    if call.name == "receive":
        return robot.receive_raw(*numbers)
    if call.name == "observe":
        return robot.observe(cast(Observation, numbers[0]))
    if call.name == "step":
        return robot.step(cast(Observation, numbers[0]))
    return robot.settle()
