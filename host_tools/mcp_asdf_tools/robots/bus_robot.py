"""One robot of a bus, without the bus: the frames that it makes and the frames that it takes.

A tick is ``broadcast``, which returns the estimate if one is due, any number of ``listen``, and ``end``. The
robots of a swarm, the neighbours of a real controller and the node of a process are all driven this way; they
differ in when heartbeats and telemetry are due, and in what carries the frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias, cast

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import alpha_from_word, alpha_word_from_float
from mcp_asdf.robot import Counters, FirmwareError, FixedPointRobot, Observation, Robot, Status
from mcp_asdf_tools.bus.frame_arrays import decode_estimates
from mcp_asdf_tools.bus.frame_layout import (
    MAX_B_HAT,
    MAX_NODE_ID,
    MIN_B_HAT,
    Q23_ONE,
    TRANSFER_IDS,
    Action,
    Rejection,
)
from mcp_asdf_tools.bus.frames import (
    TELEMETRY_FORMAT,
    Estimate,
    FrameContent,
    FrameFormat,
    Heartbeat,
    Telemetry,
    decode_frame,
    encode_estimate,
    encode_heartbeat,
    encode_telemetry,
    format_frame,
)
from mcp_asdf_tools.robots.record import RobotRecord
from mcp_asdf_tools.robots.suspicion import Suspicion, Suspicions

Words: TypeAlias = NDArray[np.uint32]
"""Estimates for a firmware, shape (estimates, 3): sender, x_hat and alpha, as ``bus.frames.Message``."""

_COUNTER_MODULUS = 2**16
_TICKS_BETWEEN_COUNTS = 64
"""Few enough for 1000 messages a tick: a counter must not gain 2**16 unseen."""

SETTLE = 3
SILENT, RESTART = "silent", "restart"

_OBSERVED = {z: str(Action.to_observe(z).value) for z in (None, *Observation)}

Event = int | str | list[int]
"""One event in a line."""


class Recorder:
    """Recorder of one robot's events, that writes a line per settle, with the texts that ``tell`` makes of
    messages."""

    def __init__(
        self, robot: int, write: Callable[[str], object], tell: Callable[[list[list[int]]], str]
    ) -> None:
        self._head = f"[{robot}"
        self._parts: list[str | list[list[int]]] = [self._head]
        self._write, self._tell = write, tell

    def observe(self, z: Observation | None) -> None:
        """The robot began a tick and observed ``z``, if anything."""
        self._parts.append(_OBSERVED[z])

    def receive(self, words: Words) -> None:
        """The robot took messages. O(messages)."""
        if isinstance(self._parts[-1], list):
            self._parts[-1] += words.tolist()
        elif len(words):
            self._parts.append(words.tolist())

    def settle(self) -> None:
        """The robot ended the tick."""
        self._parts.append(str(SETTLE))
        self.flush()

    def silent(self) -> None:
        """The last broadcast did not go out."""
        self._parts.append(f'"{SILENT}"')

    def falsified(self, x_hat: int, alpha_bits: int) -> None:
        """The last broadcast went out with these values instead of the robot's own."""
        self._parts.append(f"[{x_hat},{alpha_bits}]")

    def restart(self) -> None:
        """The robot started anew."""
        self._parts.append(f'"{RESTART}"')

    def foreign(self, frame: can.Message) -> None:
        """Another node sent ``frame`` under the robot's id."""
        self._write(f'"{format_frame(frame)}"\n')

    def flush(self) -> None:
        """Write the events taken so far."""
        if len(self._parts) > 1:
            texts = [part if isinstance(part, str) else self._tell(part) for part in self._parts]
            self._write(",".join(texts) + "]\n")
            self._parts = [self._head]


@dataclass
class Reception:
    """Frames that one robot heard.

    Attributes:
        delivered: Estimates handed to the firmware.
        refused: Those among them that the firmware did not accept (repeated or invalid).
        strays: Legal estimates from outside the swarm: another program uses the subject.
        heartbeats: Heartbeats.
        telemetry: Telemetry, that of other processes' robots included.
        errors: Error frames.
        rejected: Other frames, by the reason why they are no estimate.
        events: Suspicious estimates; the firmware does not get those of unknown ids.
    """

    delivered: int = 0
    refused: int = 0
    strays: int = 0
    heartbeats: int = 0
    telemetry: int = 0
    errors: int = 0
    rejected: Counter[Rejection] = field(default_factory=Counter)
    events: Suspicions = field(default_factory=Counter)

    @property
    def id_conflicts(self) -> int:
        """Estimates under the robot's own id: another node has it, too."""
        return self._of(Suspicion.CONFLICT)

    @property
    def unknown(self) -> int:
        """Estimates under ids that are not allowed."""
        return self._of(Suspicion.UNKNOWN)

    def _of(self, kind: Suspicion) -> int:
        return sum(count for (each, _), count in self.events.items() if each is kind)


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


class BusRobot:
    """A robot on a bus.

    The firmware counts rounds and leaves their length to its caller. Here a round has ``comms_period`` ticks:
    in the last of them the robot broadcasts, and at the end of that tick the firmware settles.
    ``c_ref/ports/node`` does the same in C.

    Attributes:
        id: Robot id and node id.
        robot: The firmware; another one after a crash that lost the state.
        ticks: Control ticks begun since the robot started.
        is_alive: Whether the robot has not crashed.
        sent: Frames made since the robot started.
        reception: Frames heard, counted.
        recorder: Takes the robot's events; None if they are not recorded.
    """

    def __init__(
        self,
        record: RobotRecord,
        estimates: FrameFormat,
        recorder: Recorder | None = None,
        telemetry: FrameFormat = TELEMETRY_FORMAT,
        make: Callable[[], Robot] | None = None,
    ) -> None:
        """Start the robot of ``record``, with the firmware that ``make`` returns in place of the record's.

        Estimates and telemetry are sent in these formats. Raises as ``RobotRecord.make``.
        """
        self.id = record.id
        self.is_alive = True
        self.reception = Reception()
        self.recorder = recorder
        self._allowed: NDArray[np.bool_] | None = None
        if record.allow is not None:
            self._allowed = np.isin(np.arange(MAX_NODE_ID + 1), [self.id, *record.allow])
        self._make = make or record.make
        self._period = record.comms_period
        self._estimates, self._telemetry = estimates, telemetry
        self._loses_state = False
        self.restart()

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        self._count()
        return self._counted

    # --- Its life ---

    def restart(self) -> None:
        """Begin anew, as after a reset that loses everything. Raises as ``RobotRecord.make``."""
        self.ticks = 0
        self.sent = FramesSent()
        self.robot = self._make()
        speaks_raw = hasattr(self.robot, "receive_all")
        self._port = cast(FixedPointRobot, self.robot) if speaks_raw else RoundingPort(self.robot)
        self._left = self._period
        self._counted = self.robot.counters

    def die(self, loses_state: bool) -> None:
        """Crash. The state is lost, or there again when the robot wakes."""
        self.is_alive = False
        self._loses_state = loses_state

    def wake(self) -> None:
        """Rejoin after a crash. Raises as ``RobotRecord.make``."""
        self.is_alive = True
        if self._loses_state:
            self.restart()
            if self.recorder is not None:
                self.recorder.restart()

    def begin(self, z: Observation | None) -> bool:
        """Begin a tick, with an observation or without; returns whether a broadcast is due.

        It stays due until a tick has ended.
        """
        if self.recorder is not None:
            self.recorder.observe(z)
        self.ticks += 1
        if z is not None:
            self.robot.observe(z)
        self._left = max(self._left - 1, 0)
        return self._left == 0

    def broadcast(self, z: Observation | None, now: float) -> list[can.Message]:
        """Begin a tick; returns the frame of the estimate, stamped ``now`` (seconds), if one is due."""
        return [encode_estimate(self.estimate(), self._estimates, now)] if self.begin(z) else []

    def end(self) -> None:
        """End the tick, and its round if that is due."""
        if self._left == 0:
            self._left = self._period
            self.robot.settle()
        if self.ticks % _TICKS_BETWEEN_COUNTS == 0:
            self._count()
        if self.recorder is not None:
            self.recorder.settle()

    def _count(self) -> None:
        """Add the gains of the firmware's counters."""
        found, known = vars(self.robot.counters), vars(self._counted)
        self._counted = Counters(
            **{name: count + (found[name] - count) % _COUNTER_MODULUS for name, count in known.items()}
        )

    # --- The frames that it makes ---

    def estimate(self) -> Estimate:
        """The next broadcast, with the present estimate."""
        transfer_id = self.sent.estimates % TRANSFER_IDS
        self.sent.estimates += 1
        return Estimate(self.id, self._port.x_hat_raw, self._port.alpha_raw, transfer_id)

    def is_heartbeat_due(self, ticks_per_second: int) -> bool:
        """Return whether a heartbeat goes before the next tick: at the start, and each second from then on.

        The seconds are the robot's own, counted by the ticks that it has begun: a robot that has lost its
        state in a crash announces itself in its first tick, and the seconds of one that has kept it go on
        where they stopped. All robots of this project follow this rule, ``c_ref/ports/node`` included.
        """
        return self.ticks % ticks_per_second == 0

    def heartbeat(self, now: float) -> can.Message:
        """Return the next heartbeat, stamped ``now`` (seconds), and count it; see ``is_heartbeat_due``."""
        uptime = self.sent.heartbeats
        self.sent.heartbeats += 1
        return encode_heartbeat(Heartbeat(self.id, uptime, uptime % TRANSFER_IDS), timestamp=now)

    def telemetry(self, now: float) -> can.Message:
        """The robot's present state."""
        b_hat = min(max(int(self.robot.b_hat * 2**24), MIN_B_HAT), MAX_B_HAT)
        updates, transfer_id = self.robot.counters.updates % 256, self.sent.telemetry % TRANSFER_IDS
        self.sent.telemetry += 1
        telemetry = Telemetry(self.id, int(self.robot.x * Q23_ONE), b_hat, updates, transfer_id)
        return encode_telemetry(telemetry, self._telemetry, now)

    # --- The frames that it takes; a dead robot takes none ---

    def listen(self, frames: Sequence[can.Message]) -> None:
        """Take any frames of other nodes, in the order in which they came."""
        decoded = decode_estimates(frames, self._estimates, np.zeros(len(frames), np.uint64))
        self.receive(decoded.rows[decoded.is_estimate])
        for frame, known in zip(frames, decoded.is_estimate.tolist(), strict=True):
            if not known:
                self.count(decode_frame(frame, self._estimates))

    def receive(self, words: Words) -> None:
        """Hand estimates under allowed ids, and its own, to the firmware. O(estimates)."""
        if not self.is_alive:
            return
        if self._allowed is not None:
            is_allowed = self._allowed[words[:, 0]]
            for sender in words[~is_allowed, 0].tolist():
                self.reception.events[Suspicion.UNKNOWN, sender] += 1
            words = words[is_allowed]
        if self.recorder is not None:
            self.recorder.receive(words)
        received, accepted = len(words), self._port.receive_all(words)
        self.reception.delivered += received
        if accepted < received:
            self.reception.refused += received - accepted
            self._note_conflicts(words[:, 0].tolist().count(self.id))

    def _note_conflicts(self, count: int) -> None:
        if count:
            self.reception.events[Suspicion.CONFLICT, self.id] += count

    def count(self, content: FrameContent, frames: int = 1) -> None:
        """Count frames of one kind that are no estimates."""
        heard = self.reception
        if not self.is_alive:
            return
        if isinstance(content, Heartbeat):
            heard.heartbeats += frames
        elif isinstance(content, Telemetry):
            heard.telemetry += frames
        elif content is Rejection.ERROR_FRAME:
            heard.errors += frames
        elif isinstance(content, Rejection):
            heard.rejected[content] += frames

    def hear_stranger(self, frame: can.Message) -> None:
        """Count a frame from outside the swarm; the firmware does not get it."""
        content = decode_frame(frame, self._estimates)
        if not isinstance(content, Estimate):
            self.count(content)
        elif self.is_alive:
            self.reception.strays += 1
            self._note_conflicts(content.sender == self.id)


class RoundingPort:
    """Raw integers of a robot that computes in float64: x_hat is rounded to nearest, alpha down as codecs do.

    Its members are those of ``FixedPointRobot``.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast."""
        return round(self._robot.x_hat * Q23_ONE)

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast."""
        return alpha_word_from_float(self._robot.alpha)

    def receive_all(self, words: Words) -> int:
        """Hand over neighbours' messages in order; returns how many were accepted."""
        return sum(self._accepts(*each) for each in words.tolist())

    def _accepts(self, sender: int, x_hat: int, alpha: int) -> bool:
        try:
            return self._robot.receive(sender, x_hat / Q23_ONE, alpha_from_word(alpha)) is Status.OK
        except FirmwareError:
            return False
