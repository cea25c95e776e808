"""Faults between robots, injected so that a run can be repeated to the bit.

``Faults`` stands between nodes and the carrier of their frames, be it that of an emulated swarm or a
bus with a real controller. It is used in every tick as follows:

    faults = Faults([parse_fault("loss=0.2,robots=3-5"), parse_fault("babble=0.1")], 1, FrameFormat())

    if not faults.survives(robot, tick):                       # dead: it neither observes nor settles
        ...
    for frame in [*own_frames, *faults.babble(robot.id, tick)]:
        sent += faults.leave(frame, robot.id, tick)            # frames that get onto the bus
    paths = faults.paths(tick, sent, in_range)                 # what becomes of them at each neighbour

Randomness: whether a fault strikes is decided by a draw that is a function of the seed, the fault, the tick,
the sender, the receiver and which of the sender's frames in this tick it is, and of nothing else: not of
what else is on the bus, nor of when frames come. It does not depend on the rate either: a larger rate strikes
wherever a smaller one does. A draw is SHAKE-128 of those numbers, the seed before them.

Faults act in the order given, each on the frames left by those before it.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import can
import numpy as np

from mcp_asdf_tools.bus.alpha_words import float32_bits
from mcp_asdf_tools.bus.frame_layout import FRAME_BYTES, MAX_NODE_ID, Q23_ONE, TRANSFER_IDS
from mcp_asdf_tools.bus.frames import Estimate, FrameFormat, decode_estimate, encode_estimate
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.delivery import Mask, Paths, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.link_faults import LINK_FAULTS, Draws, Injector, LinkFault


class Spells(Injector):
    """Crash and busoff: spells of several ticks, of a node. Each tick counts."""

    def __init__(self, fault: Fault, draws: Draws) -> None:
        super().__init__(fault, draws)
        self._left: dict[int, tuple[int, int]] = {}
        """The last tick asked for, and the ticks that a spell then had left, by node."""

    def lasts(self, node: int, tick: int) -> bool:
        """True if a spell of the node lasts in this tick. O(ticks since the last call for it)."""
        known, left = self._left.get(node, (self.fault.start - 1, 0))
        if node in self._left and tick < known:
            raise ValueError(f"tick {tick} comes after tick {known}; ticks must not decrease")
        for now in range(known + 1, tick + 1):
            left = max(left - 1, 0)
            if left == 0 and self.fault.is_on(now, node):
                left = self.fault.ticks * self._strikes_node(node, now)
            self.injected += left > 0
            self._left[node] = now, left
        return left > 0


class Babbler(Injector):
    """Babble and sybil: frames besides a node's own, of random content or estimates under other ids."""

    def __init__(self, fault: Fault, draws: Draws, frames: FrameFormat) -> None:
        super().__init__(fault, draws)
        self.is_early = fault.kind is FaultKind.SYBIL
        self._frames = frames

    def frames(self, node: int, tick: int, now: float) -> list[can.Message]:
        """This tick's frames, stamped ``now``."""
        if not (self.fault.is_on(tick, node) and self._strikes_node(node, tick)):
            return []
        frames = self._estimates(tick, now) if self.is_early else self._random(node, tick, now)
        self.injected += len(frames)
        return frames

    def _random(self, node: int, tick: int, now: float) -> list[can.Message]:
        identifier = self._frames.identifier(node)
        words = (self._draws.of_node(node, tick, number)[1] for number in range(self.fault.frames))
        contents = [word.to_bytes(FRAME_BYTES, "little") for word in words]
        return [
            can.Message(timestamp=now, arbitration_id=identifier, data=data, is_rx=False) for data in contents
        ]

    def _estimates(self, tick: int, now: float) -> list[can.Message]:
        ids = sorted(self.fault.ids or ())
        said = (Estimate(each, round(self.fault.x * Q23_ONE), 0, tick % TRANSFER_IDS) for each in ids)
        return [claiming(self.fault.alpha, encode_estimate(each, self._frames, now)) for each in said]


def claiming(alpha: float, frame: can.Message) -> can.Message:
    """The estimate with ``alpha`` as claimed: the codec would round it to the firmware's grid."""
    frame.data[3:7] = float32_bits(alpha).to_bytes(4, "little")
    return frame


class SenderFault(Injector):
    """Freeze, liar and collide: they change a frame before it is on the bus."""

    def __init__(self, fault: Fault, draws: Draws, frames: FrameFormat) -> None:
        super().__init__(fault, draws)
        self._frames = frames
        self._regular: dict[int, Estimate] = {}
        """The last estimate of each sender that was not frozen."""

    def act(self, sent: SentFrame) -> SentFrame:
        """The frame that replaces ``sent``, which may be itself."""
        if self.fault.kind is FaultKind.COLLIDE:
            return self._collide(sent)
        own = decode_estimate(sent.frame, self._frames)
        if not isinstance(own, Estimate):
            return sent
        return self._lie(sent, own) if self.fault.kind is FaultKind.LIAR else self._freeze(sent, own)

    def _collide(self, sent: SentFrame) -> SentFrame:
        if self.fault.id is None or not self._strikes(sent):
            return sent
        frame = copy.copy(sent.frame)
        frame.arbitration_id = frame.arbitration_id & ~MAX_NODE_ID | self.fault.id
        return replace(sent, frame=frame)

    def _lie(self, sent: SentFrame, own: Estimate) -> SentFrame:
        if not self._strikes(sent):
            return sent
        lie = self._say(sent, replace(own, x_hat=round(self.fault.x * Q23_ONE), alpha=0))
        claiming(self.fault.alpha, lie.frame)
        return lie

    def _freeze(self, sent: SentFrame, own: Estimate) -> SentFrame:
        """Strikes only where there is an estimate to repeat."""
        held = self._regular.setdefault(sent.sender, own)
        if held is not own and self._strikes(sent):
            return self._say(sent, replace(own, x_hat=held.x_hat, alpha=held.alpha))
        self._regular[sent.sender] = own
        return sent

    def _say(self, sent: SentFrame, message: Estimate) -> SentFrame:
        return replace(sent, frame=encode_estimate(message, self._frames, sent.frame.timestamp))


class Faults:
    """Faults at work. Ticks are 0 .. 2**32 - 1, and must not decrease from call to call.

    Calls for one frame or node are O(faults), with crash and busoff O(ticks since the last).

    Attributes:
        faults: The faults, in the order in which they act.
    """

    def __init__(self, faults: Sequence[Fault], seed: int, frames: FrameFormat) -> None:
        """Prepare. ``seed`` has up to 128 bits, ``frames`` is the estimates' format, for freeze and liar."""
        self.faults = tuple(faults)
        self._frames = frames
        kinds = [fault.kind for fault in faults]
        draws = [Draws(seed, kind, kinds[:place].count(kind)) for place, kind in enumerate(kinds)]
        self._all = [self._injector(*each) for each in zip(self.faults, draws, strict=True)]
        self._spells = [each for each in self._all if isinstance(each, Spells)]
        self._babblers = [each for each in self._all if isinstance(each, Babbler)]
        self._sender_faults = [each for each in self._all if isinstance(each, SenderFault)]
        self._link_faults = [each for each in self._all if isinstance(each, LinkFault)]
        self._numbers: dict[int, tuple[int, dict[int, int]]] = {}

    def crash(self, robot: int, tick: int) -> Fault | None:
        """The fault that keeps ``robot`` dead in this tick; None while it lives."""
        lasting = [each.fault for each in self._spells if each.lasts(robot, tick)]
        return next((fault for fault in lasting if fault.kind is FaultKind.CRASH), None)

    def survives(self, robot: BusRobot, tick: int) -> bool:
        """Let ``robot`` crash or wake as this tick wants it; returns whether it lives."""
        fault = self.crash(robot.id, tick)
        if fault is None and not robot.is_alive:
            robot.wake()
        elif fault is not None and robot.is_alive:
            robot.die(loses_state=fault.rejoin == "new")
        return robot.is_alive

    def is_off(self, robot: int, tick: int) -> bool:
        """True if the node is off the bus, crashed or bus-off. ``leave``, ``babble``, ``paths`` obey it."""
        # All are evaluated, since each counts its ticks.
        return bool(self._spells) and any([each.lasts(robot, tick) for each in self._spells])

    def babble(self, robot: int, tick: int, now: float = 0.0, is_early: bool = False) -> list[can.Message]:
        """The frames, stamped ``now`` (seconds), that the node sends besides its own: before all others'
        frames of this tick, or after them.

        Call once per tick for either, and pass each to ``leave``.
        """
        own = [each for each in self._babblers if each.is_early == is_early]
        if not own or self.is_off(robot, tick):
            return []
        return [frame for each in own for frame in each.frames(robot, tick, now)]

    def leave(self, frame: can.Message, sender: int, tick: int) -> list[SentFrame]:
        """What gets onto the bus when a node sends ``frame``: one frame, or none while the node is off.

        Call once per frame, in sending order.
        """
        if not self.faults:
            return [SentFrame(frame, sender, tick)]
        if self.is_off(sender, tick):
            return []
        sent = SentFrame(frame, sender, tick, self._number(frame, sender, tick))
        for each in self._sender_faults:
            sent = each.act(sent)
        return [sent]

    def paths(self, tick: int, sent: Sequence[SentFrame], in_range: Mask) -> list[Paths]:
        """Paths of the frames that arrive in this tick, if undisturbed, at the receivers in range.

        ``in_range`` has shape (frames, receivers), and receivers are numbered by id. Call once per tick with
        all frames. O(faults frames receivers).
        """
        reach = in_range.copy()
        if self._spells:
            hearing = np.flatnonzero(in_range.any(axis=0)).tolist()
            reach[:, [receiver for receiver in hearing if self.is_off(receiver, tick)]] = False
        paths = [Paths(sent, reach, np.zeros(len(sent), np.uint64))]
        for fault in self._link_faults:
            paths = [after for each in paths for after in fault.act(each) if after.reach.any()]
        return paths

    def figures(self) -> list[dict[str, Any]]:
        """Each fault's text and how often it struck, as plain values for JSON.

        Counted are ticks of a robot for crash and busoff, frames for all others.
        """
        return [{"fault": str(each.fault), "injected": each.injected} for each in self._all]

    def _injector(self, fault: Fault, draws: Draws) -> Injector:
        if fault.kind in (FaultKind.CRASH, FaultKind.BUSOFF):
            return Spells(fault, draws)
        if fault.kind in (FaultKind.BABBLE, FaultKind.SYBIL):
            return Babbler(fault, draws, self._frames)
        if fault.kind in LINK_FAULTS:
            return LinkFault(fault, draws)
        return SenderFault(fault, draws, self._frames)

    def _number(self, frame: can.Message, sender: int, tick: int) -> int:
        """Number of frames with its identifier that the sender has sent before in this tick."""
        last, counts = self._numbers.get(sender, (-1, {}))
        if last != tick:
            self._numbers[sender] = tick, (counts := {})
        number = counts.get(frame.arbitration_id, 0)
        counts[frame.arbitration_id] = number + 1
        return number
