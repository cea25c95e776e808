"""Nodes on the bus that have no part in a verification: named, not blamed on the controller."""

from __future__ import annotations

from collections import Counter

import can

from mcp_asdf_tools.bus import (
    EVERY_ROBOT,
    Command,
    Heartbeat,
    Message,
    Telemetry,
    decode,
    decode_command,
    decode_heartbeat,
    decode_telemetry,
)
from mcp_asdf_tools.robots import Subjects


class Disturbed(Exception):  # noqa: N818 (an outcome, no error)
    """The controller heard a stranger, which the message names: no comparison with the model any more."""


class Strangers:
    """Watch over the nodes that are neither the controller nor emulated.

    Most are harmless, and counted. One that the controller listens to ends the verification.
    """

    def __init__(self, robot: int, subjects: Subjects) -> None:
        """Watch on behalf of the controller with the id ``robot``."""
        self._robot = robot
        self._subjects = subjects
        self._counts: Counter[tuple[int | None, str]] = Counter()

    def take(self, frame: can.Message) -> None:
        """Take a frame that is not the controller's. Raises Disturbed if the controller heeds it."""
        sender, kind, is_heard = self._content(frame)
        self._counts[sender, kind] += 1
        if is_heard:
            raise Disturbed(
                f"node {sender} sends {kind} on this bus, too, and robot {self._robot} hears them: take it "
                "off the bus, or give it other subjects"
            )

    def lines(self) -> list[str]:
        """Who was there, in words."""
        names = {
            sender: "an unknown node" if sender is None else f"node {sender}" for sender, _ in self._counts
        }
        return [f"{names[sender]}: {count} {kind}" for (sender, kind), count in self._counts.items()]

    def _content(self, frame: can.Message) -> tuple[int | None, str, bool]:
        """Sender and kind of a frame, and whether it reaches the controller's firmware or its commands."""
        if frame.is_error_frame or not frame.is_extended_id:
            return None, "error frames" if frame.is_error_frame else "frames with 11-bit identifiers", False
        estimate = decode(frame, self._subjects.estimates)
        if isinstance(estimate, Message):
            return estimate.sender, "estimates", True
        command = decode_command(frame, self._subjects.commands)
        if isinstance(command, Command):
            return command.sender, "commands", command.target in (self._robot, EVERY_ROBOT)
        return frame.arbitration_id & 0x7F, self._harmless(frame), False

    def _harmless(self, frame: can.Message) -> str:
        if isinstance(decode_heartbeat(frame), Heartbeat):
            return "heartbeats"
        telemetry = decode_telemetry(frame, self._subjects.telemetry)
        return "telemetry frames" if isinstance(telemetry, Telemetry) else "other frames"
