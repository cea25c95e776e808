"""Replay of a log: every robot runs again on its recorded events, and its broadcasts are compared."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import can
import numpy as np

from mcp_asdf.robot import Robot
from mcp_asdf_tools.bus.alpha_words import alpha_word_to_bits, float32_value
from mcp_asdf_tools.bus.frame_layout import TRANSFER_IDS, Action
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, alpha_float32_bits, decode_estimate, format_frame
from mcp_asdf_tools.recording.events import (
    RESTART,
    SETTLE,
    SILENT,
    Event,
    EventsReader,
    InjectedFrame,
    RobotEvents,
)
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.robot_setup import RobotSetup


@dataclass(frozen=True)
class Broadcast:
    """One broadcast of a robot that runs again.

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


class RepeatedRobot:
    """A robot that repeats its recorded run.

    Attributes:
        robot: The robot.
        broadcasts: Its broadcasts that have not been found in the log yet, in order.
    """

    def __init__(self, record: RobotSetup) -> None:
        """Start the robot like the one recorded."""
        self.robot = BusRobot(record, FrameFormat())
        self.broadcasts: deque[Broadcast] = deque()

    def apply_events(self, events: Iterable[Event]) -> None:
        """Let the robot live through ``events``, in order. O(events).

        Raises ValueError for an event that cannot follow the one before it.
        """
        estimates: list[Event] = []
        for event in events:
            if isinstance(event, list) and len(event) == 3:
                estimates.append(event)  # handed over together, which is much faster
                continue
            self._receive(estimates)
            estimates = []
            self._apply_event(event)
        self._receive(estimates)

    def _receive(self, estimates: list[Event]) -> None:
        if estimates:
            self.robot.receive_all(np.array(estimates, np.uint32))

    def _apply_event(self, event: Event) -> None:
        """Let an event other than an estimate happen."""
        if isinstance(event, list):
            x_hat, alpha_bits = event
            last_broadcast = self._take_back_broadcast("falsified")
            false_broadcast = replace(last_broadcast, x_hat=x_hat, alpha_bits=alpha_bits, is_false=True)
            self.broadcasts.append(false_broadcast)
        elif event == RESTART:
            self.robot.restart()
        elif event == SILENT:
            self._take_back_broadcast(SILENT)
        elif event == SETTLE:
            self.robot.settle()
        elif self.robot.observe(Action(event).observation):
            estimate = self.robot.next_estimate()
            alpha_bits = alpha_word_to_bits(estimate.alpha)
            self.broadcasts.append(
                Broadcast(self.robot.ticks, estimate.transfer_id, estimate.x_hat, alpha_bits)
            )

    def _take_back_broadcast(self, description: str) -> Broadcast:
        """Remove and return the last broadcast. Raises ValueError, with the description, if there is none."""
        if not self.broadcasts:
            raise ValueError(f"robot {self.robot.id} has a broadcast {description} before it made one")
        return self.broadcasts.pop()


@dataclass
class ReplayVerdict:
    """Result of a comparison.

    Attributes:
        reproduced: Broadcasts of the log that the robots made again, bit for bit.
        falsified: Those that went out with the values that a fault gave them.
        foreign: Frames under a robot's id that it did not send.
        not_logged: Broadcasts that the log lacks.
        beyond: Estimates after the last event, if the events were cut off.
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


def verify(log: Iterable[can.Message], events: EventsReader) -> ReplayVerdict:
    """Run every robot of ``events`` again, and compare its broadcasts with those of ``log``.

    Stops at the first difference. Time O(events + frames), memory O(broadcasts). Raises UsageError if the log
    or the events cannot be read, or the events contradict each other.
    """
    robots = _start_robots(events)
    foreign_frames = Counter(
        entry.text for entry in _apply_entries(events, robots) if isinstance(entry, InjectedFrame)
    )
    comparison = _Comparison(robots, foreign_frames, events)
    for number, frame in enumerate(log, start=1):
        comparison.compare_frame(number, frame)
        if comparison.verdict.difference is not None:
            return comparison.verdict
    comparison.verdict.not_logged += sum(len(robot.broadcasts) for robot in robots.values())
    return comparison.verdict


def rerun(events: EventsReader) -> Iterator[tuple[int, Robot]]:
    """Run every robot again, and yield its id and its state each time that it settles.

    Robots settle in the order of the file. O(1) an event. Raises UsageError as ``verify``.
    """
    robots = _start_robots(events)
    for entry in _apply_entries(events, robots):
        if isinstance(entry, RobotEvents) and entry.events and entry.events[-1] == SETTLE:
            repeated_robot = robots[entry.robot_id]
            repeated_robot.broadcasts.clear()  # nothing compares them here
            yield entry.robot_id, repeated_robot.robot.robot


def _start_robots(events: EventsReader) -> dict[int, RepeatedRobot]:
    """Start all robots of a header; returns them by id."""
    return {record.id: RepeatedRobot(record) for record in events.header.robots}


def _apply_entries(
    events: EventsReader, robots: dict[int, RepeatedRobot]
) -> Iterator[RobotEvents | InjectedFrame]:
    """Yield the entries of a file of events, each after its robot has lived through it."""
    for entry in events.entries():
        if isinstance(entry, RobotEvents):
            try:
                robots[entry.robot_id].apply_events(entry.events)
            except ValueError as error:
                raise events.error(str(error)) from error
        yield entry


class _Comparison:
    """Comparison of a log with the broadcasts of robots that have run again.

    Attributes:
        verdict: The result so far.
    """

    def __init__(
        self, robots: dict[int, RepeatedRobot], foreign_frames: Counter[str], events: EventsReader
    ) -> None:
        """Compare with ``robots``, which have run; ``foreign_frames`` counts frames that none of them
        sent."""
        self.verdict = ReplayVerdict()
        self._robots = robots
        self._foreign_frames = foreign_frames
        self._frame_format = events.header.frames
        self._is_part = events.is_part

    def compare_frame(self, number: int, frame: can.Message) -> None:
        """Compare a frame of the log, by its number from 1, and count it, or set the difference."""
        estimate = decode_estimate(frame, self._frame_format)
        if not isinstance(estimate, Estimate) or estimate.sender not in self._robots:
            self.verdict.other += 1
            return
        broadcasts = self._robots[estimate.sender].broadcasts
        index = _index_of_broadcast(estimate, broadcasts)
        alpha_bits, frame_text = alpha_float32_bits(frame), format_frame(frame)
        is_reproduced = (
            index is not None
            and broadcasts[index].x_hat == estimate.x_hat
            and broadcasts[index].alpha_bits == alpha_bits
        )
        # A frame that foreign nodes sent, too, is the robot's only if it is next: a later match is chance.
        is_next = is_reproduced and index == 0
        if self._foreign_frames[frame_text] and not is_next:
            self._foreign_frames[frame_text] -= 1
            self.verdict.foreign += 1
        elif is_reproduced and index is not None:
            self._count_reproduced(broadcasts, index)
        elif self._is_part and not broadcasts:
            self.verdict.beyond += 1
        else:
            expectation = "makes no more broadcasts"
            if broadcasts:
                expected = broadcasts[index or 0]
                expected_values = _format_values(expected.x_hat, expected.alpha_bits, expected.transfer_id)
                expectation = f"in tick {expected.tick} it makes {expected_values}"
            values = _format_values(estimate.x_hat, alpha_bits, estimate.transfer_id)
            self.verdict.difference = (
                f"frame {number} at {frame.timestamp:.6f} s: robot {estimate.sender} broadcast "
                f"{values}, but {expectation}"
            )

    def _count_reproduced(self, broadcasts: deque[Broadcast], index: int) -> None:
        """Count and remove the broadcast at ``index``, and those before it, which the log lacks."""
        for _ in range(index):
            broadcasts.popleft()
        self.verdict.not_logged += index
        if broadcasts.popleft().is_false:
            self.verdict.falsified += 1
        else:
            self.verdict.reproduced += 1


def _index_of_broadcast(estimate: Estimate, broadcasts: deque[Broadcast]) -> int | None:
    """Return the index of the next broadcast with the estimate's transfer_id; 0 in a log without gaps.

    None if there is none among the next 32, after which the transfer_ids repeat.
    """
    for index in range(min(len(broadcasts), TRANSFER_IDS)):
        if broadcasts[index].transfer_id == estimate.transfer_id:
            return index
    return None


def _format_values(x_hat: int, alpha_bits: int, transfer_id: int) -> str:
    return (
        f"x_hat {x_hat:#08x} ({x_hat / 2**23:.7f}), "
        f"alpha {alpha_bits:#010x} ({float32_value(alpha_bits):.7g}), "
        f"transfer_id {transfer_id}"
    )
