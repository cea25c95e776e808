"""Injectors, one for each kind of fault; ``mcp_asdf_tools.swarm.faults`` puts them to work."""

from __future__ import annotations

import copy
import hashlib
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import can

from mcp_asdf_tools.bus import FRAME_BYTES, MAX_NODE_ID, ONE, FrameFormat, Message, bits_of, decode, encode
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.transmission import Delivery, SentFrame

Words = tuple[int, ...]
"""Eight random words of 64 bits: the first decides whether a fault strikes, the others how."""

_WORD = 1 << 64
_KEY = struct.Struct("<IIIBBB")
_NO_RECEIVER = 255
"""Receiver in draws that concern the sender alone."""

_BUS_ERROR = 0x88
"""Linux's code of a protocol violation and bus error (CAN_ERR_PROT | CAN_ERR_BUSERROR)."""

_Subject = TypeVar("_Subject")


class Draws:
    """Random words of one fault; ``number`` distinguishes faults of one kind."""

    def __init__(self, seed: int, kind: FaultKind, number: int) -> None:
        person = f"{kind.value} {number}".encode()
        self._hash = hashlib.blake2b(digest_size=64, key=seed.to_bytes(16, "little"), person=person)

    def of_node(self, node: int, tick: int, number: int = 0) -> Words:
        """Words of a node in a tick."""
        return self._words(tick, number, 0, node, _NO_RECEIVER, 0)

    def of_link(self, link: tuple[int, int], tick: int) -> Words:
        """Words of a sender and a receiver in a tick."""
        return self._words(tick, 0, 0, *link, 0)

    def of_frame(self, sent: SentFrame, receiver: int = _NO_RECEIVER, version: int = 0) -> Words:
        """Words of a frame, or of one of its copies on the way to a receiver."""
        return self._words(
            sent.tick, sent.number, sent.frame.arbitration_id, sent.sender, receiver, version % 256
        )

    def _words(self, *key: int) -> Words:
        drawn = self._hash.copy()
        drawn.update(_KEY.pack(*key))
        return struct.unpack("<8Q", drawn.digest())


class Injector:
    """A fault with its draws.

    Attributes:
        fault: The fault.
        injected: How often it struck.
    """

    def __init__(self, fault: Fault, draws: Draws) -> None:
        self.fault = fault
        self._draws = draws
        self.injected = 0

    def _strikes(self, words: Words) -> bool:
        """Let the fault strike or not by this draw; True if it did, which counts."""
        strikes = _below(words, self.fault.rate)
        self.injected += strikes
        return strikes


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
            left = self.fault.ticks * _below(self._draws.of_node(node, tick), self.fault.rate)
        self.injected += left > 0
        return left


class Babbler(Injector):
    """Babble: frames of random content."""

    def contents(self, node: int, tick: int) -> list[bytes]:
        """The data of this tick's frames."""
        if not (self.fault.is_on(tick, node) and _below(self._draws.of_node(node, tick), self.fault.rate)):
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
        is_short = _below(self._draws.of_node(sent.sender, sent.tick), self.fault.rate)
        if is_short and taken >= self.fault.frames:
            self.injected += 1
            return []
        self._taken[sent.sender] = sent.tick, taken + 1
        return [sent]


class OnTheWay(Injector, ABC):
    """Fault that acts on a frame on its way to one receiver."""

    def act(self, ways: Sequence[Delivery], sent: SentFrame, receiver: int) -> Sequence[Delivery]:
        """Deliveries that replace ``ways``, those left by earlier faults."""
        chosen = self.fault.receivers
        if not self.fault.is_on(sent.tick, sent.sender) or (chosen is not None and receiver not in chosen):
            return ways
        return [
            after for version, way in enumerate(ways) for after in self._act(way, sent, receiver, version)
        ]

    @abstractmethod
    def _act(self, way: Delivery, sent: SentFrame, receiver: int, version: int) -> Sequence[Delivery]:
        """Deliveries that replace one ``way`` within the schedule, to a receiver that the fault affects."""


class _ByDraw(OnTheWay):
    """Fault that strikes each frame by a draw of its own."""

    def _act(self, way: Delivery, sent: SentFrame, receiver: int, version: int) -> Sequence[Delivery]:
        words = self._draws.of_frame(sent, receiver, version)
        return self._struck(way, words) if self._strikes(words) else (way,)

    @abstractmethod
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        """Deliveries that replace one that is struck."""


class _Loss(_ByDraw):
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        return ()


class _Burst(OnTheWay):
    """Gilbert's chain for each sender and receiver: nothing passes in its bad state."""

    def __init__(self, fault: Fault, draws: Draws) -> None:
        super().__init__(fault, draws)
        self._is_bad: _Course[tuple[int, int]] = _Course(fault.start, self._step)

    def _act(self, way: Delivery, sent: SentFrame, receiver: int, version: int) -> Sequence[Delivery]:
        is_bad = self._is_bad.at((sent.sender, receiver), sent.tick)
        self.injected += is_bad
        return () if is_bad else (way,)

    def _step(self, link: tuple[int, int], tick: int, is_bad: int) -> int:
        """Start in the stationary state; then bursts end, and new ones begin to keep their share."""
        share, length = self.fault.rate, self.fault.length
        words = self._draws.of_link(link, tick)
        if tick == self.fault.start:
            return _below(words, share)
        if is_bad:
            return not _below(words, 1 / length)
        return _below(words, share / (1 - share) / length)


class _Delay(_ByDraw):
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        return (replace(way, delay=way.delay + self.fault.ticks),)


class _Duplicate(_ByDraw):
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        return way, replace(way, delay=way.delay + self.fault.ticks)


class _Reorder(_ByDraw):
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        return (replace(way, place=(words[1] >> 11) * 2.0**-53),)


class _Corrupt(_ByDraw):
    def _struck(self, way: Delivery, words: Words) -> Sequence[Delivery]:
        frame = copy.copy(way.frame)
        width = 8 * len(frame.data)
        flips = _choice(width, min(self.fault.bits, width), words[1:])
        frame.data = bytearray((int.from_bytes(frame.data, "little") ^ flips).to_bytes(width // 8, "little"))
        return (replace(way, frame=frame),)


AT_SENDERS: dict[FaultKind, Callable[[Fault, Draws, FrameFormat], AtSender]] = {
    FaultKind.FREEZE: _Freeze,
    FaultKind.LIAR: _Liar,
    FaultKind.COLLIDE: _Collide,
    FaultKind.ERROR: _Error,
    FaultKind.QUEUE: _Queue,
}

ON_THE_WAY: dict[FaultKind, Callable[[Fault, Draws], OnTheWay]] = {
    FaultKind.LOSS: _Loss,
    FaultKind.BURST: _Burst,
    FaultKind.DELAY: _Delay,
    FaultKind.DUPLICATE: _Duplicate,
    FaultKind.REORDER: _Reorder,
    FaultKind.CORRUPT: _Corrupt,
}


def _below(words: Words, probability: float) -> bool:
    """True if the draw is below the probability: with 1 always, with 0 never."""
    return words[0] < probability * _WORD


def _choice(width: int, count: int, words: Words) -> int:
    """``count`` different bits of ``width`` (at most 64), all choices equally likely up to 2**-100."""
    drawn = sum(word << 64 * place for place, word in enumerate(words))
    places, chosen = list(range(width)), 0
    for _ in range(count):
        drawn, at = divmod(drawn, len(places))
        chosen |= 1 << places.pop(at)
    return chosen
