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
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mcp_asdf_tools.swarm.delivery import SentFrame

    RandomWords: TypeAlias = NDArray[np.uint64]

_KEY_LAYOUT = struct.Struct("<IIIBBBB")
"""Layout of the 16 bytes that `FaultRandom._hash_bytes` hashes: the attributes of a `_WordKey`, and a 0."""
_BYTES_IN_WORD = 8


class _Purpose(IntEnum):
    """Purposes of random words. The values are hashed, so other values would change every run."""

    NODE = 0
    FRAME = 2
    RECEIVERS = 3


class _WordKey(NamedTuple):
    """What random words are for; 0 stands for what they have not.

    Attributes:
        tick: Tick in which they are needed.
        repetition: Number of earlier frames of the sender in this tick with the same identifier.
        identifier: CAN identifier of the frame.
        node: The node, or the sender of the frame.
        copy_number: Which copy of a duplicated frame it is, below 256.
        purpose: What the words decide.
    """

    tick: int
    repetition: int
    identifier: int
    node: int
    copy_number: int
    purpose: _Purpose


class FaultRandom:
    """Source of the random words of one fault.

    Attributes:
        fault_number: Position among the faults of its kind, so that two faults of one kind draw different
            words.
    """

    def __init__(self, seed: int, fault_name: str, fault_number: int) -> None:
        """Prepare random words for one fault of a run, which differ from those of all its other faults.

        ``fault_name`` is the kind of the fault, and ``fault_number`` counts the faults of this kind from 0.
        ``seed`` has up to 128 bits.
        """
        import hashlib  # noqa: PLC0415 (it loads slowly, and the help of faults needs none of it)

        self.fault_number = fault_number
        self._seeded_hash = hashlib.shake_128(
            seed.to_bytes(16, "little") + f"{fault_name} {fault_number}".encode()
        )

    def hit_word(self, node: int, tick: int) -> int:
        """Return the word that decides whether the fault hits a node in a tick."""
        hit_word, _ = self._words_for_node(node, tick, repetition=0)
        return hit_word

    def content_word(self, node: int, tick: int, index: int) -> int:
        """Return the word that is the content of the frame of this index among a node's in a tick."""
        _, content_word = self._words_for_node(node, tick, repetition=index)
        return content_word

    def _words_for_node(self, node: int, tick: int, repetition: int) -> tuple[int, int]:
        """Return two words for a node in a tick: for the decision on a hit, and for the content of a frame.

        Other repetitions have other words. Both are for no frame on the bus, so that identifier and copy
        number are 0.
        """
        key = _WordKey(
            tick=tick, repetition=repetition, identifier=0, node=node, copy_number=0, purpose=_Purpose.NODE
        )
        return struct.unpack("<2Q", self._hash_bytes(key, word_count=2))

    def word_for_frame(self, sent_frame: SentFrame) -> int:
        """Return a word for a frame, the same for all of its receivers."""
        key = _key_of_frame(sent_frame, copy_number=0, purpose=_Purpose.FRAME)
        hash_bytes = self._hash_bytes(key, word_count=1)
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
        key = _key_of_frame(sent_frame, copy_number=copy_number % 256, purpose=_Purpose.RECEIVERS)
        hash_bytes = self._hash_bytes(key, word_count=receiver_count * words_per_receiver)
        return np.frombuffer(hash_bytes, "<u8").reshape(receiver_count, words_per_receiver)

    def _hash_bytes(self, key: _WordKey, word_count: int) -> bytes:
        """Return the bytes of ``word_count`` words, which seed, fault and ``key`` decide."""
        keyed_hash = self._seeded_hash.copy()  # a copy, as the hash of seed and fault serves for every word
        spare_byte = 0
        keyed_hash.update(_KEY_LAYOUT.pack(*key, spare_byte))
        return keyed_hash.digest(_BYTES_IN_WORD * word_count)


def _key_of_frame(sent_frame: SentFrame, copy_number: int, purpose: _Purpose) -> _WordKey:
    """Return the key of words for a sent frame; a ``copy_number`` of 0 stands for the frame itself."""
    return _WordKey(
        tick=sent_frame.tick,
        repetition=sent_frame.repetition,
        identifier=sent_frame.frame.arbitration_id,
        node=sent_frame.sender,
        copy_number=copy_number,
        purpose=purpose,
    )


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
        The masks of the chosen bits, shape (words,). If more bits are to be chosen than there are, the mask
        has all bits. All choices are equally likely up to 2**-52.
    """
    import numpy as np  # noqa: PLC0415 (it loads slowly, and the help of faults needs none of it)

    one = np.uint64(1)
    chosen_bits = np.zeros(len(bit_counts), np.uint64)
    bits_to_choose = random_words.shape[1]
    for turn in range(bits_to_choose):
        # Draw a candidate. Candidates are the lowest bits: one more in each turn, and all bits in the last.
        # If an earlier turn has chosen this bit, take the highest candidate, which is new in this turn.
        turns_left = bits_to_choose - 1 - turn
        candidate_counts = bit_counts - turns_left
        has_candidates = candidate_counts > 0
        # A word without candidates needs a divisor, too; what it draws is left out below.
        divisors = np.maximum(candidate_counts, 1).astype(np.uint64)
        drawn_bit = one << (random_words[:, turn] % divisors)
        highest_candidate = one << (divisors - one)
        is_chosen_already = (chosen_bits & drawn_bit) != 0
        new_bit = np.where(is_chosen_already, highest_candidate, drawn_bit)
        chosen_bits |= np.where(has_candidates, new_bit, np.uint64(0))
    return chosen_bits
