"""Histories from frames alone: of robots on a bus as they send, and of logs without events.

Neither shows positions or which robot receives from which, so the histories have none of these.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np

from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, Telemetry, decode_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log
from mcp_asdf_tools.view.history import NO_LINKS, History, RunDescription, State
from mcp_asdf_tools.view.roster import Roster

STATES_PER_SECOND = 10
"""States that a history has for each second, at most; they are its ticks."""
SECONDS_BETWEEN_REPORTS = 0.5
"""Seconds from one report on the robots of a bus to the next."""
_MAX_LOG_SECONDS = 366 * 24 * 3600.0
"""Longest time that a log may span. A longer one mixes clocks, and its ticks may not fit in 32 bits."""


@dataclass(frozen=True)
class KnownTruth:
    """Facts of a run that no frame shows. The page draws those that are known; the others are None.

    Attributes:
        fill_ratio: Share of black tiles of the floor, f.
        true_accuracy: Share of right readings of every sensor, b.
    """

    fill_ratio: float | None = None
    true_accuracy: float | None = None


class FrameRecorder:
    """Records a history from frames, each of which comes with its time in seconds since the start.

    Attributes:
        history: What was recorded so far; robots are in the order of their first estimate or telemetry.
        roster: What an observer knows of all nodes, also of those that sent neither.
    """

    def __init__(self, title: str, frame_format: FrameFormat, truth: KnownTruth) -> None:
        """Prepare to record the estimates of ``frame_format``, heartbeats and telemetry."""
        self.history = History(
            RunDescription(title, robots=[], fill_ratio=truth.fill_ratio, steps_per_second=STATES_PER_SECOND)
        )
        self.roster = Roster()
        self._frame_format = frame_format
        self._true_accuracy = math.nan if truth.true_accuracy is None else truth.true_accuracy
        self._next_tick = 0

    def receive(self, frame: can.Message, now: float) -> None:
        """Add the states of the time before ``now``, and then take a frame of any node that came at ``now``.

        A robot is added to the history when its first values come, in O(states).
        """
        self.add_states(now)
        content = decode_frame(frame, self._frame_format)
        self.roster.receive(frame, content, now)
        known_ids = self.history.description.robots
        if isinstance(content, Estimate | Telemetry) and content.sender not in known_ids:
            self.history.add_robot(content.sender)

    def add_states(self, now: float) -> None:
        """Add the states of all ticks before ``now`` that the history keeps and that are missing."""
        if not self.history.description.robots:  # nothing is kept, however long that is
            self._next_tick = int(now * STATES_PER_SECOND)
        while self._next_tick / STATES_PER_SECOND < now:
            # This also moves the next tick on.
            self._add_next_state(self._next_tick / STATES_PER_SECOND)

    def finish(self, now: float) -> None:
        """End the history at the time of the last frame: add a state with its values, and a report."""
        self._add_next_state(now)
        self.history.report = self.roster.report(now)
        self.history.has_ended = True

    def _add_next_state(self, now: float) -> None:
        """Add a state with the values at ``now``, if there are robots, and move the next tick on."""
        if self.history.description.robots:
            self.history.add(self._make_state(now))
        # The history keeps the multiples of its spacing, which grows with the number of states. So the next
        # tick is the first multiple above the present one.
        spacing = self.history.ticks_between_states
        multiples_passed = self._next_tick // spacing
        self._next_tick = (multiples_passed + 1) * spacing

    def _make_state(self, now: float) -> State:
        """Return the state of the next tick, with the robots' values at ``now``.

        It has neither links nor positions, as no frame shows them.
        """
        values_by_robot = []
        for robot_id in self.history.description.robots:
            x, x_hat, b_hat = self.roster.robots[robot_id].values(now)
            values_by_robot.append([x, x_hat, b_hat, self._true_accuracy])
        # A state has a row for each of the four quantities, and a column for each robot.
        return State(self._next_tick, np.transpose(values_by_robot), NO_LINKS, positions=None)


def record_bus(bus: can.BusABC, recorder: FrameRecorder, should_stop: Callable[[], bool]) -> None:
    """Record the frames of a bus until ``should_stop``, which is asked after each and ten times a second.

    Twice a second the history gets a new report. Raises can.CanError if the bus fails.
    """
    start_time = time.monotonic()
    next_report_time = 0.0
    while not should_stop():
        frame = bus.recv(timeout=1 / STATES_PER_SECOND)
        now = time.monotonic() - start_time
        if frame is None:
            recorder.add_states(now)
        else:
            recorder.receive(frame, now)
        if now >= next_report_time:
            recorder.history.report = recorder.roster.report(now)
            next_report_time = now + SECONDS_BETWEEN_REPORTS


def read_frame_log(
    log: Path,
    frame_format: FrameFormat,
    truth: KnownTruth,
    summary: LogSummary,
    channel: str | None = None,
) -> FrameRecorder:
    """Record the frames of a log, and return the recorder, whose history has ended.

    Only frames of ``channel`` count; None takes all channels. ``summary`` gets the log's channels and how
    many of its lines were skipped. Raises UsageError if it cannot be read, has no values of a robot, or if
    its times span nothing or more than a year.
    """
    recorder = FrameRecorder(log.name, frame_format, truth)
    end_time = 0.0
    for frame, now in _read_timed_frames(log, channel, summary):
        recorder.receive(frame, now)
        end_time = now
    if not recorder.history.description.robots:
        raise UsageError(
            f"{log} has no estimate and no telemetry of a robot, so there is nothing to see; is --subject "
            "right?"
        )
    if end_time == 0:
        raise _span_error(log, end_time)
    recorder.finish(end_time)
    return recorder


def _read_timed_frames(
    log: Path, channel: str | None, summary: LogSummary
) -> Iterator[tuple[can.Message, float]]:
    """Yield the frames of a log together with their times.

    A time is in seconds since the first frame, and never less than the time before it. Raises UsageError if
    the log cannot be read, or if its times span more than a year.
    """
    first_time: float | None = None
    now = 0.0
    for frame in read_log(log, channel, summary):
        if first_time is None:
            first_time = frame.timestamp
        # Frames of two buses may be out of order in a log, but the time of a history must not go back.
        now = max(now, frame.timestamp - first_time)
        if now >= _MAX_LOG_SECONDS:
            raise _span_error(log, now)
        yield frame, now


def _span_error(log: Path, seconds: float) -> UsageError:
    """Return the error for a log whose times span nothing or more than a year."""
    return UsageError(
        f"the times of the frames in {log} span {seconds:g} s, so they cannot be shown; record them with "
        "absolute times of one clock: candump -L, or candump -t a"
    )
