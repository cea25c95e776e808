"""Faults between robots, injected so that a run can be repeated to the bit.

``Faults`` stands between nodes and the carrier of their frames, be it that of an emulated swarm or a
bus with a real controller. It is used in every tick as follows:

    faults = Faults([parse_fault("loss=0.2,robots=3-5"), parse_fault("babble=0.1,frames=20")], seed=1)

    if not faults.survives(robot, tick):                       # dead: it neither observes nor settles
        ...
    for frame in [*own_frames, *faults.babble(robot.id, tick)]:
        sent += faults.leave(frame, robot.id, tick)            # frames that get onto the bus
    paths = faults.paths(tick, sent, in_range)                   # what becomes of them at each neighbour

Randomness: whether a fault strikes is decided by a draw that is a function of the seed, the fault, the tick,
the sender, the receiver and which of the sender's frames in this tick it is, and of nothing else: not of
what else is on the bus, nor of when frames come. It does not depend on the rate either: a larger rate strikes
wherever a smaller one does (except for bursts). A draw is SHAKE-128 of those numbers, the seed before them.

Faults act in the order given, each on the frames left by those before it.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import can
import numpy as np

from mcp_asdf_tools.bus.frames import (
    FRAME_BYTES,
    MAX_NODE_ID,
    ONE,
    FrameFormat,
    Message,
    bits_of,
    decode,
    encode,
)
from mcp_asdf_tools.common.errors import UsageError
from mcp_asdf_tools.robots.bus_robot import BusRobot
from mcp_asdf_tools.swarm.delivery import Mask, Paths, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.link_faults import LINK_FAULTS, Draws, Injector, LinkFault, below

_BUS_ERROR = 0x88
"""Linux's code of a protocol violation and bus error (CAN_ERR_PROT | CAN_ERR_BUSERROR)."""

_Subject = TypeVar("_Subject")


class _Course(dict[_Subject, tuple[int, int]]):
    """Number of each key that ``step`` (of key, tick and number) carries from tick to tick."""

    def __init__(self, start: int, step: Callable[[_Subject, int, int], int]) -> None:
        super().__init__()
        self._start = start
        self._step = step

    def at(self, key: _Subject, tick: int) -> int:
        """The number of ``key`` in this tick; 0 before the start. Raises ValueError if the tick decreases."""
        known, number = self.get(key, (self._start - 1, 0))
        if tick < known and tick >= self._start:
            raise ValueError(f"tick {tick} comes after tick {known}; ticks must not decrease")
        for now in range(known + 1, tick + 1):
            number = self._step(key, now, number)
        if tick > known:
            self[key] = tick, number
        return number


class Spells(Injector):
    """Crash and busoff: spells of several ticks, of a node. Each tick counts."""

    def __init__(self, fault: Fault, draws: Draws) -> None:
        super().__init__(fault, draws)
        self._left: _Course[int] = _Course(fault.start, self._step)

    def lasts(self, node: int, tick: int) -> bool:
        """True if a spell of the node lasts in this tick. O(ticks since the last call for it)."""
        return self._left.at(node, tick) > 0

    def _step(self, node: int, tick: int, left: int) -> int:
        left = max(left - 1, 0)
        if left == 0 and self.fault.is_on(tick, node):
            left = self.fault.ticks * below(self._draws.of_node(node, tick), self.fault.rate)
        self.injected += left > 0
        return left


class Babbler(Injector):
    """Babble: frames of random content."""

    def contents(self, node: int, tick: int) -> list[bytes]:
        """The data of this tick's frames."""
        if not (self.fault.is_on(tick, node) and below(self._draws.of_node(node, tick), self.fault.rate)):
            return []
        self.injected += self.fault.frames
        words = (self._draws.of_node(node, tick, number)[1] for number in range(self.fault.frames))
        return [word.to_bytes(FRAME_BYTES, "little") for word in words]


class AtSender(Injector, ABC):
    """Fault that acts on a frame before it is on the bus."""

    def __init__(self, fault: Fault, draws: Draws, frames: FrameFormat) -> None:
        super().__init__(fault, draws)
        self._frames = frames

    @abstractmethod
    def act(self, sent: SentFrame) -> list[SentFrame]:
        """Frames that replace the frame. Error frames stay unchanged."""

    def _say(self, sent: SentFrame, own: Message, x_hat: int, alpha: int) -> list[SentFrame]:
        """The estimate ``own`` with other content."""
        message = replace(own, x_hat=x_hat, alpha=alpha)
        return [replace(sent, frame=encode(message, self._frames, sent.frame.timestamp))]


class _InItsTicks(AtSender):
    """Fault that ignores frames outside its schedule."""

    def act(self, sent: SentFrame) -> list[SentFrame]:
        if sent.frame.is_error_frame or not self.fault.is_on(sent.tick, sent.sender):
            return [sent]
        return self._act(sent)

    @abstractmethod
    def _act(self, sent: SentFrame) -> list[SentFrame]:
        """Frames that replace a frame in the fault's schedule."""


class _Freeze(AtSender):
    """Freeze: strikes only where there is an estimate to repeat."""

    def __init__(self, fault: Fault, draws: Draws, frames: FrameFormat) -> None:
        super().__init__(fault, draws, frames)
        self._regular: dict[int, Message] = {}

    def act(self, sent: SentFrame) -> list[SentFrame]:
        own = decode(sent.frame, self._frames)
        if not isinstance(own, Message):
            return [sent]
        held = self._regular.setdefault(sent.sender, own)
        may_strike = held is not own and self.fault.is_on(sent.tick, sent.sender)
        if may_strike and self._strikes(self._draws.of_frame(sent)):
            return self._say(sent, own, held.x_hat, held.alpha)
        self._regular[sent.sender] = own
        return [sent]


class _Liar(_InItsTicks):
    def _act(self, sent: SentFrame) -> list[SentFrame]:
        own = decode(sent.frame, self._frames)
        if not (isinstance(own, Message) and self._strikes(self._draws.of_frame(sent))):
            return [sent]
        (lie,) = self._say(sent, own, round(self.fault.x * ONE), 0)
        # As claimed; the codec would round it to the firmware's grid.
        lie.frame.data[3:7] = bits_of(self.fault.alpha).to_bytes(4, "little")
        return [lie]


class _Collide(_InItsTicks):
    def _act(self, sent: SentFrame) -> list[SentFrame]:
        if self.fault.id is None or not self._strikes(self._draws.of_frame(sent)):
            return [sent]
        frame = copy.copy(sent.frame)
        frame.arbitration_id = frame.arbitration_id & ~MAX_NODE_ID | self.fault.id
        return [replace(sent, frame=frame)]


class _Error(_InItsTicks):
    def _act(self, sent: SentFrame) -> list[SentFrame]:
        if not self._strikes(self._draws.of_frame(sent)):
            return [sent]
        error = can.Message(
            timestamp=sent.frame.timestamp,
            arbitration_id=_BUS_ERROR,
            is_error_frame=True,
            dlc=FRAME_BYTES,
            data=bytes(FRAME_BYTES),
            is_rx=False,
        )
        return [replace(sent, frame=error), sent]


class _Queue(_InItsTicks):
    def __init__(self, fault: Fault, draws: Draws, frames: FrameFormat) -> None:
        super().__init__(fault, draws, frames)
        self._taken: dict[int, tuple[int, int]] = {}

    def _act(self, sent: SentFrame) -> list[SentFrame]:
        tick, taken = self._taken.get(sent.sender, (sent.tick, 0))
        taken = taken if tick == sent.tick else 0
        is_short = below(self._draws.of_node(sent.sender, sent.tick), self.fault.rate)
        if is_short and taken >= self.fault.frames:
            self.injected += 1
            return []
        self._taken[sent.sender] = sent.tick, taken + 1
        return [sent]


AT_SENDERS: dict[FaultKind, Callable[[Fault, Draws, FrameFormat], AtSender]] = {
    FaultKind.FREEZE: _Freeze,
    FaultKind.LIAR: _Liar,
    FaultKind.COLLIDE: _Collide,
    FaultKind.ERROR: _Error,
    FaultKind.QUEUE: _Queue,
}


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
        self._link_faults = [each for each in self._all if isinstance(each, LinkFault)]
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
        """True if the node is off the bus, crashed or bus-off. ``leave``, ``babble``, ``paths`` obey it."""
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

    def paths(self, tick: int, sent: Sequence[SentFrame], in_range: Mask) -> list[Paths]:
        """Paths of the frames that arrive in this tick, if undisturbed, at the receivers in range.

        ``in_range`` has shape (frames, receivers), and receivers are numbered by id. Call once per tick with
        all frames; error frames reach every node. O(faults frames receivers).
        """
        reach = in_range.copy()
        if self._spells:
            hearing = np.flatnonzero(in_range.any(axis=0)).tolist()
            reach[:, [receiver for receiver in hearing if self.is_off(receiver, tick)]] = False
        paths = [Paths(reach)]
        for each in self._link_faults:
            paths = each.act(sent, paths)
        return paths

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
        return LINK_FAULTS[fault.kind](fault, draws)

    def _number(self, frame: can.Message, sender: int, tick: int) -> int:
        """Number of frames with its identifier that the sender has sent before in this tick."""
        last, counts = self._numbers.get(sender, (-1, {}))
        if last != tick:
            self._numbers[sender] = tick, (counts := {})
        number = counts.get(frame.arbitration_id, 0)
        counts[frame.arbitration_id] = number + 1
        return number
