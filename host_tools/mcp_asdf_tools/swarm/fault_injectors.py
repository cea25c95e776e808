"""Faults of nodes and of frames that a node sends; ``mcp_asdf_tools.swarm.faults`` puts them to work.

The faults of frames on their way to a receiver are in ``ways``.
"""

from __future__ import annotations

import copy
import hashlib
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum
from fractions import Fraction
from functools import cache
from typing import TypeVar

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus import FRAME_BYTES, MAX_NODE_ID, ONE, FrameFormat, Message, bits_of, decode, encode
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.transmission import SentFrame

Words = tuple[int, ...]
"""Eight random words of 64 bits."""

Row = NDArray[np.uint64]
"""One random word for each receiver, shape (receivers,)."""

_MAX_WORD = (1 << 64) - 1
_KEY = struct.Struct("<IIIBBBB")
_WORDS = 8

_BUS_ERROR = 0x88
"""Linux's code of a protocol violation and bus error (CAN_ERR_PROT | CAN_ERR_BUSERROR)."""

_Subject = TypeVar("_Subject")


class _Of(IntEnum):
    """Subjects of draws."""

    NODE = 0
    LINKS = 1
    FRAME = 2
    COPIES = 3


class Draws:
    """Random words of one fault; ``number`` distinguishes faults of one kind.

    Where each receiver has words of its own, receiver i has them however many receivers are asked for.

    Attributes:
        number: As given.
    """

    def __init__(self, seed: int, kind: FaultKind, number: int) -> None:
        self.number = number
        self._hash = hashlib.shake_128(seed.to_bytes(16, "little") + f"{kind.value} {number}".encode())

    def of_node(self, node: int, tick: int, number: int = 0) -> Words:
        """Eight words of a node in a tick."""
        return self._eight(tick, number, 0, node, 0, _Of.NODE, 0)

    def of_links(self, sender: int, tick: int, receivers: int) -> Row:
        """A word of the way to each receiver in a tick."""
        return self._row(receivers, tick, 0, 0, sender, 0, _Of.LINKS, 0)

    def of_frame(self, sent: SentFrame) -> Words:
        """Eight words of a frame."""
        return self._eight(*_frame_key(sent), 0, _Of.FRAME, 0)

    def of_copies(self, sent: SentFrame, version: int, receivers: int, words: int) -> Row:
        """``words`` words of the copy of a frame for each receiver, shape (receivers, words).

        ``version`` counts copies for the same receiver.
        """
        key = *_frame_key(sent), version % 256, _Of.COPIES, 0
        return self._row(receivers * words, *key).reshape(receivers, words)

    def _eight(self, *key: int) -> Words:
        return struct.unpack("<8Q", self._digest(_WORDS, key))

    def _row(self, words: int, *key: int) -> Row:
        return np.frombuffer(self._digest(words, key), "<u8")

    def _digest(self, words: int, key: tuple[int, ...]) -> bytes:
        drawn = self._hash.copy()
        drawn.update(_KEY.pack(*key))
        return drawn.digest(8 * words)


def _frame_key(sent: SentFrame) -> tuple[int, int, int, int]:
    return sent.tick, sent.number, sent.frame.arbitration_id, sent.sender


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


AT_SENDERS: dict[FaultKind, Callable[[Fault, Draws, FrameFormat], AtSender]] = {
    FaultKind.FREEZE: _Freeze,
    FaultKind.LIAR: _Liar,
    FaultKind.COLLIDE: _Collide,
    FaultKind.ERROR: _Error,
    FaultKind.QUEUE: _Queue,
}


@cache
def _limit(probability: float) -> int:
    """The number of words below ``probability`` times 2**64: with 1 all of them, with 0 none."""
    return math.ceil(Fraction(probability) * (_MAX_WORD + 1))


def _below(words: Words, probability: float) -> bool:
    """True if the first word strikes."""
    return words[0] < _limit(probability)


def each_below(words: Row, probability: float) -> NDArray[np.bool_]:
    """True for each word that strikes."""
    last = _last_below(probability)
    if last is None:
        return np.zeros(words.shape, np.bool_)
    struck: NDArray[np.bool_] = words <= last
    return struck


@cache
def _last_below(probability: float) -> np.uint64 | None:
    """The largest word that strikes; None if none does."""
    limit = _limit(probability)
    return np.uint64(limit - 1) if limit else None
