"""One robot's side of a CAN bus without the bus: frames in, frames out.

The same node runs in ``mcp-asdf node``, on any bus and by either clock, and in tools that predict what a
robot must say. ``docs/frame.md`` has the rules that it follows in lockstep.
"""

from __future__ import annotations

import errno
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import can
from can.typechecking import CanFilters

from mcp_asdf.robot import Counters, Observation, Robot, Status
from mcp_asdf_tools.bus import (
    COMMANDS,
    EVERY_ROBOT,
    MAX_B_HAT,
    MAX_NODE,
    MIN_B_HAT,
    ONE,
    TELEMETRY,
    Action,
    Collision,
    CollisionWatch,
    Command,
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    Telemetry,
    decode,
    decode_command,
    encode,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.robots.events import Recorder
from mcp_asdf_tools.robots.rounds import MAX_PERIOD, TickedRobot

ACCEPTANCE_MASK = 0x039F_FF80
"""Of an identifier's bits, those that a receiver checks; see docs/frame.md."""

_TRANSFERS = 32
_PAUSE = 0.001
"""Seconds in which a bus sends several frames."""


@dataclass(frozen=True)
class Subjects:
    """Where each kind of message is on the bus, the same for all nodes. Raises UsageError if two are one.

    Attributes:
        estimates: Broadcasts of robots.
        telemetry: Broadcasts for watchers.
        commands: Orders of a simulator.
    """

    estimates: FrameFormat = field(default_factory=FrameFormat)
    telemetry: FrameFormat = TELEMETRY
    commands: FrameFormat = COMMANDS

    def __post_init__(self) -> None:
        chosen = [self.estimates.subject, self.telemetry.subject, self.commands.subject]
        if len(set(chosen)) < len(chosen):
            raise UsageError(
                f"estimates, telemetry and commands have the subjects {chosen}; choose three different ones"
            )


def filters_for(*formats: FrameFormat) -> CanFilters:
    """What a connection has to be told so that nothing but frames of these formats gets through."""
    return [{"can_id": each.subject << 8, "can_mask": ACCEPTANCE_MASK, "extended": True} for each in formats]


def telemetry_of(robot: Robot, robot_id: int, transfer: int) -> Telemetry:
    """The robot's present state as its telemetry number ``transfer``."""
    b_hat = min(max(int(robot.b_hat * 2**24), MIN_B_HAT), MAX_B_HAT)
    updates = robot.counters.updates % 256
    return Telemetry(robot_id, int(robot.x * ONE), b_hat, updates, transfer % _TRANSFERS)


@dataclass
class NodeTraffic:
    """What a node sent and heard, in frames.

    Attributes:
        estimates_sent: Estimates.
        heartbeats_sent: Heartbeats.
        telemetry_sent: Telemetry frames.
        received: Legal estimates of others, all given to the firmware.
        refused: Those among them that the firmware did not accept (repeated or invalid).
        obeyed: Commands followed.
        disobeyed: Commands for this robot that the rules did not let it follow.
        unsettled: Ticks that the next one ended, since no *settle* had come.
        rejected: Other frames, by reason; no more than the connection's filters let through.
        collisions: What is wrong with the id of a sender, by id.
    """

    estimates_sent: int = 0
    heartbeats_sent: int = 0
    telemetry_sent: int = 0
    received: int = 0
    refused: int = 0
    obeyed: int = 0
    disobeyed: int = 0
    unsettled: int = 0
    rejected: Counter[Rejection] = field(default_factory=Counter)
    collisions: dict[int, Collision] = field(default_factory=dict)

    def figures(self) -> dict[str, Any]:
        """The counts as plain values, for JSON."""
        return asdict(self) | {
            "rejected": {reason.name: n for reason, n in self.rejected.items()},
            "collisions": {str(sender): what.value for sender, what in sorted(self.collisions.items())},
        }


@dataclass(frozen=True)
class NodeSettings:
    """What a node is told. Raises UsageError if a value is out of range.

    Attributes:
        id: Robot id and node id, 0 .. 127.
        subjects: Where messages are.
        steps_per_second: Control ticks between two heartbeats, 1 or more.
        telemetry_period: Control ticks between two telemetry frames; 1 in lockstep, 0 for none.
    """

    id: int
    subjects: Subjects = field(default_factory=Subjects)
    steps_per_second: int = 10
    telemetry_period: int = 1

    def __post_init__(self) -> None:
        for name, least, most in (
            ("id", 0, MAX_NODE),
            ("steps_per_second", 1, 10**6),
            ("telemetry_period", 0, MAX_PERIOD),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise UsageError(f"{name.replace('_', '-')} is {value}; it must be {least} to {most}")


class RobotNode:
    """A robot that speaks in frames. Every method returns the frames to send now, in order.

    Attributes:
        settings: What the node is told.
        ticks: Control ticks begun: observations made.
        is_settled: Whether the last tick is over.
        traffic: What was sent and heard so far.
    """

    def __init__(self, robot: TickedRobot, settings: NodeSettings, recorder: Recorder | None = None) -> None:
        """Make a node of a robot that has done nothing yet; ``recorder`` is told what happens to it."""
        self.settings = settings
        self.ticks = 0
        self.is_settled = True
        self.traffic = NodeTraffic()
        self._ticked = robot
        self._recorder = recorder
        self._watch = CollisionWatch(settings.id)
        self.traffic.collisions = self._watch.found
        self._tick_of_command: int | None = None

    @property
    def robot(self) -> Robot:
        """The firmware."""
        return self._ticked.robot

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        return self._ticked.counters

    def start(self) -> list[can.Message]:
        """Say that the node is there."""
        return [self._heartbeat()]

    def observe(self, z: Observation | None) -> list[can.Message]:
        """Begin a tick, with an observation or without. One that is still open ends first, unanswered."""
        frames = []
        if not self.is_settled:
            self.traffic.unsettled += 1
            self._end()
        if self.ticks and self.ticks % self.settings.steps_per_second == 0:
            frames.append(self._heartbeat())
        if self._recorder is not None:
            self._recorder.observe(z)
        if self._ticked.observe(z):
            frames.append(self._estimate())
        self.ticks += 1
        self.is_settled = False
        return frames

    def settle(self) -> list[can.Message]:
        """End the tick."""
        self._end()
        is_due = self.settings.telemetry_period and self.ticks % self.settings.telemetry_period == 0
        return [self._telemetry()] if is_due else []

    def _end(self) -> None:
        self._ticked.settle()
        if self._recorder is not None:
            self._recorder.settle()
        self.is_settled = True

    def hear(self, frame: can.Message) -> list[can.Message]:
        """Take in any frame whatever, but none that this node has sent itself."""
        message = decode(frame, self.settings.subjects.estimates)
        if isinstance(message, Message):
            if message.sender == self.settings.id and self._recorder is not None:
                self._recorder.foreign(frame)
            self._receive(message)
            return []
        if message is Rejection.SUBJECT:
            command = decode_command(frame, self.settings.subjects.commands)
            if isinstance(command, Command):
                return self._obey(command)
            message = command
        self.traffic.rejected[message] += 1
        return []

    def lost(self, frame: can.Message) -> None:
        """Note that ``frame``, which was to be sent, was not: the bus did not take it."""
        if self._recorder is not None and isinstance(
            decode(frame, self.settings.subjects.estimates), Message
        ):
            self._recorder.silent()

    def _receive(self, message: Message) -> None:
        self._watch.hear(message)
        if self._recorder is not None:
            self._recorder.receive(message.sender, message.x_hat, message.alpha)
        status = self._ticked.port.receive_raw(message.sender, message.x_hat, message.alpha)
        self.traffic.received += 1
        self.traffic.refused += status != Status.OK

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

    def _estimate(self) -> can.Message:
        transfer = self.traffic.estimates_sent % _TRANSFERS
        self.traffic.estimates_sent += 1
        port = self._ticked.port
        message = Message(self.settings.id, port.x_hat_raw, port.alpha_raw, transfer)
        return encode(message, self.settings.subjects.estimates, self._now())

    def _heartbeat(self) -> can.Message:
        uptime = self.ticks // self.settings.steps_per_second
        transfer = self.traffic.heartbeats_sent % _TRANSFERS
        self.traffic.heartbeats_sent += 1
        return encode_heartbeat(Heartbeat(self.settings.id, uptime, transfer), timestamp=self._now())

    def _telemetry(self) -> can.Message:
        transfer = self.traffic.telemetry_sent
        self.traffic.telemetry_sent += 1
        telemetry = telemetry_of(self.robot, self.settings.id, transfer)
        return encode_telemetry(telemetry, self.settings.subjects.telemetry, self._now())

    def _now(self) -> float:
        """The node's own time, seconds."""
        return self.ticks / self.settings.steps_per_second


def send_all(bus: can.BusABC, frames: Iterable[can.Message], timeout: float) -> None:
    """Put ``frames`` on the bus in order, and wait where its queue is full.

    Raises can.CanError if it takes none for ``timeout`` seconds, or fails otherwise.
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
