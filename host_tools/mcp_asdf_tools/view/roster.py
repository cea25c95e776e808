"""The nodes of a bus as an observer of its frames knows them: which there are, and what each has sent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from math import nan
from typing import Any

import can

from mcp_asdf_tools.bus.alpha_words import float32_bits_from_alpha_word, float32_value
from mcp_asdf_tools.bus.frame_layout import B_HAT_UNITS, Q23_ONE, TRANSFER_ID_MODULUS, Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameContent, Heartbeat, Telemetry, format_frame
from mcp_asdf_tools.robots.suspicion import AlphaWatch

SILENT_SECONDS = 3.0
"""Seconds without a frame after which a robot counts as silent: OpenCyphal's timeout of heartbeats."""
RATE_SECONDS = 5.0
"""Seconds over which the rate of a robot's estimates is taken."""
_MAX_REPORTED_FRAMES = 4000
"""Frames in a report: as many as a bus of 1 Mbit/s has in half a second."""


@dataclass
class RobotOnBus:
    """What one robot has sent; times are in seconds of the observer's clock.

    Attributes:
        first_frame_time: When its first frame was received.
        last_frame_time: When its latest frame was received.
        estimate_times: When its estimates of the last RATE_SECONDS were received; older ones may be among
            them until ``rate`` removes them.
        received_frames: Number of its frames that were received.
        lost_frames: Number of frames that gaps in its transfer ids (sequence numbers modulo 32) show to be
            missing.
        conflicts: Number of heartbeats that show that two nodes send with this id.
        alpha_jumps: Number of estimates whose confidence alpha jumped (see ``AlphaWatch``).
        heartbeat: Its latest heartbeat; None before the first.
        estimate: Its latest estimate; None before the first, also after a silence.
        telemetry: Its latest telemetry; None before the first, also after a silence.
    """

    first_frame_time: float
    last_frame_time: float
    estimate_times: deque[float] = field(default_factory=deque)
    received_frames: int = 0
    lost_frames: int = 0
    conflicts: int = 0
    alpha_jumps: int = 0
    heartbeat: Heartbeat | None = None
    estimate: Estimate | None = None
    telemetry: Telemetry | None = None
    _previous_heartbeat: Heartbeat | None = None
    _alpha_watch: AlphaWatch = field(default_factory=AlphaWatch)
    _last_transfer_ids: dict[type, int] = field(default_factory=dict)

    def receive(self, content: Estimate | Heartbeat | Telemetry, now: float) -> None:
        """Take the content of one of the robot's frames, which was received at ``now``. O(1).

        It becomes the latest of its kind. Lost frames before it, jumps of alpha and conflicts are counted.
        After a silence of SILENT_SECONDS, estimate, telemetry and transfer ids from before are forgotten, so
        that no frame counts as lost in the silence.
        """
        if self.is_silent(now):
            self._forget_values()
        self.last_frame_time = now
        self._count_frame(content)
        if isinstance(content, Estimate):
            self._receive_estimate(content, now)
        elif isinstance(content, Heartbeat):
            self._receive_heartbeat(content)
        else:
            self.telemetry = content

    def _forget_values(self) -> None:
        """Forget the latest estimate and telemetry, which are old, and all transfer ids."""
        self.estimate = None
        self.telemetry = None
        # In a long silence transfer ids may have wrapped around any number of times, so a gap between them
        # says nothing.
        self._last_transfer_ids.clear()

    def _receive_estimate(self, estimate: Estimate, now: float) -> None:
        """Keep an estimate and its time; count a jump if its alpha has jumped."""
        self.estimate = estimate
        self.estimate_times.append(now)
        if self._alpha_watch.is_jump(estimate.sender, estimate.alpha):
            self.alpha_jumps += 1

    def _receive_heartbeat(self, heartbeat: Heartbeat) -> None:
        """Keep a heartbeat and the one before it; count a conflict if it shows a second node with this id."""
        if self._shows_conflict(heartbeat):
            self.conflicts += 1
        self._previous_heartbeat = self.heartbeat
        self.heartbeat = heartbeat

    def _count_frame(self, content: Estimate | Heartbeat | Telemetry) -> None:
        """Count a received frame, and the lost frames between it and the one before of its kind.

        Each kind of frame has transfer ids of its own, modulo 32. A repeated id is no gap, since a frame may
        be received twice.
        """
        kind = type(content)
        last_id = self._last_transfer_ids.get(kind)
        self._last_transfer_ids[kind] = content.transfer_id
        self.received_frames += 1
        if last_id is not None and content.transfer_id != last_id:
            frames_since_last = (content.transfer_id - last_id) % TRANSFER_ID_MODULUS
            self.lost_frames += frames_since_last - 1  # one of them is this frame

    def _shows_conflict(self, heartbeat: Heartbeat) -> bool:
        """Return whether a new heartbeat shows that two nodes send with this id.

        It does if it equals the latest one, since a node sends each heartbeat once. It also does if it
        continues not the latest heartbeat but the one before: another node's heartbeat came between. A single
        node that restarts has smaller uptimes from then on, so it never continues a heartbeat from before the
        restart.
        """
        latest = self.heartbeat
        previous = self._previous_heartbeat
        if latest is None:
            return False
        equals_latest = heartbeat.uptime == latest.uptime and heartbeat.transfer_id == latest.transfer_id
        if equals_latest:
            return True
        if previous is None:
            return False
        # Another node, which has been up for a shorter time, may have sent the latest heartbeat.
        latest_is_of_other_node = latest.uptime < previous.uptime < heartbeat.uptime
        # A node sends a heartbeat each second, so its transfer id grows as its uptime does, modulo 32.
        seconds_passed = heartbeat.uptime - previous.uptime
        heartbeats_passed = heartbeat.transfer_id - previous.transfer_id
        continues_previous = (heartbeats_passed - seconds_passed) % TRANSFER_ID_MODULUS == 0
        return latest_is_of_other_node and continues_previous

    def is_silent(self, now: float) -> bool:
        """Return whether no frame was received in the last SILENT_SECONDS."""
        return now - self.last_frame_time >= SILENT_SECONDS

    def values(self, now: float) -> tuple[float, float, float]:
        """Return the latest x, x_hat and b_hat; unknown values and those of a silent robot are NaN."""
        x = x_hat = b_hat = nan
        if self.is_silent(now):
            return x, x_hat, b_hat
        if self.estimate is not None:
            x_hat = self.estimate.x_hat / Q23_ONE
        if self.telemetry is not None:
            x = self.telemetry.x / Q23_ONE
            b_hat = self.telemetry.b_hat / B_HAT_UNITS
        return x, x_hat, b_hat

    def rate(self, now: float) -> float:
        """Return the robot's estimates per second over the last RATE_SECONDS, or since its first frame.

        Older times are removed from ``estimate_times``.
        """
        start = now - RATE_SECONDS
        # Old times are removed each time somebody asks: so they neither pile up nor have to be counted.
        while self.estimate_times and self.estimate_times[0] <= start:
            self.estimate_times.popleft()
        observed_seconds = min(now - self.first_frame_time, RATE_SECONDS)
        # In the first second a few estimates would look like a high rate.
        return len(self.estimate_times) / max(observed_seconds, 1.0)


class Roster:
    """All robots of a bus, and the frames that passed since the last report.

    Attributes:
        robots: The robots by id, in the order of their first frames.
        has_telemetry: Whether a robot has sent telemetry: x and b_hat are in no other frame.
    """

    def __init__(self) -> None:
        """Create a roster without robots and frames."""
        self.robots: dict[int, RobotOnBus] = {}
        self.has_telemetry = False
        self._frame_lines: deque[tuple[float, int | None, str]] = deque(maxlen=_MAX_REPORTED_FRAMES)

    def receive(self, frame: can.Message, content: FrameContent, now: float) -> None:
        """Take a frame, its decoded ``content`` and the time in seconds at which it was received. O(1).

        The frame is listed in the next report, and counts for its sender, who is added to ``robots`` with its
        first frame. A rejected frame is listed, but counts for no robot.
        """
        line = format_content(frame, content)
        if isinstance(content, Rejection):
            self._frame_lines.append((round(now, 3), None, line))
            return
        sender = content.sender
        self._frame_lines.append((round(now, 3), sender, line))
        if sender not in self.robots:
            self.robots[sender] = RobotOnBus(first_frame_time=now, last_frame_time=now)
        self.robots[sender].receive(content, now)
        if isinstance(content, Telemetry):
            self.has_telemetry = True

    def report(self, now: float) -> dict[str, Any]:
        """Return what the page's table and list show, as plain values, and forget the frames that it lists.

        "robots" has a row for each robot, by rising id. "frames" has [seconds, sender, text] for each of the
        last 4000 frames since the report before; the sender of a rejected frame is None.
        """
        rows = [_report_row(robot_id, self.robots[robot_id], now) for robot_id in sorted(self.robots)]
        frames = [list(frame_line) for frame_line in self._frame_lines]
        self._frame_lines.clear()
        return {"robots": rows, "frames": frames}


def _report_row(robot_id: int, robot: RobotOnBus, now: float) -> dict[str, Any]:
    """Return a robot's row of a report as plain values.

    "seen" says how many seconds ago its last frame came, "rate" how many estimates come in a second, and
    "loss" which share of its frames was lost. "conflicts" and "jumps" count heartbeats of a second node with
    this id, and estimates whose confidence jumped. Health and mode are None before the first heartbeat; x,
    b_hat and updates before the first telemetry.
    """
    heartbeat, telemetry = robot.heartbeat, robot.telemetry
    # At least 1, since a robot is listed from its first frame on.
    sent_frames = robot.lost_frames + robot.received_frames
    return {
        "robot": robot_id,
        "silent": robot.is_silent(now),
        "seen": round(now - robot.last_frame_time, 1),
        "health": None if heartbeat is None else _format_name(heartbeat.health),
        "mode": None if heartbeat is None else _format_name(heartbeat.mode),
        "rate": round(robot.rate(now), 1),
        "loss": robot.lost_frames / sent_frames,
        "conflicts": robot.conflicts,
        "x": None if telemetry is None else telemetry.x / Q23_ONE,
        "b_hat": None if telemetry is None else telemetry.b_hat / B_HAT_UNITS,
        "updates": None if telemetry is None else telemetry.updates,
        "jumps": robot.alpha_jumps,
    }


def format_content(frame: can.Message, content: FrameContent) -> str:
    """Return a frame's content as a line, such as "estimate 8: x_hat 0.5000, alpha 0.25".

    The number after the kind is the transfer id. Of a rejected frame the line has the reason and the frame
    itself.
    """
    if isinstance(content, Estimate):
        alpha = float32_value(float32_bits_from_alpha_word(content.alpha))
        return f"estimate {content.transfer_id}: x_hat {content.x_hat / Q23_ONE:.4f}, alpha {alpha:.6g}"
    if isinstance(content, Heartbeat):
        health, mode = _format_name(content.health), _format_name(content.mode)
        return f"heartbeat {content.transfer_id}: {health}, {mode}, up {content.uptime} s"
    if isinstance(content, Telemetry):
        x, b_hat = content.x / Q23_ONE, content.b_hat / B_HAT_UNITS
        return f"telemetry {content.transfer_id}: x {x:.4f}, b_hat {b_hat:.4f}, updates {content.updates}"
    return f"refused, {_format_name(content)}: {format_frame(frame)}"


def _format_name(member: Enum) -> str:
    """Return an enum member's name as the page shows it: SOFTWARE_UPDATE as "software update"."""
    return member.name.lower().replace("_", " ")
