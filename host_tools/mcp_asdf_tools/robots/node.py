"""Node of one robot without the bus: it obeys commands, and schedules its heartbeats.

The same node runs in ``mcp-asdf node``, on any bus, and in tools that predict the frames of a robot.
``docs/frame.md`` has the rules that it follows.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import can
from can.typechecking import CanFilters

from mcp_asdf.robot import Counters, FixedPointRobot, Observation, Robot
from mcp_asdf_tools.bus.bus_errors import BusGoneError
from mcp_asdf_tools.bus.frame_layout import EVERY_ROBOT, Action, Rejection
from mcp_asdf_tools.bus.frames import (
    COMMAND_FORMAT,
    TELEMETRY_FORMAT,
    Command,
    Estimate,
    FrameFormat,
    decode_command,
    decode_estimate,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot, FramesSent, Reception, Recorder
from mcp_asdf_tools.robots.robot_setup import RobotSetup
from mcp_asdf_tools.robots.suspicion import AlphaWatch, Suspicion

_RAW = ("x_hat_raw", "alpha_raw", "x_bar_raw", "beta_raw", "x_raw", "b_hat_raw")
_FLOATS = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")

ACCEPTANCE_MASK = 0x039F_FF80
"""Identifier bits that a receiver checks; see docs/frame.md."""


SEND_TIMEOUT = 2.0
"""Seconds after which a bus that takes no frame counts as failed."""

_SLICE = 0.1
"""Longest wait in seconds between two checks for a stop."""

_MOST_AT_ONCE = 4096
"""Upper bound on frames taken at once, so that a flood cannot starve a robot."""

_PAUSE = 0.001
"""Seconds in which a bus sends several frames."""

FrameTaker = Callable[[can.Message], None]


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
        chosen = [self.estimates.subject, self.telemetry.subject, self.commands.subject]
        if len(set(chosen)) < len(chosen):
            raise UsageError(
                f"estimates, telemetry and commands have the subjects {chosen}; choose three different ones"
            )


def filters_for(*formats: FrameFormat) -> CanFilters:
    """Filters of a connection that let only frames of these formats through."""
    return [{"can_id": each.subject << 8, "can_mask": ACCEPTANCE_MASK, "extended": True} for each in formats]


class RobotNode:
    """A robot that obeys commands: its methods return the frames to send now, in order.

    Attributes:
        bus_robot: The robot, which the node drives.
        subjects: Formats of the messages.
        is_settled: Whether the last tick has ended.
        obeyed: Number of commands followed.
        disobeyed: Number of commands for this robot that the rules did not let it follow.
        unsettled: Number of ticks ended by the next one, since no *settle* had come.
    """

    def __init__(
        self,
        setup: RobotSetup,
        subjects: Subjects | None = None,
        steps_per_second: int = 10,
        recorder: Recorder | None = None,
        make: Callable[[], Robot] | None = None,
    ) -> None:
        """Start a robot, with the firmware that ``make`` returns in place of the setup's.

        A heartbeat is due every ``steps_per_second`` ticks, 1 or more. Raises as ``BusRobot``.
        """
        self.subjects = subjects or Subjects()
        self.bus_robot = BusRobot(
            setup, self.subjects.estimates, recorder, self.subjects.telemetry, make_firmware=make
        )
        self.is_settled = True
        self.obeyed = self.disobeyed = self.unsettled = 0
        self._steps_per_second = steps_per_second
        self._alpha_watch = AlphaWatch()
        self._tick_of_command: int | None = None

    @property
    def id(self) -> int:
        """Robot id and node id."""
        return self.bus_robot.id

    @property
    def robot(self) -> Robot:
        """The firmware."""
        return self.bus_robot.robot

    @property
    def ticks(self) -> int:
        """Control ticks begun."""
        return self.bus_robot.ticks

    @property
    def sent(self) -> FramesSent:
        """Numbers of frames sent."""
        return self.bus_robot.sent

    @property
    def reception(self) -> Reception:
        """Counts of the frames received."""
        return self.bus_robot.reception

    @property
    def counters(self) -> Counters:
        """The firmware's diagnostics, in numbers that do not wrap."""
        return self.bus_robot.counters

    def start(self) -> list[can.Message]:
        """Return the heartbeat that announces the node."""
        return [self.bus_robot.heartbeat(self._now)]

    def observe(self, z: Observation | None) -> list[can.Message]:
        """Begin a tick, with an observation or without: return the heartbeat and the broadcast that are due.

        A tick that is still open ends first, without an answer.
        """
        if not self.is_settled:
            self.unsettled += 1
            self.bus_robot.settle()
        self.is_settled = False
        frames = []
        # The heartbeat that is due before the first tick has been sent by start().
        if self.ticks > 0 and self.bus_robot.is_heartbeat_due(self._steps_per_second):
            frames.append(self.bus_robot.heartbeat(self._now))
        time_before_tick = self._now
        if self.bus_robot.observe(z):
            frames.append(self.bus_robot.broadcast(time_before_tick))
        return frames

    def settle(self) -> list[can.Message]:
        """End the tick, and return the answer, which is telemetry."""
        self.bus_robot.settle()
        self.is_settled = True
        return [self.bus_robot.telemetry(self._now)]

    def hear(self, frame: can.Message) -> list[can.Message]:
        """Receive any frame that this node has not sent itself, and return the answers to a command."""
        content = decode_estimate(frame, self.subjects.estimates)
        if isinstance(content, Estimate):
            if content.sender == self.id and self.bus_robot.recorder is not None:
                self.bus_robot.recorder.record_foreign_frame(frame)
            self._receive(content)
            return []
        command: Command | Rejection = content
        if content is Rejection.SUBJECT:
            command = decode_command(frame, self.subjects.commands)
        if isinstance(command, Command):
            return self._obey(command)
        self.reception.rejected[command] += 1
        return []

    def figures(self) -> dict[str, Any]:
        """Return the counts of frames sent and received so far as plain values, for JSON."""
        return {
            **{f"{kind}_sent": count for kind, count in vars(self.sent).items()},
            "delivered": self.reception.delivered,
            "refused": self.reception.refused,
            "obeyed": self.obeyed,
            "disobeyed": self.disobeyed,
            "unsettled": self.unsettled,
            "rejected": {reason.name: count for reason, count in self.reception.rejected.items()},
            "id_conflicts": self.reception.id_conflicts,
            "events": [
                {"event": kind.value, "sender": sender, "estimates": count}
                for (kind, sender), count in self.reception.events.items()
            ],
        }

    def _receive(self, estimate: Estimate) -> None:
        """Hand an estimate to the robot, and count it if its alpha is suspicious."""
        if self._alpha_watch.is_jump(estimate.sender, estimate.alpha):
            self.reception.events[Suspicion.JUMP, estimate.sender] += 1
        self.bus_robot.receive(estimate)

    def _obey(self, command: Command) -> list[can.Message]:
        """Follow a command for this robot and return the answers, or count it as disobeyed.

        The rules: *settle* ends the tick that its number began, and no other; an observation begins a tick,
        unless the tick with its number is still open, since then it is a repetition.
        """
        if command.target not in (self.id, EVERY_ROBOT):
            return []
        is_settle = command.action is Action.SETTLE
        is_tick_open = not self.is_settled and command.tick == self._tick_of_command
        if is_settle != is_tick_open:
            self.disobeyed += 1
            return []
        self.obeyed += 1
        if is_settle:
            return self.settle()
        self._tick_of_command = command.tick
        return self.observe(command.action.observation)

    @property
    def _now(self) -> float:
        """The node's own time, seconds."""
        return self.ticks / self._steps_per_second


def state_of(node: RobotNode) -> dict[str, Any]:
    """A robot's estimates and counters as plain values, for JSON; with raw ones if the firmware has any."""
    robot = node.robot
    state: dict[str, Any] = {name: getattr(robot, name) for name in _FLOATS}
    if isinstance(robot, FixedPointRobot):
        state["raw"] = {name.removesuffix("_raw"): getattr(robot, name) for name in _RAW}
    return state | {"counters": asdict(node.counters)}


# --- On a bus ---


class Stopped(Exception):  # noqa: N818 (no error)
    """The node was asked to stop."""


@dataclass
class BusLink:
    """A node's connection to its bus.

    Attributes:
        bus: The connection; its filters should pass only frames that the node needs.
        should_stop: Checked while waiting.
        endures: Whether to go on when the bus fails, as in real time. A bus that is gone ends the run.
        log: Takes all frames sent and received; they are stamped with the time of day.
        failures: How often sending or receiving failed.
        last_failure: Failure of the last attempt; None if it succeeded.
    """

    bus: can.BusABC
    should_stop: Callable[[], bool] = lambda: False
    endures: bool = False
    log: FrameTaker | None = None
    failures: int = 0
    last_failure: can.CanError | None = None

    def send(self, frame: can.Message) -> bool:
        """Put a frame on the bus; returns whether that succeeded.

        Raises can.CanError if it failed and the link does not endure, and BusGoneError in any case.
        """
        try:
            self.bus.send(frame, timeout=SEND_TIMEOUT)
        except can.CanError as error:
            self._count_failure(error)
            return False
        self.last_failure = None
        if self.log is not None:
            frame.timestamp = time.time()
            self.log(frame)
        return True

    def receive(self, seconds: float) -> can.Message | None:
        """A frame of another node, if one comes within ``seconds``, or within the next tenth of a second.

        Raises Stopped if the node was asked to stop, can.CanError as ``send``.
        """
        if self.should_stop():
            raise Stopped
        seconds = min(seconds, _SLICE)
        try:
            frame = self.bus.recv(seconds)
        except can.CanError as error:
            self._count_failure(error)
            time.sleep(seconds)  # a bus that fails at once must not keep the processor busy
            return None
        if frame is None or not frame.is_rx:
            return None
        self.last_failure = None
        if self.log is not None:
            self.log(frame)
        return frame

    def catch_up(self, take: FrameTaker) -> None:
        """Hand over waiting frames, since a late clock leaves no time to listen."""
        for _ in range(_MOST_AT_ONCE):
            frame = self.receive(0)
            if frame is None:
                return
            take(frame)

    def _count_failure(self, error: can.CanError) -> None:
        """Count a failure, and raise it unless the link endures it."""
        self.failures += 1
        self.last_failure = error
        if not self.endures or isinstance(error, BusGoneError):
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


def run_node(
    node: RobotNode, link: BusLink, ticks: int | None = None, watch: Callable[[], None] = lambda: None
) -> RunOutcome:
    """Let a node follow commands for ``ticks`` ticks, or for any number if None.

    ``watch`` is called regularly. The run ends early when the link is asked to stop or fails.
    """
    outcome = RunOutcome("all ticks done")
    try:
        for frame in node.start():
            link.send(frame)
        while not node.is_settled or ticks is None or node.ticks < ticks:
            heard = link.receive(_SLICE)
            for answer in [] if heard is None else node.hear(heard):
                link.send(answer)
            watch()
    except (Stopped, KeyboardInterrupt):
        outcome.ending, outcome.is_interrupted = "stopped", ticks is not None
    except can.CanError as error:
        outcome.ending, outcome.has_failed = f"the bus failed: {error}", True
    return outcome


def send_all(bus: can.BusABC, frames: Iterable[can.Message], timeout: float) -> None:
    """Put ``frames`` on the bus in order, waiting while its queue is full.

    Raises can.CanError if it takes no frame for ``timeout`` seconds, or fails otherwise.
    """
    for frame in frames:
        deadline = time.monotonic() + timeout
        while True:
            try:
                bus.send(frame, timeout=timeout)
                break
            except can.CanOperationError as error:
                if error.error_code != errno.ENOBUFS:
                    raise
                if time.monotonic() > deadline:
                    raise can.CanTimeoutError(f"the bus took no frame for {timeout:g} s") from error
                time.sleep(_PAUSE)
