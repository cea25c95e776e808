"""Faults of frames on their path to each receiver, for all frames and receivers of a tick at once.

``Draws`` and ``Injector`` are those of all faults; the faults of nodes are in ``faults``.
"""

from __future__ import annotations

import hashlib
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from enum import IntEnum
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import FRAME_BYTES
from mcp_asdf_tools.swarm.delivery import Mask, Paths, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind

Words = tuple[int, ...]
"""Eight random words of 64 bits."""

Row = NDArray[np.uint64]
"""One random word for each receiver, shape (receivers,)."""

_MAX_WORD = (1 << 64) - 1
_KEY = struct.Struct("<IIIBBBB")
_WORDS = 8

Drawn = NDArray[np.uint64]
"""Random words for each of these, shape (frames, receivers, words)."""


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
        """A word of the path to each receiver in a tick."""
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
        strikes = below(words, self.fault.rate)
        self.injected += strikes
        return strikes


class LinkFault(Injector, ABC):
    """Fault that acts on a frame on its path to one receiver."""

    def act(self, sent: Sequence[SentFrame], paths: Sequence[Paths]) -> list[Paths]:
        """Paths of the frames ``sent`` that replace those left by earlier faults. O(frames receivers)."""
        after = [path for each in paths for path in self._act(sent, each)]
        return [each for each in after if each.reach.any()]

    def _act(self, sent: Sequence[SentFrame], paths: Paths) -> Iterator[Paths]:
        struck = paths.reach.copy()
        numbers = [
            number
            for number, each in enumerate(sent)
            if not each.frame.is_error_frame and self.fault.is_on(each.tick, each.sender)
        ]
        if len(numbers) < len(sent):
            struck[np.isin(np.arange(len(sent)), numbers, invert=True)] = False
        if self.fault.receivers is not None:
            struck &= np.isin(np.arange(struck.shape[1]), list(self.fault.receivers))
        words = self._drawn(sent, numbers, paths)
        if numbers:
            struck[numbers] &= self._hits([sent[number] for number in numbers], words[numbers])
        self.injected += int(np.count_nonzero(struck))
        yield replace(paths, reach=paths.reach & ~struck)
        yield from self._struck(replace(paths, reach=struck), sent, words[:, :, 1:])

    @property
    def _words(self) -> int:
        """Number of words drawn for a frame on its path to a receiver: whether it is struck, and how."""
        return 1

    def _drawn(self, sent: Sequence[SentFrame], numbers: Sequence[int], paths: Paths) -> Drawn:
        """The words for the frames with these ``numbers``, else 0."""
        words = np.zeros((*paths.reach.shape, self._words), np.uint64)
        for number in numbers if self._words else ():
            words[number] = self._draws.of_copies(sent[number], paths.version, *words.shape[1:])
        return words

    def _hits(self, sent: Sequence[SentFrame], words: Drawn) -> Mask:
        """True if the fault strikes frames on their paths to each receiver."""
        return each_below(words[:, :, 0], self.fault.rate)

    @abstractmethod
    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        """Paths that replace those struck; ``words`` are those after the first."""


class _Loss(LinkFault):
    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        yield from ()


class _Burst(_Loss):
    """Gilbert's chain for each sender and receiver: nothing passes in its bad state."""

    def __init__(self, fault: Fault, draws: Draws) -> None:
        super().__init__(fault, draws)
        self._chains: dict[int, tuple[int, NDArray[np.bool_]]] = {}

    @property
    def _words(self) -> int:
        return 0

    def _hits(self, sent: Sequence[SentFrame], words: Drawn) -> Mask:
        """By the state of the link; a frame that a bus has brought late meets that of the last in time."""
        return np.array([self._state(each, words.shape[1]) for each in sent])

    def _state(self, sent: SentFrame, receivers: int) -> NDArray[np.bool_]:
        start = self.fault.start
        known, is_bad = self._chains.get(sent.sender, (start - 1, np.zeros(receivers, np.bool_)))
        if len(is_bad) < receivers:
            known, is_bad = start - 1, np.zeros(receivers, np.bool_)
        for tick in range(known + 1, sent.tick + 1):
            is_bad = self._step(sent.sender, tick, is_bad)
        self._chains[sent.sender] = max(known, sent.tick), is_bad
        return is_bad[:receivers]

    def _step(self, sender: int, tick: int, is_bad: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Start in the stationary state; then bursts end, and new ones begin to keep their share."""
        share, length = self.fault.rate, self.fault.length
        words = self._draws.of_links(sender, tick, len(is_bad))
        if tick == self.fault.start:
            return each_below(words, share)
        goes_on = ~each_below(words, 1 / length)
        begins = each_below(words, share / (1 - share) / length)
        return np.where(is_bad, goes_on, begins)


class _Delay(LinkFault):
    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        yield replace(paths, delay=paths.delay + self.fault.ticks)


class _Duplicate(LinkFault):
    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        """The same, and copies, whose version has one more bit: that of this among faults of its kind."""
        yield paths
        version = paths.version | 1 << self._draws.number
        yield replace(paths, delay=paths.delay + self.fault.ticks, version=version)


class _Reorder(LinkFault):
    @property
    def _words(self) -> int:
        return 2

    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        above_0 = (words[:, :, 0] >> np.uint64(11)) + np.uint64(1)
        yield replace(paths, places=above_0.astype(np.float64) * 2.0**-53)


class _Corrupt(LinkFault):
    @property
    def _words(self) -> int:
        return 1 + self.fault.bits

    def _struck(self, paths: Paths, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Paths]:
        widths = np.array([8 * min(len(each.frame.data), FRAME_BYTES) for each in sent], np.int64)
        flips = np.zeros(paths.reach.shape, np.uint64) if paths.flips is None else paths.flips.copy()
        flips[paths.reach] ^= choices(widths[paths.reach.nonzero()[0]], words[paths.reach])
        yield replace(paths, flips=flips)


LINK_FAULTS: dict[FaultKind, Callable[[Fault, Draws], LinkFault]] = {
    FaultKind.LOSS: _Loss,
    FaultKind.BURST: _Burst,
    FaultKind.DELAY: _Delay,
    FaultKind.DUPLICATE: _Duplicate,
    FaultKind.REORDER: _Reorder,
    FaultKind.CORRUPT: _Corrupt,
}


def choices(widths: NDArray[np.int64], words: Drawn) -> NDArray[np.uint64]:
    """For each row of ``words`` as many different bits of the lowest ``widths`` (up to 64), or all of them.

    All choices are equally likely up to 2**-52: Floyd's algorithm, with a remainder of each word.
    """
    one, chosen = np.uint64(1), np.zeros(len(widths), np.uint64)
    for bits_to_come, column in zip(range(words.shape[1], 0, -1), words.T, strict=True):
        exists = widths >= bits_to_come
        last = np.maximum(widths - bits_to_come, 0).astype(np.uint64)
        bit = one << column % (last + one)
        chosen |= np.where(exists, np.where(chosen & bit, one << last, bit), np.uint64(0))
    return chosen


@cache
def _limit(probability: float) -> int:
    """The number of words below ``probability`` times 2**64: with 1 all of them, with 0 none."""
    return math.ceil(Fraction(probability) * (_MAX_WORD + 1))


def below(words: Words, probability: float) -> bool:
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
