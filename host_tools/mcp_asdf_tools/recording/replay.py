"""Replay of a log: every robot runs again on its recorded input."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import can
import numpy as np

from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.alpha_words import alpha_word_to_bits, float32_value
from mcp_asdf_tools.bus.frame_layout import TRANSFER_IDS, Action
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, alpha_float32_bits, decode_estimate, format_frame
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
        robot: The robot.
        broadcasts: Its broadcasts, in order; the comparison takes them off.
    """

    def __init__(self, record: RobotRecord) -> None:
        """Prepare a robot that starts like the one recorded."""
        self.robot = BusRobot(record, FrameFormat())
        self.broadcasts: deque[Broadcast] = deque()

    def do(self, events: Iterable[Event]) -> None:
        """Let ``events`` happen to it. O(1) each; raises ValueError for one that cannot follow the last."""
        for is_message, group in groupby(events, lambda event: isinstance(event, list) and len(event) == 3):
            if is_message:
                self.robot.receive(np.array(list(group), np.uint32))
                continue
            for event in group:
                self._suffer(event)

    def _suffer(self, event: Event) -> None:
        if isinstance(event, list):
            x_hat, bits = event
            last = self._last("falsified")
            self.broadcasts.append(last._replace(x_hat=x_hat, alpha_bits=bits, is_false=True))
        elif event == RESTART:
            self.robot.restart()
        elif isinstance(event, str):
            self._last(event)
        elif event == SETTLE:
            self.robot.end()
        elif self.robot.begin(Action(event).observation):
            said = self.robot.estimate()
            alpha = alpha_word_to_bits(said.alpha)
            self.broadcasts.append(Broadcast(self.robot.ticks, said.transfer_id, said.x_hat, alpha))

    def _last(self, what: str) -> Broadcast:
        """Take back the last broadcast."""
        if not self.broadcasts:
            raise ValueError(f"robot {self.robot.id} has a broadcast {what} before it made one")
        return self.broadcasts.pop()


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
        difference: The first broadcast that is not reproduced, in words; None if all are.
    """

    reproduced: int = 0
    falsified: int = 0
    foreign: int = 0
    not_logged: int = 0
    beyond: int = 0
    other: int = 0
    difference: str | None = None


def verify(log: Iterable[can.Message], input_log: InputLogReader) -> ReplayVerdict:
    """Run every robot of ``input_log`` again and compare its broadcasts with those of ``log``.

    Stops at the first difference. Time O(events + frames), memory O(broadcasts). Raises UsageError if log or
    input_log cannot be read or the input log contradicts itself.
    """
    robots = _robots_of(input_log)
    foreign = Counter(line for line in _play(input_log, robots) if isinstance(line, str))
    comparison = _Comparison(robots, foreign, input_log)
    for number, frame in enumerate(log, start=1):
        comparison.take(number, frame)
        if comparison.verdict.difference is not None:
            return comparison.verdict
    comparison.verdict.not_logged += sum(len(robot.broadcasts) for robot in robots.values())
    return comparison.verdict


def rerun(input_log: InputLogReader) -> Iterator[tuple[int, Robot]]:
    """Run every robot again; yields an id, and that robot's state, each time that one settles.

    Robots settle in the order of the file. O(1) an event. Raises UsageError as ``verify``.
    """
    robots = _robots_of(input_log)
    for line in _play(input_log, robots):
        if not isinstance(line, str) and line[1][-1:] == [SETTLE]:
            again = robots[line[0]]
            again.broadcasts.clear()
            yield line[0], again.robot.robot


def _robots_of(input_log: InputLogReader) -> dict[int, Rerun]:
    return {record.id: Rerun(record) for record in input_log.header.robots}


def _play(input_log: InputLogReader, robots: dict[int, Rerun]) -> Iterator[tuple[int, Sequence[Event]] | str]:
    """Let the robots do what each line of the input log says; yields the line when that is done."""
    for line in input_log.lines():
        if not isinstance(line, str):
            robot, events = line
            try:
                robots[robot].do(events)
            except ValueError as error:
                raise input_log.wrong(str(error)) from error
        yield line


class _Comparison:
    """Comparison of a log with the broadcasts of robots that have run again."""

    def __init__(self, robots: dict[int, Rerun], foreign: Counter[str], input_log: InputLogReader) -> None:
        """Compare with ``robots`` after their events; ``foreign`` counts frames that none of them sent."""
        self.verdict = ReplayVerdict()
        self._robots = robots
        self._foreign = foreign
        self._frames, self._is_part = input_log.header.frames, input_log.is_part

    def take(self, number: int, frame: can.Message) -> None:
        """Compare frame ``number`` of the log."""
        message = decode_estimate(frame, self._frames)
        if not isinstance(message, Estimate) or message.sender not in self._robots:
            self.verdict.other += 1
            return
        broadcasts = self._robots[message.sender].broadcasts
        place = _place_of(message, broadcasts)
        bits, text = alpha_float32_bits(frame), format_frame(frame)
        is_own = place is not None and broadcasts[place][2:4] == (message.x_hat, bits)
        # A frame that strangers sent, too, is the robot's own only in its turn: a later match is chance.
        if self._foreign[text] and not (is_own and place == 0):
            self._foreign[text] -= 1
            self.verdict.foreign += 1
        elif is_own and place is not None:
            self._pass(broadcasts, place)
        elif self._is_part and not broadcasts:
            self.verdict.beyond += 1
        else:
            expected = "makes no more broadcasts"
            if broadcasts:
                other = broadcasts[place or 0]
                expected = f"in tick {other.tick} it makes {_values(other, other.alpha_bits)}"
            self.verdict.difference = (
                f"frame {number} at {frame.timestamp:.6f} s: robot {message.sender} broadcast "
                f"{_values(message, bits)}, but {expected}"
            )

    def _pass(self, broadcasts: deque[Broadcast], place: int) -> None:
        """Take the broadcast at ``place`` off, and those before it, which the log lacks."""
        for _ in range(place):
            broadcasts.popleft()
        self.verdict.not_logged += place
        if broadcasts.popleft().is_false:
            self.verdict.falsified += 1
        else:
            self.verdict.reproduced += 1


def _place_of(message: Estimate, broadcasts: deque[Broadcast]) -> int | None:
    """Place of the broadcast with the message's transfer_id among the next; 0 in a log without gaps."""
    ahead = range(min(len(broadcasts), TRANSFER_IDS))
    return next((i for i in ahead if broadcasts[i].transfer_id == message.transfer_id), None)


def _values(said: Estimate | Broadcast, bits: int) -> str:
    return (
        f"x_hat {said.x_hat:#08x} ({said.x_hat / 2**23:.7f}), "
        f"alpha {bits:#010x} ({float32_value(bits):.7g}), "
        f"transfer_id {said.transfer_id}"
    )
