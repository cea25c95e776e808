"""The robots of a bus as an observer knows them: who is there, how well it is heard, and what it says."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import can

from mcp_asdf_tools.bus.alpha_words import alpha_word_to_bits, float32_value
from mcp_asdf_tools.bus.frame_layout import Q23_ONE, TRANSFER_IDS, Rejection
from mcp_asdf_tools.bus.frames import Estimate, FrameContent, Heartbeat, Telemetry, format_frame
from mcp_asdf_tools.robots.suspicion import AlphaWatch

SILENT_SECONDS = 3.0
"""After which a robot counts as silent: OpenCyphal's timeout of heartbeats."""
RATE_SECONDS = 5.0
"""Over which a rate is taken."""
_MOST_FRAMES = 4000
"""In a report: as many as a bus of 1 Mbit/s has in half a second."""


@dataclass
class RobotOnBus:
    """What was heard of one robot; times in seconds of the observer's clock.

    Attributes:
        first, last: When its first and its latest frame came.
        estimates: When its estimates came in the last RATE_SECONDS.
        received, lost: Frames that came, and those that transfer ids say are missing between them.
        conflicts: Heartbeats that another node with its id must have sent.
        alpha_jumps: Estimates whose confidence jumps; see ``robots.suspicion.AlphaWatch``.
        heartbeat: The latest.
        telemetry: The latest.
    """

    first: float
    last: float
    estimates: deque[float] = field(default_factory=deque)
    received: int = 0
    lost: int = 0
    conflicts: int = 0
    alpha_jumps: int = 0
    heartbeat: Heartbeat | None = None
    telemetry: Telemetry | None = None
    _before: Heartbeat | None = None
    _alpha_watch: AlphaWatch = field(default_factory=AlphaWatch)
    _transfer_ids: dict[type, int] = field(default_factory=dict)

    def hear(self, content: Estimate | Heartbeat | Telemetry, now: float) -> None:
        """Take one of its frames. O(1) on average."""
        if self.is_silent(now):
            self._transfer_ids.clear()  # they have gone round, nobody knows how often
        self.last = now
        self._count(content)
        if isinstance(content, Estimate):
            self.estimates.append(now)
            self.alpha_jumps += self._alpha_watch.is_jump(content.sender, content.alpha)
        elif isinstance(content, Heartbeat):
            self.conflicts += self._is_of_another(content)
            self._before, self.heartbeat = self.heartbeat, content
        else:
            self.telemetry = content

    def _count(self, content: Estimate | Heartbeat | Telemetry) -> None:
        """Count what is missing before a frame: each kind has transfer ids of its own, modulo 32.

        A repeated id is no gap, since a frame may come twice.
        """
        kind = type(content)
        before = self._transfer_ids.get(kind)
        self._transfer_ids[kind] = content.transfer_id
        self.received += 1
        if before is not None and before != content.transfer_id:
            self.lost += (content.transfer_id - before - 1) % TRANSFER_IDS

    def _is_of_another(self, said: Heartbeat) -> bool:
        """Whether two nodes have this id: a heartbeat comes again, or goes on with the one before the last.

        One that has begun anew goes on with no uptime from before.
        """
        last, before = self.heartbeat, self._before
        if last is None:
            return False
        if (last.uptime, last.transfer_id) == (said.uptime, said.transfer_id):
            return True
        if before is None or not last.uptime < before.uptime < said.uptime:
            return False
        return (said.transfer_id - before.transfer_id - said.uptime + before.uptime) % TRANSFER_IDS == 0

    def is_silent(self, now: float) -> bool:
        """Whether nothing came for SILENT_SECONDS."""
        return now - self.last >= SILENT_SECONDS

    def rate(self, now: float) -> float:
        """Estimates a second, over the last RATE_SECONDS or since its first frame."""
        while self.estimates and self.estimates[0] <= now - RATE_SECONDS:
            self.estimates.popleft()
        return len(self.estimates) / max(min(now - self.first, RATE_SECONDS), 1.0)


class Roster:
    """All robots of a bus, and the frames that passed since the last report.

    Attributes:
        robots: By id, in the order in which they were first heard.
    """

    def __init__(self) -> None:
        self.robots: dict[int, RobotOnBus] = {}
        self._frames: deque[tuple[float, int | None, str]] = deque(maxlen=_MOST_FRAMES)

    def hear(self, frame: can.Message, content: FrameContent, now: float) -> None:
        """Take a frame that was decoded. O(1)."""
        robot = None if isinstance(content, Rejection) else content.sender
        self._frames.append((round(now, 3), robot, text_of(frame, content)))
        if not isinstance(content, Rejection):
            self.robots.setdefault(content.sender, RobotOnBus(now, now)).hear(content, now)

    def report(self, now: float) -> dict[str, Any]:
        """A row for each robot, by rising id, and the frames since the last report, as plain values."""
        rows = [_row(robot, self.robots[robot], now) for robot in sorted(self.robots)]
        frames = [list(each) for each in self._frames]
        self._frames.clear()
        return {"robots": rows, "frames": frames}


def _row(robot: int, heard: RobotOnBus, now: float) -> dict[str, Any]:
    heartbeat, telemetry = heard.heartbeat, heard.telemetry
    return {
        "robot": robot,
        "silent": heard.is_silent(now),
        "seen": round(now - heard.last, 1),
        "health": None if heartbeat is None else heartbeat.health.name.lower(),
        "mode": None if heartbeat is None else heartbeat.mode.name.lower().replace("_", " "),
        "rate": round(heard.rate(now), 1),
        "loss": heard.lost / (heard.lost + heard.received),
        "conflicts": heard.conflicts,
        "x": None if telemetry is None else telemetry.x / Q23_ONE,
        "b_hat": None if telemetry is None else telemetry.b_hat / 2**24,
        "updates": None if telemetry is None else telemetry.updates,
        "jumps": heard.alpha_jumps,
    }


def text_of(frame: can.Message, content: FrameContent) -> str:
    """A frame in words."""
    if isinstance(content, Estimate):
        alpha = float32_value(alpha_word_to_bits(content.alpha))
        return f"estimate {content.transfer_id}: x_hat {content.x_hat / Q23_ONE:.4f}, alpha {alpha:.6g}"
    if isinstance(content, Heartbeat):
        state = f"{content.health.name.lower()}, {content.mode.name.lower().replace('_', ' ')}"
        return f"heartbeat {content.transfer_id}: {state}, up {content.uptime} s"
    if isinstance(content, Telemetry):
        values = f"x {content.x / Q23_ONE:.4f}, b_hat {content.b_hat / 2**24:.4f}, updates {content.updates}"
        return f"telemetry {content.transfer_id}: {values}"
    return f"refused, {content.name.lower().replace('_', ' ')}: {format_frame(frame)}"
