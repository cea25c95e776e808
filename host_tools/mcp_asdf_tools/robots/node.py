"""The node of one robot: it follows commands, and sends heartbeats, estimates and telemetry.

``RobotNode`` has no bus: it takes frames and returns those to send. ``BusLink`` is its connection to a bus,
and ``run_node`` connects both. The same node runs in ``mcp-asdf node``, on any bus, and in tools that predict
the frames of a robot. ``docs/design.md`` has the rules that it follows.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import can
from can.typechecking import CanFilters

from mcp_asdf.robot import FixedPointRobot, Observation, Robot
from mcp_asdf_tools.bus.bus_errors import BusGoneError
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Rejection
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    IGNORED_IDENTIFIER_BITS,
    SUBJECT_SHIFT,
    TELEMETRY_FORMAT,
    Command,
    Estimate,
    FrameFormat,
    decode_command,
    decode_estimate,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot, Recorder, estimate_rows
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.robots.suspicion import AlphaWatch, Suspicion

_RAW_ATTRIBUTES = ("x_hat_raw", "alpha_raw", "x_bar_raw", "beta_raw", "x_raw", "b_hat_raw")
_STATE_ATTRIBUTES = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")

_ALL_IDENTIFIER_BITS = 0x1FFF_FFFF
"""The 29 bits of an extended identifier."""

ACCEPTANCE_MASK = _ALL_IDENTIFIER_BITS & ~IGNORED_IDENTIFIER_BITS
"""Identifier bits that a receiver checks, 0x039F_FF80: all but the priority, the sender, and the two that
Cyphal sends as 1."""

SEND_TIMEOUT = 2.0
"""Seconds after which a bus that takes no frame counts as failed."""

_MAX_WAIT = 0.1
"""Longest wait in seconds between two checks for a stop."""

_MAX_FRAMES_AT_ONCE = 4096
"""Frames handed over at once, so that a flood cannot keep a robot from its tick."""

_SECONDS_BETWEEN_SENDS = 0.001
"""Pause before a full bus is tried again: time in which it sends several frames."""

FrameTaker = Callable[[can.Message], None]
"""Takes a frame that was sent or received, such as a log or a picture."""


@dataclass(frozen=True)
class Subjects:
    """Format of each kind of message, the same for all nodes. Raises UsageError if two share a subject.

    Attributes:
        estimates: Broadcasts of robots.
        telemetry: Broadcasts for observers.
        commands: Orders of a simulator.
    """

    estimates: FrameFormat = field(default_factory=FrameFormat)
    telemetry: FrameFormat = TELEMETRY_FORMAT
    commands: FrameFormat = COMMAND_FORMAT

    def __post_init__(self) -> None:
        """Raise UsageError if two kinds of messages have the same subject."""
        subjects = [self.estimates.subject, self.telemetry.subject, self.commands.subject]
        # Receivers distinguish the kinds of messages by their subjects alone.
        if len(set(subjects)) < len(subjects):
            raise UsageError(
                f"estimates, telemetry and commands have the subjects {subjects}; choose three different ones"
            )


def filters_for(*formats: FrameFormat) -> CanFilters:
    """Return filters for python-can that let only frames of these formats through, one for each.

    Their priority does not matter, and the sender may be any node.
    """
    return [
        {
            "can_id": frame_format.subject << SUBJECT_SHIFT,
            "can_mask": ACCEPTANCE_MASK,
            "extended": True,
        }
        for frame_format in formats
    ]


class RobotNode(BusRobot):
    """A robot on a bus that follows commands: its methods return the frames to send now, in order.

    A tick is ``begin_tick``, any number of frames received, and ``end_tick``. The end of the last tick of a
    round also makes the robot use the estimates of its neighbours that it has received in the round.

    Attributes:
        subjects: Formats of the messages.
        is_settled: Whether the last tick has ended; true before the first.
        obeyed: Number of commands followed.
        disobeyed: Number of commands for this robot that the rules of ``docs/design.md`` did not let it
            follow.
        unsettled: Number of ticks that ended only when the next one began, since no *settle* had come.
    """

    def __init__(
        self,
        setup: RobotSetup,
        subjects: Subjects | None = None,
        steps_per_second: int = 10,
        recorder: Recorder | None = None,
        make: Callable[[], Robot] | None = None,
    ) -> None:
        """Create the robot. Nothing is sent yet: see ``start``.

        Args:
            setup: How the robot starts.
            subjects: Formats of the messages; None for the default ones.
            steps_per_second: Ticks from one heartbeat to the next, 1 or more.
            recorder: Takes the robot's events; None to record none.
            make: Returns the firmware, in place of the one that the setup names.

        Raises:
            UsageError: If the setup's firmware is not available here.
            FirmwareError: If the firmware refuses the setup.
        """
        self.subjects = subjects or Subjects()
        super().__init__(
            setup, self.subjects.estimates, recorder, self.subjects.telemetry, make_firmware=make
        )
        self.is_settled = True
        self.obeyed = 0
        self.disobeyed = 0
        self.unsettled = 0
        self._steps_per_second = steps_per_second
        self._alpha_watch = AlphaWatch()
        self._tick_of_command: int | None = None
        """Number of the tick that the last command began; None before the first."""

    def start(self) -> list[can.Message]:
        """Return the heartbeat that announces the node."""
        return [self.heartbeat(self._now)]

    def begin_tick(self, observation: Observation | None) -> list[can.Message]:
        """Begin a tick, with this observation or, if it is None, without one.

        Returns a heartbeat if a second of ticks has passed since the last, then the robot's estimate if its
        round is over; an empty list if neither. A tick that is still open ends first, without telemetry, and
        counts as unsettled.
        """
        if not self.is_settled:
            self.unsettled += 1
            self.settle()
        self.is_settled = False
        frames = []
        # The heartbeat that is due before the first tick has been sent by start().
        if self.ticks > 0 and self.is_heartbeat_due(self._steps_per_second):
            frames.append(self.heartbeat(self._now))
        # Beginning a tick advances the node's time: frames of this tick are stamped with its start.
        time_before_tick = self._now
        is_broadcast_due = self.observe(observation)
        if is_broadcast_due:
            frames.append(self.broadcast(time_before_tick))
        return frames

    def end_tick(self) -> list[can.Message]:
        """End the tick, and return one frame, the telemetry of the state after it."""
        self.settle()
        self.is_settled = True
        return [self.telemetry(self._now)]

    def receive_frame(self, frame: can.Message) -> list[can.Message]:
        """Receive any frame that this node has not sent itself, and return the frames that answer it.

        Only commands that the robot follows have answers: one to observe may have a heartbeat and an
        estimate, and one to settle has telemetry. An estimate goes to the robot, and also to the recorder if
        another node sent it under this robot's id; it counts as suspicious if the sender's confidence jumps
        (``suspicion.AlphaWatch``). Any other frame is counted as rejected.
        """
        content: Estimate | Command | Rejection = decode_estimate(frame, self.subjects.estimates)
        if content is Rejection.SUBJECT:  # a message, but no estimate
            content = decode_command(frame, self.subjects.commands)
        if isinstance(content, Command):
            return self._follow_command(content)
        if isinstance(content, Rejection):
            self.reception.rejected[content] += 1
            return []
        # A replay knows what the robot has sent itself, but not what another sends under its id.
        if content.sender == self.id and self.recorder is not None:
            self.recorder.record_foreign_frame(frame)
        # A jump of the sender's confidence is suspicious, but the robot gets the estimate all the same.
        if self._alpha_watch.is_jump(content.sender, content.alpha):
            self.reception.events[Suspicion.JUMP, content.sender] += 1
        self.receive_all(estimate_rows([content]))
        return []

    def figures(self) -> dict[str, Any]:
        """Return the counts of frames sent and received so far as plain values, for JSON.

        The keys are

        - ``estimates_sent``, ``heartbeats_sent`` and ``telemetry_sent``;
        - ``delivered``, ``refused`` and ``id_conflicts``: estimates that the firmware got, those of them that
          it refused, and those that came under the robot's own id;
        - ``obeyed`` and ``disobeyed``: commands that were followed, and ones that were not;
        - ``unsettled``: ticks that ended without a command to settle;
        - ``rejected``: the numbers of rejected frames, by reason;
        - ``events``: one dictionary per kind of suspicious estimate and sender, with the keys ``event`` (the
          kind), ``sender`` and ``estimates`` (how many came).
        """
        events = []
        # A list, since keys of JSON are single texts.
        for (kind, sender), count in self.reception.events.items():
            events.append({"event": kind.value, "sender": sender, "estimates": count})
        return {
            "estimates_sent": self.sent.estimates,
            "heartbeats_sent": self.sent.heartbeats,
            "telemetry_sent": self.sent.telemetry,
            "delivered": self.reception.delivered,
            "refused": self.reception.refused,
            "obeyed": self.obeyed,
            "disobeyed": self.disobeyed,
            "unsettled": self.unsettled,
            "rejected": {reason.name: count for reason, count in self.reception.rejected.items()},
            "id_conflicts": self.reception.id_conflicts,
            "events": events,
        }

    def _follow_command(self, command: Command) -> list[can.Message]:
        """Follow a command, and return the frames that answer it.

        A *settle* ends the tick with its number, and no other. A command to observe begins a tick, unless the
        tick with its number is still open, since then it is a repetition. A command that comes out of turn is
        not followed, but counted as disobeyed, and has no answer. Commands for other robots are ignored.
        """
        if command.target not in (self.id, EVERY_ROBOT):
            return []
        is_settle = command.action is Action.SETTLE
        is_tick_open = not self.is_settled and command.tick == self._tick_of_command
        # While its tick is open, a command to observe is a repetition.
        is_in_turn = is_tick_open if is_settle else not is_tick_open
        if not is_in_turn:
            self.disobeyed += 1
            return []
        self.obeyed += 1
        if is_settle:
            return self.end_tick()
        self._tick_of_command = command.tick
        return self.begin_tick(command.action.observation)

    @property
    def _now(self) -> float:
        """The node's own time, seconds."""
        return self.ticks / self._steps_per_second


def state_of(node: RobotNode) -> dict[str, Any]:
    """Return a robot's estimates and counters as plain values, for JSON.

    The keys are ``t``, ``n``, ``x_hat``, ``alpha``, ``x_bar``, ``beta``, ``x``, ``b_hat`` and ``counters``.
    If the firmware computes in fixed point there is ``raw``, too, with the integers behind those from
    ``x_hat`` to ``b_hat``.
    """
    robot = node.robot
    state: dict[str, Any] = {name: getattr(robot, name) for name in _STATE_ATTRIBUTES}
    if isinstance(robot, FixedPointRobot):
        state["raw"] = {name.removesuffix("_raw"): getattr(robot, name) for name in _RAW_ATTRIBUTES}
    state["counters"] = asdict(node.counters)
    return state


# --- On a bus ---


class Stopped(Exception):  # noqa: N818 (no error)
    """The node was asked to stop."""


@dataclass
class BusLink:
    """A node's connection to its bus.

    Attributes:
        bus: The connection; its filters should pass only frames that the node needs.
        should_stop: Called before each read; if it returns true, the read raises Stopped.
        tolerates_failures: Whether `send` and `receive` return instead of raising can.CanError when the bus
            fails, as a run in real time needs it. A bus that is gone raises in any case.
        log: Takes all frames sent and received, stamped with the time of day; None for no log.
        failures: How often sending or receiving failed.
        last_failure: Failure of the last attempt; None if it succeeded.
    """

    bus: can.BusABC
    should_stop: Callable[[], bool] = lambda: False
    tolerates_failures: bool = False
    log: FrameTaker | None = None
    failures: int = 0
    last_failure: can.CanError | None = None

    def send(self, frame: can.Message) -> bool:
        """Put a frame on the bus, log it, and return whether the bus took it.

        A failure is counted, and a success clears ``last_failure``. A failure raises can.CanError unless the
        link tolerates failures, and BusGoneError in any case if the bus is gone.
        """
        try:
            self.bus.send(frame, timeout=SEND_TIMEOUT)
        except can.CanError as error:
            self._count_or_raise(error)
            return False
        self.last_failure = None
        if self.log is not None:
            # A log has the time of day; until now the frame had the node's own time, which counts ticks.
            frame.timestamp = time.time()
            self.log(frame)
        return True

    def receive(self, seconds: float) -> can.Message | None:
        """Wait for a frame of another node, at most ``seconds`` and at most a tenth of a second; log it.

        Returns None if no frame came, or one that this node has sent. A failure of the bus is counted, and
        raises can.CanError unless the link tolerates failures and the bus is not gone; then the result is
        None after a pause of that time. A frame of another node clears ``last_failure``. Raises Stopped if
        the node was asked to stop.
        """
        if self.should_stop():
            raise Stopped
        seconds = min(seconds, _MAX_WAIT)
        try:
            frame = self.bus.recv(seconds)
        except can.CanError as error:
            self._count_or_raise(error)
            time.sleep(seconds)  # A bus that fails at once must not keep the processor busy.
            return None
        if frame is None or not frame.is_rx:  # Some buses return the frames that were sent here.
            return None
        self.last_failure = None
        if self.log is not None:
            self.log(frame)
        return frame

    def handle_waiting_frames(self, on_frame: FrameTaker) -> None:
        """Call ``on_frame`` with the frames in the receive buffer, up to 4096 of them, without waiting.

        A node whose ticks are late calls this, as it has no time left to wait for frames. Raises Stopped if
        the node was asked to stop, and can.CanError if the bus fails, unless the link tolerates failures and
        the bus is not gone.
        """
        for _ in range(_MAX_FRAMES_AT_ONCE):
            frame = self.receive(0)
            if frame is None:
                return
            on_frame(frame)

    def _count_or_raise(self, error: can.CanError) -> None:
        """Count and remember a failure of the bus.

        Raises it again if the bus is gone, or if the link does not tolerate failures.
        """
        self.failures += 1
        self.last_failure = error
        if not self.tolerates_failures or isinstance(error, BusGoneError):
            raise error


@dataclass
class RunOutcome:
    """End of a run on a bus.

    Attributes:
        ending: The reason in words.
        is_interrupted: Whether the run was asked to stop before all its ticks were done.
        has_failed: Whether the bus ended it.
        lateness: Figures of ``clock.RealTimeClock``; None in lockstep.
    """

    ending: str
    is_interrupted: bool = False
    has_failed: bool = False
    lateness: dict[str, Any] | None = None

    @property
    def failure(self) -> str | None:
        """Why the bus ended the run, in words; None if it did not."""
        return self.ending if self.has_failed else None


def run_node(
    node: RobotNode, link: BusLink, ticks: int | None = None, watch: Callable[[], None] = lambda: None
) -> RunOutcome:
    """Let a node follow commands until it has done ``ticks`` ticks, or without end if that is None.

    ``watch`` is called after each wait for a frame, at least ten times per second. The run ends early when
    the link is asked to stop, on Ctrl-C, or when the bus fails; the result says which. A stop interrupts only
    a run with a number of ticks: for a run without end it is the regular end.
    """
    outcome = RunOutcome("all ticks done")
    try:
        for frame in node.start():
            link.send(frame)
        # A tick that is open is finished first, so that its telemetry is not missing at the end.
        while not node.is_settled or ticks is None or node.ticks < ticks:
            received_frame = link.receive(_MAX_WAIT)
            if received_frame is not None:
                for answer in node.receive_frame(received_frame):
                    link.send(answer)
            watch()
    except (Stopped, KeyboardInterrupt):
        outcome.ending = "stopped"
        outcome.is_interrupted = ticks is not None
    except can.CanError as error:
        outcome.ending = f"the bus failed: {error}"
        outcome.has_failed = True
    return outcome


def send_all(bus: can.BusABC, frames: Iterable[can.Message], timeout: float) -> None:
    """Put ``frames`` on the bus in order, waiting while its queue is full.

    Raises can.CanTimeoutError if the bus takes no frame for ``timeout`` seconds, and can.CanError if it fails
    otherwise; the frames before have been sent then.
    """
    for frame in frames:
        _send_when_queue_has_room(bus, frame, timeout)


def _send_when_queue_has_room(bus: can.BusABC, frame: can.Message, timeout: float) -> None:
    """Put a frame on the bus, and wait up to ``timeout`` seconds while its queue is full.

    Raises can.CanTimeoutError after that time, and can.CanError if the bus fails otherwise.
    """
    deadline = time.monotonic() + timeout
    while True:
        try:
            bus.send(frame, timeout=timeout)
            return
        except can.CanOperationError as error:
            # Linux reports a full queue with this code at once, whatever the timeout.
            is_queue_full = error.error_code == errno.ENOBUFS
            if not is_queue_full:
                raise
            if time.monotonic() > deadline:
                raise can.CanTimeoutError(f"the bus took no frame for {timeout:g} s") from error
        time.sleep(_SECONDS_BETWEEN_SENDS)
