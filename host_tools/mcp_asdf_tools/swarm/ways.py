"""Faults of frames on their way to each receiver, for all frames and receivers of a tick at once."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import can
import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.swarm.fault_injectors import Draws, Injector, each_below
from mcp_asdf_tools.swarm.fault_spec import Fault, FaultKind
from mcp_asdf_tools.swarm.transmission import SentFrame

Mask = NDArray[np.bool_]
"""One value for each frame of a tick and each receiver, by id, shape (frames, receivers)."""


@dataclass(frozen=True)
class Ways:
    """Frames of one tick on ways of one kind to the receivers in range.

    Attributes:
        reach: Whether a frame reaches a receiver on such a way.
        delay: Ticks that it takes.
        version: Number that tells copies for one receiver apart.
        places: Where in its tick a frame arrives, above 0 up to 1, shape (frames, receivers); None for
            its turn.
        damaged: Frames that arrive instead of those sent, by (frame, receiver); for all that reach, or none.
    """

    reach: Mask
    delay: int = 0
    version: int = 0
    places: NDArray[np.float64] | None = None
    damaged: Mapping[tuple[int, int], can.Message] = field(default_factory=dict)

    def to(self, receiver: int, sent: Sequence[SentFrame]) -> list[tuple[float, can.Message]]:
        """The frames that reach ``receiver``, each with its place, 0 for its turn."""
        return [
            (
                0.0 if self.places is None else float(self.places[number, receiver]),
                self.damaged.get((number, receiver), sent[number].frame),
            )
            for number in self.reach[:, receiver].nonzero()[0].tolist()
        ]


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
        if numbers:
            struck[numbers] &= self._hits([sent[number] for number in numbers], ways.version, struck.shape[1])
        self.injected += int(np.count_nonzero(struck))
        yield replace(ways, reach=ways.reach & ~struck)
        yield from self._struck(replace(ways, reach=struck), sent)

    def _hits(self, sent: Sequence[SentFrame], version: int, receivers: int) -> Mask:
        """Whether the fault strikes frames on their ways to each receiver: by draws of their own."""
        rows = [self._draws.of_copies(each, version, receivers) for each in sent]
        return each_below(np.array(rows), self.fault.rate)

    @abstractmethod
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        """Ways that replace those struck."""


class _Loss(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        yield from ()


class _Burst(_Loss):
    """Gilbert's chain for each sender and receiver: nothing passes in its bad state."""

    def __init__(self, fault: Fault, draws: Draws) -> None:
        super().__init__(fault, draws)
        self._chains: dict[int, tuple[int, NDArray[np.bool_]]] = {}

    def _hits(self, sent: Sequence[SentFrame], version: int, receivers: int) -> Mask:
        """By the state of the link; a frame that a bus has brought late meets that of the last in time."""
        return np.array([self._state(each, receivers) for each in sent])

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
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        yield replace(ways, delay=ways.delay + self.fault.ticks)


class _Duplicate(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        """The same, and copies, whose version has one more bit: that of this among faults of its kind."""
        yield ways
        version = ways.version | 1 << self._draws.number
        yield replace(ways, delay=ways.delay + self.fault.ticks, version=version)


class _Reorder(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        words = [self._draws.of_places(each, ways.version, ways.reach.shape[1]) for each in sent]
        if words:
            above_0 = (np.array(words) >> np.uint64(11)) + np.uint64(1)
            yield replace(ways, places=above_0.astype(np.float64) * 2.0**-53)


class _Corrupt(OnTheWay):
    def _struck(self, ways: Ways, sent: Sequence[SentFrame]) -> Iterator[Ways]:
        yield replace(
            ways,
            damaged={
                (number, receiver): self._flip(
                    ways.damaged.get((number, receiver), sent[number].frame),
                    self._draws.of_copy(sent[number], ways.version, receiver),
                )
                for number, receiver in zip(*(each.tolist() for each in ways.reach.nonzero()), strict=True)
            },
        )

    def _flip(self, frame: can.Message, drawn: int) -> can.Message:
        """The frame with different bits."""
        damaged, width = copy.copy(frame), 8 * len(frame.data)
        flips = _choice(width, min(self.fault.bits, width), drawn)
        data = int.from_bytes(frame.data, "little") ^ flips
        damaged.data = bytearray(data.to_bytes(width // 8, "little"))
        return damaged


ON_THE_WAY: dict[FaultKind, Callable[[Fault, Draws], OnTheWay]] = {
    FaultKind.LOSS: _Loss,
    FaultKind.BURST: _Burst,
    FaultKind.DELAY: _Delay,
    FaultKind.DUPLICATE: _Duplicate,
    FaultKind.REORDER: _Reorder,
    FaultKind.CORRUPT: _Corrupt,
}


def _choice(width: int, count: int, drawn: int) -> int:
    """``count`` different bits of ``width`` (at most 64), by a draw of 512 bits.

    All choices are equally likely up to 2**-100.
    """
    places, chosen = list(range(width)), 0
    for _ in range(count):
        drawn, at = divmod(drawn, len(places))
        chosen |= 1 << places.pop(at)
    return chosen
