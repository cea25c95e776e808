"""Errors of many kinds, counted in bounded memory: how many, the largest, and a high percentile."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

_BINS_PER_OCTAVE = 16
PERCENTILE = 0.999


@dataclass
class Errors:
    """Absolute values of errors, of which the largest is kept exactly and all others in bins of 4.4 %."""

    count: int = 0
    largest: float = 0.0
    _bins: Counter[int] = field(default_factory=Counter)

    def add(self, error: float) -> None:
        """Count an error. O(1)."""
        size = abs(error)
        self.count += 1
        self.largest = max(self.largest, size)
        if size > 0:
            self._bins[math.floor(_BINS_PER_OCTAVE * math.log2(size))] += 1

    @property
    def percentile(self) -> float:
        """The 99.9 percentile, rounded up by less than 4.5 %; 0 without errors above 0."""
        outside = self.count - math.ceil(PERCENTILE * self.count)
        for index in sorted(self._bins, reverse=True):
            outside -= self._bins[index]
            if outside < 0:
                return min(2.0 ** ((index + 1) / _BINS_PER_OCTAVE), self.largest)
        return 0.0
