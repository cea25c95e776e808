"""Unusual frames that a robot must take like any others: what differs is to be ignored, or free to choose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import can

from mcp_asdf_tools.bus import EVERY_ROBOT, Command, FrameFormat, encode_command

PRIORITIES = range(8)
_PRIORITY = 7 << 26
_IGNORED = 3 << 21

Changer = Callable[[can.Message], None]


def _with_priority(priority: int) -> Changer:
    def change(frame: can.Message) -> None:
        frame.arbitration_id = frame.arbitration_id & ~_PRIORITY | priority << 26

    return change


def _without_ignored_bits(frame: can.Message) -> None:
    frame.arbitration_id &= ~_IGNORED


def _with_spare_byte(frame: can.Message) -> None:
    frame.data[6] = 0xFF


_IDENTIFIERS: dict[str, Changer] = {
    **{f"with priority {priority}": _with_priority(priority) for priority in PRIORITIES},
    "with identifier bits 22 and 21 clear": _without_ignored_bits,
}

UNUSUAL_MESSAGES = {f"messages {name}": change for name, change in _IDENTIFIERS.items()}
"""Ways to change an estimate that make no difference."""


@dataclass(frozen=True)
class UnusualCommand:
    """Difference of a command from those of the driver.

    Attributes:
        is_for_all: Whether it is for every robot.
        is_of_another: Whether another node sends it.
        change: What else differs.
    """

    is_for_all: bool = False
    is_of_another: bool = False
    change: Changer = lambda frame: None

    def frame(self, usual: Command, other: int, frames: FrameFormat) -> can.Message:
        """The ``usual`` command with this difference; ``other`` is the id of another node."""
        command = replace(
            usual,
            target=EVERY_ROBOT if self.is_for_all else usual.target,
            sender=other if self.is_of_another else usual.sender,
        )
        frame = encode_command(command, frames)
        self.change(frame)
        return frame


UNUSUAL_COMMANDS = {
    "commands for every robot": UnusualCommand(is_for_all=True),
    "commands of another node": UnusualCommand(is_of_another=True),
    "commands whose spare byte is not 0": UnusualCommand(change=_with_spare_byte),
    **{f"commands {name}": UnusualCommand(change=change) for name, change in _IDENTIFIERS.items()},
}

_HIGH_BITS = (8, 16, 24, 31)
DISTANT_NUMBERS = {
    f"an observe whose number differs from that of the open tick in bit {bit} alone": 1 << bit
    for bit in _HIGH_BITS
}
"""Distances between the numbers of two ticks."""

UNUSUAL = (*UNUSUAL_COMMANDS, *DISTANT_NUMBERS, *UNUSUAL_MESSAGES)
