"""Node of one robot without the bus: it schedules heartbeats and telemetry, and obeys commands.

The same node runs in ``mcp-asdf node``, on any bus and by either clock, and in tools that predict the frames
of a robot. ``docs/frame.md`` has the rules that it follows in lockstep.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np
from can.typechecking import CanFilters

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus import (
    COMMANDS,
    EVERY_ROBOT,
    MAX_NODE_ID,
    TELEMETRY,
    Action,
    Command,
    FrameFormat,
    IdConflict,
    IdConflictWatch,
    Message,
    Rejection,
    decode,
    decode_command,
)
from mcp_asdf_tools.common import UsageError, check_types
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.events import Recorder
from mcp_asdf_tools.robots.rounds import MAX_PERIOD, TickedRobot

ACCEPTANCE_MASK = 0x039F_FF80
"""Identifier bits that a receiver checks; see docs/frame.md."""

_PAUSE = 0.001
"""Seconds in which a bus sends several frames."""


@dataclass(frozen=True)
class Subjects:
    """Format of each kind of message, the same for all nodes. Raises UsageError if two share a subject.

    Attributes:
        estimates: Broadcasts of robots.
        telemetry: Broadcasts for observers.
        commands: Orders of a simulator.
    """

    estimates: FrameFormat = field(default_factory=FrameFormat)
    telemetry: FrameFormat = TELEMETRY
    commands: FrameFormat = COMMANDS

    def __post_init__(self) -> None:
        check_types(self)
        chosen = [self.estimates.subject, self.telemetry.subject, self.commands.subject]
        if len(set(chosen)) < len(chosen):
            raise UsageError(
                f"estimates, telemetry and commands have the subjects {chosen}; choose three different ones"
            )


def filters_for(*formats: FrameFormat) -> CanFilters:
    """Filters of a connection that let only frames of these formats through."""
    return [{"can_id": each.subject << 8, "can_mask": ACCEPTANCE_MASK, "extended": True} for each in formats]


@dataclass
class NodeTraffic:
    """Commands that a node heard, ticks that they left open, and conflicts that it noticed.

    Attributes:
        obeyed: Commands followed.
        disobeyed: Commands for this robot that the rules did not let it follow.
        unsettled: Ticks ended by the next one, since no *settle* had come.
        id_conflicts: Evidence of two nodes with one id, by id.
    """

    obeyed: int = 0
    disobeyed: int = 0
    unsettled: int = 0
    id_conflicts: dict[int, IdConflict] = field(default_factory=dict)


@dataclass(frozen=True)
class NodeSettings:
    """Parameters of a node. Raises UsageError if a value is out of range.

    Attributes:
        id: Robot id and node id, 0 .. 127.
        subjects: Formats of the messages.
        steps_per_second: Control ticks between two heartbeats, 1 or more.
        telemetry_period: Control ticks between two telemetry frames; 1 in lockstep, 0 for none.
    """

    id: int
    subjects: Subjects = field(default_factory=Subjects)
    steps_per_second: int = 10
    telemetry_period: int = 1

    def __post_init__(self) -> None:
        check_types(self)
        for name, low, high in (
            ("id", 0, MAX_NODE_ID),
            ("steps_per_second", 1, 10**6),
            ("telemetry_period", 0, MAX_PERIOD),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"{name.replace('_', '-')} is {value}; it must be {low} to {high}")


class RobotNode(BusRobot):
    """Robot with a schedule of its own that obeys commands.

    Its methods return the frames to send now, in order.

    Attributes:
        settings: Id, subjects and periods.
        is_settled: Whether the last tick is over.
        traffic: Commands and conflicts so far.
    """

    def __init__(self, robot: TickedRobot, settings: NodeSettings, recorder: Recorder | None = None) -> None:
        """Make a node of a robot that has done nothing yet; ``recorder`` takes its events."""
        subjects = settings.subjects
        # A node ends with its process: it is never asked to crash and start again.
        super().__init__(settings.id, lambda: robot, subjects.estimates, recorder, subjects.telemetry)
        self.settings = settings
        self.is_settled = True
        self._watch = IdConflictWatch(settings.id)
        self.traffic = NodeTraffic(id_conflicts=self._watch.found)
        self._tick_of_command: int | None = None

    def start(self) -> list[can.Message]:
        """Announce the node."""
        return [self.heartbeat(self._now)]

    def observe(self, z: Observation | None) -> list[can.Message]:
        """Begin a tick, with an observation or without. One that is still open ends first, unanswered."""
        if not self.is_settled:
            self.traffic.unsettled += 1
            self.end()
        self.is_settled = False
        is_second = self.ticks and self.ticks % self.settings.steps_per_second == 0
        heartbeats = self.start() if is_second else []
        return heartbeats + self.broadcast(z, self._now)

    def settle(self) -> list[can.Message]:
        """End the tick."""
        self.end()
        self.is_settled = True
        is_due = self.settings.telemetry_period and self.ticks % self.settings.telemetry_period == 0
        return [self.telemetry(self._now)] if is_due else []

    def hear(self, frame: can.Message) -> list[can.Message]:
        """Take any frame that this node has not sent itself."""
        message = decode(frame, self.settings.subjects.estimates)
        if isinstance(message, Message):
            if message.sender == self.id and self.recorder is not None:
                self.recorder.foreign(frame)
            self._receive(message)
            return []
        if message is Rejection.SUBJECT:
            command = decode_command(frame, self.settings.subjects.commands)
            if isinstance(command, Command):
                return self._obey(command)
            message = command
        self.reception.rejected[message] += 1
        return []

    def lost(self, frame: can.Message) -> None:
        """Note that the bus did not take ``frame``, which was to be sent."""
        if self.recorder is not None and isinstance(decode(frame, self.settings.subjects.estimates), Message):
            self.recorder.silent()

    def figures(self) -> dict[str, Any]:
        """The frames sent and heard so far as plain values, for JSON."""
        counts = {f"{kind}_sent": count for kind, count in vars(self.sent).items()}
        conflicts = sorted(self.traffic.id_conflicts.items())
        return counts | {
            "delivered": self.reception.delivered,
            "refused": self.reception.refused,
            **vars(self.traffic),
            "rejected": {reason.name: count for reason, count in self.reception.rejected.items()},
            "id_conflicts": {str(sender): conflict.value for sender, conflict in conflicts},
        }

    def _receive(self, message: Message) -> None:
        self._watch.hear(message)
        self.receive(np.array([[message.sender, message.x_hat, message.alpha]], np.uint32))

    def _obey(self, command: Command) -> list[can.Message]:
        if command.target not in (self.settings.id, EVERY_ROBOT):
            return []
        settles = command.action is Action.SETTLE
        is_open = not self.is_settled and command.tick == self._tick_of_command
        if settles != is_open:
            self.traffic.disobeyed += 1
            return []
        self.traffic.obeyed += 1
        if settles:
            return self.settle()
        self._tick_of_command = command.tick
        return self.observe(command.action.observation)

    @property
    def _now(self) -> float:
        """The node's own time, seconds."""
        return self.ticks / self.settings.steps_per_second


def send_all(bus: can.BusABC, frames: Iterable[can.Message], timeout: float) -> None:
    """Put ``frames`` on the bus in order, waiting while its queue is full.

    Raises can.CanError if it takes no frame for ``timeout`` seconds, or fails otherwise.
    """
    for frame in frames:
        deadline = time.monotonic() + timeout
        while not _is_taken(bus, frame, timeout):
            if time.monotonic() > deadline:
                raise can.CanTimeoutError(f"the bus took no frame for {timeout:g} s")
            time.sleep(_PAUSE)


def _is_taken(bus: can.BusABC, frame: can.Message, timeout: float) -> bool:
    """Send a frame; returns whether there was room in the send queue."""
    try:
        bus.send(frame, timeout=timeout)
    except can.CanOperationError as error:
        if error.error_code != errno.ENOBUFS:
            raise
        return False
    return True
