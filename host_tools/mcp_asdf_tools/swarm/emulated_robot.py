"""One robot of an emulated swarm with its radio."""

from __future__ import annotations

import can

from mcp_asdf.robot import Counters, Observation, Robot, Status
from mcp_asdf_tools.bus import (
    FrameFormat,
    Heartbeat,
    Message,
    Rejection,
    decode,
    encode,
    encode_heartbeat,
    encode_telemetry,
)
from mcp_asdf_tools.robots import Recorder, RobotRecord, telemetry_of
from mcp_asdf_tools.swarm.traffic import Reception

_TRANSFERS = 32


class Decoder:
    """``decode`` with a memory: many robots hear the very same frame one after the other.

    Attributes:
        frames: Where estimates are.
    """

    def __init__(self, frames: FrameFormat) -> None:
        self.frames = frames
        self._last: dict[int, tuple[can.Message, Message | Rejection]] = {}

    def __call__(self, frame: can.Message) -> Message | Rejection:
        """The estimate, or why it is none. Frames must not change once they have been here."""
        known = self._last.get(frame.arbitration_id)
        if known is not None and known[0] is frame:
            return known[1]
        message = decode(frame, self.frames)
        self._last[frame.arbitration_id] = frame, message
        return message


class Node:
    """A robot that turns what it does into frames, and frames into what it hears.

    Attributes:
        id: Robot id and node id.
        is_flawed: Whether the robot started with a flawed assumed accuracy.
        is_alive: Whether it has not crashed.
        heard: Neighbours whose message was accepted since the last broadcast.
        reception: What it heard, counted.
    """

    def __init__(
        self, record: RobotRecord, is_flawed: bool, decoder: Decoder, recorder: Recorder | None = None
    ) -> None:
        """Make the robot of ``record``; ``recorder`` is told what happens to it.

        Raises UsageError if there is no such firmware here.
        """
        self.id = record.id
        self.is_flawed = is_flawed
        self.is_alive = True
        self.reception = Reception()
        self.recorder = recorder
        self._record = record
        self._decode = decoder
        self._frames = decoder.frames
        self._loses_state = False
        self.start()

    @property
    def robot(self) -> Robot:
        """The firmware; another one after a crash."""
        return self._ticked.robot

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        return self._ticked.counters

    def start(self) -> None:
        """Begin anew, as after a reset that loses all."""
        self._ticked = self._record.make()
        self.heard = 0
        self._beats = 0
        self._reports = 0
        self._rounds = 0

    def die(self, loses_state: bool) -> None:
        """Crash. What the robot knew is gone, or there again when it wakes."""
        self.is_alive = False
        self._loses_state = loses_state

    def wake(self) -> None:
        """Rejoin after a crash."""
        self.is_alive = True
        if self._loses_state:
            self.start()
            if self.recorder is not None:
                self.recorder.restart()

    def observe(self, z: Observation | None) -> bool:
        """Begin a tick, with an observation or without; returns whether a broadcast is due."""
        if self.recorder is not None:
            self.recorder.observe(z)
        is_due = self._ticked.observe(z)
        if is_due:
            self.heard = 0
        return is_due

    def settle(self) -> None:
        """End the tick."""
        self._ticked.settle()
        if self.recorder is not None:
            self.recorder.settle()

    def heartbeat(self, now: float) -> can.Message:
        """The next sign of life, one a second, stamped ``now`` (seconds)."""
        self._beats += 1
        uptime = self._beats - 1
        return encode_heartbeat(Heartbeat(self.id, uptime, uptime % _TRANSFERS), timestamp=now)

    def telemetry_frame(self, now: float) -> can.Message:
        """The robot's present state."""
        self._reports += 1
        return encode_telemetry(telemetry_of(self.robot, self.id, self._reports - 1), timestamp=now)

    def broadcast(self, now: float) -> can.Message:
        """The robot's estimate."""
        self._rounds += 1
        transfer = (self._rounds - 1) % _TRANSFERS
        message = Message(self.id, self._ticked.port.x_hat_raw, self._ticked.port.alpha_raw, transfer)
        return encode(message, self._frames, now)

    def hear(self, frame: can.Message) -> None:
        """Take in a frame that a neighbour's radio has sent, whatever has become of it. O(1)."""
        message = self._message_of(frame)
        if message is None:
            return
        if self.recorder is not None:
            self.recorder.receive(message.sender, message.x_hat, message.alpha)
        status = self._ticked.port.receive_raw(message.sender, message.x_hat, message.alpha)
        self.reception.delivered += 1
        if status == Status.OK:
            self.heard += 1
            return
        self.reception.refused += 1
        self.reception.collisions += message.sender == self.id

    def hear_stranger(self, frame: can.Message) -> None:
        """Take in a frame that nobody of the swarm has sent. Estimates among them are not listened to."""
        message = self._message_of(frame)
        if message is None:
            return
        self.reception.strays += 1
        self.reception.collisions += message.sender == self.id

    def _message_of(self, frame: can.Message) -> Message | None:
        """The estimate in a frame; None, and the rest is counted, where there is none or the node is dead."""
        if not self.is_alive:
            return None
        message = self._decode(frame)
        if isinstance(message, Rejection):
            self.reception.take_other(frame, message)
            return None
        return message
