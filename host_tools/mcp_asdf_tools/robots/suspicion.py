"""Suspicious estimates: security events, by kind and sender. ``c_ref/ports/node`` has the same in C."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import TypeAlias

from mcp_asdf.fixed_point import alpha_units

WATCHED_AFTER = 32
"""Estimates of a sender before its alpha is watched: that of a robot that has just begun doubles honestly."""


class Suspicion(Enum):
    """Kind of event. The value is its name in reports."""

    CONFLICT = "conflict"
    UNKNOWN = "unknown"
    JUMP = "jump"


MEANINGS = {
    Suspicion.CONFLICT: "another node sends under this node's own id; give one of them another",
    Suspicion.UNKNOWN: "its id is not among those of --allow, so its estimates are dropped",
    Suspicion.JUMP: "its confidence doubled at once: normal after a recalibration and in radio --verify",
}
"""What each kind of event means, for the user."""

Suspicions: TypeAlias = Counter[tuple[Suspicion, int]]
"""Number of suspicious estimates by kind of event and id of the sender."""


class AlphaWatch:
    """Detects when the alpha of a sender, its confidence, jumps to at least twice its last value.

    The first WATCHED_AFTER estimates of a sender are not watched.
    An honest alpha is nearly proportional to the observations behind it, so after k of them it grows by a
    k-th with the next. It doubles at once only if b_hat is re-estimated, or if as many estimates were missed
    as came before. An alpha of at most half the last one is no jump: the sender has begun anew, and its
    estimates are counted from there on. Nodes and the page of a bus count by this rule, as does
    ``check_alpha_jump()`` of ``c_ref/ports/node``; ``docs/threats.md`` states it.
    """

    def __init__(self) -> None:
        """Begin without any sender."""
        self._last_alpha_and_count: dict[int, tuple[int, int]] = {}
        """Last alpha of each sender in units of 2^-24, and its number of estimates since it began, by id."""

    def is_jump(self, sender: int, alpha_word: int) -> bool:
        """Count the next estimate of ``sender``, and return whether its alpha is a jump. O(1).

        It is if it is at least twice the sender's last alpha. The first 32 estimates (``WATCHED_AFTER``) of a
        sender are not watched, and an alpha of at most half the last one starts counting them anew.
        ``alpha_word`` is the alpha as frames' decoders return it: mantissa and shift in 32 bits.
        """
        last_alpha, estimate_count = self._last_alpha_and_count.get(sender, (0, 0))
        # In units alphas can be compared: different words may stand for the same number.
        alpha = alpha_units(alpha_word)
        has_begun_anew = 2 * alpha <= last_alpha
        next_count = 0 if has_begun_anew else estimate_count + 1
        self._last_alpha_and_count[sender] = (alpha, next_count)
        is_watched = estimate_count >= WATCHED_AFTER
        # A last alpha of 0 does no harm here: it has started the count anew, so that nothing is watched.
        has_doubled = alpha >= 2 * last_alpha
        return is_watched and has_doubled
