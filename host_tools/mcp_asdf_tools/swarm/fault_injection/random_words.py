"""Random 64-bit words that decide when a fault hits, and whom.

A word is the SHAKE-128 hash of the seed, the fault and what the word is for: the tick, the sender, the frame
and the receiver. It is not the next one of a sequence, so that it depends neither on what else is on the bus
nor on when frames arrive. Nor does it depend on the fault's rate: a fault with a larger rate hits wherever
one with a smaller rate does.
"""

from __future__ import annotations

import math
import struct
from enum import IntEnum
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mcp_asdf_tools.swarm.delivery import SentFrame

    RandomWords: TypeAlias = NDArray[np.uint64]

_KEY = struct.Struct("<IIIBBBB")
"""Layout of the 16 bytes that `FaultRandom._hash_bytes` hashes: the arguments that name a word, and a 0."""


class _Purpose(IntEnum):
    """Purposes of random words. The values are hashed, so that other ones would change every run."""

    NODE = 0
    FRAME = 2
    RECEIVERS = 3


class FaultRandom:
    """Source of the random words of one fault.

    Attributes:
        fault_number: Position of the fault among those of its kind, so that two of one kind draw other words.
    """

    def __init__(self, seed: int, fault_name: str, fault_number: int) -> None:
        """Prepare the hash. ``seed`` has up to 128 bits."""
        import hashlib  # noqa: PLC0415 (it loads slowly, and the help of faults needs none of it)

        self.fault_number = fault_number
        self._seeded_hash = hashlib.shake_128(
            seed.to_bytes(16, "little") + f"{fault_name} {fault_number}".encode()
        )

    def hit_word(self, node: int, tick: int) -> int:
        """Return the word that decides whether the fault hits a node in a tick."""
        word, _ = self._words_for_node(node, tick, 0)
        return word

    def content_word(self, node: int, tick: int, index: int) -> int:
        """Return the word that is the content of the frame of this index among a node's in a tick."""
        _, word = self._words_for_node(node, tick, index)
        return word

    def _words_for_node(self, node: int, tick: int, repetition: int) -> tuple[int, int]:
        """Return two words for a node in a tick; other repetitions have other words."""
        # 0 stands for the identifier and the copy number of a frame, as there is none.
        hash_bytes = self._hash_bytes(2, tick, repetition, 0, node, 0, _Purpose.NODE)
        return struct.unpack("<2Q", hash_bytes)

    def word_for_frame(self, sent_frame: SentFrame) -> int:
        """Return a word for a frame, the same for all of its receivers."""
        hash_bytes = self._hash_bytes(1, *_frame_key(sent_frame), 0, _Purpose.FRAME)
        return int.from_bytes(hash_bytes, "little")

    def words_for_receivers(
        self, sent_frame: SentFrame, copy_number: int, receiver_count: int, words_per_receiver: int
    ) -> RandomWords:
        """Return the words of one copy of a frame for each receiver, shape (receivers, words per receiver).

        A receiver's words are the same for every ``receiver_count``. Copies whose numbers are equal modulo
        256 share their words.
        """
        import numpy as np  # noqa: PLC0415 (it loads slowly, and the help of faults needs none of it)

        # The key has one byte for the copy number.
        key = (*_frame_key(sent_frame), copy_number % 256, _Purpose.RECEIVERS)
        hash_bytes = self._hash_bytes(receiver_count * words_per_receiver, *key)
        return np.frombuffer(hash_bytes, "<u8").reshape(receiver_count, words_per_receiver)

    def _hash_bytes(self, word_count: int, *key: int) -> bytes:
        """Return the bytes of ``word_count`` words.

        The key is the tick, the repetition, a CAN identifier, a node, a copy number and the purpose.
        """
        # A copy, as the hash of seed and fault serves for every word.
        keyed_hash = self._seeded_hash.copy()
        keyed_hash.update(_KEY.pack(*key, 0))
        return keyed_hash.digest(8 * word_count)


def _frame_key(sent_frame: SentFrame) -> tuple[int, int, int, int]:
    """Return the numbers of a key that identify a sent frame."""
    return sent_frame.tick, sent_frame.repetition, sent_frame.frame.arbitration_id, sent_frame.sender


@cache
def hit_threshold(probability: float) -> int:
    """Return the largest 64-bit word that is a hit, so that this share of all 2**64 words are hits.

    For a probability of 0 that is -1, which is below every word.
    """
    return math.ceil(Fraction(probability) * 2**64) - 1


def choose_bits(bit_counts: NDArray[np.int64], random_words: RandomWords) -> NDArray[np.uint64]:
    """Choose different bits at random in each of many words, with Floyd's algorithm.

    Args:
        bit_counts: From how many of the lowest bits to choose in each word, at most 64, shape (words,).
        random_words: A random word for each bit to choose, shape (words, bits to choose).

    Returns:
        The masks of the chosen bits, shape (words,). Where more bits are to be chosen than there are, it has
        all of them. All choices are equally likely up to 2**-52.
    """
    import numpy as np  # noqa: PLC0415 (it loads slowly, and the help of faults needs none of it)

    lowest_bit = np.uint64(1)
    chosen_bits = np.zeros(len(bit_counts), np.uint64)
    bits_to_choose = random_words.shape[1]
    for turn in range(bits_to_choose):
        # Draw one of the bits 0 to top_bit. If an earlier turn has chosen it, take top_bit, which is one
        # higher than in the turn before and so cannot have been drawn yet.
        turns_left = bits_to_choose - turn
        top_bit = np.maximum(bit_counts - turns_left, 0).astype(np.uint64)
        drawn_bit = lowest_bit << (random_words[:, turn] % (top_bit + lowest_bit))
        is_chosen_already = chosen_bits & drawn_bit
        new_bit = np.where(is_chosen_already, lowest_bit << top_bit, drawn_bit)
        has_top_bit = bit_counts >= turns_left
        chosen_bits |= np.where(has_top_bit, new_bit, np.uint64(0))
    return chosen_bits
