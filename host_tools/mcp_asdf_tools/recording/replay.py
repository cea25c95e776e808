"""Replay of a log: every robot runs again on its recorded input."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any, NamedTuple

import can
import numpy as np

from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.frames import (
    TRANSFER_IDS,
    Action,
    FrameFormat,
    Message,
    alpha_bits,
    binary32_of,
    decode,
    float_of,
    frame_as_text,
)
from mcp_asdf_tools.recording.input_log import InputLogReader
from mcp_asdf_tools.robots.bus_robot import RESTART, SETTLE, BusRobot, Event
from mcp_asdf_tools.robots.record import RobotRecord


class Broadcast(NamedTuple):
    """Broadcast of a robot.

    Attributes:
        tick: Number of the tick that it belongs to, from 1 at the robot's start.
        transfer_id: Number of the broadcast since then modulo 32.
        x_hat: Local estimate in units of 2**-23.
        alpha_bits: Local confidence as the frame has it, in binary32 bits.
        is_false: Whether a fault replaced the firmware's values by these.
    """

    tick: int
    transfer_id: int
    x_hat: int
    alpha_bits: int
    is_false: bool = False


class Rerun:
    """Robot that repeats its recorded run.

    Attributes:
        broadcasts: Its broadcasts, in order; the comparison takes them off.
    """

    def __init__(self, record: RobotRecord) -> None:
        """Prepare a robot that starts like the one recorded."""
        self.broadcasts: deque[Broadcast] = deque()
        self._robot = BusRobot(record, FrameFormat())

    @property
    def state(self) -> Robot:
        """Its firmware in the present state."""
        return self._robot.robot

    def do(self, events: Iterable[Event]) -> None:
        """Let ``events`` happen to it. O(1) each; raises ValueError for one that cannot follow the last."""
        for is_message, group in groupby(events, _is_message):
            if is_message:
                self._robot.receive(np.array(list(group), np.uint32))
                continue
            for event in group:
                self._suffer(event)

    def _suffer(self, event: Event) -> None:
        if isinstance(event, list):
            x_hat, bits = event
            last = self._last("falsified")
            self.broadcasts.append(last._replace(x_hat=x_hat, alpha_bits=bits, is_false=True))
        elif event == RESTART:
            self._robot.restart()
        elif isinstance(event, str):
            self._last(event)
        elif event == SETTLE:
            self._robot.end()
        else:
            self._observe(Action(event))

    def _observe(self, action: Action) -> None:
        if self._robot.begin(action.observation):
            estimate = self._robot.estimate()
            alpha = binary32_of(estimate.alpha)
            self.broadcasts.append(Broadcast(self._robot.ticks, estimate.transfer_id, estimate.x_hat, alpha))

    def _last(self, what: str) -> Broadcast:
        """Take back the last broadcast."""
        if not self.broadcasts:
            raise ValueError(f"robot {self._robot.id} has a broadcast {what} before it made one")
        return self.broadcasts.pop()


def _is_message(event: Event) -> bool:
    return isinstance(event, list) and len(event) == 3


@dataclass(frozen=True)
class LogDifference:
    """First broadcast of a log that the robot would not have sent.

    Attributes:
        frame: Its number in the log, from 1.
        timestamp: As the log has it, seconds.
        logged: The broadcast in the log.
        alpha_bits: Its alpha in the binary32 bits of the frame.
        expected: The robot's broadcast at this place; None if it sends no more.
    """

    frame: int
    timestamp: float
    logged: Message
    alpha_bits: int
    expected: Broadcast | None

    def __str__(self) -> str:
        logged, expected = self.logged, self.expected
        text = (
            f"frame {self.frame} at {self.timestamp:.6f} s: robot {logged.sender} broadcast "
            f"{_values(logged, self.alpha_bits)}"
        )
        if expected is None:
            return f"{text}, but makes no more broadcasts"
        return f"{text}, but in tick {expected.tick} it makes {_values(expected, expected.alpha_bits)}"


def _values(said: Message | Broadcast, bits: int) -> str:
    return (
        f"x_hat {said.x_hat:#08x} ({said.x_hat / 2**23:.7f}), alpha {bits:#010x} ({float_of(bits):.7g}), "
        f"transfer_id {said.transfer_id}"
    )


@dataclass
class ReplayVerdict:
    """Result of a comparison.

    Attributes:
        reproduced: Broadcasts of the log that the robots made again, bit for bit.
        falsified: Those that went out with the values that a fault gave them.
        foreign: Frames under a robot's id that it did not send.
        not_logged: Broadcasts that the log lacks.
        beyond: Estimates after the last event of an input log that was cut off.
        other: Frames that are no estimate of a recorded robot.
        difference: The first broadcast that is not reproduced; None if all are.
    """

    reproduced: int = 0
    falsified: int = 0
    foreign: int = 0
    not_logged: int = 0
    beyond: int = 0
    other: int = 0
    difference: LogDifference | None = None

    def plain(self) -> dict[str, Any]:
        """The verdict as plain values, for JSON."""
        return asdict(self) | {"difference": None if self.difference is None else str(self.difference)}


def verify(
    log: Iterable[can.Message], input_log: InputLogReader, progress: Callable[[], None] = lambda: None
) -> ReplayVerdict:
    """Run every robot of ``input_log`` again and compare its broadcasts with those of ``log``.

    Calls ``progress`` after each line of the input log, which is the longest part. Stops at the first
    difference. Time O(events + frames), memory O(broadcasts). Raises UsageError if log or input_log cannot be
    read or the input log contradicts itself.
    """
    robots, foreign = _run_again(input_log, progress)
    comparison = _Comparison(robots, foreign, input_log.header.frames, input_log.is_part)
    for number, frame in enumerate(log, start=1):
        if not comparison.take(number, frame):
            break
    else:
        comparison.verdict.not_logged += sum(len(robot.broadcasts) for robot in robots.values())
    return comparison.verdict


def rerun(input_log: InputLogReader) -> Iterator[tuple[int, Robot]]:
    """Run every robot again; yields an id, and that robot's state, each time that one settles.

    Robots settle in the order of the file. O(1) an event. Raises UsageError as ``verify``.
    """
    robots = {record.id: Rerun(record) for record in input_log.header.robots}
    for line in input_log.lines():
        if not isinstance(line, str):
            robot, events = line
            _do(robots[robot], events, input_log)
            if events[-1:] == [SETTLE]:
                robots[robot].broadcasts.clear()
                yield robot, robots[robot].state


def _run_again(
    input_log: InputLogReader, progress: Callable[[], None]
) -> tuple[dict[int, Rerun], Counter[str]]:
    """The robots after all their events, and the frames that none of them sent."""
    robots = {record.id: Rerun(record) for record in input_log.header.robots}
    foreign: Counter[str] = Counter()
    for line in input_log.lines():
        if isinstance(line, str):
            foreign[line] += 1
        else:
            robot, events = line
            _do(robots[robot], events, input_log)
        progress()
    return robots, foreign


def _do(robot: Rerun, events: Iterable[Event], input_log: InputLogReader) -> None:
    try:
        robot.do(events)
    except ValueError as error:
        raise input_log.wrong(str(error)) from error


class _Comparison:
    def __init__(
        self, robots: dict[int, Rerun], foreign: Counter[str], frames: FrameFormat, is_part: bool
    ) -> None:
        self.verdict = ReplayVerdict()
        self._is_part = is_part
        self._robots = robots
        self._foreign = foreign
        self._frames = frames

    def take(self, number: int, frame: can.Message) -> bool:
        """Compare one frame; returns whether it is as expected."""
        message = decode(frame, self._frames)
        if not isinstance(message, Message) or message.sender not in self._robots:
            self.verdict.other += 1
            return True
        broadcasts = self._robots[message.sender].broadcasts
        place = _place_of(message, broadcasts)
        said = message.x_hat, alpha_bits(frame)
        is_own = place is not None and (broadcasts[place].x_hat, broadcasts[place].alpha_bits) == said
        # A frame that strangers sent, too, is the robot's own only in its turn: a later match is chance.
        text = frame_as_text(frame)
        if self._foreign[text] and not (is_own and place == 0):
            self._foreign[text] -= 1
            self.verdict.foreign += 1
            return True
        if is_own and place is not None:
            self._pass(broadcasts, place)
            return True
        if self._is_part and not broadcasts:
            self.verdict.beyond += 1
            return True
        expected = broadcasts[place or 0] if broadcasts else None
        self.verdict.difference = LogDifference(number, frame.timestamp, message, said[1], expected)
        return False

    def _pass(self, broadcasts: deque[Broadcast], place: int) -> None:
        """Take the broadcast at ``place`` off, and those before it, which the log lacks."""
        for _ in range(place):
            broadcasts.popleft()
        self.verdict.not_logged += place
        if broadcasts.popleft().is_false:
            self.verdict.falsified += 1
        else:
            self.verdict.reproduced += 1


def _place_of(message: Message, broadcasts: deque[Broadcast]) -> int | None:
    """Place of the broadcast with the message's transfer_id among the next; 0 in a log without gaps."""
    ahead = range(min(len(broadcasts), TRANSFER_IDS))
    return next((i for i in ahead if broadcasts[i].transfer_id == message.transfer_id), None)
