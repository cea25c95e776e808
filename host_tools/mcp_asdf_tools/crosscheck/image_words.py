"""Which word of a saved robot's image holds what, and how numbers of other sizes than 32 bits are packed.

An image consists of words of 32 bits (``mcp_asdf_image.c``). With any of the paper's filters there are 31:

    0         version of the layout, with a flag for the robust filter
    1 .. 6    b_hat, t, n, x_hat, alpha, rounds until the filter runs next
    7 .. 12   sums over the closed round: alpha, alpha_x_low, alpha_x_high, of two words each
    13 .. 22  sums over the open round: the same three and x_squared of two words each, then x and count
    23 .. 26  senders of the open round, a bit for each id
    27        accepted messages (bits 0 to 15), repeated messages (16 to 31)
    28        rejected messages (bits 0 to 15), tests (16 to 31)
    29        updates of b_hat (bits 0 to 15), whether b_hat is newer than x_hat (16 to 23), id (24 to 31)
    30        checksum

With the robust filter there are 39. Words 7 to 14 hold what this filter remembers, words 15 to 30 the
estimates of two slots each, and the senders follow from word 31 on. The functions here return words by their
index, as ``restore`` calls of a scenario take them.
"""

from __future__ import annotations

from dataclasses import dataclass

from mcp_asdf.image_format import image_word_count
from mcp_asdf.robot import MAX_ID, Sums

B_HAT_WORD, T_WORD, N_WORD, X_HAT_WORD, ALPHA_WORD, FILTER_LEFT_WORD = range(1, 7)
CLOSED_ROUND_WORD = 7
"""First word of the sums over the closed round."""
OPEN_ROUND_WORD = 13
"""First word of the sums over the open round."""

MAX_16_BITS, MAX_32_BITS = 0xFFFF, 0xFFFFFFFF
"""Largest number of 16 and of 32 bits."""


@dataclass(frozen=True)
class ImageLayout:
    """Indices of the words at the end of an image, which depend on its length.

    Attributes:
        word_count: Number of words of the image.
    """

    word_count: int

    @property
    def accepted_and_repeated_word(self) -> int:
        """Index of the word of the counters of accepted and of repeated messages."""
        return self.word_count - 4

    @property
    def rejected_and_tests_word(self) -> int:
        """Index of the word of the counters of rejected messages and of tests."""
        return self.word_count - 3

    @property
    def updates_and_id_word(self) -> int:
        """Index of the word of the counter of updates, the flag of a b_hat newer than x_hat, and the id."""
        return self.word_count - 2

    def pack_sender(self, sender: int) -> dict[int, int]:
        """Return the word of the open round's senders, by its index, with the bit of this id alone set."""
        # Four words of senders are followed by three with the counters, and by the checksum.
        first_senders_word = self.word_count - 8
        word_index = first_senders_word + sender // 32
        return {word_index: 1 << (sender % 32)}


def layout_of(filter_number: int) -> ImageLayout:
    """Return where the last words are in an image of a robot with this filter, a number of `Filter`."""
    return ImageLayout(image_word_count(filter_number))


def pack_pair(low_half: int, high_half: int) -> int:
    """Return a word with one number of 16 bits in its lower half and another in its upper half."""
    return low_half | (high_half << 16)


def pack_updates_and_id(robot_id: int, updated: int = 0, updates: int = 0) -> int:
    """Return the word before the checksum of an image: counter, flag and id, from the lowest bit up.

    Args:
        robot_id: Id of the robot, 8 bits.
        updated: 1 if b_hat has changed since x_hat and alpha were computed from t, n and b_hat; otherwise 0.
            It has 8 bits, so an image may hold other numbers, which a firmware must refuse.
        updates: Number of changes of b_hat, 16 bits.
    """
    return updates | (updated << 16) | (robot_id << 24)


def split_in_words(number: int) -> list[int]:
    """Return a number of 64 bits as two words, the lower one first."""
    return [number & MAX_32_BITS, number >> 32]


def pack_closed_round(sums: Sums) -> dict[int, int]:
    """Return words 7 to 12 of an image, by index, for a robot whose last closed round has these sums.

    They are alpha, alpha_x_low and alpha_x_high, in this order, of two words each. A closed round keeps no
    other sums.
    """
    words = [
        *split_in_words(sums.alpha),
        *split_in_words(sums.alpha_x_low),
        *split_in_words(sums.alpha_x_high),
    ]
    return dict(enumerate(words, CLOSED_ROUND_WORD))


def pack_open_round_with_all_senders(sums: Sums, robot_id: int) -> dict[int, int]:
    """Return words 13 to 26 of an image, by index, for a robot whose open round has these sums.

    They are alpha, alpha_x_low, alpha_x_high and x_squared, of two words each, x and the count of one word
    each, and four words of senders. The senders are all ids but the robot's own, ``robot_id``.
    """
    words = [
        *split_in_words(sums.alpha),
        *split_in_words(sums.alpha_x_low),
        *split_in_words(sums.alpha_x_high),
        *split_in_words(sums.x_squared),
        sums.x,
        sums.count,
    ]
    # The senders are a mask with a bit for each id, of which each word has 32.
    all_senders = (1 << (MAX_ID + 1)) - 1
    other_senders = all_senders ^ (1 << robot_id)
    for first_id in range(0, MAX_ID + 1, 32):
        words.append((other_senders >> first_id) & MAX_32_BITS)
    return dict(enumerate(words, OPEN_ROUND_WORD))
