"""Replay of a log: its robots run again on their events, and their broadcasts are compared with the log.

The same firmware makes the same broadcasts of the same events, bit for bit. So a difference shows that the
log, the events or the firmware have changed.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import can
import numpy as np

from mcp_asdf.robot import Observation, Robot
from mcp_asdf_tools.bus.alpha_words import float32_bits_from_alpha_word, float32_value
from mcp_asdf_tools.bus.frame_layout import Q23_ONE, TRANSFER_ID_MODULUS, Action
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, alpha_float32_bits, decode_estimate, format_frame
from mcp_asdf_tools.recording.events import (
    RESTART,
    SETTLE,
    SILENT,
    Event,
    EventsReader,
    InjectedFrame,
    RobotEvents,
    is_received_estimate,
)
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.robots.robot_setup import RobotSetup


@dataclass(frozen=True)
class Broadcast:
    """A broadcast that a robot makes again, with the values that its frame had on the bus.

    Attributes:
        tick: Number of the robot's tick, from 1 at its start.
        transfer_id: Number of the broadcast since the robot's start, modulo 32.
        x_hat: Local estimate of the fill ratio in units of 2**-23.
        alpha_bits: Confidence in x_hat, as the 32 bits of an IEEE number.
        is_false: Whether a fault had replaced the firmware's values by these.
    """

    tick: int
    transfer_id: int
    x_hat: int
    alpha_bits: int
    is_false: bool = False

    def has_values(self, x_hat: int, alpha_bits: int) -> bool:
        """Return whether the broadcast has exactly these values, which have the units of its attributes."""
        return self.x_hat == x_hat and self.alpha_bits == alpha_bits


class RepeatedRobot(BusRobot):
    """A robot that repeats its recorded run.

    Attributes:
        broadcasts: Its broadcasts that have not been found in the log yet, in order.
    """

    def __init__(self, setup: RobotSetup) -> None:
        """Start the robot in its recorded initial state."""
        super().__init__(setup, FrameFormat())
        self.broadcasts: deque[Broadcast] = deque()

    def apply_events(self, events: Iterable[Event]) -> None:
        """Repeat events in their order, and append to ``broadcasts`` those that follow from them. O(events).

        Raises ValueError for an event that cannot follow the one before it.
        """
        estimates: list[Event] = []
        for event in events:
            # Estimates that were received one after the other are passed on together, which is much faster.
            if is_received_estimate(event):
                estimates.append(event)
                continue
            self._receive_events(estimates)
            estimates = []
            self._apply_event(event)
        self._receive_events(estimates)

    def _receive_events(self, estimates: list[Event]) -> None:
        """Pass received estimates to the robot, each a list of sender, x_hat and alpha."""
        if estimates:
            self.receive_all(np.array(estimates, np.uint32))

    def _apply_event(self, event: Event) -> None:
        """Repeat an event that is not an estimate. Raises ValueError if it needs a broadcast before it."""
        if isinstance(event, list):  # a fault put these values into the robot's last broadcast
            x_hat, alpha_bits = event
            broadcast = self._remove_last_broadcast("falsified")
            self.broadcasts.append(replace(broadcast, x_hat=x_hat, alpha_bits=alpha_bits, is_false=True))
        elif event == SILENT:  # a fault kept the robot's last broadcast from the bus
            self._remove_last_broadcast(SILENT)
        elif event == RESTART:
            self.restart()
        elif event == SETTLE:
            self.settle()
        else:  # one of the actions with which a tick begins
            self._observe_and_broadcast(Action(event).observation)

    def _observe_and_broadcast(self, observation: Observation | None) -> None:
        """Begin a tick with an observation, or with none.

        If the robot broadcasts in this tick, its broadcast is appended to ``broadcasts``.
        """
        makes_broadcast = self.observe(observation)
        if makes_broadcast:
            estimate = self.next_estimate()
            self.broadcasts.append(
                Broadcast(
                    tick=self.ticks,
                    transfer_id=estimate.transfer_id,
                    x_hat=estimate.x_hat,
                    alpha_bits=float32_bits_from_alpha_word(estimate.alpha),
                )
            )

    def _remove_last_broadcast(self, description: str) -> Broadcast:
        """Remove and return the last broadcast.

        Raises ValueError if there is none. Its message says by ``description``, a word such as "silent", what
        happened to the broadcast in the recorded run.
        """
        if not self.broadcasts:
            raise ValueError(f"robot {self.id} has a broadcast {description} before it made one")
        return self.broadcasts.pop()


@dataclass
class ReplayVerdict:
    """Result of the comparison of a log with the broadcasts that its robots make again.

    Attributes:
        reproduced: Number of broadcasts in the log that the robots made again, bit for bit.
        falsified: Number of those that a fault had given other values, which the log has, too.
        foreign: Number of frames under a robot's id that the robot did not send.
        not_logged: Number of broadcasts that the log lacks.
        beyond: Number of broadcasts in the log after the last event, if the events were cut off.
        other: Number of frames that are no estimate of a recorded robot.
        difference: Sentence on the first broadcast that is not reproduced; None if all are.
    """

    reproduced: int = 0
    falsified: int = 0
    foreign: int = 0
    not_logged: int = 0
    beyond: int = 0
    other: int = 0
    difference: str | None = None


def verify(log: Iterable[can.Message], events: EventsReader) -> ReplayVerdict:
    """Run every robot of a file of events again, and compare its broadcasts with the frames of a log.

    Stops at the first difference. Takes O(events + frames) time and O(broadcasts) memory. Raises UsageError
    if the log or the events cannot be read, or if the events contradict each other.
    """
    robots = _start_robots(events)
    foreign_frames: Counter[str] = Counter()
    for entry in _apply_entries(events, robots):  # which lets the robots run
        if isinstance(entry, InjectedFrame):
            foreign_frames[entry.text] += 1
    comparison = _Comparison(robots, foreign_frames, events)
    for frame_number, frame in enumerate(log, start=1):
        comparison.compare_frame(frame_number, frame)
        if comparison.verdict.difference is not None:
            return comparison.verdict
    # The broadcasts that the robots still have were in no frame of the log.
    comparison.verdict.not_logged += sum(len(robot.broadcasts) for robot in robots.values())
    return comparison.verdict


def rerun(events: EventsReader) -> Iterator[tuple[int, Robot]]:
    """Run every robot again, and yield a robot's id and the robot each time that it has ended a tick.

    It is the same object each time, in its present state. The order of robots and ticks is that of the file.
    O(1) per event. Raises UsageError if the events cannot be read or contradict each other.
    """
    robots = _start_robots(events)
    for entry in _apply_entries(events, robots):
        if isinstance(entry, InjectedFrame):
            continue
        # SETTLE is the last event of each tick.
        has_ended_tick = len(entry.events) > 0 and entry.events[-1] == SETTLE
        if has_ended_tick:
            repeated_robot = robots[entry.robot_id]
            # Nothing compares the broadcasts here, so they must not fill the memory.
            repeated_robot.broadcasts.clear()
            yield entry.robot_id, repeated_robot.robot


def _start_robots(events: EventsReader) -> dict[int, RepeatedRobot]:
    """Return a robot in its initial state for each one in the header of the events, by id."""
    return {setup.id: RepeatedRobot(setup) for setup in events.header.robots}


def _apply_entries(
    events: EventsReader, robots: dict[int, RepeatedRobot]
) -> Iterator[RobotEvents | InjectedFrame]:
    """Yield the entries of a file of events; a robot repeats its events before their entry is yielded.

    Raises UsageError, which names the line, if a line is malformed or has an event that cannot follow the one
    before it.
    """
    for entry in events.entries():
        if isinstance(entry, RobotEvents):
            try:
                robots[entry.robot_id].apply_events(entry.events)
            except ValueError as error:
                raise events.error_in_line(str(error)) from error
        yield entry


class _Comparison:
    """Comparison of the frames of a log with the broadcasts of robots that have run again.

    Attributes:
        verdict: The result so far.
    """

    def __init__(
        self, robots: dict[int, RepeatedRobot], foreign_frames: Counter[str], events: EventsReader
    ) -> None:
        """Prepare to compare.

        Args:
            robots: The robots, which have repeated all events.
            foreign_frames: How often a fault has sent each frame, as candump writes it. Those that are found
                in the log are removed.
            events: The events, for the format of estimates and whether the run was cut off.
        """
        self.verdict = ReplayVerdict()
        self._robots = robots
        self._foreign_frames = foreign_frames
        self._frame_format = events.header.frames
        self._are_events_cut_off = events.is_part

    def compare_frame(self, frame_number: int, frame: can.Message) -> None:
        """Compare the next frame of the log with the broadcasts that its sender is still to make.

        The verdict counts the frame as one of these:
            other: It is no estimate, or not of a recorded robot.
            foreign: A fault has sent it, not the robot.
            reproduced or falsified: It equals a broadcast of the robot. This is removed, and so are those
                before it, which count as not logged.
            beyond: The robot makes no more broadcasts, as its events were cut off.

        Any other frame sets the verdict's difference, whose text names ``frame_number``, from 1.
        """
        estimate = decode_estimate(frame, self._frame_format)
        if not isinstance(estimate, Estimate) or estimate.sender not in self._robots:
            self.verdict.other += 1
            return
        broadcasts = self._robots[estimate.sender].broadcasts
        index = _index_of_equal_broadcast(frame, estimate, broadcasts)
        # A fault may have sent the same frame as a robot. Then the frame is the robot's if the broadcast is
        # the robot's next one: one that comes later is equal by chance.
        is_next_broadcast = index == 0
        if not is_next_broadcast and self._remove_foreign_frame(frame):
            self.verdict.foreign += 1
        elif index is not None:
            self._count_reproduced(broadcasts, index)
        elif self._are_events_cut_off and not broadcasts:
            self.verdict.beyond += 1
        else:
            expected = _broadcast_in_place_of(estimate, broadcasts)
            self.verdict.difference = _describe_difference(frame_number, frame, estimate, expected)

    def _remove_foreign_frame(self, frame: can.Message) -> bool:
        """Remove a frame from those that a fault has sent; return whether there was one like it."""
        frame_text = format_frame(frame)
        if self._foreign_frames[frame_text] == 0:
            return False
        self._foreign_frames[frame_text] -= 1
        return True

    def _count_reproduced(self, broadcasts: deque[Broadcast], index: int) -> None:
        """Remove and count the broadcast at ``index``, and those before it, which count as not logged.

        The broadcast itself counts as falsified if a fault had changed its values, else as reproduced.
        """
        for _ in range(index):
            broadcasts.popleft()
        self.verdict.not_logged += index
        if broadcasts.popleft().is_false:
            self.verdict.falsified += 1
        else:
            self.verdict.reproduced += 1


def _describe_difference(
    frame_number: int, frame: can.Message, estimate: Estimate, expected: Broadcast | None
) -> str:
    """Return a sentence with the values of a frame and those that should be in its place.

    Args:
        frame_number: Number of the frame in the log, from 1.
        frame: The frame.
        estimate: The decoded frame.
        expected: The broadcast that the robot makes instead; None if it makes no more.
    """
    values = _format_values(estimate.x_hat, alpha_float32_bits(frame), estimate.transfer_id)
    expectation = "makes no more broadcasts"
    if expected is not None:
        expected_values = _format_values(expected.x_hat, expected.alpha_bits, expected.transfer_id)
        expectation = f"in tick {expected.tick} it makes {expected_values}"
    return (
        f"frame {frame_number} at {frame.timestamp:.6f} s: robot {estimate.sender} broadcast "
        f"{values}, but {expectation}"
    )


def _index_of_equal_broadcast(
    frame: can.Message, estimate: Estimate, broadcasts: deque[Broadcast]
) -> int | None:
    """Return the index of the broadcast that has the transfer_id and the values of a frame.

    ``estimate`` is the decoded frame. Returns None if there is no such broadcast.
    """
    index = _index_of_broadcast(estimate.transfer_id, broadcasts)
    if index is None:
        return None
    is_equal = broadcasts[index].has_values(estimate.x_hat, alpha_float32_bits(frame))
    return index if is_equal else None


def _broadcast_in_place_of(estimate: Estimate, broadcasts: deque[Broadcast]) -> Broadcast | None:
    """Return the broadcast that should be in the log in place of ``estimate``; None if there are no more.

    That is the one with its transfer_id or, if there is none, the robot's next one.
    """
    if not broadcasts:
        return None
    index = _index_of_broadcast(estimate.transfer_id, broadcasts)
    return broadcasts[0 if index is None else index]


def _index_of_broadcast(transfer_id: int, broadcasts: deque[Broadcast]) -> int | None:
    """Return the index of the next broadcast with a transfer_id; it is 0 as long as the log has no gaps.

    Returns None if none of the next 32 broadcasts has it. More are not searched, as transfer_ids, which count
    broadcasts modulo 32, repeat then.
    """
    for index in range(min(len(broadcasts), TRANSFER_ID_MODULUS)):
        if broadcasts[index].transfer_id == transfer_id:
            return index
    return None


def _format_values(x_hat: int, alpha_bits: int, transfer_id: int) -> str:
    """Return a text such as ``x_hat 0x400000 (0.5000000), alpha 0x41000000 (8), transfer_id 3``.

    ``x_hat`` is in units of 2**-23, ``alpha_bits`` has the 32 bits of an IEEE number. Both appear as
    hexadecimal integers and, in parentheses, as the numbers that they stand for.
    """
    return (
        f"x_hat {x_hat:#08x} ({x_hat / Q23_ONE:.7f}), "
        f"alpha {alpha_bits:#010x} ({float32_value(alpha_bits):.7g}), "
        f"transfer_id {transfer_id}"
    )
