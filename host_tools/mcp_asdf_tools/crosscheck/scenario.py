"""A scenario of the cross-check: a robot and the calls made to it, as one line of text that replays it.

A line is a list of items separated by commas; an item is a word and its whole numbers, joined by colons::

    table:0.05:30,robot:0:5:2147483648:7:3006477107,observe:1,receive:3:4194304:2147483649,settle

``table`` gives omega and q; without it the robot has no table. ``robot`` gives filter, filter_period, memory,
id and b_hat. All that follows are calls (see ``Call``). Numbers are the firmware's raw integers and may be as
wrong as their C types allow. Only ``restore`` names its numbers: ``restore:t=5:n=3``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

from mcp_asdf.image_format import image_size
from mcp_asdf.robot import Config, Filter, FixedPointRobot, Observation, Status
from mcp_asdf.table import Table
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.crosscheck.image_numbers import (
    MAX_32_BITS,
    largest_number_at,
    places_of_numbers,
    replace_numbers,
)
from mcp_asdf_tools.tables.thresholds import check_q, generate, parse_omega

_MAX_8_BITS = 2**8 - 1
"""Largest number of 8 bits."""
_LARGEST_IMAGE_SIZE = max(image_size(robot_filter) for robot_filter in Filter)
"""Bytes of the largest image."""
_LARGEST_NUMBERS_OF_ITEM = {
    "robot": (_MAX_8_BITS, MAX_32_BITS, MAX_32_BITS, _MAX_8_BITS, MAX_32_BITS),
    "observe": (MAX_32_BITS,),
    "step": (MAX_32_BITS,),
    "settle": (),
    "receive": (_MAX_8_BITS, MAX_32_BITS, MAX_32_BITS),
    "damage": (_LARGEST_IMAGE_SIZE - 1, _MAX_8_BITS),
}
"""The largest value of every number of an item, by the item's name: ``robot``, which makes the robot, or that
of a call. ``restore`` is not here, as it takes any number of numbers with names."""
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
            restore: none; the robot is saved and replaced by the robot restored from its image, in which
                ``new_numbers`` were put and the checksum made right again. If that is refused it stays as
                it was.
            damage: As restore, but the byte at an index is changed by exclusive or with a mask and the
                checksum left as it is.
        new_numbers: Pairs of a name and a value, of numbers that a ``restore`` replaces in the image. Other
            calls have none.
    """

    name: str
    numbers: tuple[int, ...] = ()
    new_numbers: tuple[tuple[str, int], ...] = ()

    def __str__(self) -> str:
        """Return the item of a line, such as ``receive:3:4194304:257`` or ``restore:t=5:n=3``."""
        texts = [str(number) for number in self.numbers]
        texts += [f"{number_name}={value}" for number_name, value in self.new_numbers]
        return ":".join([self.name, *texts])


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

    def first_calls(self, count: int) -> Scenario:
        """Return a scenario of the same robot with the first ``count`` calls, or all if there are fewer."""
        return replace(self, calls=self.calls[:count])


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


@dataclass(frozen=True)
class CallRecord:
    """A call that was made on a robot, with the robot before and after it.

    Attributes:
        setup: Setup of the robot.
        call: The call.
        before: Result of the call before; for the first call, of making the robot.
        after: Result of this call.
    """

    setup: Setup
    call: Call
    before: CallResult
    after: CallResult

    @property
    def old_state(self) -> State:
        """State of the robot before the call."""
        return self.before.state

    @property
    def new_state(self) -> State:
        """State of the robot after the call."""
        return self.after.state

    @property
    def is_observation(self) -> bool:
        """Whether the call has made the robot observe a tile."""
        return self.call.name in ("observe", "step") and self._is_accepted

    @property
    def is_end_of_round(self) -> bool:
        """Whether the call has ended a round."""
        return self.call.name in ("settle", "step") and self._is_accepted

    @property
    def _is_accepted(self) -> bool:
        """Whether the firmware has accepted the call: names of refusals begin with ERR."""
        return not self.after.outcome.startswith("ERR")

    @property
    def had_to_run_filter(self) -> bool:
        """Whether the call, which must have ended a round, had to run the robot's filter, if it has one.

        It had to in the last round of a filter period, if the robot has observed anything.
        """
        is_last_round_of_period = self.old_state["filter_left"] == 1
        has_observations = self.new_state["t"] > 0
        return is_last_round_of_period and has_observations

    @property
    def is_updated(self) -> bool:
        """Whether the call has re-estimated b_hat."""
        return self.after.outcome == "UPDATED"


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
    calls = [_parse_call(call_item, setup.filter) for call_item in call_items]
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


def _parse_call(item: str, filter_number: int) -> Call:
    """Read the item of a call, such as ``observe:1``, of a robot with this filter.

    The names are observe, step, settle, receive, damage and restore; `Call` lists their numbers. Raises
    UsageError for another name, for too few or too many numbers, and for a number that is out of range or
    that the image of such a robot does not have.
    """
    name = _first_word_of(item)
    if name not in _CALL_NAMES:
        raise UsageError(f"{item!r} is no call; there are {', '.join(_CALL_NAMES)}")
    if name == "restore":
        return Call(name, new_numbers=_parse_new_numbers(item, filter_number))
    numbers = _parse_numbers(item)
    if name == "damage":
        _check_limit(numbers[0], image_size(filter_number) - 1, item)
    return Call(name, numbers)


def _parse_new_numbers(item: str, filter_number: int) -> tuple[tuple[str, int], ...]:
    """Read what a ``restore`` replaces in an image: names and values, as in ``restore:t=5:n=3``.

    Raises UsageError for a name that the image of a robot with this filter does not have, and for a value
    that is too large there.
    """
    _, *assignments = item.split(":")
    places = places_of_numbers(filter_number)
    new_numbers = []
    for assignment in assignments:
        number_name, _, text = assignment.partition("=")
        if number_name not in places:
            raise UsageError(
                f"{item}: the image has no {number_name!r}; it has {', '.join(places)}, "
                "for example restore:t=5"
            )
        value = _parse_integer(text, item)
        _check_limit(value, largest_number_at(places[number_name]), item)
        new_numbers.append((number_name, value))
    return tuple(new_numbers)


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
        _check_limit(number, max_number, item)
    return numbers


def _check_limit(number: int, max_number: int, item: str) -> None:
    """Raise UsageError, which names the item, if a number in it is above its limit."""
    if number > max_number:
        raise UsageError(f"{item}: {number} is too large; the limit there is {max_number}")


def _parse_integer(text: str, item: str) -> int:
    """Read a whole number, ``text``, of an ``item``, which the error names.

    Raises UsageError for anything but up to 20 decimal digits.
    """
    is_number = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
    if not is_number:
        raise UsageError(f"{item}: {text!r} is no whole number of decimal digits")
    return int(text)


# --- Calls ---


def edit_image(image: bytes, call: Call, filter_number: int) -> bytes:
    """Return a copy of a robot's image with the changes that a ``restore`` or ``damage`` call makes.

    ``restore`` replaces numbers and computes the checksum anew; ``damage`` flips bits of one byte and leaves
    the checksum as it is. ``filter_number`` is that of the robot, a number of `Filter`.
    """
    if call.name == "restore":
        return replace_numbers(image, filter_number, dict(call.new_numbers))
    byte_index, mask = call.numbers
    damaged_image = bytearray(image)
    damaged_image[byte_index] ^= mask
    return bytes(damaged_image)


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
