"""Driving robots of other processes, or real ones, tick by tick with command frames.

In each tick a robot observes the floor, broadcasts its estimate if its round is over, and settles. To settle
is to end the tick and to answer with a telemetry frame. In the last tick of a round the robot also uses what
it has received in the round.

The simulator's half of the protocol in ``docs/design.md``; the robot's is ``robots.node.RobotNode``, the
C node and the firmware images. A tick of robots that are all driven::

    lockstep.observe({3: Observation.BLACK, 4: Observation.WHITE})
    estimates = lockstep.wait_for_estimates({3, 4})   # in ticks in which these robots broadcast
    telemetry = lockstep.settle({3, 4})

Between the calls other nodes may send.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from typing import TypeVar

import can

from mcp_asdf.robot import Observation
from mcp_asdf_tools.bus.frame_layout import TRANSFER_ID_MODULUS, Action
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

_SECONDS_BETWEEN_CHECKS = 0.1
"""How often the caller's ``check`` is called while waiting."""

_MAX_ROBOTS_IN_ERROR = 8
"""Missing robots that an error names."""

Answer = TypeVar("Answer", Estimate, Telemetry, Heartbeat)


class LockstepError(RuntimeError):
    """A robot did not answer in time, or answered with an unexpected number; the message names it."""


class Lockstep:
    """Commands robots over one connection to their bus, and waits for their answers.

    Attributes:
        tick: Number of the tick that is open or, between ticks, of the next.
        repeated: Number of commands sent a second time because no answer had come.
        check: Called several times per second of waiting; it may raise an error that ends the wait.
    """

    def __init__(
        self,
        bus: can.BusABC,
        subjects: Subjects | None = None,
        timeout: float = 2.0,
        on_frame: Callable[[can.Message], None] = lambda frame: None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepare to command robots over ``bus``, which is left open at the end. Nothing is sent yet.

        Args:
            bus: Connection to the robots' bus.
            subjects: Formats of the messages; None for the default ones.
            timeout: Seconds that robots have to answer. After half of them a command is repeated once.
            on_frame: Called with every frame that comes in and, with ``is_rx`` false, every command sent.
            check: Called several times per second of waiting, see the attribute.
        """
        self.tick = 0
        self.repeated = 0
        self._bus = bus
        self._subjects = subjects or Subjects()
        self._timeout = timeout
        self._on_frame = on_frame
        self.check = check
        self._sent_command_count = 0
        self._heartbeats: dict[int, Heartbeat] = {}
        """First heartbeat of each robot since the last wait for heartbeats began, by id."""
        self._estimates: dict[int, Estimate] = {}
        """First estimate of each robot in this tick, by id."""
        self._telemetry: dict[int, Telemetry] = {}
        """First telemetry of each robot since it was commanded to settle, by id."""
        self._next_transfer_ids: dict[int, int] = {}
        """Number that the next telemetry of each robot must have, by id; empty before its first."""
        self._last_actions: Mapping[int, Action] = {}
        """Actions that robots were commanded last, by id, to be commanded again if no answer comes."""

    def wait_until_up(self, robots: Collection[int], timeout: float) -> None:
        """Wait until a heartbeat of each of ``robots`` (ids) has come.

        Raises LockstepError, naming the missing robots, after ``timeout`` seconds.
        """
        self._heartbeats.clear()
        self._last_actions = {}  # a heartbeat answers no command, so that none is repeated
        self._wait_for_answers(robots, self._heartbeats, "send a heartbeat", timeout)

    def observe(self, observations: Mapping[int, Observation | None]) -> None:
        """Command robots to begin a tick, and forget the estimates of the last one.

        ``observations`` has what each robot observes, by id; with None it begins the tick without an
        observation. Does not wait for an answer. Raises UsageError if a robot has the simulator's id, and
        can.CanError if the bus does not take the commands.
        """
        if DRIVER_ID in observations:
            raise UsageError(f"robot {DRIVER_ID} has the id of the simulator; give it another")
        self._estimates.clear()
        # Kept so that a command can be repeated if no answer comes.
        self._last_actions = {
            robot: Action.to_observe(observation) for robot, observation in observations.items()
        }
        self._send_commands(self._last_actions)

    def wait_for_estimates(self, robots: Collection[int]) -> dict[int, Estimate]:
        """Wait until all of ``robots`` have broadcast in this tick, and return their estimates by id.

        Of several estimates of one robot the first is returned. Raises LockstepError if one sends none
        within the time limit.
        """
        return self._wait_for_answers(robots, self._estimates, "broadcast its estimate", self._timeout)

    def settle(self, robots: Collection[int]) -> dict[int, Telemetry]:
        """Command ``robots`` to settle, wait for their telemetry, and return it by id; the tick is then over.

        Raises LockstepError if a robot does not answer within the time limit, or its telemetry is not the
        next after its last; can.CanError if the bus does not take the commands.
        """
        self._telemetry.clear()  # telemetry that came before the command is no answer to it
        self._last_actions = {robot: Action.SETTLE for robot in robots}
        self._send_commands(self._last_actions)
        answers = self._wait_for_answers(robots, self._telemetry, "settle", self._timeout)
        for robot, answer in answers.items():
            self._check_transfer_id(robot, answer.transfer_id)
        # This comes last, since the tick must still be open after an error.
        self.tick += 1
        return answers

    def skip_settle(self, distance: int = 1) -> None:
        """End the tick without a *settle*, as if all were lost: robots end it when they observe again.

        The number of the next tick is ``distance`` higher, or lower if that is negative; it is not 0.
        """
        self.tick += distance

    def _check_transfer_id(self, robot: int, transfer_id: int) -> None:
        """Check that a robot's telemetry follows its last, and expect the next number from now on.

        The first telemetry of a robot may have any number, since the robot may have run before. Raises
        LockstepError for another number than the expected one.
        """
        if robot in self._next_transfer_ids and transfer_id != self._next_transfer_ids[robot]:
            # A robot sends telemetry only when it settles: a gap or a repetition reveals a restart or an
            # answer to nobody's command.
            raise LockstepError(
                f"robot {robot} answered in tick {self.tick} with transfer_id {transfer_id}, not "
                f"{self._next_transfer_ids[robot]} (modulo {TRANSFER_ID_MODULUS}): it restarted or sends "
                "telemetry of its own accord"
            )
        self._next_transfer_ids[robot] = (transfer_id + 1) % TRANSFER_ID_MODULUS

    def _send_commands(self, actions: Mapping[int, Action]) -> None:
        """Send each robot, by id, the command for its action in the present tick, and report the frames.

        Raises can.CanError if the bus does not take them.
        """
        frames = []
        # All commands are encoded before the first is sent, so that a wrong id sends none of them.
        for robot, action in actions.items():
            transfer_id = self._sent_command_count % TRANSFER_ID_MODULUS
            command = Command(DRIVER_ID, self.tick, robot, action, transfer_id)
            frames.append(encode_command(command, self._subjects.commands))
            self._sent_command_count += 1
        send_all(self._bus, frames, self._timeout)
        # A frame that the bus did not take must not be in a log.
        for frame in frames:
            self._on_frame(frame)

    def _wait_for_answers(
        self, robots: Collection[int], answers: Mapping[int, Answer], expected_answer: str, seconds: float
    ) -> dict[int, Answer]:
        """Receive frames until ``answers`` has an entry for each of ``robots``, and return these by id.

        ``answers`` is one of this object's stores, which fill while frames are received. An answer may have
        come already, while an earlier one was awaited. After half of ``seconds`` the robots that are still
        missing get their last commands again, if there are any, and another half of ``seconds`` from then on:
        a robot follows a command that it has missed, and ignores the repetition of one that it has received.
        The caller's ``check`` is called several times per second. Raises LockstepError, naming the missing
        robots and what they did not do (``expected_answer``), after ``seconds``; on a bus that is never quiet
        after twice that.
        """
        start = time.monotonic()
        repetition_time = start + seconds / 2
        deadline = start + seconds
        next_check = start + _SECONDS_BETWEEN_CHECKS
        missing_robots = set(robots) - answers.keys()
        while missing_robots:
            now = time.monotonic()
            if now > repetition_time:
                repetition_time = math.inf
                if self._last_actions:
                    self._repeat_commands(missing_robots)
                    # However long sending took, robots have the second half of the time for the repetition.
                    deadline = time.monotonic() + seconds / 2

            # Wait for a frame, but not beyond what is due next: a check, the repetition or the end.
            seconds_to_next_event = max(0.0, min(repetition_time, deadline) - now)
            frame = self._receive(min(_SECONDS_BETWEEN_CHECKS, seconds_to_next_event))
            missing_robots.difference_update(answers)
            # On a bus that is never quiet frames come without end: then the time decides.
            if frame is None or now >= next_check:
                self.check()
                next_check = now + _SECONDS_BETWEEN_CHECKS

            # While frames keep coming, those in the receive buffer still count: for as long once more.
            last_moment = deadline if frame is None else deadline + seconds
            if missing_robots and now > last_moment:
                raise self._missing_error(missing_robots, expected_answer, seconds)
        return {robot: answers[robot] for robot in robots}

    def _repeat_commands(self, missing_robots: Collection[int]) -> None:
        """Send the missing robots their last commands again, and count these commands.

        Raises can.CanError if the bus does not take them.
        """
        late_actions = {
            robot: action for robot, action in self._last_actions.items() if robot in missing_robots
        }
        self.repeated += len(late_actions)
        self._send_commands(late_actions)

    def _missing_error(
        self, missing_robots: Collection[int], expected_answer: str, seconds: float
    ) -> LockstepError:
        """Return an error that names some of the missing robots, and what they did not do."""
        names = ", ".join(str(robot) for robot in sorted(missing_robots)[:_MAX_ROBOTS_IN_ERROR])
        if len(missing_robots) > _MAX_ROBOTS_IN_ERROR:
            names += ", ..."
        return LockstepError(
            f"robot {names} did not {expected_answer} within {seconds:g} s on {self._bus.channel_info}; is "
            "it there, in lockstep, with these ids and subjects?"
        )

    def _receive(self, seconds: float) -> can.Message | None:
        """Return the next frame, or None if none comes within ``seconds``.

        A frame that another node has sent is reported and stored before that.
        """
        frame = self._bus.recv(seconds)
        if frame is not None and frame.is_rx:  # some buses return the commands sent here
            self._on_frame(frame)
            self._store_answer(frame)
        return frame

    def _store_answer(self, frame: can.Message) -> None:
        """Store an estimate, telemetry or a heartbeat by its sender, and ignore every other frame.

        The first of a robot is kept until the next wait of its kind begins: a faulty robot that sends more
        cannot change what has been read.
        """
        estimate = decode_estimate(frame, self._subjects.estimates)
        if isinstance(estimate, Estimate):
            self._estimates.setdefault(estimate.sender, estimate)
            return
        telemetry = decode_telemetry(frame, self._subjects.telemetry)
        if isinstance(telemetry, Telemetry):
            self._telemetry.setdefault(telemetry.sender, telemetry)
            return
        heartbeat = decode_heartbeat(frame)
        if isinstance(heartbeat, Heartbeat):
            self._heartbeats.setdefault(heartbeat.sender, heartbeat)
