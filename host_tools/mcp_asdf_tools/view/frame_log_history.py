"""Histories of logs without events, such as those of real robots, from their frames alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import can

from mcp_asdf_tools.bus.frames import FrameFormat, decode_frame
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log
from mcp_asdf_tools.view.bus_recorder import STATES_PER_SECOND
from mcp_asdf_tools.view.history import History, RunDescription, State, steps_between_states
from mcp_asdf_tools.view.roster import Roster

_MAX_LOG_SECONDS = 366 * 24 * 3600.0
"""Longest time that a log may span. A longer one mixes clocks, and its ticks may not fit in 32 bits."""


@dataclass(frozen=True)
class FrameLogHistory:
    """The history that the frames of a log show, and what a user should know about the log.

    Attributes:
        history: The history, which has ended. It has no floor and no links, as no frame shows them.
        has_telemetry: Whether a robot sent telemetry; without it x and b_hat are unknown.
        summary: The log's channels, and how many of its lines were skipped.
    """

    history: History
    has_telemetry: bool
    summary: LogSummary


@dataclass(frozen=True)
class _LogExtent:
    """What has to be known of a log before its history can be made.

    Attributes:
        robot_ids: Ids of the robots that sent values, in the order in which they began.
        start_time: Time of the earliest frame, in seconds of the log's clock.
        seconds: Seconds from the earliest frame to the latest.
    """

    robot_ids: list[int]
    start_time: float
    seconds: float


def read_frame_history(
    log: Path,
    frame_format: FrameFormat,
    channel: str | None = None,
    fill_ratio: float | None = None,
    true_accuracy: float | None = None,
) -> FrameLogHistory:
    """Return the history that the frames of ``log`` show: the robots' values, ten times a second at most.

    Only frames of ``channel`` count; None takes all channels. ``fill_ratio`` and ``true_accuracy``, which no
    frame shows, are for the page; None if unknown. The log is read twice. Raises UsageError if it cannot be
    read, has no values of a robot, or if its times span nothing or more than a year.
    """
    extent = _measure_log(log, frame_format, channel)
    history = History(
        RunDescription(log.name, extent.robot_ids, fill_ratio=fill_ratio, steps_per_second=STATES_PER_SECOND)
    )
    roster = Roster(true_accuracy)
    summary = LogSummary()
    timed_frames = _time_frames(read_log(log, channel, summary), extent.start_time)
    for state in _make_states(timed_frames, roster, frame_format, extent):
        history.add(state)
    history.report = roster.report(extent.seconds)
    history.has_ended = True
    return FrameLogHistory(history, roster.has_telemetry, summary)


def _measure_log(log: Path, frame_format: FrameFormat, channel: str | None) -> _LogExtent:
    """Read a log for its robots and its length, on which the spacing of the states depends.

    Raises UsageError if it cannot be read, has no values of a robot, or if its times span nothing or more
    than a year.
    """
    roster = Roster()
    start_time = math.inf
    end_time = -math.inf
    for frame in read_log(log, channel):
        roster.receive(frame, decode_frame(frame, frame_format), frame.timestamp)
        start_time = min(start_time, frame.timestamp)
        end_time = max(end_time, frame.timestamp)
    seconds = end_time - start_time
    if not roster.ids_with_values:
        raise UsageError(
            f"{log} has no estimate and no telemetry of a robot, so there is nothing to see; is --subject "
            "right?"
        )
    if not 0 < seconds < _MAX_LOG_SECONDS:
        raise UsageError(
            f"the times of the frames in {log} span {seconds:g} s, so they cannot be shown; record them with "
            "absolute times of one clock: candump -L, or candump -t a"
        )
    return _LogExtent(roster.ids_with_values, start_time, seconds)


def _make_states(
    timed_frames: Iterable[tuple[float, can.Message]],
    roster: Roster,
    frame_format: FrameFormat,
    extent: _LogExtent,
) -> Iterator[State]:
    """Let ``roster`` receive all frames of a log, and yield states with what was sent up to each.

    States are evenly spaced, at most STATES_PER_SECOND a second, from the first frame on. The last one comes
    after the last frame, and shows the log's end.
    """
    last_tick = int(extent.seconds * STATES_PER_SECOND) + 1  # the first one after the last frame
    spacing = steps_between_states(last_tick, len(extent.robot_ids))
    next_tick = 0
    for seconds, frame in timed_frames:
        # The states at all ticks before this frame
        while next_tick / STATES_PER_SECOND < seconds:
            yield roster.make_state(next_tick, next_tick / STATES_PER_SECOND, extent.robot_ids)
            next_tick += spacing
        roster.receive(frame, decode_frame(frame, frame_format), seconds)
    # The remaining ticks have the state at the log's end. The last state is at ``last_tick`` or, if that is
    # between two states, at the next.
    for tick_after_frames in range(next_tick, last_tick + spacing, spacing):
        yield roster.make_state(tick_after_frames, extent.seconds, extent.robot_ids)


def _time_frames(frames: Iterable[can.Message], start_time: float) -> Iterator[tuple[float, can.Message]]:
    """Yield for each frame the seconds since ``start_time``, which never decrease, and the frame.

    Frames of two buses may be out of order in a log, but the time of a history must not go back: such a frame
    gets the seconds of the frame before.
    """
    seconds = 0.0
    for frame in frames:
        seconds = max(seconds, frame.timestamp - start_time)
        yield seconds, frame
