"""One robot of a bus, without the bus: the frames that it makes and the frames that it takes.

A tick is ``observe``, which returns the estimate if one is due, any number of ``hear``, and ``settle``. The
robots of a swarm, the neighbours of a real controller and the node of a process are all driven this way; they
differ in when heartbeats and telemetry are due, and in what carries the frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import can

from mcp_asdf.robot import Counters, Observation, Robot
from mcp_asdf_tools.bus import (
    MAX_B_HAT,
    MIN_B_HAT,
    ONE,
    TELEMETRY,
    TRANSFER_IDS,
    FrameFormat,
    Heartbeat,
    Message,
    Telemetry,
    encode,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.robots.events import Recorder
from mcp_asdf_tools.robots.firmwares import Words
from mcp_asdf_tools.robots.reception import Content, Decoder, Estimates, Reception, rows_of
from mcp_asdf_tools.robots.rounds import TickedRobot


class Ticked(Protocol):
    """A firmware driven tick by tick, here or in another process."""

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""

    def observe(self, z: Observation | None) -> bool:
        """Begin a tick; returns whether a broadcast is due."""

    def receive_all(self, words: Words) -> int:
        """Take neighbours' messages in order; returns how many were accepted."""

    def settle(self) -> None:
        """End the tick."""


class Participant:
    """The part of a robot's life on a bus that does not depend on where its firmware runs.

    Attributes:
        id: Robot id and node id.
        ticks: Control ticks begun since the robot started.
        is_alive: Whether the robot has not crashed.
        heard: Neighbours whose estimate was accepted since the last broadcast.
        reception: Frames heard, counted.
        recorder: Takes the robot's events; None if they are not recorded.
    """

    def __init__(self, robot_id: int, ticked: Ticked, decoder: Decoder, recorder: Recorder | None) -> None:
        self.id = robot_id
        self.is_alive = True
        self.reception = Reception()
        self.recorder = recorder
        self._decode = decoder
        self._drive(ticked)

    def _drive(self, ticked: Ticked) -> None:
        """Drive this firmware from now on; it has done nothing yet."""
        self.ticks = self.heard = 0
        self._ticked = ticked

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        return self._ticked.counters

    def begin(self, z: Observation | None) -> bool:
        """Begin a tick, with an observation or without; returns whether a broadcast is due."""
        if self.recorder is not None:
            self.recorder.observe(z)
        self.ticks += 1
        is_due = self._ticked.observe(z)
        if is_due:
            self.heard = 0
        return is_due

    def hear(self, *frames: can.Message) -> None:
        """Take any frames of other nodes, in the order in which they came. A dead robot hears nothing."""
        contents = [self._decode(frame) for frame in frames]
        self.receive(Estimates.of(rows_of(contents)))
        self.count([content for content in contents if not isinstance(content, Message)])

    def receive(self, estimates: Estimates) -> None:
        """Hand estimates to the firmware. A dead robot receives nothing. O(estimates)."""
        if not self.is_alive:
            return
        if self.recorder is not None:
            self.recorder.receive(estimates.texts)
        received, accepted = len(estimates), self._ticked.receive_all(estimates.words)
        self.heard += accepted
        self.reception.delivered += received
        if accepted < received:
            self.reception.refused += received - accepted
            self.reception.id_conflicts += estimates.words[:, 0].tolist().count(self.id)

    def count(self, contents: Sequence[Content]) -> None:
        """Count frames that are no estimates. A dead robot counts nothing."""
        if self.is_alive and contents:
            self.reception.count(contents)

    def hear_stranger(self, frame: can.Message) -> None:
        """Count a frame from outside the swarm; the firmware does not get it."""
        if not self.is_alive:
            return
        content = self._decode(frame)
        if isinstance(content, Message):
            self.reception.strays += 1
            self.reception.id_conflicts += content.sender == self.id
        else:
            self.reception.count([content])

    def settle(self) -> None:
        """End the tick."""
        self._ticked.settle()
        if self.recorder is not None:
            self.recorder.settle()


@dataclass
class FramesSent:
    """Frames that a robot has made since it started. Modulo 32 each number is the next transfer_id.

    Attributes:
        estimates: Estimates.
        heartbeats: Heartbeats.
        telemetry: Telemetry frames.
    """

    estimates: int = 0
    heartbeats: int = 0
    telemetry: int = 0


class BusRobot(Participant):
    """A robot whose firmware runs here.

    Attributes:
        sent: Frames made since the robot started.
    """

    _ticked: TickedRobot

    def __init__(
        self,
        robot_id: int,
        make: Callable[[], TickedRobot],
        decoder: Decoder,
        recorder: Recorder | None = None,
        telemetry: FrameFormat = TELEMETRY,
    ) -> None:
        """Start the robot that ``make`` returns; it is called again after a crash that loses the state.

        Estimates are sent where ``decoder`` reads them. Raises as ``make``.
        """
        self._make = make
        self._estimates, self._telemetry = decoder.frames, telemetry
        self._loses_state = False
        self.sent = FramesSent()
        super().__init__(robot_id, make(), decoder, recorder)

    @property
    def robot(self) -> Robot:
        """The firmware; another one after a crash that lost the state."""
        return self._ticked.robot

    def die(self, loses_state: bool) -> None:
        """Crash. The state is lost, or there again when the robot wakes."""
        self.is_alive = False
        self._loses_state = loses_state

    def wake(self) -> None:
        """Rejoin after a crash. Raises as ``make``."""
        self.is_alive = True
        if self._loses_state:
            self.restart()
            if self.recorder is not None:
                self.recorder.restart()

    def restart(self) -> None:
        """Begin anew, as after a reset that loses everything. Raises as ``make``."""
        self.sent = FramesSent()
        self._drive(self._make())

    def observe(self, z: Observation | None, now: float) -> list[can.Message]:
        """Begin a tick; returns the frame of the estimate, stamped ``now`` (seconds), if one is due."""
        return [encode(self.estimate(), self._estimates, now)] if self.begin(z) else []

    def estimate(self) -> Message:
        """The next broadcast, with the present estimate."""
        port, transfer_id = self._ticked.port, self.sent.estimates % TRANSFER_IDS
        self.sent.estimates += 1
        return Message(self.id, port.x_hat_raw, port.alpha_raw, transfer_id)

    def heartbeat(self, now: float) -> can.Message:
        """The next heartbeat. One is due when the robot starts, and then once per second."""
        uptime = self.sent.heartbeats
        self.sent.heartbeats += 1
        return encode_heartbeat(Heartbeat(self.id, uptime, uptime % TRANSFER_IDS), timestamp=now)

    def telemetry(self, now: float) -> can.Message:
        """The robot's present state."""
        b_hat = min(max(int(self.robot.b_hat * 2**24), MIN_B_HAT), MAX_B_HAT)
        updates, transfer_id = self.robot.counters.updates % 256, self.sent.telemetry % TRANSFER_IDS
        self.sent.telemetry += 1
        telemetry = Telemetry(self.id, int(self.robot.x * ONE), b_hat, updates, transfer_id)
        return encode_telemetry(telemetry, self._telemetry, now)
