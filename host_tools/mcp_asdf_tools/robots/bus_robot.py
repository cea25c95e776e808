"""One robot of a bus, without the bus: the frames that it sends, and what it does with those it receives.

A tick is ``observe``, then ``broadcast`` if the robot's round is over, any number of frames received, and
``settle``, which ends the tick and, at the end of a round, makes the firmware use what it has received. The
robots of a swarm, the neighbours of a real controller and the node of a process are all driven this way; they
differ in when heartbeats and telemetry are due, and in what carries the frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, cast

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf.fixed_point import alpha_from_word, alpha_word_from_float
from mcp_asdf.robot import Counters, FirmwareError, FixedPointRobot, Observation, Robot, Status
from mcp_asdf_tools.bus.frame_layout import (
    B_HAT_UNITS,
    MAX_B_HAT,
    MAX_NODE_ID,
    MIN_B_HAT,
    Q23_ONE,
    TRANSFER_ID_MODULUS,
    UPDATE_COUNT_MODULUS,
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
)
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.robots.suspicion import Suspicion, Suspicions

EstimateRows: TypeAlias = NDArray[np.uint32]
"""Estimates for a firmware, shape (estimates, 3): the sender, x_hat in units of 2**-23, and alpha as the 32
bits in which a firmware keeps it, a mantissa and a shift."""

_SENDER_COLUMN = 0
"""Column of the sender in ``EstimateRows``."""

_COUNTER_MODULUS = 2**16
"""Number of values of a counter in the firmware, which wraps: it has 16 bits."""

_TICKS_BETWEEN_COUNTS = 64
"""Few enough for 1000 messages a tick: 64 * 1000 is below 2**16, which a counter must not gain unseen."""


def estimate_rows(contents: Iterable[FrameContent]) -> EstimateRows:
    """Return the estimates among the contents of frames as rows for a firmware, in their order."""
    rows = [
        (content.sender, content.x_hat, content.alpha)
        for content in contents
        if isinstance(content, Estimate)
    ]
    # Without an estimate there are no rows, but three columns nevertheless.
    return np.array(rows, np.uint32).reshape(-1, 3)


class Recorder(Protocol):
    """Writer of the events of one robot, so that it can be run again. ``recording.events`` has one."""

    def record_observation(self, z: Observation | None) -> None:
        """Record that a tick began, in which the robot observed ``z``, or nothing."""

    def record_estimates(self, estimates: Sequence[list[int]]) -> None:
        """Record that the robot received estimates: sender, x_hat and alpha each."""

    def record_settle(self) -> None:
        """Record that the robot ended the tick."""

    def record_restart(self) -> None:
        """Record that the robot started anew."""

    def record_foreign_frame(self, frame: can.Message) -> None:
        """Record a frame that another node sent under the robot's id."""


@dataclass
class Reception:
    """Counts of the frames that one robot received.

    Attributes:
        delivered: Estimates handed to the firmware.
        refused: Those among them that the firmware did not accept (repeated or invalid).
        strays: Valid estimates from outside the swarm, which the firmware does not get: another program uses
            the same subject.
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
        """Number of estimates under the robot's own id: another node has it, too."""
        return self._count_events(Suspicion.CONFLICT)

    @property
    def unknown(self) -> int:
        """Number of estimates under ids that are not allowed."""
        return self._count_events(Suspicion.UNKNOWN)

    def _count_events(self, suspicion: Suspicion) -> int:
        """Return the number of events of this kind, from all senders."""
        total = 0
        for (kind, _sender), count in self.events.items():
            if kind is suspicion:
                total += count
        return total


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
        is_alive: Whether the robot has not crashed. One that has receives nothing.
        sent: Frames made since the robot started.
        reception: Frames received, counted.
        recorder: Takes the robot's events; None if they are not recorded.
    """

    def __init__(
        self,
        setup: RobotSetup,
        estimate_format: FrameFormat,
        recorder: Recorder | None = None,
        telemetry_format: FrameFormat = TELEMETRY_FORMAT,
        make_firmware: Callable[[], Robot] | None = None,
    ) -> None:
        """Start a robot, with the firmware that ``make_firmware`` returns in place of the setup's.

        Estimates and telemetry are sent in these formats. Raises UsageError if the setup's firmware is not
        available here, and FirmwareError if it refuses the setup.
        """
        self.id = setup.id
        self.is_alive = True
        self.reception = Reception()
        self.recorder = recorder
        # Whether the robot accepts estimates of a sender, by its id; None if all senders are allowed
        self._is_allowed_by_sender: NDArray[np.bool_] | None = None
        if setup.allow is not None:
            # Its own id is always allowed: the firmware refuses what another node sends under it.
            allowed_ids = [self.id, *setup.allow]
            all_ids = np.arange(MAX_NODE_ID + 1)
            self._is_allowed_by_sender = np.isin(all_ids, allowed_ids)
        self._make_firmware = make_firmware or setup.make_robot
        self._comms_period = setup.comms_period
        self._estimate_format = estimate_format
        self._telemetry_format = telemetry_format
        self._loses_state = False
        self.restart()

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        self._update_counters()
        return self._counters

    # --- Start, crash and restart ---

    def restart(self) -> None:
        """Start anew, as after a reset that loses everything but the counts of received frames.

        Raises UsageError if the setup's firmware is not available here, and FirmwareError if it refuses the
        setup.
        """
        self.ticks = 0
        self.sent = FramesSent()
        self.robot = self._make_firmware()
        # Frames carry integers: a robot that computes in float64 gets them by an adapter.
        takes_integers = hasattr(self.robot, "receive_all")
        self._integer_robot = (
            cast(FixedPointRobot, self.robot) if takes_integers else IntegerAdapter(self.robot)
        )
        self._ticks_to_broadcast = self._comms_period
        self._counters = self.robot.counters

    def crash(self, loses_state: bool) -> None:
        """Stop until ``rejoin``, which starts the robot anew if ``loses_state``, and else lets it go on."""
        self.is_alive = False
        self._loses_state = loses_state

    def rejoin(self) -> None:
        """Go on after a crash; start anew, and record that, if the crash has lost the state.

        Raises UsageError if the setup's firmware is not available here, and FirmwareError if it refuses the
        setup.
        """
        self.is_alive = True
        if self._loses_state:
            self.restart()
            if self.recorder is not None:
                self.recorder.record_restart()

    # --- A tick ---

    def observe(self, observation: Observation | None) -> bool:
        """Begin a tick, with an observation or without, and return whether a broadcast is due.

        It is due in the last of the ``comms_period`` ticks of a round, and stays due until a tick has ended.
        """
        if self.recorder is not None:
            # Recorded first, as it begins the tick to which the events that follow belong.
            self.recorder.record_observation(observation)
        self.ticks += 1
        if observation is not None:
            self.robot.observe(observation)
        # Not below 0, since the broadcast stays due until ``settle`` begins the next round.
        self._ticks_to_broadcast = max(self._ticks_to_broadcast - 1, 0)
        return self._ticks_to_broadcast == 0

    def broadcast(self, now: float) -> can.Message:
        """Return the frame of the present estimate, stamped ``now`` (seconds), and count it."""
        return encode_estimate(self.next_estimate(), self._estimate_format, now)

    def settle(self) -> None:
        """End the tick, and the firmware's round if a broadcast was due in it; record that the tick ended."""
        if self._ticks_to_broadcast == 0:
            self._ticks_to_broadcast = self._comms_period
            self.robot.settle()
        # Often enough that no counter wraps unseen, and not in every tick, since reading them takes time.
        if self.ticks % _TICKS_BETWEEN_COUNTS == 0:
            self._update_counters()
        if self.recorder is not None:
            self.recorder.record_settle()

    def _update_counters(self) -> None:
        """Add what the firmware's counters, which wrap at 2**16, have gained since the last call."""
        firmware_counts = vars(self.robot.counters)
        counts = {}
        for name, last_count in vars(self._counters).items():
            # Modulo 2**16 this equals the firmware's count at the last call, so the difference is the gain.
            gain = (firmware_counts[name] - last_count) % _COUNTER_MODULUS
            counts[name] = last_count + gain
        self._counters = Counters(**counts)

    # --- Frames to send ---

    def next_estimate(self) -> Estimate:
        """Return the present estimate with the next transfer_id, and count it as sent."""
        transfer_id = self.sent.estimates % TRANSFER_ID_MODULUS
        self.sent.estimates += 1
        return Estimate(self.id, self._integer_robot.x_hat_raw, self._integer_robot.alpha_raw, transfer_id)

    def is_heartbeat_due(self, ticks_per_second: int) -> bool:
        """Return whether a heartbeat goes before the next tick: at the start, and each second from then on.

        The seconds are the robot's own, counted by the ticks that it has begun: a robot that has lost its
        state in a crash announces itself in its first tick, and the seconds of one that has kept it go on
        where they stopped. All robots of this project follow this rule, ``c_ref/ports/node`` included.
        """
        return self.ticks % ticks_per_second == 0

    def heartbeat(self, now: float) -> can.Message:
        """Return the next heartbeat, stamped ``now`` (seconds), and count it; see ``is_heartbeat_due``."""
        uptime = self.sent.heartbeats  # there is one heartbeat a second, from second 0 on
        self.sent.heartbeats += 1
        return encode_heartbeat(Heartbeat(self.id, uptime, uptime % TRANSFER_ID_MODULUS), timestamp=now)

    def telemetry(self, now: float) -> can.Message:
        """Return a frame with the robot's present state, stamped ``now`` (seconds), and count it."""
        return encode_telemetry(self.next_telemetry(), self._telemetry_format, now)

    def next_telemetry(self) -> Telemetry:
        """Return the robot's present state with the next transfer_id, and count it as sent.

        It holds x, the robot's informed estimate of the share of black tiles, b_hat, the accuracy that it
        assumes of its sensor, and modulo 256 the number of times it has re-estimated b_hat.
        """
        x = int(self.robot.x * Q23_ONE)  # units of 2**-23
        b_hat = int(self.robot.b_hat * B_HAT_UNITS)  # units of 2**-24
        # A robot that computes in float64 may be nearer to 0 or 1 than telemetry allows.
        legal_b_hat = min(max(b_hat, MIN_B_HAT), MAX_B_HAT)
        updates = self.robot.counters.updates % UPDATE_COUNT_MODULUS
        transfer_id = self.sent.telemetry % TRANSFER_ID_MODULUS
        self.sent.telemetry += 1
        return Telemetry(self.id, x, legal_b_hat, updates, transfer_id)

    # --- Frames received ---

    def receive_frames(self, frames: Sequence[can.Message]) -> None:
        """Hand the estimates among frames of other nodes to the firmware, in order, and count the others.

        All estimates are handed over before the other frames are counted. A robot that has crashed receives
        nothing.
        """
        contents = [decode_frame(frame, self._estimate_format) for frame in frames]
        self.receive_all(estimate_rows(contents))
        for content in contents:
            if not isinstance(content, Estimate):
                self.count_content(content)

    def receive_all(self, estimates: EstimateRows) -> None:
        """Hand many estimates to the firmware in order, and count them and its refusals. O(estimates).

        Estimates whose sender is not allowed are only counted, as the event UNKNOWN. Those under the robot's
        own id always reach the firmware, which refuses them, and count as the event CONFLICT. A robot that
        has crashed receives nothing.
        """
        if not self.is_alive:
            return
        if self._is_allowed_by_sender is not None:
            estimates = self._drop_unknown(estimates, self._is_allowed_by_sender)
        if self.recorder is not None and len(estimates):
            self.recorder.record_estimates(estimates.tolist())
        received_count = len(estimates)
        accepted_count = self._integer_robot.receive_all(estimates)
        self.reception.delivered += received_count
        # The firmware refuses a sender's second estimate in a round, impossible values, and its own id.
        if accepted_count < received_count:
            self.reception.refused += received_count - accepted_count
            is_under_own_id = estimates[:, _SENDER_COLUMN] == self.id
            self._count_id_conflicts(int(np.count_nonzero(is_under_own_id)))

    def _drop_unknown(self, estimates: EstimateRows, is_allowed_by_sender: NDArray[np.bool_]) -> EstimateRows:
        """Return the estimates whose sender is allowed, and count each of the others as the event UNKNOWN."""
        senders = estimates[:, _SENDER_COLUMN]
        is_allowed = is_allowed_by_sender[senders]  # of each estimate
        for sender in senders[~is_allowed].tolist():
            self.reception.events[Suspicion.UNKNOWN, sender] += 1
        return estimates[is_allowed]

    def _count_id_conflicts(self, count: int) -> None:
        """Count ``count`` estimates that another node sent under the robot's id, unless there are none."""
        if count > 0:  # An entry of 0 would be reported as an event.
            self.reception.events[Suspicion.CONFLICT, self.id] += count

    def count_content(self, content: FrameContent) -> None:
        """Count a frame with this content in ``reception``, by its kind.

        Heartbeats, telemetry and error frames have one each, and rejected frames one for each reason.
        Estimates and commands are not counted here, and a robot that has crashed counts nothing.
        """
        if not self.is_alive:
            return
        if isinstance(content, Heartbeat):
            self.reception.heartbeats += 1
        elif isinstance(content, Telemetry):
            self.reception.telemetry += 1
        elif content is Rejection.ERROR_FRAME:
            # The bus has damaged a frame, whoever sent it: no node has sent a wrong one.
            self.reception.errors += 1
        elif isinstance(content, Rejection):
            self.reception.rejected[content] += 1

    def count_foreign_content(self, content: FrameContent) -> None:
        """Count a frame with this content that no robot of the swarm has sent. The firmware does not get it.

        An estimate counts as a stray and, under the robot's own id, also as an id conflict; other frames are
        counted by ``count_content``. A robot that has crashed counts nothing.
        """
        if not isinstance(content, Estimate):
            self.count_content(content)
        elif self.is_alive:
            self.reception.strays += 1
            if content.sender == self.id:
                self._count_id_conflicts(1)


class IntegerAdapter:
    """Adapter that gives a robot which computes in float64 the integers of ``FixedPointRobot``.

    x_hat is rounded to the nearest integer, alpha down, as the codecs of frames do.
    """

    def __init__(self, robot: Robot) -> None:
        """Wrap ``robot``, which keeps its state."""
        self._robot = robot

    @property
    def x_hat_raw(self) -> int:
        """Local estimate to broadcast, in units of 2**-23."""
        return round(self._robot.x_hat * Q23_ONE)

    @property
    def alpha_raw(self) -> int:
        """Local confidence to broadcast, as an alpha word: mantissa and shift in 32 bits."""
        return alpha_word_from_float(self._robot.alpha)

    def receive_all(self, estimates: EstimateRows) -> int:
        """Hand neighbours' estimates to the robot in order, and return how many it accepted."""
        accepted_count = 0
        for sender, x_hat_units, alpha_word in estimates.tolist():
            x_hat = x_hat_units / Q23_ONE
            alpha = alpha_from_word(alpha_word)
            # Invalid estimates are usual on a bus: as with ``FixedPointRobot`` they are no exceptions here.
            with suppress(FirmwareError):
                status = self._robot.receive(sender, x_hat, alpha)
                if status is Status.OK:
                    accepted_count += 1
        return accepted_count
