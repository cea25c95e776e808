"""The t-table as the firmware reads it: a run of 32-bit words with a checksum.

Layout (word index: content), the same on every target::

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
FORMAT_VERSION = 2
FRACTION_BITS = 26
EXTRA_WORDS = 3
"""Words of a table that are no entries: two before them, and the checksum."""
MIN_Q, MAX_Q = 2, 127
MAX_OMEGA_WORD = round(0.9 * 2**32)
MAX_WORD = 2**32 - 1
FNV_OFFSET, FNV_PRIME = 0x811C9DC5, 0x01000193


class TableError(ValueError):
    """The words are not a t-table; the message names the word and the fix."""


@dataclass(frozen=True)
class Table:
    """A t-table.

    Attributes:
        omega_word: Type II error probability omega in units of 2**-32, 1 .. MAX_OMEGA_WORD.
        entries: q words: k for m = 2 .. q, then the entry for m > q; units of 2**-26.
    """

    omega_word: int
    entries: tuple[int, ...]

    @property
    def q(self) -> int:
        """Largest number of messages with an entry of its own."""
        return len(self.entries)

    @property
    def omega(self) -> float:
        """Type II error probability."""
        return self.omega_word / 2**32

    def entry(self, m: int) -> int:
        """k for ``m`` >= 2 messages, in units of 2**-26. O(1)."""
        return self.entries[min(m, self.q + 1) - 2]

    def words(self) -> tuple[int, ...]:
        """The table as the firmware reads it. O(q)."""
        body = (MAGIC | self.q, self.omega_word, *self.entries)
        return (*body, checksum(body))

    @classmethod
    def from_words(cls, words: Sequence[int]) -> Table:
        """Read a table back. Raises TableError if the firmware would refuse it. O(q)."""
        for index, word in enumerate(words):
            if not 0 <= word <= MAX_WORD:
                raise TableError(f"word {index} is {word}, which is no 32-bit word")
        if len(words) < EXTRA_WORDS + MIN_Q:
            raise TableError(f"a table has at least {EXTRA_WORDS + MIN_Q} words, not {len(words)}")
        first, omega_word, *entries, stated = words
        q = first & 0xFF
        if first - q != MAGIC:
            raise TableError(f"word 0 is {first:#010x}, a table starts with {MAGIC:#010x} plus q")
        if not MIN_Q <= q <= MAX_Q:
            raise TableError(f"q = {q} is outside {MIN_Q} .. {MAX_Q}")
        if len(entries) != q:
            raise TableError(f"q = {q} needs {EXTRA_WORDS + q} words, not {len(words)}")
        if not 1 <= omega_word <= MAX_OMEGA_WORD:
            raise TableError(f"omega = {omega_word / 2**32} is outside (0, 0.9]")
        expected = checksum(words[:-1])
        if stated != expected:
            raise TableError(f"checksum is {stated:#010x}, the words give {expected:#010x}")
        _check_order(entries)
        return cls(omega_word, tuple(entries))


def _check_order(entries: Sequence[int]) -> None:
    for index, (left, right) in enumerate(pairwise(entries)):
        if right >= left:
            raise TableError(f"entry {index + 1} is {right}, not below entry {index} ({left})")
    if entries[-1] <= 1 << FRACTION_BITS:
        raise TableError(f"entry {len(entries) - 1} is {entries[-1]}, not above 1.0")


def checksum(words: Sequence[int]) -> int:
    """FNV-1a over 32-bit words instead of bytes. O(len(words))."""
    value = FNV_OFFSET
    for word in words:
        value = (value ^ word) * FNV_PRIME & 0xFFFFFFFF
    return value
