"""Nodes on the bus that have no part in a verification: named, not blamed on the controller."""

from __future__ import annotations

from collections import Counter

import can

from mcp_asdf_tools.bus.frames import EVERY_ROBOT, Command, Message, decode, decode_command
from mcp_asdf_tools.robots.node import Subjects


class Disturbed(Exception):  # noqa: N818 (an outcome, no error)
    """The controller heard another node, which the message names: the model cannot follow any more."""


class OtherNodes:
    """Watch over the nodes that are neither the controller nor emulated.

    Most are harmless, and counted. One that the controller listens to ends the verification.
    """

    def __init__(self, robot: int, subjects: Subjects) -> None:
        """Watch on behalf of the controller with the id ``robot``."""
        self._robot = robot
        self._subjects = subjects
        self._counts: Counter[str] = Counter()

    def take(self, frame: can.Message) -> None:
        """Take a frame that is not the controller's. Raises Disturbed if the controller heeds it."""
        if frame.is_error_frame or not frame.is_extended_id:
            self._counts["error frames" if frame.is_error_frame else "frames with 11-bit identifiers"] += 1
            return
        node = frame.arbitration_id & 0x7F
        self._counts[f"frames of node {node}"] += 1
        kind = self._heeded(frame)
        if kind is not None:
            raise Disturbed(
                f"node {node} sends {kind} on this bus, too, and robot {self._robot} hears them: take it "
                "off the bus, or give it other subjects"
            )

    def lines(self) -> list[str]:
        """Number of frames by sender, one line each."""
        return [f"{count} {what}" for what, count in self._counts.items()]

    def _heeded(self, frame: can.Message) -> str | None:
        """The kind of a frame that reaches the controller's firmware or its commands."""
        if isinstance(decode(frame, self._subjects.estimates), Message):
            return "estimates"
        command = decode_command(frame, self._subjects.commands)
        is_obeyed = isinstance(command, Command) and command.target in (self._robot, EVERY_ROBOT)
        return "commands" if is_obeyed else None
