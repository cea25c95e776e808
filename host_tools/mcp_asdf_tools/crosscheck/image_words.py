"""Which word of a saved robot's image holds what, and how numbers of other sizes than 32 bits are packed.

An image has 31 words of 32 bits (``mcp_asdf_image.c``):

    0         version of the layout, with a flag for the robust filter
    1 .. 6    b_hat, t, n, x_hat, alpha, rounds until the filter runs next
    7 .. 12   sums over the closed round: alpha, alpha_x_low, alpha_x_high, of two words each
    13 .. 22  sums over the open round: the same three and x_squared of two words each, then x and count
    23 .. 26  senders of the open round, a bit for each id
    27        accepted messages (bits 0 to 15), repeated messages (16 to 31)
    28        rejected messages (bits 0 to 15), tests (16 to 31)
    29        updates of b_hat (bits 0 to 15), whether b_hat is newer than x_hat (16 to 23), id (24 to 31)
    30        checksum

With the robust filter words 7 to 11 hold its crowd, the summary of the votes, and words 12 to 22 are 0.
The functions here return words by their index, as ``restore`` calls of a scenario take them.
"""

from __future__ import annotations

from dataclasses import dataclass

from mcp_asdf.robot import MAX_ID, Sums

B_HAT_WORD, T_WORD, N_WORD, X_HAT_WORD, ALPHA_WORD, FILTER_LEFT_WORD = range(1, 7)
CLOSED_ROUND_WORD = 7
"""First word of the sums over the closed round."""
CROWD_WORD = 7
"""First word of the robust filter's crowd, which has the place of those sums."""
FIRST_WORD_AFTER_CROWD = 12
OPEN_ROUND_WORD = 13
"""First word of the sums over the open round."""
SENDERS_WORD = 23
"""First of the four words with a bit for each sender of the open round."""
ACCEPTED_AND_REPEATED_WORD, REJECTED_AND_TESTS_WORD = 27, 28
UPDATES_AND_ID_WORD = 29

MAX_16_BITS, MAX_32_BITS = 0xFFFF, 0xFFFFFFFF
"""Largest number of 16 and of 32 bits."""


@dataclass
class CrowdWords:
    """The robust filter's crowd, its summary of the received x_hat, which are its votes.

    The attributes are in the order of an image's words; the last two share a word.

    Attributes:
        centre: Centre of the votes, in units of 2**-30.
        spread: Median distance of the votes from the centre, in units of 2**-30.
        voices: Senders of the votes, with a bit for each id modulo 32.
        initial_b_hat: Accuracy that the robot assumed at its start, in units of 2**-32.
        votes: Number of votes.
        trend: Share of the recent moves of the centre that went up, in units of 2**-16.
    """

    centre: int
    spread: int
    voices: int
    initial_b_hat: int
    votes: int
    trend: int

    def pack(self) -> dict[int, int]:
        """Return the crowd as words 7 to 11 of an image."""
        votes_and_trend = pack_pair(self.votes, self.trend)
        words = [self.centre, self.spread, self.voices, self.initial_b_hat, votes_and_trend]
        return dict(enumerate(words, CROWD_WORD))


def pack_pair(low_half: int, high_half: int) -> int:
    """Return a word of two numbers of 16 bits."""
    return low_half | (high_half << 16)


def pack_updates_and_id(robot_id: int, updated: int = 0, updates: int = 0) -> int:
    """Return word 29 of an image.

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
    """Return sums as those of the closed round, words 7 to 12. It keeps no squares, x and count."""
    words = [
        *split_in_words(sums.alpha),
        *split_in_words(sums.alpha_x_low),
        *split_in_words(sums.alpha_x_high),
    ]
    return dict(enumerate(words, CLOSED_ROUND_WORD))


def pack_open_round_from_all(sums: Sums, robot_id: int) -> dict[int, int]:
    """Return sums as those of the open round, words 13 to 26, in which all robots but ``robot_id`` sent."""
    words = [
        *split_in_words(sums.alpha),
        *split_in_words(sums.alpha_x_low),
        *split_in_words(sums.alpha_x_high),
        *split_in_words(sums.x_squared),
        sums.x,
        sums.count,
    ]
    all_senders = (1 << (MAX_ID + 1)) - 1
    other_senders = all_senders ^ (1 << robot_id)
    sender_words = [(other_senders >> first_id) & MAX_32_BITS for first_id in range(0, MAX_ID + 1, 32)]
    return dict(enumerate([*words, *sender_words], OPEN_ROUND_WORD))


def pack_sender(sender: int) -> dict[int, int]:
    """Return the word of the open round's senders that has the bit of this id, with no other bit set."""
    return {SENDERS_WORD + sender // 32: 1 << (sender % 32)}
