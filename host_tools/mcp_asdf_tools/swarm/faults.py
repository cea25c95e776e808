"""Faults between robots, injected so that a run can be repeated to the bit.

``Faults`` stands between nodes and the carrier of their frames, be it the medium of an emulated swarm or a
bus with a real controller. It is used in every tick as follows:

    faults = Faults([parse_fault("loss=0.2,robots=3-5"), parse_fault("babble=0.1,frames=20")], seed=1)

    if not faults.survives(robot, tick):                       # dead: it neither observes nor settles
        ...
    for frame in [*own_frames, *faults.babble(robot.id, tick)]:
        sent += faults.leave(frame, robot.id, tick)            # frames that get onto the bus
    ways = faults.ways(tick, sent, in_range)                   # what becomes of them at each neighbour

Randomness: whether a fault strikes is decided by a draw that is a function of the seed, the fault, the tick,
the sender, the receiver and which of the sender's frames in this tick it is, and of nothing else: not of
what else is on the bus, nor of when frames come. It does not depend on the rate either: a larger rate strikes
wherever a smaller one does (except for bursts). A draw is SHAKE-128 of those numbers, the seed before them.

Faults act in the order given, each on the frames left by those before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can
import numpy as np

from mcp_asdf_tools.bus import FrameFormat
from mcp_asdf_tools.common import UsageError
from mcp_asdf_tools.robots import BusRobot
from mcp_asdf_tools.swarm.fault_injectors import (
    AT_SENDERS,
    AtSender,
    Babbler,
    Draws,
    Injector,
    Spells,
)
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind, parse_fault
from mcp_asdf_tools.swarm.transmission import SentFrame
from mcp_asdf_tools.swarm.ways import ON_THE_WAY, Mask, OnTheWay, Ways

__all__ = ["Fault", "FaultKind", "Faults", "SentFrame", "Ways", "parse_fault"]


class Faults:
    """Faults at work. Ticks are 0 .. 2**32 - 1, and must not decrease from call to call.

    Calls for one frame or node are O(faults), with crash, busoff and burst O(ticks since the last).

    Attributes:
        faults: The faults, in the order in which they act.
    """

    def __init__(self, faults: Sequence[Fault], seed: int, frames: FrameFormat | None = None) -> None:
        """Prepare. ``frames`` is the format of estimates, which freeze and liar change.

        Raises UsageError if ``seed`` is not in 0 .. 2**128 - 1.
        """
        if not 0 <= seed < 1 << 128:
            raise UsageError(f"seed is {seed}; choose 0 .. 2**128 - 1")
        self.faults = tuple(faults)
        self._frames = FrameFormat() if frames is None else frames
        kinds = [fault.kind for fault in faults]
        draws = [Draws(seed, kind, kinds[:place].count(kind)) for place, kind in enumerate(kinds)]
        self._all = [self._injector(*each) for each in zip(self.faults, draws, strict=True)]
        self._spells = [each for each in self._all if isinstance(each, Spells)]
        self._babblers = [each for each in self._all if isinstance(each, Babbler)]
        self._at_senders = [each for each in self._all if isinstance(each, AtSender)]
        self._on_the_way = [each for each in self._all if isinstance(each, OnTheWay)]
        self._numbers: dict[int, tuple[int, dict[int, int]]] = {}

    def crash(self, robot: int, tick: int) -> Fault | None:
        """The fault that keeps ``robot`` dead in this tick; None while it lives."""
        lasting = [each.fault for each in self._spells if each.lasts(robot, tick)]
        return next((fault for fault in lasting if fault.kind is FaultKind.CRASH), None)

    def survives(self, robot: BusRobot, tick: int) -> bool:
        """Let ``robot`` crash or wake as this tick wants it; returns whether it lives."""
        if not self._spells:
            return robot.is_alive
        fault = self.crash(robot.id, tick)
        if fault is None and not robot.is_alive:
            robot.wake()
        elif fault is not None and robot.is_alive:
            robot.die(loses_state=fault.rejoin == "new")
        return robot.is_alive

    @property
    def babbles(self) -> bool:
        """True if ``babble`` may return frames in any tick."""
        return bool(self._babblers)

    def is_off(self, robot: int, tick: int) -> bool:
        """True if the node is off the bus, crashed or bus-off. ``leave`` and ``ways`` respect it."""
        # All are evaluated, since each counts its ticks.
        return bool(self._spells) and any([each.lasts(robot, tick) for each in self._spells])

    def babble(self, robot: int, tick: int, now: float = 0.0) -> list[can.Message]:
        """The frames, stamped ``now`` (seconds), that the node sends besides its own.

        Call once per tick, and pass each to ``leave``.
        """
        if not self.babbles or self.is_off(robot, tick):
            return []
        identifier = self._frames.identifier(robot)
        return [
            can.Message(timestamp=now, arbitration_id=identifier, data=data, is_rx=False)
            for each in self._babblers
            for data in each.contents(robot, tick)
        ]

    def leave(self, frame: can.Message, sender: int, tick: int) -> list[SentFrame]:
        """Frames that get onto the bus when a node sends ``frame``. Call once per frame, in sending order."""
        if not self.faults:
            return [SentFrame(frame, sender, tick)]
        if self.is_off(sender, tick):
            return []
        leaving = [SentFrame(frame, sender, tick, self._number(frame, sender, tick))]
        for each in self._at_senders:
            leaving = [after for sent in leaving for after in each.act(sent)]
        return leaving

    def ways(self, tick: int, sent: Sequence[SentFrame], in_range: Mask) -> list[Ways]:
        """Ways of the frames that arrive in this tick, if undisturbed, at the receivers in range.

        ``in_range`` has shape (frames, receivers), and receivers are numbered by id. Call once per tick with
        all frames; error frames reach every node. O(faults frames receivers).
        """
        reach = in_range.copy()
        if self._spells:
            hearing = np.flatnonzero(in_range.any(axis=0)).tolist()
            reach[:, [receiver for receiver in hearing if self.is_off(receiver, tick)]] = False
        ways = [Ways(reach)]
        for each in self._on_the_way:
            ways = each.act(sent, ways)
        return ways

    def figures(self) -> list[dict[str, Any]]:
        """Each fault's text and how often it struck, as plain values for JSON.

        Counted are ticks of a robot for crash and busoff, frames for all others.
        """
        return [{"fault": str(each.fault), "injected": each.injected} for each in self._all]

    def _injector(self, fault: Fault, draws: Draws) -> Injector:
        if fault.kind in (FaultKind.CRASH, FaultKind.BUSOFF):
            return Spells(fault, draws)
        if fault.kind is FaultKind.BABBLE:
            return Babbler(fault, draws)
        if fault.kind in AT_SENDERS:
            return AT_SENDERS[fault.kind](fault, draws, self._frames)
        return ON_THE_WAY[fault.kind](fault, draws)

    def _number(self, frame: can.Message, sender: int, tick: int) -> int:
        """Number of frames with its identifier that the sender has sent before in this tick."""
        last, counts = self._numbers.get(sender, (-1, {}))
        if last != tick:
            self._numbers[sender] = tick, (counts := {})
        number = counts.get(frame.arbitration_id, 0)
        counts[frame.arbitration_id] = number + 1
        return number
