"""Driving robots of other processes, or real ones, tick by tick with command frames.

The simulator's half of the protocol in ``docs/frame.md``; the robot's is ``robots.node.RobotNode``, the
C node and the firmware images. A tick of robots that are all driven::

    lockstep.observe({3: Observation.BLACK, 4: Observation.WHITE})
    estimates = lockstep.estimates({3, 4})   # in ticks in which broadcasts are due
    telemetry = lockstep.settle({3, 4})

Between the calls other nodes may send.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TypeVar

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frame_layout import TRANSFER_IDS, Action
from mcp_asdf_tools.bus.frames import (
    Command,
    Estimate,
    Heartbeat,
    Telemetry,
    decode_estimate,
    decode_heartbeat,
    decode_telemetry,
    encode_command,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.node import Subjects, send_all

DRIVER_ID = 126
"""Node id of the simulator: the first that Cyphal keeps for tools."""

_SLICE = 0.1
"""Seconds between two checks while waiting."""


Answer = TypeVar("Answer")


class LockstepError(RuntimeError):
    """A robot did not answer in time, or not in order; the message names it."""


class Lockstep:
    """Commands robots over one connection to their bus.

    Attributes:
        tick: Number of the tick that is open or, between ticks, of the next.
        repeated: Commands repeated because no answer had come.
    """

    def __init__(
        self,
        bus: can.BusABC,
        subjects: Subjects | None = None,
        timeout: float = 2.0,
        watch: Callable[[can.Message], None] = lambda frame: None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Command from ``bus``, which is left open at the end. Nothing is sent yet.

        Messages have the formats of ``subjects``. Robots have ``timeout`` seconds to answer; after half of
        them a command is repeated once. ``watch`` takes every frame that comes in and, with ``is_rx`` false,
        every command that goes out; ``check`` is called several times per second of waiting and may raise an
        error that ends it.
        """
        self.tick = self.repeated = 0
        self._bus = bus
        self._subjects = subjects or Subjects()
        self._timeout = timeout
        self._watch = watch
        self._check = check
        self._commands = 0
        self._estimates: dict[int, Estimate] = {}
        self._telemetry: dict[int, Telemetry] = {}
        self._turns: dict[int, int] = {}
        self._orders: Mapping[int, Action] = {}

    def wait_until_up(self, robots: Collection[int], timeout: float) -> None:
        """Return when a heartbeat of each of ``robots`` has come.

        Raises LockstepError, naming the missing robots, after ``timeout`` seconds.
        """
        waiting = set(robots)
        for frame in self._frames_until_none(waiting, "send a heartbeat", timeout):
            heartbeat = decode_heartbeat(frame)
            if isinstance(heartbeat, Heartbeat):
                waiting.discard(heartbeat.sender)

    def observe(self, observations: Mapping[int, Observation | None]) -> None:
        """Let each robot, by id, make its observation, or none.

        Raises can.CanError if the bus does not take the commands.
        """
        if DRIVER_ID in observations:
            raise UsageError(f"robot {DRIVER_ID} has the id of the simulator; give it another")
        self._estimates.clear()
        self._orders = {robot: Action.to_observe(z) for robot, z in observations.items()}
        self._send(self._orders)

    def estimates(self, robots: Collection[int]) -> dict[int, Estimate]:
        """Estimates of ``robots`` in this tick, by id; the first one if a robot sends several.

        Raises LockstepError if one sends none within the time limit.
        """
        return self._answers(robots, self._estimates, "broadcast its estimate")

    def settle(self, robots: Collection[int]) -> dict[int, Telemetry]:
        """Let ``robots`` settle and end the tick; returns their answers by id.

        Raises LockstepError if one does not answer within the time limit, or not in turn; can.CanError if
        the bus does not take the commands.
        """
        self._telemetry.clear()
        self._orders = dict.fromkeys(robots, Action.SETTLE)
        self._send(self._orders)
        answers = self._answers(robots, self._telemetry, "settle")
        for robot, answer in answers.items():
            # It counts settles, so it reveals stray answers and restarts.
            number, expected = answer.transfer_id, self._turns.get(robot, answer.transfer_id)
            if number != expected:
                raise LockstepError(
                    f"robot {robot} answered in tick {self.tick} with transfer_id {number}, not {expected} "
                    f"(modulo {TRANSFER_IDS}): it restarted or sends telemetry of its own accord"
                )
            self._turns[robot] = (number + 1) % TRANSFER_IDS
        self.tick += 1
        return answers

    def leave_open(self, distance: int = 1) -> None:
        """End the tick without a *settle*, as if all were lost: robots end it when they observe again.

        The number of the next tick is ``distance`` higher, or lower if that is negative; it is not 0.
        """
        self.tick += distance

    def _send(self, orders: Mapping[int, Action]) -> None:
        frames = []
        for robot, action in orders.items():
            command = Command(DRIVER_ID, self.tick, robot, action, self._commands % TRANSFER_IDS)
            frames.append(encode_command(command, self._subjects.commands))
            self._commands += 1
        send_all(self._bus, frames, self._timeout)
        for frame in frames:
            self._watch(frame)

    def _answers(self, robots: Collection[int], found: Mapping[int, Answer], what: str) -> dict[int, Answer]:
        """What is ``found`` of each robot, by id, once all is there."""
        waiting = set(robots) - found.keys()
        for _ in self._frames_until_none(waiting, what, self._timeout, self._orders):
            waiting.difference_update(found)
        return {robot: found[robot] for robot in robots}

    def _frames_until_none(
        self, waiting: set[int], what: str, seconds: float, orders: Mapping[int, Action] | None = None
    ) -> Iterator[can.Message]:
        """Take and yield frames until the caller has emptied ``waiting``.

        After half of ``seconds`` the robots still waited for get their ``orders`` again: they obey one that
        they have missed, and ignore one that they have heard.
        """
        again, began = dict(orders or {}), time.monotonic()
        check_at = began + _SLICE
        while waiting:
            now = time.monotonic()
            passed = now - began
            if again and passed > seconds / 2:
                late = {robot: action for robot, action in again.items() if robot in waiting}
                self.repeated += len(late)
                self._send(late)
                again, began = {}, time.monotonic() - seconds / 2
            left = (seconds / 2 if again else seconds) - passed
            frame = self._bus.recv(min(_SLICE, max(0.0, left)))
            if frame is None or now >= check_at:  # frames may come without end
                self._check()
                check_at = now + _SLICE
            if frame is not None and frame.is_rx:  # not one of the driver's own, returned to it
                self._watch(frame)
                self._take(frame)
                yield frame
            # Frames in the queue count even if they are late, but not without end.
            if waiting and passed > (seconds if frame is None else 2 * seconds):
                names = ", ".join(map(str, sorted(waiting)[:8])) + ", ..." * (len(waiting) > 8)
                raise LockstepError(
                    f"robot {names} did not {what} within {seconds:g} s on {self._bus.channel_info}; is it "
                    "there, in lockstep, with these ids and subjects?"
                )

    def _take(self, frame: can.Message) -> None:
        estimate = decode_estimate(frame, self._subjects.estimates)
        if isinstance(estimate, Estimate):
            self._estimates.setdefault(estimate.sender, estimate)
            return
        telemetry = decode_telemetry(frame, self._subjects.telemetry)
        if isinstance(telemetry, Telemetry):
            self._telemetry.setdefault(telemetry.sender, telemetry)
