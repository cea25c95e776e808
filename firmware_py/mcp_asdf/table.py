"""The t-table as the firmware reads it: an array of 32-bit words with a checksum.

The table holds the thresholds k_m of the hypothesis test, by which a robot decides whether its own estimate
differs too much from m received ones. omega is the type II error probability of that test, and q the number
of messages up to which a threshold is exact. The layout is the same on every target (word index and
content)::

    0      magic 0x4D4354 ("MCT") in bits 8..31, q in bits 0..7
    1      omega in units of 2**-32, rounded to nearest
    m      k_m for m = 2 .. q, in units of 2**-26
    q + 1  k for every m > q, in the same units
    q + 2  checksum of all other words

k_m is ``(t_{m-1,(1-omega)/2} / sqrt(m) + 1)**2 * m / (m - 1)`` (eq. 12, squared and multiplied out), rounded
to nearest. Entries fall strictly with m, from below 64.0, and stay above 1.0. A table takes 12 + 4 q bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

MAGIC = 0x4D435400
"""Word 0 of every table, without its q."""
FORMAT_VERSION = 2
FRACTION_BITS = 26
"""Entries are in units of 2**-26."""
EXTRA_WORDS = 3
"""Number of words that are no entries: two before the entries, and the checksum."""
MIN_Q = 2
MAX_Q = 127
"""A robot receives from at most 127 others, so no larger q is of use."""
MAX_OMEGA_WORD = round(0.9 * 2**32)
"""Largest omega, 0.9, in units of 2**-32."""
MAX_WORD = 2**32 - 1
FNV_OFFSET = 0x811C9DC5
"""Hash of no words, as FNV-1a defines it."""
FNV_PRIME = 0x01000193
"""Factor by which FNV-1a multiplies the hash at every word."""


class TableError(ValueError):
    """Words that are not a t-table; the message names the first wrong one."""


@dataclass(frozen=True)
class Table:
    """A t-table: the thresholds of the hypothesis test (eq. 12) for one omega, its type II error probability.

    Attributes:
        omega_word: Type II error probability omega in units of 2**-32, 1 .. MAX_OMEGA_WORD.
        entries: Thresholds k_m for m = 2 .. q messages, then one k for every m > q, in units of 2**-26.
            These are q words.
    """

    omega_word: int
    entries: tuple[int, ...]

    @property
    def q(self) -> int:
        """Largest number of messages that has an entry of its own."""
        return len(self.entries)

    @property
    def omega(self) -> float:
        """Type II error probability of the hypothesis test."""
        return self.omega_word / 2**32

    def entry(self, m: int) -> int:
        """Return the threshold k for ``m`` >= 2 messages, in units of 2**-26. O(1).

        All m above q have the same threshold.
        """
        m_of_entry = min(m, self.q + 1)  # the last entry is for every m > q
        return self.entries[m_of_entry - 2]  # the first entry is for m = 2

    def words(self) -> tuple[int, ...]:
        """Return the table as the 32-bit words that the firmware reads. O(q).

        These are "MCT" and q, omega in units of 2**-32, the thresholds, and a checksum.
        """
        body = (MAGIC | self.q, self.omega_word, *self.entries)
        return (*body, checksum(body))

    @classmethod
    def from_words(cls, words: Sequence[int]) -> Table:
        """Make a table from its words. O(q).

        These are 32-bit words: "MCT" and q, omega, the q thresholds, and a checksum. Raises TableError, which
        names the wrong word, if the firmware would refuse the table. All words are checked before
        anything is computed from them, as they may come from a damaged file.
        """
        for index, word in enumerate(words):
            if not 0 <= word <= MAX_WORD:
                raise TableError(f"word {index} is {word}, which is no 32-bit word")
        if len(words) < EXTRA_WORDS + MIN_Q:
            raise TableError(f"a table has at least {EXTRA_WORDS + MIN_Q} words, not {len(words)}")
        magic_and_q, omega_word, *entries, stated_checksum = words
        q = magic_and_q & 0xFF  # the lowest byte; the others are the magic
        # Format and q are checked before the checksum, so that the message names what is wrong.
        if magic_and_q - q != MAGIC:
            raise TableError(f"word 0 is {magic_and_q:#010x}, a table starts with {MAGIC:#010x} plus q")
        if not MIN_Q <= q <= MAX_Q:
            raise TableError(f"q = {q} is outside {MIN_Q} .. {MAX_Q}")
        if len(entries) != q:
            raise TableError(f"q = {q} needs {EXTRA_WORDS + q} words, not {len(words)}")
        if not 1 <= omega_word <= MAX_OMEGA_WORD:
            raise TableError(f"omega = {omega_word / 2**32} is outside (0, 0.9]")
        expected_checksum = checksum(words[:-1])
        if stated_checksum != expected_checksum:
            raise TableError(f"checksum is {stated_checksum:#010x}, the words give {expected_checksum:#010x}")
        _check_order(entries)
        return cls(omega_word, tuple(entries))


def _check_order(entries: Sequence[int]) -> None:
    """Raise TableError unless the thresholds, in units of 2**-26, fall strictly and stay above 1.0."""
    for index, (entry, next_entry) in enumerate(pairwise(entries)):
        if next_entry >= entry:
            raise TableError(f"entry {index + 1} is {next_entry}, not below entry {index} ({entry})")
    if entries[-1] <= 1 << FRACTION_BITS:
        raise TableError(f"entry {len(entries) - 1} is {entries[-1]}, not above 1.0")


def checksum(words: Sequence[int]) -> int:
    """Return the hash FNV-1a, taken over 32-bit words instead of bytes. O(len(words))."""
    hash_value = FNV_OFFSET
    for word in words:
        hash_value = ((hash_value ^ word) * FNV_PRIME) & MAX_WORD
    return hash_value
