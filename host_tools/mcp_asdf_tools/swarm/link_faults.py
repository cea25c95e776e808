"""Faults of frames on their path to each receiver, for all frames and receivers of a tick at once.

``Draws`` and ``Injector`` are those of all faults; the faults of nodes are in ``faults``.
"""

from __future__ import annotations

import hashlib
import math
import struct
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frame_layout import FRAME_BYTES
from mcp_asdf_tools.swarm.delivery import Paths, SentFrame
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind

Drawn = NDArray[np.uint64]
"""Random words of 64 bits, the last axis those for one purpose."""

LINK_FAULTS = (FaultKind.LOSS, FaultKind.DELAY, FaultKind.DUPLICATE, FaultKind.CORRUPT)

_KEY = struct.Struct("<IIIBBBB")
_NODE, _FRAME, _COPIES = 0, 2, 3
"""Subjects of draws. Their numbers are part of the keys, so that other ones would draw other words."""


class Draws:
    """Random words of one fault; ``number`` distinguishes faults of one kind.

    Where each receiver has words of its own, receiver i has them however many receivers are asked for.

    Attributes:
        number: As given.
    """

    def __init__(self, seed: int, kind: FaultKind, number: int) -> None:
        self.number = number
        self._hash = hashlib.shake_128(seed.to_bytes(16, "little") + f"{kind.value} {number}".encode())

    def of_node(self, node: int, tick: int, number: int = 0) -> tuple[int, int]:
        """Two words of a node in a tick."""
        return struct.unpack("<2Q", self._digest(2, tick, number, 0, node, 0, _NODE, 0))

    def of_frame(self, sent: SentFrame) -> int:
        """A word of a frame."""
        return int.from_bytes(self._digest(1, *_frame_key(sent), 0, _FRAME, 0), "little")

    def of_copies(self, sent: SentFrame, version: int, receivers: int, words: int) -> Drawn:
        """``words`` words of the copy of a frame for each receiver, shape (receivers, words).

        ``version`` counts copies for the same receiver.
        """
        key = *_frame_key(sent), version % 256, _COPIES, 0
        return np.frombuffer(self._digest(receivers * words, *key), "<u8").reshape(receivers, words)

    def _digest(self, words: int, *key: int) -> bytes:
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
        self.injected = 0
        self._draws = draws

    def _strikes_node(self, node: int, tick: int) -> bool:
        """True if the fault strikes a node of its schedule."""
        return self._draws.of_node(node, tick)[0] <= last_word(self.fault.rate)

    def _strikes(self, sent: SentFrame) -> bool:
        """True if the fault strikes a frame of its schedule, which counts."""
        is_on = self.fault.is_on(sent.tick, sent.sender)
        strikes = is_on and self._draws.of_frame(sent) <= last_word(self.fault.rate)
        self.injected += strikes
        return strikes


class LinkFault(Injector):
    """Loss, delay, duplicate and corrupt: they act on a frame on its path to each receiver."""

    def act(self, paths: Paths) -> list[Paths]:
        """Paths that replace some that earlier faults have left. O(frames robots)."""
        fault, version = self.fault, paths.version
        is_on = np.array([fault.is_on(each.tick, each.sender) for each in paths.sent], np.bool_)
        words = self._drawn(paths, is_on)
        struck = paths.reach & is_on[:, np.newaxis] & (words[:, :, 0] <= last_word(fault.rate))
        if fault.receivers is not None:
            struck &= np.isin(np.arange(struck.shape[1]), list(fault.receivers))
        self.injected += int(np.count_nonzero(struck))
        spared, hit = replace(paths, reach=paths.reach & ~struck), replace(paths, reach=struck)
        later = replace(hit, delay=paths.delay + fault.ticks)
        if fault.kind is FaultKind.LOSS:
            return [spared]
        if fault.kind is FaultKind.DELAY:
            return [spared, later]
        if fault.kind is FaultKind.DUPLICATE:
            # A copy's version has one more bit: that of this fault among those of its kind.
            return [spared, hit, replace(later, version=version | 1 << self._draws.number)]
        return [spared, _damaged(hit, words[:, :, 1:])]

    def _drawn(self, paths: Paths, is_on: NDArray[np.bool_]) -> Drawn:
        """Words for each frame that ``is_on`` and robot, else 0: whether it is struck, and which bits."""
        bits = self.fault.bits if self.fault.kind is FaultKind.CORRUPT else 0
        words = np.zeros((*paths.reach.shape, 1 + bits), np.uint64)
        for number in np.flatnonzero(is_on).tolist():
            words[number] = self._draws.of_copies(paths.sent[number], paths.version, *words.shape[1:])
        return words


def _damaged(paths: Paths, words: Drawn) -> Paths:
    """A frame for each receiver, of which each word flips another bit of the data."""
    numbers, receivers = paths.reach.nonzero()
    reach = np.zeros((len(numbers), paths.reach.shape[1]), np.bool_)
    reach[np.arange(len(numbers)), receivers] = True
    sent = [paths.sent[number] for number in numbers.tolist()]
    widths = np.array([8 * min(len(each.frame.data), FRAME_BYTES) for each in sent], np.int64)
    flips = paths.flips[numbers] ^ choices(widths, words[numbers, receivers])
    return replace(paths, sent=sent, reach=reach, flips=flips)


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
def last_word(probability: float) -> int:
    """The largest word that strikes with this probability; -1 if none does."""
    return math.ceil(Fraction(probability) * 2**64) - 1
