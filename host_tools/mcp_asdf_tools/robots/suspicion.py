"""Suspicious estimates: security events, by kind and sender. ``c_ref/ports/node`` has the same in C."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import TypeAlias

from mcp_asdf.fixed_point import alpha_units

WATCHED_AFTER = 32
"""Estimates of a sender before its alpha is watched: one of a robot that has just begun doubles honestly."""


class Suspicion(Enum):
    """Kind of event. The value is its name in reports."""

    CONFLICT = "conflict"
    UNKNOWN = "unknown"
    JUMP = "jump"


MEANINGS = {
    Suspicion.CONFLICT: "another node sends under this node's own id; give one of them another",
    Suspicion.UNKNOWN: "its id is not among those of --allow, so its estimates are dropped",
    Suspicion.JUMP: "its alpha doubled at once: it has recalibrated (its telemetry counts updates), or lies",
}
"""A line on each."""

Suspicions: TypeAlias = Counter[tuple[Suspicion, int]]
"""Estimates by kind of event and sender."""


class AlphaWatch:
    """Finds confidences that jump.

    An honest alpha is nearly proportional to the observations behind it, so after k of them it grows by a
    k-th with the next. It doubles at once only if b_hat is re-estimated, or if as many estimates were missed
    as came before.
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[int, int]] = {}

    def jumps(self, sender: int, alpha: int) -> bool:
        """Take the word ``alpha`` of ``sender``'s next estimate; returns whether it is a jump. O(1)."""
        before, heard = self._known.get(sender, (0, 0))
        now = alpha_units(alpha)
        has_begun_anew = 2 * now <= before
        self._known[sender] = now, 0 if has_begun_anew else heard + 1
        return heard >= WATCHED_AFTER and now >= 2 * before  # after an alpha of 0 nobody is watched
