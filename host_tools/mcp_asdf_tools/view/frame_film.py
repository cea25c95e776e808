"""Films of logs without events, such as those of real robots: what their frames say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.recording.frame_logs import LogSummary, read_log
from mcp_asdf_tools.view.film import History, RunDescription
from mcp_asdf_tools.view.films import STATES_PER_SECOND, steps_between_states
from mcp_asdf_tools.view.heard_robots import LatestRobotValues

_LONGEST_LOG = 366 * 24 * 3600.0
"""Seconds; a longer one mixes clocks. Ticks of a film have 32 bits."""


@dataclass(frozen=True)
class FrameLogHistory:
    """A film of a log's frames.

    Attributes:
        film: The film, which has ended. It has no floor and no links, as no frame shows them.
        has_telemetry: Whether a robot sends telemetry: x and b_hat are in no other frame.
        summary: What was met in the log.
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
    """Return the film of what the robots of a log say, as ``BusRecorder`` shows a bus that is live.

    It reads the log twice, first for its robots and its length. The true ``fill_ratio`` and
    ``true_accuracy`` are drawn if they are known. Raises UsageError if the log cannot be read, has no values
    of a robot, or its times cannot be those of one run.
    """
    heard_robots = LatestRobotValues(frame_format, true_accuracy)
    start, end = math.inf, -math.inf
    for frame in read_log(log, channel):
        heard_robots.receive(frame, frame.timestamp)
        start, end = min(start, frame.timestamp), max(end, frame.timestamp)
    robots, seconds = heard_robots.ids, end - start
    if not robots:
        raise UsageError(
            f"{log} has no estimate and no telemetry of a robot, so there is nothing to see; is --subject "
            "right?"
        )
    if not 0 < seconds < _LONGEST_LOG:
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
    heard_robots = LatestRobotValues(frame_format, true_accuracy)
    summary = LogSummary()
    next_tick, now = 0, 0.0

    def add_states_before(time: float) -> None:
        nonlocal next_tick
        while next_tick / STATES_PER_SECOND < time:
            history.add(heard_robots.state(next_tick, next_tick / STATES_PER_SECOND, robots, no_links))
            next_tick += ticks_between_states

    for frame in read_log(log, channel, summary):
        now = max(now, frame.timestamp - start)  # of two buses, frames may be out of order
        add_states_before(now)
        heard_robots.receive(frame, now)
    add_states_before(last_tick / STATES_PER_SECOND)
    history.add(heard_robots.state(next_tick, now, robots, no_links))
    history.report = heard_robots.roster.report(now)
    history.has_ended = True
    return FrameLogHistory(history, heard_robots.has_telemetry, summary)
