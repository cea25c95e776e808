"""Histories of logs without events, such as those of real robots, from their frames alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log
from mcp_asdf_tools.view.bus_recorder import STATES_PER_SECOND
from mcp_asdf_tools.view.history import History, RunDescription, steps_between_states
from mcp_asdf_tools.view.robot_values import LatestRobotValues

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


def read_frame_history(
    log: Path,
    frame_format: FrameFormat,
    channel: str | None = None,
    fill_ratio: float | None = None,
    true_accuracy: float | None = None,
) -> FrameLogHistory:
    """Return the history that the frames of ``log`` show, as ``BusRecorder`` records that of a live bus.

    Only frames of ``channel`` count; None takes those of all. ``fill_ratio`` and ``true_accuracy``, which no
    frame shows, are for the page; None if unknown. The log is read twice. Raises UsageError if it cannot be
    read, has no values of a robot, or if its times span nothing or more than a year.
    """
    # The first reading finds the robots and the length, on which the spacing of the states depends.
    robot_values = LatestRobotValues(frame_format, true_accuracy)
    start, end = math.inf, -math.inf
    for frame in read_log(log, channel):
        robot_values.receive(frame, frame.timestamp)
        start, end = min(start, frame.timestamp), max(end, frame.timestamp)
    robots = robot_values.ids
    seconds = end - start
    if not robots:
        raise UsageError(
            f"{log} has no estimate and no telemetry of a robot, so there is nothing to see; is --subject "
            "right?"
        )
    if not 0 < seconds < _MAX_LOG_SECONDS:
        raise UsageError(
            f"the times of the frames in {log} span {seconds:g} s, so they cannot be shown; record them with "
            "absolute times of one clock: candump -L, or candump -t a"
        )

    history = History(
        RunDescription(log.name, robots, fill_ratio=fill_ratio, steps_per_second=STATES_PER_SECOND)
    )
    last_tick = int(seconds * STATES_PER_SECOND) + 1
    ticks_between_states = steps_between_states(last_tick, len(robots))
    no_links = np.zeros((len(robots), len(robots)), np.bool_)
    robot_values = LatestRobotValues(frame_format, true_accuracy)
    summary = LogSummary()
    next_tick, now = 0, 0.0

    def add_states_before(time: float) -> None:
        """Add the states that are due before ``time``, in seconds from the start of the log."""
        nonlocal next_tick
        while next_tick / STATES_PER_SECOND < time:
            seconds_at_tick = next_tick / STATES_PER_SECOND
            history.add(robot_values.state(next_tick, seconds_at_tick, robots, no_links))
            next_tick += ticks_between_states

    for frame in read_log(log, channel, summary):
        # Frames of two buses may be out of order, but the time of a history must not go back.
        now = max(now, frame.timestamp - start)
        add_states_before(now)
        robot_values.receive(frame, now)
    add_states_before(last_tick / STATES_PER_SECOND)
    history.add(robot_values.state(next_tick, now, robots, no_links))
    history.report = robot_values.roster.report(now)
    history.has_ended = True
    return FrameLogHistory(history, robot_values.has_telemetry, summary)
