"""A robot's node at work on a bus, in real time or in lockstep with a simulator."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import can

from mcp_asdf.robot import FixedPointRobot, Observation
from mcp_asdf_tools.robots.clock import RealTimeClock
from mcp_asdf_tools.robots.node import RobotNode
from mcp_asdf_tools.robots.observations import ObservationSource

SEND_TIMEOUT = 2.0
"""Seconds after which a bus that takes no frame counts as failed."""

_SLICE = 0.1
"""Longest wait in seconds between two checks for a stop."""

_MOST_AT_ONCE = 4096
"""Upper bound on frames taken at once, so that a flood cannot starve the robot."""

_RAW = ("x_hat_raw", "alpha_raw", "x_bar_raw", "beta_raw", "x_raw", "b_hat_raw")
_FLOATS = ("t", "n", "x_hat", "alpha", "x_bar", "beta", "x", "b_hat")

FrameTaker = Callable[[can.Message], None]


class Stopped(Exception):  # noqa: N818 (no error)
    """The node was asked to stop."""


@dataclass
class BusLink:
    """A node's connection to its bus.

    Attributes:
        bus: The connection; its filters should pass only frames that the node needs.
        should_stop: Checked while waiting.
        endures: Whether to go on when the bus fails, as a robot must.
        log: Takes all frames sent and received; they are stamped with the time of day.
        failures: How often sending or receiving failed.
        last_failure: The last reason.
    """

    bus: can.BusABC
    should_stop: Callable[[], bool] = lambda: False
    endures: bool = False
    log: FrameTaker | None = None
    failures: int = 0
    last_failure: str | None = None

    def send(self, frame: can.Message) -> bool:
        """Put a frame on the bus; returns whether that succeeded.

        Raises can.CanError if it failed and the link does not endure.
        """
        try:
            self.bus.send(frame, timeout=SEND_TIMEOUT)
        except can.CanError as error:
            self._note(error)
            return False
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
            self._note(error)
            time.sleep(seconds)  # a bus that fails at once must not keep the processor busy
            return None
        if frame is None or not frame.is_rx:
            return None
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

    def _note(self, error: can.CanError) -> None:
        self.failures += 1
        self.last_failure = str(error)
        if not self.endures:
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


class NodeRun:
    """A node at work.

    Attributes:
        node: The node.
        link: Its connection.
        outcome: How the run ended, once it is over.
    """

    def __init__(
        self,
        node: RobotNode,
        link: BusLink,
        ticks: int | None = None,
        watch: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepare for ``ticks`` ticks, or for any number if None; ``watch`` is called regularly."""
        self.node = node
        self.link = link
        self.outcome = RunOutcome("all ticks done")
        self._ticks = ticks
        self._watch = watch

    def in_lockstep(self) -> None:
        """Follow commands until all ticks are done or the run ends early."""
        self._run(self._follow)

    def in_real_time(self, source: ObservationSource) -> None:
        """Tick at the node's rate until all ticks are done, the observations end or the run ends early.

        A tick lasts until the next one begins: frames that arrive meanwhile belong to its round. A tick waits
        for its observation. Raises UsageError for an invalid observation.
        """
        clock = RealTimeClock(self.node.settings.steps_per_second, sleep=self._listen)
        try:
            self._run(lambda: self._tick_by(clock, source))
        finally:
            self.outcome.lateness = clock.figures()

    def _run(self, work: Callable[[], None]) -> None:
        try:
            self._send(self.node.start())
            work()
        except (Stopped, KeyboardInterrupt):
            self.outcome.ending = "stopped"
            self.outcome.is_interrupted = self._ticks is not None
        except can.CanError as error:
            self.outcome.ending = f"the bus failed: {error}"
            self.outcome.has_failed = True

    def _is_over(self) -> bool:
        return self._ticks is not None and self.node.ticks >= self._ticks

    def _follow(self) -> None:
        while not (self._is_over() and self.node.is_settled):
            self._listen(_SLICE)
            self._watch()

    def _tick_by(self, clock: RealTimeClock, source: ObservationSource) -> None:
        while not self._is_over():
            clock.begin(self.node.ticks)
            self.link.catch_up(self._take)
            try:
                z = self._observation(source)
            except EOFError:
                self._settle()
                self.outcome.ending = "the observations ended"
                return
            self._settle()
            self._send(self.node.observe(z))
            self._watch()
        clock.begin(self.node.ticks)
        self.link.catch_up(self._take)
        self._settle()

    def _observation(self, source: ObservationSource) -> Observation | None:
        """The next observation, waited for if need be. Raises EOFError if there are no more."""
        while True:
            try:
                return source.next(0)
            except TimeoutError:
                self._listen(_SLICE)

    def _listen(self, seconds: float) -> None:
        """Wait for a frame for at most ``seconds``, and take it."""
        frame = self.link.receive(seconds)
        if frame is not None:
            self._take(frame)

    def _take(self, frame: can.Message) -> None:
        self._send(self.node.hear(frame))

    def _send(self, frames: Iterable[can.Message]) -> None:
        for frame in frames:
            if not self.link.send(frame):
                self.node.lost(frame)

    def _settle(self) -> None:
        if not self.node.is_settled:
            self._send(self.node.settle())


def state_of(node: RobotNode) -> dict[str, Any]:
    """A robot's estimates and counters as plain values, for JSON; with raw ones if the firmware has any."""
    robot = node.robot
    state: dict[str, Any] = {name: getattr(robot, name) for name in _FLOATS}
    if isinstance(robot, FixedPointRobot):
        state["raw"] = {name.removesuffix("_raw"): getattr(robot, name) for name in _RAW}
    return state | {"counters": asdict(node.counters)}
