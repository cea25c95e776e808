"""The t-table as the firmware reads it: a run of 32-bit words with a checked header.

Layout (word index: content), the same on every target::

    0  magic, 0x4D435054
    1  format version 1 in bits 24..31, q in bits 16..23, fraction bits F in bits 8..15, zero below
    2  omega in units of 2**-32, rounded to nearest
    3  checksum of all other words
    4  k for m = 2, then m = 3, ..., m = q, and last the entry for every m > q; units of 2**-F

k_m is ``(t_{m-1,(1-omega)/2} / sqrt(m) + 1)**2 * m / (m - 1)`` (eq. 12, squared and multiplied out);
F is the largest for which the first, largest entry still fits 32 bits. Entries fall strictly with m,
from below 64.0, and stay above 1.0. A table takes 16 + 4 q bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

MAGIC = 0x4D435054
FORMAT_VERSION = 1
HEADER_WORDS = 4
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
        fraction_bits: F, 1 .. 31.
        entries: q words: k for m = 2 .. q, then the entry for m > q; units of 2**-F.
    """

    omega_word: int
    fraction_bits: int
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
        """k for ``m`` >= 2 messages, in units of 2**-F. O(1)."""
        return self.entries[min(m, self.q + 1) - 2]

    def words(self) -> tuple[int, ...]:
        """The table as the firmware reads it. O(q)."""
        shape = FORMAT_VERSION << 24 | self.q << 16 | self.fraction_bits << 8
        body = (MAGIC, shape, self.omega_word, *self.entries)
        return (*body[:3], checksum(body), *self.entries)

    @classmethod
    def from_words(cls, words: Sequence[int]) -> Table:
        """Read a table back. Raises TableError if the firmware would refuse it. O(q)."""
        for index, word in enumerate(words):
            if not 0 <= word <= MAX_WORD:
                raise TableError(f"word {index} is {word}, which is no 32-bit word")
        if len(words) < HEADER_WORDS + MIN_Q:
            raise TableError(f"a table has at least {HEADER_WORDS + MIN_Q} words, not {len(words)}")
        magic, shape, omega_word, stated = words[:HEADER_WORDS]
        version, q, fraction_bits = shape >> 24, shape >> 16 & 0xFF, shape >> 8 & 0xFF
        if magic != MAGIC:
            raise TableError(f"word 0 is {magic:#010x}, a table starts with {MAGIC:#010x}")
        if version != FORMAT_VERSION or shape & 0xFF:
            raise TableError(f"word 1 is {shape:#010x}: only format version 1 is known")
        if not MIN_Q <= q <= MAX_Q or not 1 <= fraction_bits <= 31:
            raise TableError(f"q = {q} or fraction bits = {fraction_bits} is out of range")
        if len(words) != HEADER_WORDS + q:
            raise TableError(f"q = {q} needs {HEADER_WORDS + q} words, not {len(words)}")
        if not 1 <= omega_word <= MAX_OMEGA_WORD:
            raise TableError(f"omega = {omega_word / 2**32} is outside (0, 0.9]")
        entries = tuple(words[HEADER_WORDS:])
        expected = checksum((magic, shape, omega_word, *entries))
        if stated != expected:
            raise TableError(f"checksum is {stated:#010x}, the words give {expected:#010x}")
        _check_order(entries, fraction_bits)
        return cls(omega_word, fraction_bits, entries)


def _check_order(entries: Sequence[int], fraction_bits: int) -> None:
    if entries[0] >= 64 << fraction_bits:
        raise TableError(f"entry 0 is {entries[0]}, not below 64.0")
    for index, (left, right) in enumerate(pairwise(entries)):
        if right >= left:
            raise TableError(f"entry {index + 1} is {right}, not below entry {index} ({left})")
    if entries[-1] <= 1 << fraction_bits:
        raise TableError(f"entry {len(entries) - 1} is {entries[-1]}, not above 1.0")


def checksum(words: Sequence[int]) -> int:
    """FNV-1a over 32-bit words instead of bytes. O(len(words))."""
    value = FNV_OFFSET
    for word in words:
        value = (value ^ word) * FNV_PRIME & 0xFFFFFFFF
    return value
