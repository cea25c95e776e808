"""State of a fault in a run, and the random 64-bit words that decide when it hits, and whom.

A word is the SHAKE-128 hash of the seed, the fault and what the word is for: the tick, the sender, the frame
and the receiver. It is not the next one of a sequence, so that it depends neither on what else is on the bus
nor on when frames arrive. Nor does it depend on the fault's rate: a fault with a larger rate hits wherever
one with a smaller rate does.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from enum import IntEnum
from fractions import Fraction
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mcp_asdf_tools.bus.frames import FrameFormat
from mcp_asdf_tools.swarm.delivery import Deliveries, ReceiverMask, SentFrame
from mcp_asdf_tools.swarm.fault_injection.fault import Fault

RandomWords: TypeAlias = NDArray[np.uint64]

_KEY_LAYOUT = struct.Struct("<IIIBBBx")
"""Layout of a ``_Key`` in 16 bytes."""
_BYTES_IN_WORD = 8


class _Purpose(IntEnum):
    """Purposes of random words. The values are hashed, so other values would change every run."""

    NODE = 0
    FRAME = 2
    RECEIVERS = 3


class _Key(NamedTuple):
    """What random words are for. The values are hashed in this order."""

    tick: int
    repetition: int
    identifier: int
    node: int
    copy_number: int
    purpose: _Purpose


class FaultRun:
    """State of a fault in a run: decides when it hits, and remembers what the fault needs from call to call.

    Attributes:
        fault: The fault.
        fault_number: Position among the faults of its kind, so that two faults of one kind draw different
            words.
        frame_format: Format of the robots' estimates.
        hit_count: Hits so far: ticks for outages, frames for all other kinds.
        memory: What the kind of fault remembers of each node, by id.
    """

    def __init__(self, fault: Fault, fault_number: int, seed: int, frame_format: FrameFormat) -> None:
        """Begin a run whose random words differ from those of all other faults; ``seed`` has 128 bits."""
        self.fault = fault
        self.fault_number = fault_number
        self.frame_format = frame_format
        self.hit_count = 0
        self.memory: dict[int, Any] = {}
        self._seeded_hash = hashlib.shake_128(
            seed.to_bytes(16, "little") + f"{fault.name} {fault_number}".encode()
        )
        # The lowest words are hits, so many that their share of all 2**64 words is the rate.
        hit_word_count = math.ceil(Fraction(fault.rate) * 2**64)
        self._largest_hit = hit_word_count - 1
        """Largest word that is a hit; -1, below all words, at a rate of 0."""

    def hits_node(self, node: int, tick: int) -> bool:
        """Return whether the fault is active for a node and hits it in this tick. Counts nothing."""
        if not self.fault.is_active(tick, node):
            return False
        [word] = self._words_for_node(1, tick, node)
        return bool(word <= self._largest_hit)

    def content_word(self, node: int, tick: int, index: int) -> int:
        """Return the content of a random frame.

        ``index`` is its number among the random frames that the node sends in the tick.
        """
        # The first of the two words of index 0 decides whether the node is hit.
        _hit_word, content_word = self._words_for_node(2, tick, node, repetition=index)
        return int(content_word)

    def hits_frame(self, sent_frame: SentFrame) -> bool:
        """Return whether the fault is active for a frame's sender and hits the frame, and count the hit."""
        if not self.fault.is_active(sent_frame.tick, sent_frame.sender):
            return False
        [word] = self._words_for_frame(1, _Purpose.FRAME, sent_frame)
        is_hit = bool(word <= self._largest_hit)
        if is_hit:
            self.hit_count += 1
        return is_hit

    def hits_receivers(self, deliveries: Deliveries, words_per_receiver: int) -> ReceiverMask:
        """Return a mask that says for which of its receivers each frame is hit.

        The first of a receiver's words decides. Frames for which the fault is not active are not hit. Counts
        nothing. O(frames receivers).
        """
        is_hit = np.zeros_like(deliveries.receivers)
        for index, sent_frame in enumerate(deliveries.sent_frames):
            if self.fault.is_active(sent_frame.tick, sent_frame.sender):
                words = self._words_for_receivers(deliveries, index, words_per_receiver)
                first_words = words[:, 0]  # each robot of the swarm has one, receiver or not
                is_hit[index] = deliveries.receivers[index] & (first_words <= self._largest_hit)
        return is_hit

    def _words_for_receivers(
        self, deliveries: Deliveries, index: int, words_per_receiver: int
    ) -> RandomWords:
        """Return random words of frame ``index`` for each receiver, shape (receivers, words per receiver).

        A copy of a frame that a fault has duplicated gets other words than the frame itself, unless their
        copy numbers are equal modulo 256.
        """
        _, receiver_count = deliveries.receivers.shape
        words = self._words_for_frame(
            receiver_count * words_per_receiver,
            _Purpose.RECEIVERS,
            deliveries.sent_frames[index],
            deliveries.copy_number % 256,  # it has one byte in the key
        )
        return words.reshape(receiver_count, words_per_receiver)

    def corrupt(self, hit: Deliveries, words_per_receiver: int) -> Deliveries:
        """Return deliveries in which each receiver of a frame has a copy for itself, with flipped bits.

        The first of a receiver's words has decided on the hit, and each of the others chooses a bit.
        """
        corrupted_frames: list[SentFrame] = []
        receiver_of_frame: list[int] = []  # the one receiver of each corrupted frame
        for index, sent_frame in enumerate(hit.sent_frames):
            words_by_receiver = self._words_by_receiver(hit, index, words_per_receiver)
            for receiver, words in words_by_receiver.items():
                _hit_word, *words_for_bits = words
                corrupted_frames.append(_with_bits_flipped(sent_frame, words_for_bits))
                receiver_of_frame.append(receiver)
        _, robot_count = hit.receivers.shape
        only_receiver = np.eye(robot_count, dtype=np.bool_)  # row i is true for robot i alone
        return replace(hit, sent_frames=corrupted_frames, receivers=only_receiver[receiver_of_frame])

    def _words_by_receiver(
        self, deliveries: Deliveries, index: int, words_per_receiver: int
    ) -> dict[int, list[int]]:
        """Return random words of frame ``index`` for the robots that receive it, by id, in rising order.

        They are those of ``_words_for_receivers``, which are not drawn if nobody receives the frame.
        """
        receivers = np.flatnonzero(deliveries.receivers[index]).tolist()
        if not receivers:
            return {}
        words = self._words_for_receivers(deliveries, index, words_per_receiver)
        return {receiver: words[receiver].tolist() for receiver in receivers}

    def _words_for_node(self, count: int, tick: int, node: int, repetition: int = 0) -> RandomWords:
        """Return ``count`` words for a node in a tick; other repetitions have other words."""
        # The words are for no frame that is there already, so that it has no identifier and no copies.
        key = _Key(tick, repetition, identifier=0, node=node, copy_number=0, purpose=_Purpose.NODE)
        return self._words(count, key)

    def _words_for_frame(
        self, count: int, purpose: _Purpose, sent_frame: SentFrame, copy_number: int = 0
    ) -> RandomWords:
        """Return ``count`` words for a frame, or for a copy of it that a fault has made."""
        key = _Key(
            tick=sent_frame.tick,
            repetition=sent_frame.repetition,
            identifier=sent_frame.frame.arbitration_id,
            node=sent_frame.sender,
            copy_number=copy_number,
            purpose=purpose,
        )
        return self._words(count, key)

    def _words(self, count: int, key: _Key) -> RandomWords:
        """Return ``count`` words, which follow from the seed, the fault and the key."""
        keyed_hash = self._seeded_hash.copy()  # a copy, as the hash of seed and fault serves for every word
        keyed_hash.update(_KEY_LAYOUT.pack(*key))
        return np.frombuffer(keyed_hash.digest(_BYTES_IN_WORD * count), "<u8")


def _with_bits_flipped(sent_frame: SentFrame, random_words: Sequence[int]) -> SentFrame:
    """Return a frame with as many bits of its data flipped as there are random words, which choose them."""
    data = sent_frame.frame.data
    flips = choose_bits(8 * len(data), random_words)
    # A copy, since other receivers get the frame as it was sent.
    corrupted_frame = copy(sent_frame.frame)
    corrupted_data = int.from_bytes(data, "little") ^ flips
    corrupted_frame.data = bytearray(corrupted_data.to_bytes(len(data), "little"))
    return replace(sent_frame, frame=corrupted_frame)


def choose_bits(bit_count: int, random_words: Sequence[int]) -> int:
    """Return a mask of as many different bits as there are random words, by Floyd's algorithm.

    The bits are among the lowest ``bit_count``. If these are fewer than the words, the mask has all of them.
    All choices are equally likely up to 2**-52.
    """
    mask = 0
    for turn, word in enumerate(random_words, start=1):
        # Candidates are the lowest bits: one more in each turn, and all bits in the last.
        turns_left = len(random_words) - turn
        candidate_count = bit_count - turns_left
        if candidate_count <= 0:  # there are more words than bits
            continue
        drawn_bit = 1 << (word % candidate_count)
        newest_candidate = 1 << (candidate_count - 1)
        # In place of a bit that is in the mask already the newest candidate joins, which cannot be in it.
        is_in_mask = mask & drawn_bit != 0
        mask |= newest_candidate if is_in_mask else drawn_bit
    return mask
