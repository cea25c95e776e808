"""Faults of frames on their way to each receiver, for all frames and receivers of a tick at once."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus import FRAME_BYTES
from mcp_asdf_tools.swarm.fault_injectors import Draws, Injector, each_below
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.transmission import SentFrame

Mask = NDArray[np.bool_]
"""One value for each frame of a tick and each receiver, by id, shape (frames, receivers)."""

Drawn = NDArray[np.uint64]
"""Random words for each of these, shape (frames, receivers, words)."""


@dataclass(frozen=True)
class Ways:
    """Frames of one tick on ways of one kind to the receivers in range.

    Attributes:
        reach: Whether a frame reaches a receiver on such a way.
        delay: Ticks that it takes.
        version: Number that tells copies for one receiver apart.
        places: Where in its tick a frame arrives, above 0 up to 1, shape (frames, receivers); None for
            its turn.
        flips: Bits of the data that arrive flipped, the lowest that of the first byte, shape (frames,
            receivers); None if none do.
    """

    reach: Mask
    delay: int = 0
    version: int = 0
    places: NDArray[np.float64] | None = None
    flips: NDArray[np.uint64] | None = None


class OnTheWay(Injector, ABC):
    """Fault that acts on a frame on its way to one receiver."""

    def act(self, sent: Sequence[SentFrame], ways: Sequence[Ways]) -> list[Ways]:
        """Ways of the frames ``sent`` that replace those left by earlier faults. O(frames receivers)."""
        after = [way for each in ways for way in self._act(sent, each)]
        return [each for each in after if each.reach.any()]

    def _act(self, sent: Sequence[SentFrame], ways: Ways) -> Iterator[Ways]:
        struck = ways.reach.copy()
        numbers = [
            number
            for number, each in enumerate(sent)
            if not each.frame.is_error_frame and self.fault.is_on(each.tick, each.sender)
        ]
        if len(numbers) < len(sent):
            struck[np.isin(np.arange(len(sent)), numbers, invert=True)] = False
        if self.fault.receivers is not None:
            struck &= np.isin(np.arange(struck.shape[1]), list(self.fault.receivers))
        words = self._drawn(sent, numbers, ways)
        if numbers:
            struck[numbers] &= self._hits([sent[number] for number in numbers], words[numbers])
        self.injected += int(np.count_nonzero(struck))
        yield replace(ways, reach=ways.reach & ~struck)
        yield from self._struck(replace(ways, reach=struck), sent, words[:, :, 1:])

    @property
    def _words(self) -> int:
        """Number of words drawn for a frame on its way to a receiver: whether it is struck, and how."""
        return 1

    def _drawn(self, sent: Sequence[SentFrame], numbers: Sequence[int], ways: Ways) -> Drawn:
        """The words for the frames with these ``numbers``, else 0."""
        words = np.zeros((*ways.reach.shape, self._words), np.uint64)
        for number in numbers if self._words else ():
            words[number] = self._draws.of_copies(sent[number], ways.version, *words.shape[1:])
        return words

    def _hits(self, sent: Sequence[SentFrame], words: Drawn) -> Mask:
        """True if the fault strikes frames on their ways to each receiver."""
        return each_below(words[:, :, 0], self.fault.rate)

    @abstractmethod
    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
        """Ways that replace those struck; ``words`` are those after the first."""


class _Loss(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
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


class _Delay(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
        yield replace(ways, delay=ways.delay + self.fault.ticks)


class _Duplicate(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
        """The same, and copies, whose version has one more bit: that of this among faults of its kind."""
        yield ways
        version = ways.version | 1 << self._draws.number
        yield replace(ways, delay=ways.delay + self.fault.ticks, version=version)


class _Reorder(OnTheWay):
    @property
    def _words(self) -> int:
        return 2

    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
        above_0 = (words[:, :, 0] >> np.uint64(11)) + np.uint64(1)
        yield replace(ways, places=above_0.astype(np.float64) * 2.0**-53)


class _Corrupt(OnTheWay):
    @property
    def _words(self) -> int:
        return 1 + self.fault.bits

    def _struck(self, ways: Ways, sent: Sequence[SentFrame], words: Drawn) -> Iterator[Ways]:
        widths = np.array([8 * min(len(each.frame.data), FRAME_BYTES) for each in sent], np.int64)
        flips = np.zeros(ways.reach.shape, np.uint64) if ways.flips is None else ways.flips.copy()
        flips[ways.reach] ^= choices(widths[ways.reach.nonzero()[0]], words[ways.reach])
        yield replace(ways, flips=flips)


ON_THE_WAY: dict[FaultKind, Callable[[Fault, Draws], OnTheWay]] = {
    FaultKind.LOSS: _Loss,
    FaultKind.BURST: _Burst,
    FaultKind.DELAY: _Delay,
    FaultKind.DUPLICATE: _Duplicate,
    FaultKind.REORDER: _Reorder,
    FaultKind.CORRUPT: _Corrupt,
}


def flipped(frame: can.Message, flips: int) -> can.Message:
    """The frame with these bits of its data flipped, the lowest that of the first byte."""
    damaged, length = copy.copy(frame), len(frame.data)
    data = int.from_bytes(frame.data, "little") ^ flips
    damaged.data = bytearray(data.to_bytes(length, "little"))
    return damaged


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
